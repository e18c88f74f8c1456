"""Shortcut for problems whose start is a goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import wraps
from typing import TypeVar, cast

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem

Solve = TypeVar("Solve", bound=Callable[..., Iterator[Path]])


def _start_is_goal(problem: Problem) -> bool:
    """Return whether the start is a goal."""
    return bool(np.any(np.all(np.asarray(problem.goals) == np.asarray(problem.start), axis=1)))


def handle_start_at_goal(solve: Solve) -> Solve:
    """Decorate `Planner.solve`: if the start is a goal, yield the single configuration and skip the search."""

    @wraps(solve)
    def answer(
        planner: Planner, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        if _start_is_goal(problem):
            yield Path(problem.start[None])
        else:
            yield from solve(planner, problem, objective, budget, rng)

    return cast("Solve", answer)
