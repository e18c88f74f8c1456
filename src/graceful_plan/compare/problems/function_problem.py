"""Planning problems and objectives defined by functions, to test and compare planners without a robot.

Planners access only `Problem` and `BoundObjective`, so a planner that solves these can also plan for an arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.planners.planner import Problem
from graceful_plan.setting_checks import not_negative

StateTest = Callable[[Array], Array]
"""Whether configurations [n, nq] are free: bool [n]."""
EdgeTest = Callable[[Array, Array], Array]
"""Whether straight edges between configurations [n, nq] are free: bool [n]."""
Density = Callable[[Array], Array]
"""Impact per unit of joint-space length at configurations [n, nq]: float [n], >= 0."""
DensityGradient = Callable[[Array], Array]
"""Derivative of a density at configurations [n, nq]: float [n, nq]."""
Clearance = Callable[[Array], tuple[Array, Array]]
"""Signed distance from obstacles at configurations [n, nq], positive outside, and its gradient: [n], [n, nq]."""


class _Pieces(NamedTuple):
    """Points along edges, ends included."""

    q: Float[Array, "points nq"]
    t: Float[Array, " points"]
    """Fraction of the edge before each point."""
    weight: Float[Array, " points"]
    """Trapezoid weight, as a fraction of the edge's length."""
    edge: Int[Array, " points"]
    """Index of the edge of each point."""
    begin: Int[Array, " n"]
    """Index of the first point of each edge."""


def _pieces(q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], step: float) -> _Pieces:
    """Subdivide each edge independently of the others in the batch."""
    count = np.maximum(1, np.ceil(np.linalg.norm(q1 - q0, axis=1) / step).astype(int))
    begin = np.concatenate([[0], np.cumsum(count + 1)[:-1]]) if len(count) else np.zeros(0, dtype=int)
    edge = np.repeat(np.arange(len(count)), count + 1)
    place = np.arange(len(edge)) - begin[edge]
    t = place / count[edge]
    is_end = (place == 0) | (place == count[edge])
    weight = np.where(is_end, 0.5, 1.0) / count[edge]
    return _Pieces((1.0 - t)[:, None] * q0[edge] + t[:, None] * q1[edge], t, weight, edge, begin)


def _sums(values: Float[Array, "points ..."], pieces: _Pieces) -> Float[Array, "n ..."]:
    """Sum values over the points of each edge."""
    return np.add.reduceat(values, pieces.begin, axis=0) if len(pieces.begin) else values[:0]


def _everywhere(q: Array) -> Array:
    return np.ones(len(q), dtype=bool)


@dataclass(frozen=True, kw_only=True, eq=False)
class FunctionProblem(Problem):
    """A problem with obstacles defined by functions.

    Args:
        start: Start of the path.
        goals: Goals of the path, at least one.
        lower: Lower limit per joint.
        upper: Upper limit per joint.
        free: Test of configurations; all are free by default.
        edge_free: Exact test of straight edges. By default edges are sampled at `step` with `free`.
        clearance: Signed distance from the obstacles, if known; needed by planners that use its gradient.
        step: Distance between checked points of an edge [rad].
    """

    start: Float[Array, " nq"]
    goals: Float[Array, "goal nq"]
    lower: Float[Array, " nq"]
    upper: Float[Array, " nq"]
    free: StateTest = _everywhere
    edge_free: EdgeTest | None = None
    clearance: Clearance | None = None
    step: float = 0.02

    def __post_init__(self) -> None:
        start = finite_array("start", self.start, ndim=1)
        object.__setattr__(self, "start", start)
        object.__setattr__(self, "goals", finite_array("goals", self.goals, ndim=2, last=len(start)))
        for name in ("lower", "upper"):
            object.__setattr__(self, name, finite_array(name, getattr(self, name), ndim=1, last=len(start)))
        if len(self.goals) == 0:
            raise SettingError("goals", self.goals, "at least one goal")
        if not np.all(self.lower <= self.upper):
            raise SettingError("lower", self.lower, f"at most upper = {self.upper}")
        if not self.step > 0.0:
            raise SettingError("step", self.step, "a number > 0 [rad]")

    def states_free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return whether configurations are free of obstacles."""
        return np.asarray(self.free(q), dtype=bool)

    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return whether straight edges are free of obstacles."""
        if self.edge_free is not None:
            return np.asarray(self.edge_free(q0, q1), dtype=bool)
        if self.free is _everywhere:
            return np.ones(len(q0), dtype=bool)
        pieces = _pieces(q0, q1, self.step)
        free = self.states_free(pieces.q)
        return np.logical_and.reduceat(free, pieces.begin) if len(pieces.begin) else free

    def clearance_gradient(self, q: Float[Array, "n nq"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]] | None:
        """Return the signed distance from the obstacles and its gradient, None if unknown."""
        return None if self.clearance is None else self.clearance(q)


@dataclass(frozen=True, kw_only=True, eq=False)
class DensityObjective:
    """Joint-space length plus a weighted line integral of an impact density, by the trapezoid rule.

    Args:
        density: Impact per unit of length, >= 0.
        gradient: Derivative of the density, if known.
        w: Safety weight, >= 0.
        step: Largest step of the trapezoid rule [rad].
    """

    density: Density
    gradient: DensityGradient | None = None
    w: float = 1.0
    step: float = 0.01

    def __post_init__(self) -> None:
        not_negative("w", self.w)
        if not self.step > 0.0:
            raise SettingError("step", self.step, "a number > 0 [rad]")

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        """Return length V and impact S of each straight edge."""
        pieces, length = _pieces(q0, q1, self.step), np.linalg.norm(q1 - q0, axis=1)
        return np.stack([length, length * _sums(pieces.weight * self.states(pieces.q), pieces)], axis=1)

    def states(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return the impact density at each configuration."""
        return np.asarray(self.density(q), dtype=np.float64)

    def edge_gradients(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]
    ) -> tuple[Float[Array, "n 2"], Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return `edges` and the derivatives of V + w S by both ends; None if the density has no gradient."""
        if self.gradient is None:
            return None
        pieces, length = _pieces(q0, q1, self.step), np.linalg.norm(q1 - q0, axis=1)
        mean = _sums(pieces.weight * self.states(pieces.q), pieces)
        slope = (pieces.weight * length[pieces.edge])[:, None] * np.asarray(self.gradient(pieces.q))
        unit = (q1 - q0) / np.where(length > 0.0, length, 1.0)[:, None]
        longer = (1.0 + self.w * mean)[:, None] * unit
        d_q0 = self.w * _sums((1.0 - pieces.t)[:, None] * slope, pieces) - longer
        d_q1 = self.w * _sums(pieces.t[:, None] * slope, pieces) + longer
        return np.stack([length, length * mean], axis=1), d_q0, d_q1
