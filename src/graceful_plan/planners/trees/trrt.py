"""T-RRT: a rapidly-exploring random tree that stays in the valleys of the impact.

It keeps the mechanical work low (the sum of the climbs), not the total cost: a source of paths of different classes.
Warning: where the impact is 0 except close to the hazards, the transition test has nothing to decide there and this is
an RRT. See `transition` for the papers and what differs.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.questions import Interrupted, Questions
from graceful_plan.planners.settings import fraction, positive
from graceful_plan.planners.shortcut import Shortcut
from graceful_plan.planners.trees.transition import (
    RefinementControl,
    TransitionSettings,
    TransitionTest,
    Variant,
    default_range,
    estimate_cost_range,
)
from graceful_plan.planners.trees.tree import Tree, steer
from graceful_plan.planners.trivial import start_is_goal


@dataclass(frozen=True, kw_only=True)
class TRRT(Planner):
    """Transition-based RRT. Stops at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "trrt"
    anytime: ClassVar[bool] = False

    variant: Variant = "devaurs"
    """"jaillet" (2010, probabilistic; climbs less, needs about ten times the samples) or "devaurs" (2013)."""
    range: float | None = None
    """Longest extension [rad]; by default 3.5 % of the extent of the space."""
    goal_bias: float = 0.05
    """Share of samples that are a goal."""
    refinement_ratio: float = 0.1
    """Nodes nearer than `range` to their parent, per node that is not; infinite switches the control off."""
    initial_temperature: float | None = None
    """T0 as a multiple of the range of the cost; by default 1e-6 (jaillet), 0.1 (devaurs)."""
    most_failures: int = 10
    """jaillet: failures before T rises; 10 is greedy, 100 is slow and finds lower passes."""
    shortcut: bool = True
    """Whether to shortcut the path, by total cost, with what is left of the budget."""

    def __post_init__(self) -> None:
        positive("range", self.range)
        fraction("goal_bias", self.goal_bias)
        if not self.refinement_ratio >= 0.0:
            raise SettingError("refinement_ratio", self.refinement_ratio, "a number >= 0, or infinity")
        self._transition()

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path found, then shorter cuts of it."""
        if start_is_goal(problem):
            if budget.spend():
                yield Path(problem.start[None])
            return
        questions = Questions(problem, objective, budget)
        with suppress(Interrupted):
            _, path = self.grow(questions, rng)
            if path is None:
                return
            yield path
            if self.shortcut:
                yield from Shortcut().improve(path, questions, budget, rng)

    def grow(self, questions: Questions, rng: np.random.Generator) -> tuple[Tree, Path | None]:
        """Grow the tree until it reaches a goal or the budget ends.

        Raises:
            Interrupted: If the time is over before the first sample.
        """
        problem, reach = questions.problem, self.range or default_range(questions.problem)
        test_rng = rng.spawn(1)[0]  # so that samples are those of an RRT with the same seed
        test = TransitionTest(self._transition(), estimate_cost_range(questions, test_rng), test_rng)
        refinement = RefinementControl(self.refinement_ratio, reach)
        tree = Tree(problem.start[None], questions.state_costs(problem.start[None]))
        while questions.budget.spend():
            target = sample(problem, self.goal_bias, rng)
            near, distance = tree.nearest(target)
            step = min(distance, reach)
            if step == 0.0 or not refinement.allows(step):
                continue
            q = steer(tree.q[near], target, distance, reach)
            node = _extend(tree, near, q, step, questions, test)
            if node is None:
                continue
            refinement.added(step)
            goal = _reach_goal(tree, node, reach, questions, test)
            if goal is not None:
                return tree, Path(tree.branch(goal)).without_duplicates()
        return tree, None

    def _transition(self) -> TransitionSettings:
        return TransitionSettings(
            variant=self.variant, initial_temperature=self.initial_temperature, most_failures=self.most_failures
        )


def sample(problem: Problem, goal_bias: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a configuration within the limits, or one of the goals with probability `goal_bias`."""
    if rng.uniform() < goal_bias:
        return problem.goals[rng.integers(len(problem.goals))]
    return rng.uniform(problem.lower, problem.upper)


def _extend(
    tree: Tree, near: int, q: np.ndarray, distance: float, questions: Questions, test: TransitionTest
) -> int | None:
    """Add `q` behind node `near` if the edge is free and the climb accepted."""
    if not questions.edge_free(tree.q[near], q):
        return None
    cost = questions.state_cost(q)
    if not test.accepts(tree.costs[near], cost, distance):
        return None
    return tree.add(q, cost, near)


def _reach_goal(tree: Tree, node: int, reach: float, questions: Questions, test: TransitionTest) -> int | None:
    """Step from `node` to the nearest goal if it is within `reach`."""
    goals = questions.problem.goals
    distances = np.linalg.norm(goals - tree.q[node], axis=1)
    nearest = int(distances.argmin())
    distance = float(distances[nearest])
    if distance == 0.0:
        return node
    return _extend(tree, node, goals[nearest], distance, questions, test) if distance <= reach else None
