"""Search for a front in turns: the planner at one weight after another, then refinement of the whole front."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.objective import MAX_WEIGHT
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.tuning.archive import Archive, Candidate
from graceful_plan.tuning.front_problem import FrontProblem, Seeds
from graceful_plan.tuning.refine import WEIGHTS, Refinement

_SHORTEST = 0.06
"""Fraction of the budget for the shortest path."""
_ONLY = 0.5
"""Fraction of the budget for the shortest path if it has no impact."""
_SEEDS = 0.12
"""Fraction of the time for other initial paths."""


@final
@dataclass(frozen=True, kw_only=True)
class FrontSettings:
    """Settings of a front search.

    Args:
        planner: Planner that minimises V + w S; if it has a field `initial`, it gets an initial path.
        weights: Weights per sweep.
        capacity: Number of paths refined at a time.
        sweep: Fraction of the budget for one sweep over the weights.
        refines: Whether to refine the paths as a front between sweeps.
    """

    planner: Planner
    weights: int = 7
    capacity: int = 24
    sweep: float = 0.2
    refines: bool = True


def search_front(
    sought: FrontProblem, settings: FrontSettings, archive: Archive[Candidate], budget: Budget, rng: np.random.Generator
) -> Iterator[str]:
    """Fill an archive with free paths until the budget ends; yields the name of the stage after every step."""
    search = _Search(sought, settings, archive, budget, rng)
    yield from search.shortest()
    if not len(archive):
        return
    if archive.candidates[0].cost[1] <= 0.0:  # without impact, only length can improve
        search.at(0.0, _ONLY)
        yield "shortest"
        return
    refinement = Refinement(sought, archive, budget, rng, settings.capacity)
    if sought.seeds is not None and not budget.exhausted:
        search.begin(sought.seeds)
        yield "roadmap"
        for _ in refinement.turn((), rounds=1) if settings.refines else ():
            yield "refine"
    for turn in range(1_000_000):
        # Sweeps alternate between upward and downward; the weights of each lie between those of the previous sweeps.
        before = budget.spent
        shift = np.modf(turn * 0.5 * (np.sqrt(5.0) - 1.0))[0]
        weights = sweep_weights(archive.candidates[0].cost, settings.weights, float(shift))
        found: list[Candidate] = []
        for w in weights[:: -1 if turn % 2 else 1].tolist():
            if budget.exhausted or archive.candidates[0].cost[1] <= 0.0:
                return
            found += search.at(w, settings.sweep / len(weights))
            yield "sweep"
        for _ in refinement.turn(found) if settings.refines else ():
            yield "refine"
        if budget.spent == before:
            return


def sweep_weights(shortest: Float[Array, " 2"], count: int, shift: float = 0.0) -> Float[Array, " count"]:
    """Return geometric weights around the one at which motion and impact of the shortest path are equal in cost.

    Args:
        shortest: Motion and impact of the shortest path.
        count: Number of weights.
        shift: Shift of all weights as a fraction of their spacing; the last one is limited to the range.
    """
    if not shortest[1] > 0.0:
        return np.zeros(count)
    least, greatest = np.log(WEIGHTS)
    exponents = least + (greatest - least) * (np.arange(count) + shift) / max(count - 1, 1)
    return np.minimum(shortest[0] / shortest[1] * np.exp(np.minimum(exponents, greatest)), MAX_WEIGHT)


@final
class _Search:
    """Minimisations of V + w S at one weight after another."""

    def __init__(
        self,
        sought: FrontProblem,
        settings: FrontSettings,
        archive: Archive[Candidate],
        budget: Budget,
        rng: np.random.Generator,
    ) -> None:
        self.sought, self.settings, self.archive, self.budget, self.rng = sought, settings, archive, budget, rng
        self.whole = budget.remaining_seconds, budget.remaining_iterations

    def shortest(self) -> Iterator[str]:
        """Search for the shortest path, until some path is found."""
        share = _SHORTEST
        while not self.budget.exhausted and not len(self.archive):
            before = self.budget.spent
            self.at(0.0, share)
            yield "shortest"
            if self.budget.spent == before:
                return
            share = self.settings.sweep

    def begin(self, seeds: Seeds) -> None:
        """Add initial paths from another source."""
        objective = self.sought.objective_at(1.0)
        with self.budget.share(seconds=_SEEDS * self.whole[0]) as part:
            paths = seeds(part)
        for path in paths:
            if self.sought.is_solved_by(path):
                candidate = Candidate.of(path, objective, "roadmap", 0.0)
                self.archive.offer(dataclasses.replace(candidate, made_with=float(candidate.cost[1])))

    def at(self, w: float, share: float) -> list[Candidate]:
        """Run the planner for a fraction of the whole budget; add all paths found, and return the best."""
        objective = self.sought.objective_at(w)
        planner = self.settings.planner
        planner = begun_at(planner, Path(self.archive.best_for(w).q)) if len(self.archive) else planner
        best: list[Candidate] = []
        with self.budget.share(share * self.whole[0], share * self.whole[1]) as part:
            for path in planner.solve(self.sought.problem, objective, part, self.rng):
                if self.sought.is_solved_by(path):
                    best = [Candidate.of(path, objective, "weight", w)]
                    self.archive.offer(best[0])
        return best


def begun_at(planner: Planner, path: Path) -> Planner:
    """Return the planner with an initial path if it has a field `initial`; otherwise unchanged."""
    if not dataclasses.is_dataclass(planner) or all(field.name != "initial" for field in dataclasses.fields(planner)):
        return planner
    return dataclasses.replace(planner, initial=path)
