"""Run a planner within a budget and keep what it finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.result import TracePoint

KEPT = 3
"""Improvements that are kept for the judge to choose from."""
ALL = 10_000
"""Keeps them all, to choose by something other than what was searched for."""
_SAME = 1e-9
"""Largest difference between two configurations that are the same [rad or m]."""

Callback = Callable[[TracePoint], bool | None]
"""Called at every improvement; returning True ends the search."""


@dataclass
class Search:
    """The best path so far and how it came about."""

    paths: list[Path] = field(default_factory=list)
    """The last improvements, the best at the end; the judge falls back on earlier ones."""
    others: list[Path] = field(default_factory=list)
    """The best of each further search, if there were several; see `restarts`."""
    firsts: list[Path] = field(default_factory=list)
    """The first that each of them found."""
    trace: list[TracePoint] = field(default_factory=list)
    refused: int = 0
    """Paths that do not lead from the start to a goal, or graze something between two checked configurations."""
    stopped: bool = False
    """Whether the callback ended the search."""


def search(
    planner: Planner,
    problem: SceneProblem,
    objective: SceneObjective,
    budget: Budget,
    rng: np.random.Generator,
    callback: Callback | None = None,
    *,
    kept: int = KEPT,
    share: float = 1.0,
) -> Search:
    """Let the planner work until the budget ends, it stops, or the callback says so; keep the last improvements.

    Of the time, it takes no more than a share once there is a path.
    """
    found = Search()
    enough = budget.elapsed + share * budget.remaining_seconds
    with budget.share(until=lambda: bool(found.paths) and budget.elapsed >= enough) as part:
        for path in planner.solve(problem, objective, part, rng):
            if not is_solution(path, problem):
                found.refused += 1
                continue
            point = _charged(path, objective, budget)
            if found.trace and point.total >= found.trace[-1].total:
                continue
            found.paths = [*found.paths[1 - kept :], path]
            found.trace.append(point)
            if callback is not None and callback(point):
                found.stopped = True
                break
    return found


def _charged(path: Path, objective: SceneObjective, budget: Budget) -> TracePoint:
    edges = objective.edges(path.q[:-1], path.q[1:])
    motion, impact = (float(v) for v in edges.sum(axis=0)) if len(edges) else (0.0, 0.0)
    return TracePoint(time=budget.elapsed, total=motion + objective.w * impact, motion=motion, impact=impact)


def thinned(n: int) -> list[int]:
    """Indices of improvements that stand for all n of them, the last one first: it, and those 1, 2, 4, 8, ... before.

    Improvements come ever closer to each other, so that few of the late ones and fewer of the early ones will do.
    """
    ages = [0, *(2**k for k in range(n.bit_length()))]
    return [n - 1 - age for age in ages if age < n]


def is_solution(path: Path, problem: SceneProblem) -> bool:
    """Check a planner's word: from the start to one of the goals, on edges that are free at a fine step."""
    ends = np.abs(path.q[0] - problem.start).max(), np.abs(problem.goals - path.q[-1]).max(axis=1).min()
    if max(ends) > _SAME:
        return False
    return bool(np.all(problem.kernels.edges_free(path.q[:-1], path.q[1:], FINE_STEP, problem.margin)))
