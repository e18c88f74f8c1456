"""Directed graphs with edge costs: cheapest paths and Pareto fronts of two costs, in the native core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.setting_checks import not_negative


@final
@dataclass(frozen=True, eq=False)
class GraphFront:
    """Non-dominated paths by ascending first cost."""

    edges: tuple[Int[Array, " _"], ...]
    """Ids of the edges along each path."""
    cost: Float[Array, "path 2"]
    """Both costs of each path."""
    complete: bool
    """Whether the search finished in time; if not, paths of low second cost are missing."""


@final
class Graph:
    """A directed graph; loops and parallel edges are allowed.

    Args:
        n: Number of nodes.
        tail: Node that each edge leaves.
        head: Node that each edge enters.
    """

    def __init__(self, n: int, tail: ArrayLike, head: ArrayLike) -> None:
        self.n, self.tail, self.head = n, _nodes("tail", tail, n), _nodes("head", head, n)
        if self.tail.shape != self.head.shape:
            raise ShapeError("head", self.head.shape, f"that of tail, {self.tail.shape}")
        self._native = _native.GraphSearch(n, self.tail, self.head)

    def cheapest(self, cost: ArrayLike, start: int, goals: ArrayLike) -> tuple[Int[Array, " step"], float]:
        """Find the cheapest path from `start` to any of `goals`, by Dijkstra's algorithm.

        Args:
            cost: Cost of each edge, at least 0; edges of infinite cost are ignored.
            start: Start node.
            goals: Goal nodes.

        Returns:
            Ids of the edges along the path, and its cost; empty and infinity if there is no path.
        """
        costs = self._costs(cost, ())
        return self._native.cheapest(costs, int(_nodes("start", [start], self.n)[0]), _nodes("goals", goals, self.n))

    def front(
        self, cost: ArrayLike, start: int, goals: ArrayLike, epsilon: float = 0.0, seconds: float = np.inf
    ) -> GraphFront:
        """Find all non-dominated paths from `start` to any of `goals`; one of several with equal costs.

        Args:
            cost: Two costs of each edge [edge, 2], at least 0.
            start: Start node.
            goals: Goal nodes.
            epsilon: 0 for all paths. Otherwise the result has, for every path, one with at most its first cost and at
                most `1 + epsilon` times its second cost.
            seconds: Time limit [s].

        References:
            Hernandez Ulloa et al., "A simple and fast bi-objective search algorithm", ICAPS 2020.
        """
        not_negative("epsilon", epsilon)
        if not seconds >= 0.0:
            raise SettingError("seconds", seconds, "a time of at least 0 s")
        costs = self._costs(cost, (2,))
        ends = int(_nodes("start", [start], self.n)[0]), _nodes("goals", goals, self.n)
        paths, found, complete = self._native.front(costs, *ends, float(epsilon), float(seconds))
        return GraphFront(tuple(paths), found, complete)

    def _costs(self, cost: ArrayLike, of_each: tuple[int, ...]) -> Array:
        costs = np.ascontiguousarray(cost, dtype=np.float64)
        if costs.shape != (len(self.tail), *of_each):
            raise ShapeError("cost", costs.shape, str((len(self.tail), *of_each)))
        if not (costs >= 0.0).all():  # also catches NaN
            raise SettingError("cost", float(costs[~(costs >= 0.0)][0]), "numbers of at least 0")
        return costs


def non_dominated(cost: Float[Array, "n 2"]) -> Int[Array, " kept"]:
    """Return the indices of non-dominated rows by ascending first cost; the first of equal rows."""
    order = np.lexsort((np.arange(len(cost)), cost[:, 1], cost[:, 0]))
    second = cost[order, 1]
    least_before = np.concatenate([[np.inf], np.minimum.accumulate(second)[:-1]])
    return order[second < least_before]


def spread_out(cost: Float[Array, "n 2"], kept: Int[Array, " kept"], most: int | None) -> Int[Array, " chosen"]:
    """Choose at most `most` points of a front: its ends, then repeatedly the point farthest from the chosen ones.

    Args:
        cost: Points.
        kept: Indices of the front, in its order.
        most: Largest number of points to choose; None for all.
    """
    if most is None or len(kept) <= most:
        return kept
    points = cost[kept]
    points = (points - points.min(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-300)
    chosen = [0, len(kept) - 1][:most]
    while len(chosen) < most:
        away = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(away)))
    return kept[np.sort(chosen)]


def _nodes(name: str, nodes: ArrayLike, n: int) -> Int[Array, " k"]:
    array = np.ascontiguousarray(nodes, dtype=np.int32)
    if array.ndim != 1:
        raise ShapeError(name, array.shape, "(k,)")
    bad = array[(array < 0) | (array >= n)]
    if len(bad):
        raise SettingError(name, int(bad[0]), f"a node from 0 to {n - 1}")
    return array
