"""Bi-TRRT: two trees that stay in the valleys of the impact and meet step by step.

References:
    [Devaurs2013] Enhancing the transition-based RRT to deal with complex cost spaces, Sec. III. One temperature is
    shared by both trees; steps are tested in the direction of travel, so the goal's tree climbs freely.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.questions import Interrupted, Questions
from graceful_plan.planners.settings import positive
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

Array = np.ndarray

_CONNECT_STEPS = 3.0
"""Default connection range in steps; 10 % of the extent of the space."""


class _Side:
    """One of the two trees, with the direction in which its edges are travelled."""

    def __init__(
        self,
        roots: Float[Array, "root nq"],
        forward: bool,
        questions: Questions,
        test: TransitionTest,
        refinement: RefinementControl,
    ) -> None:
        self.tree = Tree(roots, questions.state_costs(roots))
        self.forward, self.questions = forward, questions
        self.test, self.refinement = test, refinement

    def extend(self, near: int, q: Float[Array, " nq"], distance: float) -> int | None:
        """Add `q` behind node `near` if the edge is free and its climb, as travelled, is accepted."""
        here = self.tree.q[near]
        q0, q1 = (here, q) if self.forward else (q, here)
        if not self.questions.edge_free(q0, q1):
            return None
        cost = self.questions.state_cost(q)
        ends = (self.tree.costs[near], cost) if self.forward else (cost, self.tree.costs[near])
        if not self.test.accepts(*ends, distance):
            return None
        return self.tree.add(q, cost, near)

    def explore(self, target: Float[Array, " nq"], reach: float) -> int | None:
        """Extend the tree by one step towards `target`."""
        near, distance = self.tree.nearest(target)
        step = min(distance, reach)
        if step == 0.0 or not self.refinement.allows(step):
            return None
        node = self.extend(near, steer(self.tree.q[near], target, distance, reach), step)
        if node is not None:
            self.refinement.added(step)
        return node

    def connect(self, target: Float[Array, " nq"], reach: float, within: float) -> int | None:
        """Step up to `target` if it is near; every step is tested, for a jump would leap over a ridge."""
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
class BiTRRT(Planner):
    """Bidirectional transition-based RRT. Stops at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "bitrrt"
    anytime: ClassVar[bool] = False

    variant: Variant = "devaurs"
    """"jaillet" (2010, probabilistic) or "devaurs" (2013, deterministic)."""
    range: float | None = None
    """Longest extension [rad]; by default 3.5 % of the extent of the space."""
    connection_range: float | None = None
    """Distance [rad] within which the trees try to meet; by default three extensions."""
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
        positive("connection_range", self.connection_range)
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
            path = self._search(questions, rng)
            if path is None:
                return
            yield path
            if self.shortcut:
                yield from Shortcut().improve(path, questions, budget, rng)

    def _search(self, questions: Questions, rng: np.random.Generator) -> Path | None:
        problem, reach = questions.problem, self.range or default_range(questions.problem)
        within = self.connection_range or _CONNECT_STEPS * reach
        test_rng = rng.spawn(1)[0]
        test = TransitionTest(self._transition(), estimate_cost_range(questions, test_rng), test_rng)
        sides = [
            _Side(roots, forward, questions, test, RefinementControl(self.refinement_ratio, reach))
            for roots, forward in ((problem.start[None], True), (problem.goals, False))
        ]
        while questions.budget.spend():
            growing, other = sides
            sides.reverse()
            node = growing.explore(rng.uniform(problem.lower, problem.upper), reach)
            if node is None:
                continue
            met = other.connect(growing.tree.q[node], reach, within)
            if met is not None:
                return _joined((growing, node), (other, met))
        return None

    def _transition(self) -> TransitionSettings:
        return TransitionSettings(
            variant=self.variant, initial_temperature=self.initial_temperature, most_failures=self.most_failures
        )


def _joined(first: tuple[_Side, int], second: tuple[_Side, int]) -> Path:
    """Path from the start over the common configuration to a goal."""
    (ahead, i), (behind, j) = (first, second) if first[0].forward else (second, first)
    return Path(np.concatenate([ahead.tree.branch(i), behind.tree.branch(j)[-2::-1]])).without_duplicates()
