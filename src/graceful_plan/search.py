"""Run a planner within a budget and keep what it finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.kernels import FINE_STEP
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.result import TracePoint

Callback = Callable[[TracePoint], bool | None]
"""Called at every improvement; returning True ends the search."""


@dataclass
class Search:
    """The best path so far and how it came about."""

    path: Path | None = None
    trace: list[TracePoint] = field(default_factory=list)
    refused: int = 0
    """Paths that graze something between the configurations that the planner checked."""


def search(
    planner: Planner,
    problem: SceneProblem,
    objective: SceneObjective,
    budget: Budget,
    rng: np.random.Generator,
    callback: Callback | None = None,
) -> Search:
    """Let the planner work until the budget ends, it stops, or the callback says so."""
    found = Search()
    best = np.inf
    for path in planner.solve(problem, objective, budget, rng):
        if not np.all(problem.kernels.edges_free(path.q[:-1], path.q[1:], FINE_STEP, problem.margin)):
            found.refused += 1
            continue
        edges = objective.edges(path.q[:-1], path.q[1:])
        motion, impact = (float(v) for v in edges.sum(axis=0)) if len(edges) else (0.0, 0.0)
        total = motion + objective.w * impact
        if found.path is not None and total >= best:
            continue
        best, found.path = total, path
        found.trace.append(TracePoint(time=budget.elapsed, total=total, motion=motion, impact=impact))
        if callback is not None and callback(found.trace[-1]):
            break
    return found
