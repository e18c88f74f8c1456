"""The best free path of an optimiser, and what of a better one that is not free can be had."""

from __future__ import annotations

from collections.abc import Iterator
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.path import Path
from graceful_plan.planners.questions import Questions
from graceful_plan.planners.resampling import evenly

Array = np.ndarray

_LEAST_GAIN = 1e-6
"""Relative fall of J that counts as an improvement."""
_BLENDS = 8
"""Times that a path is drawn back from what it hits before it is given up."""
_BLEND_SPAN = 6.0
"""Edges over which it returns to where it wants to be."""


def with_edges(path: Path, edges: int) -> Float[Array, "point nq"]:
    """Return the same path with that many edges: vertices stay, the longest edges are halved, cut in three and so on.

    A path of more edges than that is sampled evenly, and cuts its corners.
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
    """The best free path so far, with as many points as those that come after it.

    Args:
        path: The path to begin with; if it is not free, any free path is better.
        edges: How many edges all paths have.
        questions: To problem and objective.
    """

    def __init__(self, path: Path, edges: int, questions: Questions) -> None:
        self._questions = questions
        self.q = with_edges(path, edges)
        self.free = self.is_free(self.q)
        """Whether `q` is free: the path to begin with may not be, or not with its corners cut."""
        self.total = np.inf
        """J to be undercut."""
        if questions.edges_free(
            path.q[:-1], path.q[1:]
        ).all():  # by the problem's own measure, that of whoever found it
            self.total = questions.path_cost(path)

    def offer(self, q: Float[Array, "point nq"], total: float) -> Iterator[Path]:
        """Take a path of cost `total`, and yield it, if it is better and free."""
        if self._is_better(total) and self._edges_free(q).all():
            yield self._take(q, total)

    def approach(self, q: Float[Array, "point nq"], total: float) -> Iterator[Path]:
        """Take a path of cost `total` if it is better; if it is not free, as much of it as is."""
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
        """Draw the points of edges that are not free back towards the incumbent, their neighbours less."""
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
        """Tell whether all edges of a path are free."""
        return bool(self._edges_free(q).all())

    def _edges_free(self, q: Float[Array, "point nq"]) -> Bool[Array, " edge"]:
        """Tell which edges are free, also where paths are looked at last: at a fine step."""
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
    """How many edges each point is away from the nearest blocked edge; 0 for its own ends."""
    i = np.arange(points)[:, None]
    return np.maximum(0, np.maximum(blocked - i, i - blocked - 1)).min(axis=1)
