"""What the native planners share: a space for the core to plan in, and slices of work that keep a budget."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from graceful_plan import _native
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.kernels import COST_STEP, FINE_STEP
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.planners.scene_problem import SceneProblem

SLICE_SECONDS = 0.004
"""How long the core works between two looks at the budget [s]."""
SLICE_ITERATIONS = 2000


def native_space(problem: Problem, objective: BoundObjective) -> _native.Space:
    """Make the space that the core plans in: all native if it can be, else calling back for every edge."""
    lower, upper = (np.ascontiguousarray(limit, dtype=np.float64) for limit in (problem.lower, problem.upper))
    scene_objective = objective if isinstance(objective, SceneObjective) else None
    severity = None if scene_objective is None else scene_objective.kernel_severity
    if isinstance(problem, SceneProblem) and severity is not None:
        return _native.SceneSpace(
            core=problem.kernels.core,
            lower=lower,
            upper=upper,
            severity=np.ascontiguousarray(severity),
            w=objective.w,
            check_step=problem.check_step,
            fine_step=FINE_STEP,
            cost_step=COST_STEP,
            margin=problem.margin,
        )
    return _native.CallbackSpace(
        edges_free=problem.edges_free,
        edge_costs=lambda q0, q1: np.ascontiguousarray(objective.edges(q0, q1), dtype=np.float64),
        state_costs=lambda q: np.ascontiguousarray(objective.states(q), dtype=np.float64),
        lower=lower,
        upper=upper,
        w=objective.w,
        motion_is_length=scene_objective is not None and scene_objective.motion_is_length,
    )


def run_slice(run: Callable[[int, float], tuple[bool, int]], budget: Budget) -> bool:
    """Let the core work for one slice of the budget; return what it reports."""
    iterations = int(min(SLICE_ITERATIONS, budget.remaining_iterations))
    seconds = min(SLICE_SECONDS, budget.remaining_seconds)
    news, used = run(iterations, seconds)
    budget.spent += used
    return news


def seed_from(rng: np.random.Generator) -> int:
    """Draw a seed for the core."""
    return int(rng.integers(2**63))
