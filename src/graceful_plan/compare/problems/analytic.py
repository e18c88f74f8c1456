"""Small planning problems defined by functions, some with an exactly known optimum.

They serve to test and compare planners without a robot. Planners access only `Problem` and `BoundObjective`, so a
planner that solves these can also plan for an arm. Every analytic problem has the form of the real objective,
J = length + w * integral of the impact along the length, with impact >= 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, finite_array
from graceful_plan.planners.planner import Problem

Array = np.ndarray
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
        if not 0.0 <= self.w < np.inf:
            raise SettingError("w", self.w, "a finite number >= 0")
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


def mechanical_work(density: Density, path: Path, step: float = 0.01) -> float:
    """Sum the increases of `density` along a path, the quantity that T-RRT keeps low.

    References:
        [Jaillet2010] Sampling-based path planning on configuration-space costmaps, Sec. III.
    """
    cost = density(path.resampled(step).q)
    return float(np.maximum(0.0, np.diff(cost)).sum())


@dataclass(frozen=True, kw_only=True, eq=False)
class AnalyticProblem:
    """A problem with a known optimum.

    Args:
        name: Name of the problem.
        problem: Start, goals, limits and obstacles.
        objective: Cost function.
        optimum: Least total cost J*, exact.
        note: Reason why the optimum is exact.
    """

    name: str
    problem: FunctionProblem
    objective: DensityObjective
    optimum: float
    note: str


def _free_of_impact(q: Array) -> Array:
    return np.zeros(len(q))


def free_space(dimension: int = 2, density: float = 0.0, w: float = 1.0) -> AnalyticProblem:
    """Return a problem without obstacles and with constant impact: J* = (1 + w density) |goal - start|."""
    start, goal = np.full(dimension, -1.0), np.full(dimension, 0.5)
    problem = FunctionProblem(
        start=start, goals=goal[None], lower=np.full(dimension, -2.0), upper=np.full(dimension, 2.0)
    )
    return AnalyticProblem(
        name="free_space" if density == 0.0 else "uniform_density",
        problem=problem,
        objective=DensityObjective(density=lambda q: np.full(len(q), density), gradient=np.zeros_like, w=w),
        optimum=(1.0 + w * density) * float(np.linalg.norm(goal - start)),
        note="a straight line is shortest and the density is the same everywhere",
    )


def _segments_miss_ball(q0: Array, q1: Array, radius: float) -> Array:
    """Return whether segments avoid the open ball around the origin, exactly."""
    direction = q1 - q0
    squared = np.einsum("ij,ij->i", direction, direction)
    t = np.clip(-np.einsum("ij,ij->i", q0, direction) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return np.linalg.norm(q0 + t[:, None] * direction, axis=1) >= radius


def _outside_ball(q: Array, radius: float) -> tuple[Array, Array]:
    """Return the distance from a ball around the origin, and its gradient."""
    distance = np.linalg.norm(q, axis=1)
    return distance - radius, q / np.where(distance > 0.0, distance, 1.0)[:, None]


def disc(dimension: int = 2) -> AnalyticProblem:
    """Return the problem of a path around a unit ball, from -2 to 2 on the first axis: two tangents and an arc."""
    distance, radius = 2.0, 1.0
    start = np.zeros(dimension)
    start[0] = -distance
    problem = FunctionProblem(
        start=start,
        goals=-start[None],
        lower=np.full(dimension, -3.0),
        upper=np.full(dimension, 3.0),
        free=lambda q: np.linalg.norm(q, axis=1) >= radius,
        edge_free=lambda q0, q1: _segments_miss_ball(q0, q1, radius),
        clearance=lambda q: _outside_ball(q, radius),
    )
    tangents = 2.0 * np.sqrt(distance**2 - radius**2)
    arc = radius * (np.pi - 2.0 * np.arccos(radius / distance))
    return AnalyticProblem(
        name="disc",
        problem=problem,
        objective=DensityObjective(density=_free_of_impact, gradient=np.zeros_like),
        optimum=float(tangents + arc),
        note="taut string around a ball; 4.511299",
    )


def two_media(dimension: int = 2) -> AnalyticProblem:
    """Return the problem from (0, 1) to (2, -1), from a medium of cost 1 (y >= 0) to one of cost 3: Snell's law."""
    start, goal = np.zeros(dimension), np.zeros(dimension)
    start[:2], goal[:2] = (0.0, 1.0), (2.0, -1.0)
    problem = FunctionProblem(
        start=start, goals=goal[None], lower=np.full(dimension, -2.0), upper=np.full(dimension, 3.0)
    )
    return AnalyticProblem(
        name="two_media",
        problem=problem,
        objective=DensityObjective(density=lambda q: np.where(q[:, 1] >= 0.0, 0.0, 2.0)),
        optimum=5.104400242840104,
        note="refraction at x = 1.700040, sines in the ratio 3",
    )


def _along_y(slope: Array) -> Array:
    """Return the gradient in the plane of a function of y."""
    return np.stack([np.zeros_like(slope), slope], axis=1)


def hyperbolic() -> AnalyticProblem:
    """Return the problem from (0, 1/2) to (1, 1/2) for the cost 1/y, the hyperbolic half-plane: a circular arc.

    The metric is invariant to scale, so this is (0, 1) to (2, 1) at half size. At this size 1/y >= 1 holds in the
    whole domain, so the impact 1/y - 1 is never negative.
    """
    problem = FunctionProblem(
        start=np.array([0.0, 0.5]),
        goals=np.array([[1.0, 0.5]]),
        lower=np.array([-0.5, 0.1]),
        upper=np.array([1.5, 1.0]),
    )
    return AnalyticProblem(
        name="hyperbolic",
        problem=problem,
        objective=DensityObjective(
            density=lambda q: np.maximum(0.0, 1.0 / q[:, 1] - 1.0),
            gradient=lambda q: _along_y(np.where(q[:, 1] < 1.0, -1.0 / q[:, 1] ** 2, 0.0)),
            step=0.005,
        ),
        optimum=float(np.arccosh(3.0)),
        note="arccosh(1 + |goal - start|^2 / (2 y0 y1)); 1.762747",
    )


def catenary() -> AnalyticProblem:
    """Return the problem from (-1, 2) to (1, 2) for the cost y: a catenary."""
    problem = FunctionProblem(
        start=np.array([-1.0, 2.0]),
        goals=np.array([[1.0, 2.0]]),
        lower=np.array([-2.0, 1.0]),
        upper=np.array([2.0, 3.0]),
    )
    return AnalyticProblem(
        name="catenary",
        problem=problem,
        objective=DensityObjective(
            density=lambda q: np.maximum(0.0, q[:, 1] - 1.0),
            gradient=lambda q: _along_y(np.where(q[:, 1] > 1.0, 1.0, 0.0)),
        ),
        optimum=3.8144964268080104,
        note="y = c cosh(x / c) with c = 1.696676",
    )


def saddle_density(q: Float[Array, "n nq"]) -> Float[Array, " n"]:
    """Return the impact of `saddle`: a ridge of height 4 along x = 0 with a pass of height 1 at y = 1."""
    ridge = np.exp(-0.5 * (q[:, 0] / 0.35) ** 2)
    gate = np.exp(-0.5 * ((q[:, 1] - 1.0) / 0.3) ** 2)
    return ridge * (4.0 - 3.0 * gate)


def _saddle_gradient(q: Array) -> Array:
    x, y = q[:, 0], q[:, 1]
    ridge = np.exp(-0.5 * (x / 0.35) ** 2)
    gate = np.exp(-0.5 * ((y - 1.0) / 0.3) ** 2)
    return np.stack([-x / 0.35**2 * ridge * (4.0 - 3.0 * gate), ridge * 3.0 * gate * (y - 1.0) / 0.3**2], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class SaddleProblem:
    """Two basins joined by a pass: the least mechanical work is known, the least total cost is not.

    Args:
        problem: Problem from one basin to the other.
        objective: Length plus impact.
        least_work: Height of the pass above the start.
    """

    problem: FunctionProblem
    objective: DensityObjective
    least_work: float


def saddle(scale: float = 1.0, offset: float = 0.0) -> SaddleProblem:
    """Return the problem across a ridge from (-1.5, 0) to (1.5, 0), with the pass off the straight line.

    Every path crosses x = 0, where the impact is at least 1, so its work is at least 1 - impact(start).

    Args:
        scale: Factor of the impact.
        offset: Constant added to the impact.
    """
    start = np.array([-1.5, 0.0])
    problem = FunctionProblem(start=start, goals=-start[None], lower=np.array([-2.0, -2.0]), upper=np.array([2.0, 2.0]))
    return SaddleProblem(
        problem=problem,
        objective=DensityObjective(
            density=lambda q: scale * saddle_density(q) + offset, gradient=lambda q: scale * _saddle_gradient(q)
        ),
        least_work=scale * (1.0 - float(saddle_density(start[None])[0])),
    )


def analytic_problems() -> dict[str, AnalyticProblem]:
    """Build the two-dimensional problems with a known optimum, by name."""
    every = (free_space(), free_space(density=2.0), disc(), two_media(), hyperbolic(), catenary())
    return {instance.name: instance for instance in every}
