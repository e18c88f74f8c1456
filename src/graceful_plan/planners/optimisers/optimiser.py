"""Base class of path optimisers: planners that improve an initial guess."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan.array_types import Array
from graceful_plan.path import Path, finite_array
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.planners.trees.rrt_connect import RRTConnect

_SHARE_OF_SHORTCUTS = 0.1
"""Share of the remaining budget for shortcutting the first path; the rest is for the optimiser."""


@dataclass(frozen=True, kw_only=True)
class Optimiser(Planner):
    """Improves an initial path locally, within its homotopy class.

    Args:
        initial: Initial guess: a path or an array of configurations. It need not be free; if it does not begin at the
            start or end at a goal, straight edges connect it to them. None: the path of RRT-Connect, after shortcutting
            for a tenth of the budget.
    """

    anytime: ClassVar[bool] = True

    initial: Path | Array | None = None

    @abstractmethod
    def improve(
        self, path: Path, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield free paths between the ends of `path`, each of lower total cost than the previous one.

        If `path` is free, they also cost less than it. Nothing is yielded if none is found within the budget.
        """

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost."""
        path = None if self.initial is None else joined_to_ends(self.initial, problem)
        if path is None:
            for path in _first_paths(problem, objective, budget, rng):
                yield path
        if path is not None:
            yield from self.improve(path, problem, objective, budget, rng)


def _first_paths(
    problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
) -> Iterator[Path]:
    """Yield the path of RRT-Connect, then cheaper versions of it by shortcutting, for a share of the budget."""
    seconds = iterations = np.inf
    for path in RRTConnect().solve(problem, objective, budget, rng):
        yield path
        if seconds == np.inf and iterations == np.inf:
            seconds = budget.elapsed + _SHARE_OF_SHORTCUTS * budget.remaining_seconds
            iterations = budget.spent + _SHARE_OF_SHORTCUTS * budget.remaining_iterations
        if budget.elapsed > seconds or budget.spent > iterations:
            return


def joined_to_ends(path: Path | Array, problem: Problem) -> Path:
    """Return a path from the start along `path` to the nearest goal, with straight edges to both if needed.

    Raises:
        ShapeError: If the path does not have the joints of the problem.
        NonFiniteError: If it contains a NaN or an infinity.
    """
    nq = len(problem.start)
    q = finite_array("initial", path.q if isinstance(path, Path) else path, ndim=2, last=nq)
    last = q[-1] if len(q) else problem.start
    goal = problem.goals[np.linalg.norm(problem.goals - last, axis=1).argmin()]
    return Path(np.concatenate([problem.start[None], q, goal[None]])).without_duplicates()
