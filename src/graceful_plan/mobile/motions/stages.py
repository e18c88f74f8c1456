"""Stages of a base's path: rolling in one gear, turning in place, moving the arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import groupby

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path

_STILL = 1e-9
"""Displacement below which a joint counts as standing still [rad or m]."""
_SHARP = 0.6 * np.pi
"""Turns in place above this stay separate stages, as no smooth curve near them pays off [rad]."""


class Move(Enum):
    """Kind of motion along an edge of a path."""

    FORWARD = "forward"
    BACKWARD = "backward"
    TURN = "turn"
    ARM = "arm"


@dataclass(frozen=True, eq=False)
class DriveStage:
    """Consecutive edges that one stretch of a drive replaces.

    Args:
        kind: Kind of motion; turns between two moves in one gear are included in their stage.
        q: Vertices of the edges.
    """

    kind: Move
    q: Float[Array, "vertex nq"]


def stages(path: Path) -> list[DriveStage]:
    """Divide a path of straight stretches and turns in place into stages.

    Turns between two moves in one gear are left to the curve that replaces both, unless they are sharp.
    """
    kinds = [_kind(a, b) for a, b in zip(path.q[:-1], path.q[1:], strict=True)]
    turning = np.abs(np.diff(path.q[:, 2]))
    merged = list(kinds)
    for first, last in _runs(kinds, Move.TURN):
        rolls = 0 < first and last < len(kinds) and kinds[first - 1] is kinds[last]
        if rolls and kinds[last] in (Move.FORWARD, Move.BACKWARD) and turning[first:last].sum() < _SHARP:
            merged[first:last] = [kinds[last]] * (last - first)
    found, begin = [], 0
    for kind, group in groupby(merged):
        end = begin + len(list(group))
        found.append(DriveStage(kind, path.q[begin : end + 1]))
        begin = end
    return found


def _kind(a: Float[Array, " nq"], b: Float[Array, " nq"]) -> Move:
    way = b - a
    if np.abs(way[:2]).max() > _STILL:
        heading = 0.5 * (a[2] + b[2])
        return Move.FORWARD if way[0] * np.cos(heading) + way[1] * np.sin(heading) > 0.0 else Move.BACKWARD
    return Move.TURN if abs(way[2]) > _STILL else Move.ARM


def _runs(kinds: list[Move], kind: Move) -> Iterator[tuple[int, int]]:
    """Yield begin and end of unbroken runs of a kind."""
    begin = 0
    for found, group in groupby(kinds):
        end = begin + len(list(group))
        if found is kind:
            yield begin, end
        begin = end
