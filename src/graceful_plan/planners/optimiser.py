"""The contract of trajectory optimisers: planners that improve a path."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.rrt_connect import RRTConnect
from graceful_plan.planners.trivial import start_is_goal


@dataclass(frozen=True, kw_only=True)
class Optimiser(Planner):
    """Improves a path within its class: local, so it needs one to begin with.

    Args:
        initial: Where to begin, leading from the start to a goal; it need not be free. None begins with the path of
            RRT-Connect after shortcuts.
    """

    anytime: ClassVar[bool] = True

    initial: Path | None = None

    @abstractmethod
    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield free paths between the same ends, each of lower total cost than the one before.

        If `path` itself is free, they cost less than it does. Nothing is yielded if there is none within the budget.
        """

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths."""
        if start_is_goal(problem):
            yield Path(problem.start[None])
            return
        path = self.initial
        if path is None:
            for path in RRTConnect().solve(problem, objective, budget, rng):
                yield path
        if path is not None:
            yield from self.improve(path, problem, objective, budget, rng)
