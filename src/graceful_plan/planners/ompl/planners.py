"""RRT, RRT*, Informed RRT* and BIT* as OMPL implements them, with our objective: baselines and alternatives.

Their edge checks and edge costs are callbacks into Python, one state at a time, so they are slower per iteration than
this library's own batched planners. OMPL's generator is seeded per process: do not interleave two of these planners
where results must be reproducible.

References:
    [LaValle1998] Rapidly-exploring random trees.
    [Karaman2011] Sampling-based algorithms for optimal motion planning (RRT*).
    [Gammell2014] Informed RRT*. This and BIT* differ in: OMPL's direct sampling of the informed set knows path
    length only, so states are drawn from the box around the set and refused outside of it.
    [Gammell2015] Batch informed trees (BIT*).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.questions import Interrupted, Questions
from graceful_plan.planners.settings import count, fraction, positive
from graceful_plan.planners.shortcut import Shortcut
from graceful_plan.planners.trivial import start_is_goal


@dataclass(frozen=True, kw_only=True)
class RRT(Planner):
    """Rapidly-exploring random tree; stops at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "rrt"
    anytime: ClassVar[bool] = False

    range: float | None = None
    """Longest extension [rad]; by default OMPL's fifth of the extent of the space."""
    goal_bias: float = 0.05
    """Share of samples that are a goal (OMPL's default)."""
    shortcut: bool = True
    """Whether to shortcut the path with what is left of the budget."""

    def __post_init__(self) -> None:
        positive("range", self.range)
        fraction("goal_bias", self.goal_bias)

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path found, then shorter cuts of it."""
        questions = Questions(problem, objective, budget)

        def configure(planner: Any) -> None:
            planner.setGoalBias(self.goal_bias)
            if self.range is not None:
                planner.setRange(self.range)

        with suppress(Interrupted):
            for path in _improvements(questions, rng, "RRT", configure):
                yield path
                if self.shortcut:
                    yield from Shortcut().improve(path, questions, budget, rng)
                return


@dataclass(frozen=True, kw_only=True)
class RRTStar(Planner):
    """Asymptotically optimal rapidly-exploring random tree. One iteration is one sample."""

    name: ClassVar[str] = "rrt_star"
    anytime: ClassVar[bool] = True

    range: float | None = None
    """Longest extension [rad]; by default OMPL's fifth of the extent of the space."""
    goal_bias: float = 0.05
    """Share of samples that are a goal (OMPL's default)."""
    rewire_factor: float = 1.1
    """Multiplies e (1 + 1/d) ln n neighbours. OMPL's 2^(d+1) on top makes that every node for an arm; left out."""

    def __post_init__(self) -> None:
        _check_rrt_star(self.range, self.goal_bias, self.rewire_factor)

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths until the budget ends or a straight line is proven best."""
        settings = (self.range, self.goal_bias, self.rewire_factor)
        return _solve_rrt_star("RRTstar", settings, problem, objective, budget, rng)


@dataclass(frozen=True, kw_only=True)
class InformedRRTStar(Planner):
    """RRT* that, once it has a path, looks only where a better one can be. One iteration is one sample."""

    name: ClassVar[str] = "informed_rrt_star"
    anytime: ClassVar[bool] = True

    range: float | None = None
    """Longest extension [rad]; by default OMPL's fifth of the extent of the space."""
    goal_bias: float = 0.05
    """Share of samples that are a goal (OMPL's default)."""
    rewire_factor: float = 1.1
    """Multiplies e (1 + 1/d) ln n neighbours. OMPL's 2^(d+1) on top makes that every node for an arm; left out."""

    def __post_init__(self) -> None:
        _check_rrt_star(self.range, self.goal_bias, self.rewire_factor)

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths until the budget ends or a straight line is proven best."""
        settings = (self.range, self.goal_bias, self.rewire_factor)
        return _solve_rrt_star("InformedRRTstar", settings, problem, objective, budget, rng)


@dataclass(frozen=True, kw_only=True)
class BITStar(Planner):
    """Batch informed trees. One iteration is one edge taken from the queue, or one new batch."""

    name: ClassVar[str] = "bit_star"
    anytime: ClassVar[bool] = True

    samples_per_batch: int = 100
    """Samples per batch (OMPL's default)."""
    rewire_factor: float = 1.1
    """Multiplies the least number of neighbours e (1 + 1/d) ln n (OMPL's default)."""

    def __post_init__(self) -> None:
        count("samples_per_batch", self.samples_per_batch)
        positive("rewire_factor", self.rewire_factor)

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield better and better paths until the budget ends or a straight line is proven best."""
        questions = Questions(problem, objective, budget)

        def configure(planner: Any) -> None:
            planner.setSamplesPerBatch(self.samples_per_batch)
            planner.setRewireFactor(self.rewire_factor)
            planner.setStopOnSolnImprovement(True)  # so that the next batch is drawn from a smaller box

        with suppress(Interrupted):
            yield from _improvements(questions, rng, "BITstar", configure, informed=True)


def _check_rrt_star(range_: float | None, goal_bias: float, rewire_factor: float) -> None:
    positive("range", range_)
    fraction("goal_bias", goal_bias)
    positive("rewire_factor", rewire_factor)


def _solve_rrt_star(
    kind: str,
    settings: tuple[float | None, float, float],
    problem: Problem,
    objective: BoundObjective,
    budget: Budget,
    rng: np.random.Generator,
) -> Iterator[Path]:
    range_, goal_bias, factor = settings
    questions = Questions(problem, objective, budget)
    d = len(problem.start)

    def neighbours(n: int) -> int:
        return int(np.ceil(factor * np.e * (1.0 + 1.0 / d) * np.log(n + 1.0)))

    def configure(planner: Any) -> None:
        planner.setGoalBias(goal_bias)
        planner.setRewireFactor(factor / 2.0 ** (d + 1))
        if range_ is not None:
            planner.setRange(range_)

    informed = kind == "InformedRRTstar"
    with suppress(Interrupted):
        yield from _improvements(questions, rng, kind, configure, neighbours, informed)


def _improvements(
    questions: Questions,
    rng: np.random.Generator,
    kind: str,
    configure: Callable[[Any], None],
    neighbours: Callable[[int], int] | None = None,
    informed: bool = False,
) -> Iterator[Path]:
    budget = questions.budget
    if start_is_goal(questions.problem):
        if budget.spend():
            yield Path(questions.problem.start[None])
    elif not budget.exhausted:
        from graceful_plan.planners.ompl.session import Session  # importing the library must not import OMPL

        seed = int(rng.integers(1, 2**31))
        yield from Session(questions, seed, kind, configure, neighbours, informed).improvements(budget)
