"""Routes for a planning request: along short floor paths (`ways`), and along paths of a search."""

from __future__ import annotations

from itertools import islice
from typing import final

import numpy as np

from graceful_plan.mobile.motions.floor_ways import ways
from graceful_plan.mobile.motions.legs import RollingLeg, Route, along_ways, routes
from graceful_plan.mobile.motions.rolling_spline import RollingCurves
from graceful_plan.mobile.planners.drive_lattice import DriveLattice
from graceful_plan.mobile.planners.floor_in_time import FloorInTime
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import Start
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.departure import without_moving
from graceful_plan.query.candidates.search import PausedSearch, Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request

_GOALS, _SHORTEST = 3, 2
"""Number of goals for floor paths, and number of floor paths for a first motion."""
_LATEST = 2
"""Largest number of new search paths in a round."""


@final
class DriveRoutes:
    """Finds routes, each with its index of arrival.

    Args:
        request: Planning request, without impact.
        ends: Start and goals.
        problem: Planning problem for the search.
        rng: Random generator of the planner.
    """

    def __init__(self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator) -> None:
        base = request.objective.scene.base
        assert base is not None
        self._request, self._ends, self._problem, self._base = request, ends, problem, base
        objective = request.objective
        if objective.scene.moving and not isinstance(request.planner, FloorInTime):
            objective, problem = without_moving(request, problem)
        self._run = PausedSearch(request.planner, problem, objective, rng)
        self._known = 0
        self._asked_for_ways = False

    @property
    def moves_arm(self) -> bool:
        """Whether the arm may move while the base does."""
        planner = self._request.planner
        return not isinstance(planner, DriveLattice) or planner.moves_arm

    @property
    def searched(self) -> Search:
        """Current result of the planner's search."""
        return self._run.found

    def search(self, budget: Budget, *, to_first: bool = False) -> None:
        """Continue the search until the budget ends, or until the first path."""
        self._run.advance(budget, to_first=to_first)

    def shortest(self) -> list[tuple[Route, int]]:
        """Return routes along the shortest floor paths to the preferred goal; none if the start is a goal."""
        stays = (self._problem.goals == self._problem.start).all(axis=1).any()
        return [] if stays else self._along_ways(1, _SHORTEST)

    def new(self) -> list[tuple[Route, int]]:
        """Return routes that no previous round has returned."""
        found = [] if self._asked_for_ways else self._along_ways(_GOALS, None)
        self._asked_for_ways = True
        paths = self.searched.paths
        latest, self._known = paths[max(self._known, len(paths) - _LATEST) :], len(paths)
        return found + [one for path in reversed(latest) for one in self.along(path)]

    def along(self, path: Path) -> list[tuple[Route, int]]:
        """Return routes along a path of the planner."""
        whole, arrival = self._ends.joined(path)
        if whole.length == 0.0:
            return []
        return [(route, arrival) for route in routes(path, moves_arm=self.moves_arm)]

    def start(self, leg: RollingLeg, arrival: int) -> Start:
        """Return the start of a descent from a leg."""
        kind = RollingCurves(
            self._base,
            before=float(leg.q[0, 2]),
            after=float(leg.q[-1, 2]),
            forward=leg.forward,
            turns_before=leg.turns_before,
            turns_after=leg.turns_after,
            holds_arm=not self.moves_arm,
            speed=self._request.speed,
        )
        return Start(Path(leg.q), arrival=arrival, kind=kind)

    def _along_ways(self, goals: int, most: int | None) -> list[tuple[Route, int]]:
        """Return routes along floor paths, in the order in which to try them; none if another planner was chosen."""
        if not isinstance(self._request.planner, DriveLattice):
            return []
        start, found = self._problem.start, list[tuple[Route, int]]()
        for arrival, goal in enumerate(self._problem.goals[:goals]):
            over = list(islice(ways(self._request.objective.scene, start, goal), most))
            along = along_ways(over, start, goal, self._base.reverse, moves_arm=self.moves_arm)
            found += [(route, arrival) for route in along]
        return found
