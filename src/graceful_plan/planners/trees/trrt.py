"""T-RRT: a rapidly-exploring random tree that prefers regions of low impact.

It keeps the mechanical work (the sum of increases of the state cost) low, not the total cost. Warning: where the impact
is 0, which may be everywhere except close to entities, the transition test accepts all steps and this is an RRT. See
`transition` for the papers and the differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.trees.guided import Side, TransitionTrees
from graceful_plan.planners.trees.tree import Tree, steer
from graceful_plan.planners.trees.untried import Untried
from graceful_plan.setting_checks import fraction


@final
@dataclass(frozen=True, kw_only=True)
class TRRT(TransitionTrees):
    """Transition-based RRT. Stops at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "trrt"

    goal_bias: float = 0.05
    """Share of samples that are a goal."""

    def __post_init__(self) -> None:
        super().__post_init__()
        fraction("goal_bias", self.goal_bias)

    def first_path(self, questions: InterruptibleProblem, rng: np.random.Generator) -> Path | None:
        """Grow the tree until it reaches a goal or the budget ends; see `grow`."""
        return self.grow(questions, rng)[1]

    def grow(self, questions: InterruptibleProblem, rng: np.random.Generator) -> tuple[Tree, Path | None]:
        """Grow the tree until it reaches a goal or the budget ends.

        Raises:
            Interrupted: If the time is over before the first sample.
        """
        problem, reach = questions.problem, self.reach(questions.problem)
        side = self.side(True, questions, self.test(questions, rng))
        goals = _Goals(side, reach)
        while questions.budget.spend():
            if rng.uniform() < self.goal_bias:
                node = goals.approach(int(rng.integers(len(problem.goals))))
            else:
                node = side.explore(rng.uniform(problem.lower, problem.upper), reach)
            end = None if node is None else goals.reached_from(node)
            if end is not None:
                return side.tree, Path(side.tree.branch(end)).without_duplicates()
        return side.tree, None


@final
class _Goals:
    """Steps towards goals; each node tries each goal once.

    Every path to a goal has to climb to its state cost. If this climb were tested, a tree would fill the whole region
    of low cost around a goal of high cost and never reach it.

    Args:
        side: The tree that grows towards the goals.
        reach: Longest step [rad].
    """

    def __init__(self, side: Side, reach: float) -> None:
        self._side, self._reach = side, reach
        self._goals = side.questions.problem.goals
        self._levels = side.questions.state_costs(self._goals)
        self._untried = Untried(self._goals)

    def approach(self, goal: int) -> int | None:
        """Extend the nearest node that has not tried a goal by one step towards it; return the new node."""
        side = self._side
        self._untried.learn(side.tree.q)
        found = self._untried.take(goal)
        if found is None:
            return None
        near, distance = found
        step = min(distance, self._reach)
        q = steer(side.tree.q[near], self._goals[goal], distance, self._reach)
        node = side.extend(near, q, step, self._levels[goal])
        if node is not None:
            side.refinement.added(step)
        return node

    def reached_from(self, node: int) -> int | None:
        """Step from a node to its nearest goal if that is within reach; return the node at the goal."""
        distances = np.linalg.norm(self._goals - self._side.tree.q[node], axis=1)
        goal = int(distances.argmin())
        distance = float(distances[goal])
        if distance == 0.0:
            return node
        if distance > self._reach:
            return None
        self._untried.exclude(node, goal)
        return self._side.extend(node, self._goals[goal], distance, self._levels[goal])
