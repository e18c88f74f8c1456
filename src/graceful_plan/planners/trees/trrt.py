"""T-RRT: a rapidly-exploring random tree that stays in the valleys of the impact.

It keeps the mechanical work low (the sum of the climbs), not the total cost: a source of paths of different classes.
Warning: where the impact is 0 except close to the hazards, the transition test has nothing to decide there and this is
an RRT. See `transition` for the papers and what differs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.planner import Problem
from graceful_plan.planners.questions import Questions
from graceful_plan.planners.settings import fraction
from graceful_plan.planners.trees.guided import Side, TransitionTrees
from graceful_plan.planners.trees.tree import Tree


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

    def first_path(self, questions: Questions, rng: np.random.Generator) -> Path | None:
        """Grow the tree until it reaches a goal or the budget ends; see `grow`."""
        return self.grow(questions, rng)[1]

    def grow(self, questions: Questions, rng: np.random.Generator) -> tuple[Tree, Path | None]:
        """Grow the tree until it reaches a goal or the budget ends.

        Raises:
            Interrupted: If the time is over before the first sample.
        """
        problem, reach = questions.problem, self.reach(questions.problem)
        side = self.side(True, questions, self.test(questions, rng))
        while questions.budget.spend():
            node = side.explore(sample(problem, self.goal_bias, rng), reach)
            goal = None if node is None else _reach_goal(side, node, reach)
            if goal is not None:
                return side.tree, Path(side.tree.branch(goal)).without_duplicates()
        return side.tree, None


def sample(problem: Problem, goal_bias: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a configuration within the limits, or one of the goals with probability `goal_bias`."""
    if rng.uniform() < goal_bias:
        return problem.goals[rng.integers(len(problem.goals))]
    return rng.uniform(problem.lower, problem.upper)


def _reach_goal(side: Side, node: int, reach: float) -> int | None:
    """Step from `node` to the nearest goal if it is within `reach`."""
    goals = side.questions.problem.goals
    distances = np.linalg.norm(goals - side.tree.q[node], axis=1)
    nearest = int(distances.argmin())
    distance = float(distances[nearest])
    if distance == 0.0:
        return node
    return side.extend(node, goals[nearest], distance) if distance <= reach else None
