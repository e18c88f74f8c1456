"""A planning problem across a saddle, whose least mechanical work is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.compare.problems.function_problem import Density, DensityObjective, FunctionProblem
from graceful_plan.path import Path

Array = np.ndarray


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


def mechanical_work(density: Density, path: Path, step: float = 0.01) -> float:
    """Sum the increases of `density` along a path, the quantity that T-RRT keeps low.

    References:
        [Jaillet2010] Sampling-based path planning on configuration-space costmaps, Sec. III.
    """
    cost = density(path.resampled(step).q)
    return float(np.maximum(0.0, np.diff(cost)).sum())
