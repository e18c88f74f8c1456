"""Small planning problems in closed form, most of them with an exactly known optimum.

Every problem has the form of the real objective, J = length + w * integral of the impact along the length, with
impact >= 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem


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


def analytic_problems() -> dict[str, AnalyticProblem]:
    """Build the two-dimensional problems with a known optimum, by name."""
    every = (free_space(), free_space(density=2.0), disc(), two_media(), hyperbolic(), catenary())
    return {instance.name: instance for instance in every}
