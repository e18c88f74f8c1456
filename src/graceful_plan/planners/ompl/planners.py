"""RRT and BIT* of OMPL with this library's objective, as baselines and alternatives.

Edge checks and edge costs are callbacks into Python for single edges, so these planners are slower per iteration than
this library's batched planners. OMPL has one random number generator per process: results are not reproducible if two
of these planners run interleaved.

References:
    [LaValle1998] Rapidly-exploring random trees.
    [Gammell2015] Batch informed trees (BIT*). Differs in: OMPL's direct sampling of the informed set supports only
    path length, so states are drawn from the bounding box of the set and rejected outside the set.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem
from graceful_plan.planners.ompl.kind import Kind, set_growth
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.shortcut import Shortcut, first_and_shorter
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.setting_checks import count, fraction, positive_or_none


@final
@dataclass(frozen=True, kw_only=True)
class RRT(Planner):
    """Rapidly-exploring random tree; stops at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "rrt"
    anytime: ClassVar[bool] = False

    range: float | None = None
    """Longest extension [rad]; default: OMPL's, a fifth of the extent of the space."""
    goal_bias: float = 0.05
    """Share of samples that are a goal (OMPL's default)."""
    shortcut: bool = True
    """Whether to shortcut the path until the budget ends."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("range", self.range)
        fraction("goal_bias", self.goal_bias)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path, then cheaper versions of it by shortcutting."""
        shortcut = Shortcut() if self.shortcut else None
        return first_and_shorter(self._first, shortcut, InterruptibleProblem(problem, objective, budget), rng)

    def _first(self, questions: InterruptibleProblem, rng: np.random.Generator) -> Path | None:
        return next(_improvements(Kind("RRT", self._configure), questions, rng), None)

    def _configure(self, planner: Any) -> None:
        set_growth(planner, self.goal_bias, self.range)


@final
@dataclass(frozen=True, kw_only=True)
class BITStar(Planner):
    """Batch informed trees. One iteration is one edge taken from the queue, or one new batch."""

    name: ClassVar[str] = "bit_star"
    anytime: ClassVar[bool] = True

    samples_per_batch: int = 100
    """Samples per batch (OMPL's default)."""
    rewire_factor: float = 1.1
    """Factor on the least number of neighbours, e (1 + 1/d) ln n (OMPL's default)."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("samples_per_batch", self.samples_per_batch)
        positive_or_none("rewire_factor", self.rewire_factor)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost until the budget ends or a straight line is proven optimal."""
        kind = Kind("BITstar", self._configure, informed=True)
        return _improvements(kind, InterruptibleProblem(problem, objective, budget), rng)

    def _configure(self, planner: Any) -> None:
        planner.setSamplesPerBatch(self.samples_per_batch)
        planner.setRewireFactor(self.rewire_factor)
        planner.setStopOnSolnImprovement(True)  # the next batch is drawn from a smaller box


def _improvements(kind: Kind, questions: InterruptibleProblem, rng: np.random.Generator) -> Iterator[Path]:
    if questions.budget.exhausted:
        return
    from graceful_plan.planners.ompl.session import Session  # OMPL is imported only when needed

    with suppress(Interrupted):
        yield from Session(questions, int(rng.integers(1, 2**31)), kind).improvements()
