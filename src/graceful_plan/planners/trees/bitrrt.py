"""Bi-TRRT: two trees that prefer regions of low impact, and connect by tested steps.

References:
    [Devaurs2013] Enhancing the transition-based RRT to deal with complex cost spaces, Sec. III. Both trees share one
    temperature; steps are tested in the direction of travel, so the goal tree may grow to higher costs without a test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.trees.guided import Side, TransitionTrees
from graceful_plan.setting_checks import positive_or_none

_CONNECT_STEPS = 3.0
"""Default connection range in steps; 10 % of the extent of the space."""


@final
@dataclass(frozen=True, kw_only=True)
class BiTRRT(TransitionTrees):
    """Bidirectional transition-based RRT. Stops at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "bitrrt"

    connection_range: float | None = None
    """Largest distance of a connection between the trees [rad]; by default three extensions."""

    def __post_init__(self) -> None:
        super().__post_init__()
        positive_or_none("connection_range", self.connection_range)

    def first_path(self, questions: InterruptibleProblem, rng: np.random.Generator) -> Path | None:
        """Grow both trees alternately until they meet or the budget ends.

        Raises:
            Interrupted: If the time is over before the first sample.
        """
        problem, reach = questions.problem, self.reach(questions.problem)
        within = self.connection_range or _CONNECT_STEPS * reach
        test = self.test(questions, rng)
        sides = [self.side(forward, questions, test) for forward in (True, False)]
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


def _joined(first: tuple[Side, int], second: tuple[Side, int]) -> Path:
    """Return the path from the start via the common configuration to a goal."""
    (ahead, i), (behind, j) = (first, second) if first[0].forward else (second, first)
    return Path(np.concatenate([ahead.tree.branch(i), behind.tree.branch(j)[-2::-1]])).without_duplicates()
