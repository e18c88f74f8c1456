"""Run a planner within a budget and keep its paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import final

import numpy as np

from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.result import TracePoint

KEPT = 3
"""Default number of improvements to keep."""
ALL = 10_000
"""Practically all improvements, for a later selection by another criterion."""
_SAME = 1e-9
"""Largest difference between two equal configurations [rad or m]."""

Callback = Callable[[TracePoint], bool | None]
"""Called at every improvement; returning True ends the search."""


@dataclass
class Search:
    """Result of a search: its paths and their costs over time."""

    paths: list[Path] = field(default_factory=list)
    """The latest improvements, the best at the end."""
    trace: list[TracePoint] = field(default_factory=list)
    refused: int = 0
    """Number of paths that do not lead from the start to a goal, or that collide at a finer step of edge checks."""
    stopped: bool = False
    """Whether the callback ended the search."""


@final
class PausedSearch:
    """A run of a planner that can be continued.

    Args:
        planner: The planner.
        problem: Problem to search.
        objective: Cost of a path.
        rng: Random numbers of the planner.
        kept: Number of latest improvements to keep.
    """

    def __init__(
        self,
        planner: Planner,
        problem: SceneProblem,
        objective: SceneObjective,
        rng: np.random.Generator,
        kept: int = ALL,
    ) -> None:
        self.found = Search()
        self._problem, self._objective, self._kept = problem, objective, kept
        self._budget = Budget()
        self._paths = planner.solve(problem, objective, self._budget, rng)

    def advance(self, budget: Budget, callback: Callback | None = None, *, to_first: bool = False) -> None:
        """Continue until the budget or the planner ends or the callback returns True; with `to_first`, until a path."""
        mine, spent = self._budget, self._budget.spent
        mine.started, mine.time_limit, mine.cancelled = budget.started, budget.time_limit, budget.cancelled
        mine.iterations = None if budget.iterations is None else spent + int(budget.remaining_iterations)
        try:
            for path in self._paths:
                point = self._kept_point(path)
                if point is not None and callback is not None and callback(point):
                    self.found.stopped = True
                if self.found.stopped or (to_first and self.found.paths):
                    break
        finally:
            budget.spent += mine.spent - spent

    def _kept_point(self, path: Path) -> TracePoint | None:
        """Keep a path if it is an improvement; return its cost, or None if it is not."""
        found = self.found
        if not is_solution(path, self._problem):
            found.refused += 1
            return None
        point = _traced(path, self._objective, self._budget)
        if found.trace and point.total >= found.trace[-1].total:
            return None
        found.paths = [*found.paths, path][-self._kept :]
        found.trace.append(point)
        return point


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
    """Run the planner until the budget or the planner ends or the callback returns True; keep the latest improvements.

    Once there is a path, the search ends after the fraction `share` of the remaining time.
    """
    run = PausedSearch(planner, problem, objective, rng, kept)
    enough = budget.elapsed + share * budget.remaining_seconds
    with budget.share(until=lambda: bool(run.found.paths) and budget.elapsed >= enough) as part:
        run.advance(part, callback)
    return run.found


def _traced(path: Path, objective: SceneObjective, budget: Budget) -> TracePoint:
    edges = objective.edges(path.q[:-1], path.q[1:])
    motion, impact = (float(v) for v in edges.sum(axis=0)) if len(edges) else (0.0, 0.0)
    return TracePoint(time=budget.elapsed, total=motion + objective.w * impact, motion=motion, impact=impact)


def subsampled(n: int) -> list[int]:
    """Return a subsample of the indices of n improvements, latest first: the last one and those 1, 2, 4, 8, ... before.

    Late improvements have lower costs than early ones, so they are sampled more densely.
    """
    ages = [0, *(2**k for k in range(n.bit_length()))]
    return [n - 1 - age for age in ages if age < n]


def is_solution(path: Path, problem: SceneProblem) -> bool:
    """Check that a planner's path leads from the start to a goal, on edges that are free at a fine step."""
    ends = np.abs(path.q[0] - problem.start).max(), np.abs(problem.goals - path.q[-1]).max(axis=1).min()
    if max(ends) > _SAME:
        return False
    return bool(np.all(problem.kernels.edges_free(path.q[:-1], path.q[1:], FINE_STEP, problem.margin)))
