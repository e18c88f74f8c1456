"""The problem of a front search: ends, costs, and the test for free edges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Problem
from graceful_plan.tuning.archive import EdgeTest

Seeds = Callable[[Budget], Sequence[Path]]
"""Returns initial paths within a budget; they should be different rather than good."""

_SAME = 1e-9
"""Largest difference between configurations that count as equal [rad or m]."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FrontProblem:
    """A planning problem with its costs at every safety weight.

    Args:
        problem: Ends, limits and obstacles, as for planners.
        objective_at: Returns the objective at a safety weight.
        certain: Returns which edges are free at the finest check.
        seeds: Source of initial paths in addition to the planner's.
    """

    problem: Problem
    objective_at: Callable[[float], BoundObjective]
    certain: EdgeTest
    seeds: Seeds | None = None

    def is_solved_by(self, path: Path) -> bool:
        """Return whether a path connects the start to a goal by edges that are free at the finest check."""
        problem = self.problem
        away = np.abs(path.q[0] - problem.start).max(), np.abs(problem.goals - path.q[-1]).max(axis=1).min()
        return bool(max(away) <= _SAME and np.all(self.certain(path.q[:-1], path.q[1:])))
