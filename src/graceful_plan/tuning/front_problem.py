"""What a search for a front is about: ends, costs, and which edges are free for certain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.tuning.archive import EdgeTest

Seeds = Callable[[Budget], Sequence[Path]]
"""Paths from elsewhere to begin with, within a budget; they need not be good, but different."""

_SAME = 1e-9
"""Largest difference between two configurations that are the same [rad or m]."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FrontProblem:
    """A problem, and its costs at every safety weight.

    Args:
        problem: Endpoints, limits and obstacles, as planners see them.
        objective_at: The objective with a safety weight.
        certain: Which edges are free, as finely as they can be checked.
        seeds: Where to take paths from to begin with, besides the planner's.
    """

    problem: Problem
    objective_at: Callable[[float], BoundObjective]
    certain: EdgeTest
    seeds: Seeds | None = None

    def is_solved_by(self, path: Path) -> bool:
        """Whether a path leads from the start to one of the goals on edges that are free for certain."""
        problem = self.problem
        away = np.abs(path.q[0] - problem.start).max(), np.abs(problem.goals - path.q[-1]).max(axis=1).min()
        return bool(max(away) <= _SAME and np.all(self.certain(path.q[:-1], path.q[1:])))
