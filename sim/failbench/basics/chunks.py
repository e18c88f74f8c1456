"""What a sweep is cut into, and what doing one piece gives: the words that work, journal and executors share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Rows = dict[str, list[dict[str, Any]]]
"""Rows of the dataset's tables, by the table's name; JSON values only."""


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """A piece of a sweep that is done in one go: some rollouts of one fault on one motion.

    Args:
        index: Place in the sweep.
        motion: Index of the motion.
        fault: Index of the fault.
        first: The first of the rollouts, counted within motion and fault.
        last: The one after the last.
        name: What it is called in messages.
    """

    index: int
    motion: int
    fault: int
    first: int
    last: int
    name: str


@dataclass(frozen=True, kw_only=True)
class ChunkOutcome:
    """How a chunk ended: with rows, or with an error."""

    chunk: Chunk
    rows: Rows | None = None
    error: str = ""


Work = Callable[[Chunk], Rows]
"""Does a chunk. It is sent to other processes, so it must be picklable; its rows must depend on the chunk alone."""


def attempt(work: Work, chunk: Chunk) -> ChunkOutcome:
    """Do a chunk and report how it ended; whatever is raised becomes the outcome's error, with the chunk's name."""
    try:
        return ChunkOutcome(chunk=chunk, rows=work(chunk))
    except Exception as error:
        return ChunkOutcome(chunk=chunk, error=f"{chunk.name}: {type(error).__name__}: {error}")
