"""Search for a front: sweeps over the weight, each begun from what its neighbours found, then refinement as a whole."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.front_archive import Archive, Candidate
from graceful_plan.front_refine import EdgeTest, refine_front
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem

Array = np.ndarray

ObjectiveAt = Callable[[float], BoundObjective]
"""The objective with a safety weight."""

_LEAST, _GREATEST = 0.02, 100.0
"""Weights of the sweep, relative to the motion of the shortest path over its impact."""
_FIRST = 0.06
"""Share of the budget for the shortest path."""
_SWEEPS = 0.4
"""Share of the budget for the sweeps over the weight, half of it up and half of it down."""


@dataclass(frozen=True, kw_only=True)
class FrontSettings:
    """How a front is searched for.

    Args:
        planner: Minimises V + w S; if it has a field `initial`, it is told where to begin.
        weights: Weights in each sweep.
        capacity: Paths that are refined at a time.
    """

    planner: Planner
    weights: int = 7
    capacity: int = 24


def search_front(
    problem: Problem,
    objective_at: ObjectiveAt,
    certain: EdgeTest,
    settings: FrontSettings,
    budget: Budget,
    rng: np.random.Generator,
    archive: Archive,
) -> Iterator[str]:
    """Fill an archive until the budget ends; yields the name of the stage after every step. Every path is free."""
    planner, plain = settings.planner, objective_at(0.0)
    seen = _Sweep(problem, objective_at, certain, planner, budget, rng, archive)
    seen.at(0.0, _FIRST)
    yield "shortest"
    if not len(archive) or archive.candidates[-1].cost[1] <= 0.0:
        yield from _persist(seen)
        return
    weights = sweep_weights(archive.candidates[0].cost, settings.weights)
    both_ways = [*weights, *weights[-2::-1]]
    for w in both_ways:
        seen.at(float(w), _SWEEPS / len(both_ways))
        yield "sweep"
    for _ in refine_front(archive, problem, plain, certain, budget, rng, settings.capacity):
        yield "refine"


def sweep_weights(shortest: Float[Array, " 2"], count: int) -> Float[Array, " count"]:
    """Geometric weights around the one at which motion and impact of the shortest path count alike."""
    return float(shortest[0] / shortest[1]) * np.geomspace(_LEAST, _GREATEST, count)


class _Sweep:
    """Minimisations of V + w S, one weight after the other."""

    def __init__(
        self,
        problem: Problem,
        objective_at: ObjectiveAt,
        certain: EdgeTest,
        planner: Planner,
        budget: Budget,
        rng: np.random.Generator,
        archive: Archive,
    ) -> None:
        self.problem, self.objective_at, self.certain = problem, objective_at, certain
        self.planner, self.budget, self.rng, self.archive = planner, budget, rng, archive
        self.whole = budget.remaining_seconds, budget.remaining_iterations

    def at(self, w: float, share: float) -> None:
        """Let the planner work for a share of the whole budget; offer all that it finds."""
        objective = self.objective_at(w)
        planner = self.planner
        if len(self.archive) and any(field.name == "initial" for field in dataclasses.fields(planner)):
            planner = dataclasses.replace(planner, initial=Path(self.archive.best_for(w).q))
        part = self._part(share)
        for path in planner.solve(self.problem, objective, part, self.rng):
            if _leads_there(path, self.problem) and np.all(self.certain(path.q[:-1], path.q[1:])):
                self.archive.offer(Candidate.of(path, objective, "weight", w))
        self.budget.spent += part.spent

    def _part(self, share: float) -> Budget:
        seconds = min(share * self.whole[0], self.budget.remaining_seconds)
        iterations = min(share * self.whole[1], self.budget.remaining_iterations)
        limit = None if np.isinf(iterations) else int(np.ceil(iterations))
        return Budget(seconds, limit, self.budget.cancelled)


def _persist(sweep: _Sweep) -> Iterator[str]:
    """Without a path there is nothing to weigh: try with other random numbers until the budget ends."""
    if len(sweep.archive):
        return
    while not sweep.budget.exhausted and not len(sweep.archive):
        before = sweep.budget.spent
        sweep.at(0.0, 0.2)
        yield "shortest"
        if sweep.budget.spent == before:
            return


def _leads_there(path: Path, problem: Problem) -> bool:
    """Whether a path leads from the start to one of the goals."""
    away = np.abs(path.q[0] - problem.start).max(), np.abs(problem.goals - path.q[-1]).max(axis=1).min()
    return max(away) <= 1e-9
