"""The incumbent of an optimiser: its best free path, which also moves towards better paths that are not free."""

from __future__ import annotations

from collections.abc import Iterator
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.path import Path, evenly
from graceful_plan.planners.interruptible import InterruptibleProblem

_LEAST_GAIN = 1e-6
"""Relative decrease of J that counts as an improvement."""
_BLENDS = 8
"""Largest number of times that a colliding path is moved towards the incumbent before it is discarded."""
_BLEND_SPAN = 6.0
"""Number of edges over which the blend returns to the colliding path."""


def with_edges(path: Path, edges: int) -> Float[Array, "point nq"]:
    """Return the path with a given number of edges: vertices are kept, and long edges are divided evenly.

    A path with more edges is resampled evenly, which cuts its corners.
    """
    q = path.without_duplicates().q
    lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
    if len(q) < 2:
        return q
    if len(lengths) > edges:
        return evenly(q, edges + 1)
    pieces = np.ones(len(lengths), dtype=int)
    for _ in range(edges - len(lengths)):
        pieces[np.argmax(lengths / pieces)] += 1
    parts = [a + np.arange(k)[:, None] / k * (b - a) for a, b, k in zip(q[:-1], q[1:], pieces, strict=True)]
    return np.concatenate([*parts, q[-1:]])


@final
class Incumbent:
    """The best-known free path; all paths have the same number of edges.

    Args:
        path: Initial path; if it is not free, any free path is better.
        edges: Number of edges of all paths.
        questions: Access to problem and objective.
    """

    def __init__(self, path: Path, edges: int, questions: InterruptibleProblem) -> None:
        self._questions = questions
        self.q = with_edges(path, edges)
        self.free = self.is_free(self.q)
        """Whether `q` is free; the initial path may not be, or not after cutting its corners."""
        self.total = np.inf
        """Best-known J."""
        if questions.edges_free(
            path.q[:-1], path.q[1:]
        ).all():  # at the problem's check step, at which the path was found
            self.total = questions.path_cost(path)

    def offer(self, q: Float[Array, "point nq"], total: float) -> Iterator[Path]:
        """Adopt and yield a path of cost `total` if it is better and free."""
        if self._is_better(total) and self._edges_free(q).all():
            yield self._take(q, total)

    def approach(self, q: Float[Array, "point nq"], total: float) -> Iterator[Path]:
        """Adopt and yield a path of cost `total` if it is better; if it is not free, a blend with the incumbent."""
        if not self._is_better(total):
            return
        reached = self._free_part(q)
        if reached is not None:
            total = self._questions.path_cost(Path(reached))
            if self._is_better(total):
                yield self._take(reached, total)

    def _is_better(self, total: float) -> bool:
        return total < self.total * (1.0 - _LEAST_GAIN)

    def _take(self, q: Array, total: float) -> Path:
        self.q, self.total, self.free = q, total, True
        return Path(q)

    def _free_part(self, q: Float[Array, "point nq"]) -> Float[Array, "point nq"] | None:
        """Move points of blocked edges towards the incumbent, and their neighbours less, until all edges are free."""
        share = np.ones(len(q))
        for _ in range(_BLENDS):
            blend = self.q + share[:, None] * (q - self.q)
            blocked = np.flatnonzero(~self._edges_free(blend))
            if not len(blocked):
                return blend
            if not self.free:
                return None
            away = _edges_away(len(q), blocked)
            drawn = 0.5 * share[np.concatenate([blocked, blocked + 1])].min()
            share = np.where(away == 0, 0.5 * share, np.minimum(share, drawn + away / _BLEND_SPAN))
        return None

    def is_free(self, q: Float[Array, "point nq"]) -> bool:
        """Return whether all edges of a path are free."""
        return bool(self._edges_free(q).all())

    def _edges_free(self, q: Float[Array, "point nq"]) -> Bool[Array, " edge"]:
        """Return which edges are free, at the fine step of the final check."""
        free = self._questions.edges_free(q[:-1], q[1:])
        if not free.all() or not len(free):
            return free
        pieces = np.maximum(1, np.ceil(np.linalg.norm(np.diff(q, axis=0), axis=1) / FINE_STEP).astype(int))
        edge = np.repeat(np.arange(len(pieces)), pieces)
        first = np.cumsum(pieces) - pieces
        place = (np.arange(len(edge)) - first[edge])[:, None]
        step = np.diff(q, axis=0)[edge] / pieces[edge][:, None]
        begin = q[edge] + place * step
        return np.logical_and.reduceat(self._questions.edges_free(begin, begin + step), first)


def _edges_away(points: int, blocked: Int[Array, " n"]) -> Int[Array, " point"]:
    """Return the distance of each point from the nearest blocked edge in edges; 0 for the ends of blocked edges."""
    i = np.arange(points)[:, None]
    return np.maximum(0, np.maximum(blocked - i, i - blocked - 1)).min(axis=1)
