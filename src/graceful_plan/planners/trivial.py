"""The case that needs no search."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import wraps
from typing import TypeVar, cast

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem

Solve = TypeVar("Solve", bound=Callable[..., Iterator[Path]])


def _start_is_goal(problem: Problem) -> bool:
    """Whether the robot already is at a goal; the path is then the single configuration `problem.start`."""
    return bool(np.any(np.all(np.asarray(problem.goals) == np.asarray(problem.start), axis=1)))


def stays_at_goal(solve: Solve) -> Solve:
    """Decorate `Planner.solve`: where the start is a goal it yields that path, at no cost, and is not asked."""

    @wraps(solve)
    def answer(
        planner: Planner, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        if _start_is_goal(problem):
            yield Path(problem.start[None])
        else:
            yield from solve(planner, problem, objective, budget, rng)

    return cast("Solve", answer)
