"""Chunks of a sweep and their outcomes: the types that work, journal and executors share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Rows = dict[str, list[dict[str, Any]]]
"""Rows of the dataset's tables, by the table's name; JSON values only."""


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """A part of a sweep that one call computes: some rollouts of one fault on one motion.

    Args:
        index: Index in the sweep.
        motion: Index of the motion.
        fault: Index of the fault.
        first: First rollout, counted within motion and fault.
        last: Rollout after the last one.
        name: Name for messages.
    """

    index: int
    motion: int
    fault: int
    first: int
    last: int
    name: str


@dataclass(frozen=True, kw_only=True)
class ChunkOutcome:
    """Outcome of a chunk: its rows, or an error."""

    chunk: Chunk
    rows: Rows | None = None
    error: str = ""


Work = Callable[[Chunk], Rows]
"""Computes a chunk. Must be picklable, since it is sent to other processes; its rows must depend on the chunk alone."""


def attempt(work: Work, chunk: Chunk) -> ChunkOutcome:
    """Compute a chunk; an exception becomes the outcome's error, prefixed with the chunk's name."""
    try:
        return ChunkOutcome(chunk=chunk, rows=work(chunk))
    except Exception as error:
        return ChunkOutcome(chunk=chunk, error=f"{chunk.name}: {type(error).__name__}: {error}")
