"""Run a planner within a budget and keep what it finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget, Planner, Problem
from graceful_plan.result import TracePoint

Callback = Callable[[TracePoint], bool | None]
"""Called at every improvement; returning True ends the search."""


@dataclass
class Search:
    """The best path so far and how it came about."""

    path: Path | None = None
    trace: list[TracePoint] = field(default_factory=list)
    gave_up: bool = False
    """Whether the planner ended before its budget did, without a path."""


def search(
    planner: Planner,
    problem: Problem,
    objective: SceneObjective,
    budget: Budget,
    rng: np.random.Generator,
    callback: Callback | None = None,
) -> Search:
    """Let the planner work until the budget ends, it stops, or the callback says so."""
    found = Search()
    best = np.inf
    for path in planner.solve(problem, objective, budget, rng):
        edges = objective.edges(path.q[:-1], path.q[1:])
        motion, impact = (float(v) for v in edges.sum(axis=0)) if len(edges) else (0.0, 0.0)
        total = motion + objective.w * impact
        if found.path is not None and total >= best:
            continue
        best, found.path = total, path
        found.trace.append(TracePoint(time=budget.elapsed, total=total, motion=motion, impact=impact))
        if callback is not None and callback(found.trace[-1]):
            break
    found.gave_up = found.path is None and not budget.exhausted
    return found
