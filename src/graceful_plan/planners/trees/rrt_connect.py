"""RRT-Connect, in the native core.

References:
    Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.core import _native
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.native import native_space, run_slice, seed_from
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.shortcut import Shortcut, first_and_shorter
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.setting_checks import count, positive_fraction


@final
@dataclass(frozen=True, kw_only=True)
class RRTConnect(Planner):
    """Two trees that grow towards each other: the fastest planner for a first path. It ignores the cost.

    The straight edge to each goal is tried first. One iteration is one extension of a tree with the attempt to connect
    the other one to it, or one round of shortcutting.

    Args:
        range: Longest edge, as a fraction of the diagonal of the limits.
        max_nodes: Number of nodes above which the trees are discarded and restarted.
        shortcut: Settings of cost-aware shortcutting; None for no shortcutting.
    """

    name: ClassVar[str] = "rrt_connect"
    anytime: ClassVar[bool] = False

    range: float = 0.08
    max_nodes: int = 10_000
    shortcut: Shortcut | None = Shortcut()

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_fraction("range", self.range)
        count("max_nodes", self.max_nodes, 10)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path, then cheaper versions of it by shortcutting."""
        return first_and_shorter(self._connect, self.shortcut, InterruptibleProblem(problem, objective, budget), rng)

    def _connect(self, questions: InterruptibleProblem, rng: np.random.Generator) -> Path | None:
        problem = questions.problem
        space = native_space(problem, questions.objective)
        core = _native.Connect(
            space,
            start=problem.start,
            goals=problem.goals,
            range=self.range * problem.extent,
            max_nodes=self.max_nodes,
            seed=seed_from(rng),
        )
        while not questions.budget.exhausted:
            if run_slice(core.run, questions.budget):
                return Path(core.path)
        return None
