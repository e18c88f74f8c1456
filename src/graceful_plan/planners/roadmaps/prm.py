"""PRM and PRM*: probabilistic roadmaps, grown in rounds and searched in between.

References:
    [Kavraki1996] Probabilistic roadmaps for path planning in high-dimensional configuration spaces.
    [Karaman2011] Sampling-based algorithms for optimal motion planning, Sec. 3.3. Both differ from the papers in:
    a sample is connected to its nearest earlier samples (so roadmaps are nested), collision checks are lazy, samples
    are informed once there is a solution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Int
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.informed import InformedSampler, probe_objective
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.roadmaps.lazy_roadmap import LazyRoadmap
from graceful_plan.planners.shortcut import MOVES, Shortcut
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.setting_checks import count, positive_or_none

_PROVEN = 1e-8
"""Relative gap to the lower bound of the cost at which a path counts as optimal."""


@final
@dataclass(frozen=True, kw_only=True)
class _Growth:
    """Settings of growth in which PRM and PRM* differ."""

    neighbours: Callable[[Array], Array]
    batch: int
    informed: bool
    first_only: bool
    max_samples: int
    shortcut: Shortcut | None


@final
@dataclass(frozen=True, kw_only=True)
class PRM(Planner):
    """Probabilistic roadmap; stops at the first path, after shortcutting it.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "prm"
    anytime: ClassVar[bool] = False

    neighbours: int = 10
    """Number of earlier samples that a new one is connected to (OMPL's default)."""
    batch: int = 50
    """Samples between two searches."""
    max_samples: int = 6000
    """Size at which the roadmap is restarted, so that no step takes long."""
    shortcut: bool = True
    """Whether to shortcut the path until the budget ends."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("neighbours", self.neighbours)
        count("batch", self.batch)
        count("max_samples", self.max_samples, 10)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path, then cheaper versions of it by shortcutting."""
        growth = _Growth(
            neighbours=lambda i: np.full(len(i), self.neighbours),
            batch=self.batch,
            informed=False,
            first_only=True,
            max_samples=self.max_samples,
            shortcut=Shortcut() if self.shortcut else None,
        )
        return _interruptible(growth, InterruptibleProblem(problem, objective, budget), rng)


@final
@dataclass(frozen=True, kw_only=True)
class PRMStar(Planner):
    """Asymptotically optimal roadmap: k(n) = factor * e (1 + 1/d) ln n neighbours.

    One iteration is one sample, or one round of shortcutting.
    """

    name: ClassVar[str] = "prm_star"
    anytime: ClassVar[bool] = True

    factor: float = 1.0
    """Factor on the number of neighbours; 1 is the constant of the theory."""
    batch: int = 100
    """Initial number of samples between two searches; later a tenth of the roadmap."""
    informed: bool = True
    """Whether to draw samples only where they can improve the best path."""
    max_samples: int = 6000
    """Size at which the roadmap is restarted with the best path, so that no step takes long."""
    shortcut: bool = True
    """Whether to shortcut the best path for a few rounds between two searches."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("factor", self.factor)
        count("batch", self.batch)
        count("max_samples", self.max_samples, 10)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost until the budget ends or a straight line is proven optimal."""
        constant = self.factor * np.e * (1.0 + 1.0 / len(problem.start))

        def neighbours(i: Int[Array, " n"]) -> Int[Array, " n"]:
            return np.maximum(1, np.ceil(constant * np.log(i + 1.0))).astype(int)

        growth = _Growth(
            neighbours=neighbours,
            batch=self.batch,
            informed=self.informed,
            first_only=False,
            max_samples=self.max_samples,
            shortcut=Shortcut(patience=len(MOVES)) if self.shortcut else None,
        )
        return _interruptible(growth, InterruptibleProblem(problem, objective, budget), rng)


def _interruptible(growth: _Growth, questions: InterruptibleProblem, rng: np.random.Generator) -> Iterator[Path]:
    with suppress(Interrupted):
        yield from _grow(growth, questions, rng)


def _grow(growth: _Growth, questions: InterruptibleProblem, rng: np.random.Generator) -> Iterator[Path]:
    budget = questions.budget
    facts = probe_objective(questions.objective, questions.problem)
    sampler = InformedSampler(questions.problem, facts.length_bound if growth.informed else 0.0)
    cut_rng = rng.spawn(1)[0]  # shortcutting does not change which samples are drawn
    best, best_path = np.inf, None
    roadmap = LazyRoadmap(questions, sampler, facts.symmetric, growth.neighbours)
    while best > sampler.least_cost * (1.0 + _PROVEN) or best_path is None:
        found = roadmap.cheapest(best)
        if found is not None:
            best, best_path = found
            yield best_path
        if best_path is not None and growth.shortcut is not None:
            for better in growth.shortcut.improve(best_path, questions, budget, cut_rng):
                best_path, best = better, questions.path_cost(better)
                yield best_path
        if best_path is not None and growth.first_only:
            return
        if len(roadmap) > growth.max_samples:
            roadmap = LazyRoadmap(questions, sampler, facts.symmetric, growth.neighbours)
            if best_path is not None:
                roadmap.add(best_path.q[1:-1], np.inf)
        samples = sampler.draw(max(growth.batch, len(roadmap) // 10), best, rng)
        samples = samples[: int(min(len(samples), budget.remaining_iterations))]
        if not budget.spend(max(1, len(samples))):
            return
        roadmap.add(samples[questions.states_free(samples)], best)
