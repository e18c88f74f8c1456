"""Motions of a base from paths of a lattice: curves descend from their legs, are put together and timed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import RetimingError
from graceful_plan.mobile.motions.drive import Drive, joined
from graceful_plan.mobile.motions.legs import ArmMove, Leg, Route, routes
from graceful_plan.mobile.motions.rolling_spline import RollingCurves, RollingSpline
from graceful_plan.path import Path
from graceful_plan.planners.descent_rounds import descend_from
from graceful_plan.planners.motion_descent import (
    COARSE,
    DRIVING_TIME_PRICE,
    DescentResult,
    DescentSettings,
    MotionDescents,
    Stage,
    Start,
)
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.descents import motion_descents
from graceful_plan.query.candidates.motions import Motion, costed
from graceful_plan.query.candidates.search import Callback, PausedSearch, Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.topp import Restraint

Array = np.ndarray

_SPACING = 0.6
"""Greatest length of a leg for each control point [m]."""
_SEARCH_SHARE = 0.15
"""Of a round, for searching paths; the rest is for descents near them."""
_WORTH_TIMING = 1.1
"""Ratio of a route's J to that of the best up to which it is timed."""
_FREE = 1e9
"""Squared path speed where nothing is to be slower."""


@final
class DriveSource:
    """Makes motions of a base for a request, each timed and with its cost, none of them verified.

    Args:
        request: What to plan.
        ends: Both ends.
        problem: Where to search.
        rng: Chance.
        tell: Called with improvements of a search whose paths are not refined; returns whether to end it.
    """

    def __init__(
        self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator, tell: Callback
    ) -> None:
        base = request.objective.scene.base
        assert base is not None
        self._request, self._ends, self._problem, self._rng, self._base = request, ends, problem, rng, base
        objective = request.objective
        short = objective.objective.with_weight(0.0).bind(objective.scene, objective.paces)
        self._first = PausedSearch(request.planner, problem, short, rng.spawn(1)[0])
        self._descents = motion_descents(request, problem, DescentSettings())
        if self._descents is not None:
            self._descents = replace(self._descents, price=DRIVING_TIME_PRICE, spacing=_SPACING)
        self._best = np.inf
        self.path_cost = np.inf
        """Least cost of a path of a search, as the search estimates it."""
        self._results: dict[tuple[int, int], list[DescentResult]] = {}

    restarts = True

    @property
    def effort(self) -> int:
        """Number of descents that have ended."""
        return 0 if self._descents is None else self._descents.effort.descents

    def search_first(self, budget: Budget) -> Search:
        """Search until there is a path; return the search."""
        self._first.advance(budget, to_first=True)
        return self._first.found

    def first(self, budget: Budget) -> Iterator[Motion]:
        """Yield motions near the first path: smooth ones, then one along the path itself.

        Raises:
            RetimingError: If the path has no timing.
        """
        whole, arrival = self._ends.joined(self._first.found.paths[-1])
        if whole.length > 0.0:
            for route in routes(whole):
                drive = self._coarse(route, arrival, budget)
                motion = None if drive is None else self._timed(drive, whole, arrival)
                if motion is not None:
                    yield motion
        yield self._along(whole, arrival)

    def round(self, budget: Budget, best: float) -> Iterator[Motion]:
        """Yield motions of one round, those that are ranked before the best one known."""
        with budget.share(_SEARCH_SHARE * budget.remaining_seconds) as part:
            self._first.advance(part)
        found = self._first.found
        if found.trace:
            self.path_cost = min(self.path_cost, found.trace[-1].total)
        jobs = [(path, route) for path in found.paths[-1:-4:-1] for route in routes(self._ends.joined(path)[0])]
        for k, (path, route) in enumerate(jobs):
            if budget.over:
                return
            with budget.share(budget.remaining_seconds / (len(jobs) - k)) as part:
                for motion in self._descended(route, path, part):
                    if motion.ranking < best:
                        best = motion.ranking
                        yield motion

    def _descended(self, route: Route, path: Path, budget: Budget) -> Iterator[Motion]:
        """Yield motions along a route whose legs descend."""
        descents = self._descents
        if descents is None:
            return
        whole, arrival = self._ends.joined(path)
        chosen: list[RollingSpline | ArmMove | None] = [None if isinstance(p, Leg) else p for p in route]
        legs = [k for k, part in enumerate(route) if isinstance(part, Leg)]
        for n, k in enumerate(legs):
            leg = route[k]
            assert isinstance(leg, Leg)
            results: list[DescentResult] = []
            with budget.share(budget.remaining_seconds / (len(legs) - n)) as part:
                for result in descend_from([self._start(leg, arrival)], descents, part, self._rng, results):
                    results.append(result)
            if not results:
                return
            curve = min(results, key=lambda one: one.value).curve
            assert isinstance(curve, RollingSpline)
            chosen[k] = curve
        motion = self._timed(self._joined(chosen), whole, arrival)
        if motion is not None:
            yield motion

    def _coarse(self, route: Route, arrival: int, budget: Budget) -> Drive | None:
        """Return a drive along a route whose legs descended coarsely; None if one of them is not free."""
        if self._descents is None:
            return None
        chosen: list[RollingSpline | ArmMove | None] = []
        for part in route:
            if not isinstance(part, Leg):
                chosen.append(part)
                continue
            found = self._descents.first(self._start(part, arrival), budget)
            if found is None:
                return None
            assert isinstance(found.curve, RollingSpline)
            chosen.append(found.curve)
        return self._joined(chosen)

    def _start(self, leg: Leg, arrival: int) -> Start:
        kind = RollingCurves(
            self._base,
            before=float(leg.q[0, 2]),
            after=float(leg.q[-1, 2]),
            forward=leg.forward,
            turns_before=leg.turns_before,
            turns_after=leg.turns_after,
            speed=self._request.speed,
        )
        return Start(Path(leg.q), arrival=arrival, kind=kind)

    def _joined(self, parts: Sequence[RollingSpline | ArmMove | None]) -> Drive:
        ends = self._ends
        return joined(ends.departure.q[-1], [part for part in parts if part is not None], ends.arrivals[0].q[0])

    def _along(self, whole: Path, arrival: int) -> Motion:
        """Return a motion along a path itself, with a stop at each of its corners."""
        trajectory = self._request.constraints.retimed(whole, deviation=0.0, speed=self._request.speed)
        return costed(whole, trajectory, arrival, self._request)

    def _timed(self, drive: Drive, whole: Path, arrival: int) -> Motion | None:
        """Time a drive; None if no timing keeps the constraints."""
        request = self._request
        try:
            trajectory = request.constraints.timed(drive, speed=request.speed)
            if drive.share(drive.grid(1)) is not None:
                trajectory = request.constraints.timed(
                    drive, speed=request.speed, slower=slower(drive, trajectory.t, trajectory.qd)
                )
        except RetimingError:
            return None
        return costed(whole, trajectory, arrival, request)


def slower(drive: Drive, t: Float[Array, " point"], qd: Float[Array, "point nq"]) -> Restraint | None:
    """Return limits on the path speed at the shares that a drive has of its fastest motion.

    Args:
        drive: The drive.
        t: Times of its fastest motion [s], at the points of a grid.
        qd: Velocities there [rad/s or m/s].
    """
    grid = next(g for g in map(drive.grid, (1, 2, 4)) if len(g.q) == len(t))
    share = drive.share(grid)
    if share is None:
        return None
    slope = np.linalg.norm(np.concatenate([grid.slope[:, 0], grid.slope[-1:, 1]]), axis=1)
    cap = (share * np.linalg.norm(qd, axis=1) / np.maximum(slope, 1e-12)) ** 2
    cap = np.where((share < 1.0) & ~grid.stop, cap, _FREE)

    def limits(of: CurveGrid) -> Float[Array, "interval limit 3"]:
        at = np.interp(of.s, grid.s, cap)
        steps, zero, one = np.diff(of.s), np.zeros(len(of.s) - 1), np.ones(len(of.s) - 1)
        begin = np.stack([zero, one, at[:-1]], axis=-1)
        end = np.stack([2.0 * steps, one, at[1:]], axis=-1)
        return np.stack([begin, end], axis=1)

    return limits
