"""Paths of a base among those who move: of a search as if nobody did, and of one over cells and time.

The first knows headings and impact on those who stand, the second when somebody is where. Curves near both are then
made and timed for when the base gets there, and compared by J at these times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from graceful_plan.mobile.among.walkers import Walkers
from graceful_plan.mobile.planners.floor_in_time import FloorInTime
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.search import ALL, Search, is_solution, search
from graceful_plan.query.request import Request


def search_among_walkers(
    request: Request, problem: SceneProblem, budget: Budget, rng: np.random.Generator, *, share: float
) -> Search:
    """Search both ways; the trace is that as if nobody moved, and paths that know of time are at the end.

    Args:
        request: What is asked.
        problem: What is searched in.
        budget: Time for it.
        rng: Chance.
        share: Of the time, for the search as if nobody moved, once there is a path.
    """
    still = Walkers(request.objective).still
    held = request.constraints.on(still.scene)
    among_still = replace(problem, kernels=held.kernels, constraints=held)
    only = isinstance(request.planner, FloorInTime)
    in_time = request.planner if only else FloorInTime()
    routes = [path for path in in_time.solve(problem, request.objective, budget, rng) if is_solution(path, problem)]
    planner = _Known(tuple(routes)) if only else request.planner
    found = search(planner, among_still, still, budget, rng, request.callback, kept=ALL, share=share)
    if not only and not found.stopped:
        found.paths = [*found.paths, *routes]
    return found


@final
@dataclass(frozen=True, eq=False)
class _Known(Planner):
    """Paths that were found before."""

    name: ClassVar[str] = FloorInTime.name
    anytime: ClassVar[bool] = False

    paths: tuple[Path, ...]

    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        del problem, objective, budget, rng
        yield from self.paths
