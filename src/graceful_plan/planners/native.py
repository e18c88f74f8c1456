"""Shared parts of the native planners: the space that the core plans in, and slices of work within a budget."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array
from graceful_plan.core import _native
from graceful_plan.core.kernels import COST_STEP, FINE_STEP
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import ShapeError
from graceful_plan.planners.interruptible import checked_costs
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.planners.scene_problem import SceneProblem

SLICE_SECONDS = 0.004
"""Time of a call of the core between two checks of the budget [s]."""
SLICE_ITERATIONS = 2000
_MEASURES = {"time": _native.Measure.time, "length": _native.Measure.length, "waypoints": _native.Measure.points}
_UNTIMED_ITERATIONS = 16
"""Iterations per call without a time limit. The end of a call affects which paths are yielded, so it must not depend on
the clock."""


def native_space(problem: Problem, objective: BoundObjective, *, timed: bool = True) -> _native.Space:
    """Create the space that the core plans in.

    In a scene, collision checks are always native, and only custom costs call back into Python, in batches. Otherwise
    the core calls back for every edge.

    Args:
        problem: Problem to plan in.
        objective: Objective to minimise.
        timed: Whether descents of motions evaluate moving entities at their predicted places, for a departure at time
            0; if False, as in searches.
    """
    lower, upper = (np.ascontiguousarray(limit, dtype=np.float64) for limit in (problem.lower, problem.upper))
    scene_objective = objective if isinstance(objective, SceneObjective) else None
    kernel = None if scene_objective is None else scene_objective.kernel
    if isinstance(problem, SceneProblem) and scene_objective is not None:
        custom, among = problem.custom, scene_objective.timed_impact if timed else None
        return _native.SceneSpace(
            core=problem.kernels.core,
            impact=_own_cost(scene_objective, problem.kernels.core) if kernel is None else kernel.native,
            lower=lower,
            upper=upper,
            w=objective.w,
            check_step=problem.check_step,
            fine_step=FINE_STEP,
            cost_step=COST_STEP,
            margin=problem.margin,
            holds=None if custom is None else lambda q: custom.custom_holds(q, problem.margin),
            clearance=None if custom is None else custom.custom_clearance,
            still=None if among is None else among.still.native,
            moving=None if among is None else among.rough,
            keeps_off=scene_objective.scene.base is not None,
        )
    return _native.CallbackSpace(
        edges_free=lambda q0, q1: _answer(problem, "edges_free", problem.edges_free(q0, q1), (len(q0),), np.bool_),
        edge_costs=lambda q0, q1: _costs(objective, "edges", objective.edges(q0, q1), (len(q0), 2)),
        state_costs=lambda q: _costs(objective, "states", objective.states(q), (len(q),)),
        lower=lower,
        upper=upper,
        w=objective.w,
        motion_is_length=False,
        core=problem.kernels.core if isinstance(problem, SceneProblem) else None,
        margin=problem.margin if isinstance(problem, SceneProblem) else 0.0,
    )


def _own_cost(objective: SceneObjective, core: _native.Core) -> _native.OwnCost:
    """Wrap an objective without a native kernel for the core; storing it in the objective would create a cycle."""
    # A descent of a path adds vertices, so it cannot be used if the cost counts vertices.
    descends = objective.motion_is_length and objective.objective.exposure != "waypoints"
    return _native.OwnCost(
        core,
        measure=_MEASURES[objective.objective.exposure],
        speed=np.ascontiguousarray(objective.pace * objective.scene.limits.velocity),
        states=lambda q: objective.impact_slopes.states(q, np.zeros_like(q)),
        slopes=lambda q, qd: _contiguous(objective.impact_slopes(q, qd if _moving(objective) else np.zeros_like(qd))),
        edges=lambda q0, q1: np.ascontiguousarray(objective.edges(q0, q1)),
        edge_slopes=(lambda q0, q1, step: _contiguous(objective.impact_gradients(q0, q1, step))) if descends else None,
        motion=None
        if objective.motion_is_length
        else lambda q, tangent: _contiguous(objective.tangent_slopes(q, tangent)),
    )


def _moving(objective: SceneObjective) -> bool:
    return objective.objective.exposure != "waypoints"


def _contiguous(arrays: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(np.ascontiguousarray(array, dtype=np.float64) for array in arrays)


def _answer(asked: object, method: str, value: ArrayLike, shape: tuple[int, ...], dtype: type) -> Array:
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.shape != shape:
        raise ShapeError(f"{type(asked).__name__}.{method}", array.shape, str(shape))
    return array


def _costs(objective: BoundObjective, method: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    return checked_costs(objective, method, _answer(objective, method, value, shape, np.float64))


def run_slice(run: Callable[[int, float], tuple[bool, int]], budget: Budget) -> bool:
    """Run the core for one slice of the budget; return whether it reports an improvement."""
    timed = budget.iterations is None or np.isfinite(budget.time_limit)
    iterations = int(min(SLICE_ITERATIONS if timed else _UNTIMED_ITERATIONS, budget.remaining_iterations))
    seconds = min(SLICE_SECONDS, budget.remaining_seconds) if timed else np.inf
    news, used = run(iterations, seconds)
    budget.spent += used
    return news


def seed_from(rng: np.random.Generator) -> int:
    """Draw a seed for the core."""
    return int(rng.integers(2**63))
