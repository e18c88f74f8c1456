"""Shared parts of T-RRT and Bi-TRRT: settings, and trees that grow by tested steps."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.shortcut import Shortcut, first_and_shorter
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.planners.trees.transition import (
    RefinementControl,
    TransitionSettings,
    TransitionTest,
    Variant,
    estimate_cost_range,
)
from graceful_plan.planners.trees.tree import Tree, steer
from graceful_plan.setting_checks import positive_or_none

_REACH = 0.035
"""Default longest extension, as a share of the extent of the space (OMPL's default)."""


@final
class Side:
    """A tree that grows by steps that pass the transition test in the direction of travel.

    Args:
        roots: Roots of the tree.
        forward: Whether motions lead away from the roots.
        questions: Access to problem and objective.
        test: Transition test of a step to a higher cost.
        refinement: Limits the number of short steps.
    """

    def __init__(
        self,
        roots: Float[Array, "root nq"],
        forward: bool,
        questions: InterruptibleProblem,
        test: TransitionTest,
        refinement: RefinementControl,
    ) -> None:
        self.tree = Tree(roots, questions.state_costs(roots))
        self.forward, self.questions = forward, questions
        self.test, self.refinement = test, refinement

    def extend(self, near: int, q: Float[Array, " nq"], distance: float, level: float = 0.0) -> int | None:
        """Add `q` as a child of node `near` if the edge is free and passes the transition test as travelled.

        Args:
            near: Parent node.
            q: Configuration to add.
            distance: Distance between the two [rad].
            level: State cost up to which climbs are not tested, since the path has to reach it anyway.
        """
        here = self.tree.q[near]
        q0, q1 = (here, q) if self.forward else (q, here)
        if not self.questions.edge_free(q0, q1):
            return None
        cost = self.questions.state_cost(q)
        before, after = (self.tree.costs[near], cost) if self.forward else (cost, self.tree.costs[near])
        if not self.test.accepts(max(before, level), after, distance):
            return None
        return self.tree.add(q, cost, near)

    def explore(self, target: Float[Array, " nq"], reach: float) -> int | None:
        """Extend the tree by one step towards `target`."""
        near, distance = self.tree.nearest(target)
        step = min(distance, reach)
        if step == 0.0 or not self.refinement.allows(step):
            return None
        q = self.questions.problem.projected(steer(self.tree.q[near], target, distance, reach)[None])[0]
        node = self.extend(near, q, step)
        if node is not None:
            self.refinement.added(step)
        return node

    def connect(self, target: Float[Array, " nq"], reach: float, within: float) -> int | None:
        """Step up to `target` if it is within `within`; every step is tested, so that costs in between are seen."""
        node, distance = self.tree.nearest(target)
        if distance > within:
            return None
        while distance > 0.0:
            step = min(distance, reach)
            found = self.extend(node, steer(self.tree.q[node], target, distance, reach), step)
            if found is None:
                return None
            node, distance = found, (0.0 if distance <= reach else distance - step)
        return node


@dataclass(frozen=True, kw_only=True)
class TransitionTrees(Planner):
    """Planners with trees under a transition test; they stop at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    anytime: ClassVar[bool] = False

    variant: Variant = "devaurs"
    """"jaillet" (2010, probabilistic; climbs less, needs about ten times the samples) or "devaurs" (2013)."""
    range: float | None = None
    """Longest extension [rad]; by default 3.5 % of the extent of the space."""
    refinement_ratio: float = 0.1
    """Largest ratio of nodes nearer than `range` to their parent to other nodes; infinite turns the control off."""
    initial_temperature: float | None = None
    """T0 as a multiple of the range of the cost; by default 1e-6 (jaillet), 0.1 (devaurs)."""
    most_failures: int = 10
    """jaillet: number of failures before T rises; 10 is greedy, 100 is slow and finds paths of lower peak cost."""
    shortcut: bool = True
    """Whether to shortcut the path, by total cost, until the budget ends."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("range", self.range)
        if not self.refinement_ratio >= 0.0:
            raise SettingError("refinement_ratio", self.refinement_ratio, "a number >= 0, or infinity")
        self._transition()

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path, then cheaper versions of it by shortcutting."""
        shortcut = Shortcut() if self.shortcut else None
        return first_and_shorter(self.first_path, shortcut, InterruptibleProblem(problem, objective, budget), rng)

    @abstractmethod
    def first_path(self, questions: InterruptibleProblem, rng: np.random.Generator) -> Path | None:
        """Grow until there is a path or the budget ends.

        Raises:
            Interrupted: If the time is over before the first sample.
        """

    def reach(self, problem: Problem) -> float:
        """Return the longest extension [rad]."""
        return self.range or _REACH * problem.extent

    def test(self, questions: InterruptibleProblem, rng: np.random.Generator) -> TransitionTest:
        """Return a test at its initial temperature; it has a separate generator, so samples equal those of an RRT."""
        own = rng.spawn(1)[0]
        return TransitionTest(self._transition(), estimate_cost_range(questions, own), own)

    def side(self, forward: bool, questions: InterruptibleProblem, test: TransitionTest) -> Side:
        """Return a tree that grows from the start, or from the goals."""
        problem = questions.problem
        roots = problem.start[None] if forward else problem.goals
        return Side(roots, forward, questions, test, RefinementControl(self.refinement_ratio, self.reach(problem)))

    def _transition(self) -> TransitionSettings:
        return TransitionSettings(
            variant=self.variant, initial_temperature=self.initial_temperature, most_failures=self.most_failures
        )
