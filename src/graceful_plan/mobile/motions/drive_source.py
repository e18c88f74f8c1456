"""Motions of a base: curves descend from ways over the floor and from paths of a lattice, and are timed.

Ways over the floor know no headings: most of them are good to begin with, and found in milliseconds. Where no curve
near one of them is free, the lattice finds a path with turns in place and changes of gear.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.costs.still import as_if_nobody_moved
from graceful_plan.exceptions import RetimingError
from graceful_plan.mobile.motions.carry_postures import carry_postures, with_posture
from graceful_plan.mobile.motions.drive import Drive, joined
from graceful_plan.mobile.motions.legs import ArmMove, Leg, Route, along_ways, routes
from graceful_plan.mobile.motions.rolling_spline import RollingCurves, RollingSpline
from graceful_plan.mobile.motions.ways import ways
from graceful_plan.path import Path
from graceful_plan.planners.descent_rounds import descend_from
from graceful_plan.mobile.planners.drive_lattice import DriveLattice
from graceful_plan.mobile.planners.floor_in_time import FloorInTime
from graceful_plan.planners.motion_descent import COARSE, DRIVING_TIME_PRICE, DescentResult, DescentSettings, Start
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.descents import motion_descents
from graceful_plan.query.candidates.motions import Motion, costed
from graceful_plan.query.candidates.search import PausedSearch, Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import TracePoint
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.topp import Restraint
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_SPACING = 0.6
"""Greatest length of a leg for each control point [m]."""
_SEARCH_SHARE = 0.15
"""Of a round, for searching paths; the rest is for descents near them."""
_WORTH_TIMING = 1.1
"""Ratio of a route's J to that of the best up to which it is timed."""
_GOALS, _SHORTEST = 3, 2
"""Goals that ways lead to, and ways for a first motion."""
_TRIED, _COMPARED = 8, 3
"""Routes along these that are tried for it at most, and of how many that are free it is the best."""
_LATEST = 2
"""Paths of a search that a round begins with at most."""
_STARTS = 3
"""Curves that a round begins with, besides those that it refines."""
_PACES = ((0.6, 0.0, 1.0), (0.35, 0.0, 1.0), (0.25, 0.0, 0.3), (0.25, 0.2, 0.5), (0.25, 0.4, 0.7))
"""Shares of the speed at which curves begin among those who move, and from where to where along them."""
_PACES_KEPT = 2
"""Of these, for each curve."""
_LOOK = replace(COARSE, evaluations=0)
"""Tells J of a curve as it is."""
_POSED = 64
"""Points of a curve along which the arm has other postures."""
_INTO = 1e6
"""Added to the ranking of motions that drive into somebody."""
_STANDING = 0.01
"""Speed of all joints below which a robot does not drive into anybody, but is walked into [m/s or rad/s]."""
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
    """

    def __init__(self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator) -> None:
        base = request.objective.scene.base
        assert base is not None
        self._request, self._ends, self._problem, self._rng, self._base = request, ends, problem, rng, base
        self._short = replace(request, objective=_without_impact(request), preference=None)
        self._lattice = _search_as_if_nobody_moved(self._short, problem, rng.spawn(1)[0])
        self._shortening = self._descents_of(self._short)
        self._descents = self._descents_of(request) or self._shortening
        self._drives: list[tuple[Drive, Path, int]] = []
        self._ways: list[tuple[Route, int]] | None = None
        self._results: list[DescentResult] = []
        self._latest: tuple[Motion, DescentResult] | None = None
        self._entered = 0
        self._rough: list[Start] = []
        self._untried: list[tuple[float, Start]] = []
        self._tried: list[tuple[float, Start]] = []
        self._composed: list[tuple[Route, int]] = []
        self.path_cost = np.inf
        """Least cost of a path of a search, as the search estimates it."""

    def _descents_of(self, request: Request) -> MotionDescents | None:
        found = motion_descents(request, self._problem, DescentSettings())
        return None if found is None else replace(found, price=DRIVING_TIME_PRICE, spacing=_SPACING)

    @property
    def restarts(self) -> bool:
        """Whether there are rounds, each longer than the one before."""
        return True

    @property
    def effort(self) -> int:
        """Number of descents that have ended."""
        both = {id(of): of for of in (self._descents, self._shortening) if of is not None}
        return sum(of.effort.descents for of in both.values())

    def search_first(self, budget: Budget) -> Search:
        """Search until there is a drive or a path; return the search."""
        stays = (self._problem.goals == self._problem.start).all(axis=1).any()
        found: list[tuple[float, Drive, int]] = []
        for route, arrival in () if stays else self._along_ways(first=True)[:_TRIED]:
            drive = self._coarse(route, arrival, budget)
            found += [(*drive, arrival)] if drive is not None else []
            if len(found) == _COMPARED or (found and budget.over):
                break
        if found:
            value, drive, arrival = min(found, key=lambda one: one[0])
            path = Path(drive.grid(1).q)
            self._drives.append((drive, path, arrival))
            point = TracePoint(time=budget.elapsed, total=value, motion=path.length, impact=0.0)
            return Search(paths=[path], trace=[point])
        self._lattice.advance(budget, to_first=True)
        return self._lattice.found

    def first(self, budget: Budget) -> Iterator[Motion]:
        """Yield motions near the first path: smooth ones, then one along the path itself.

        Raises:
            RetimingError: If the path has no timing.
        """
        for drive, whole, arrival in self._drives:
            motion = self._timed(drive, whole, arrival)
            if motion is not None:
                yield motion
        if not self._lattice.found.paths:
            self._lattice.advance(budget, to_first=True)
        for path in self._lattice.found.paths[-1:]:
            whole, arrival = self._ends.joined(path)
            for route in routes(whole) if whole.length > 0.0 else ():
                drive = self._coarse(route, arrival, budget)
                motion = None if drive is None else self._timed(drive[1], whole, arrival)
                if motion is not None:
                    yield motion
            yield self._along(whole, arrival)

    def round(self, budget: Budget, best: float) -> Iterator[Motion]:
        """Yield motions of one round, those that are ranked before the best one known."""
        with budget.share(_SEARCH_SHARE * budget.remaining_seconds) as part:
            self._lattice.advance(part)
        found = self._lattice.found
        if found.trace:
            self.path_cost = min(self.path_cost, found.trace[-1].total)
        fresh = [*(self._along_ways() if self._ways is None else ()), *self._along_lattice()]
        self._composed += [one for one in fresh if not _is_single(one[0])]
        self._rough += [self._start(route[0], arrival) for route, arrival in fresh if _is_single(route)]
        self._rough += self._posed()
        if self._descents is None:
            yield from self._stopping(best)
            return
        self._enter(budget)
        if not (self._untried or self._results):
            self._untried, self._tried = self._tried, []  # once more, bent at random
        starts, self._untried = self._untried[:_STARTS], self._untried[_STARTS:]
        self._tried += starts
        for result in descend_from([start for _, start in starts], self._descents, budget, self._rng, self._results):
            self._results.append(result)
            if result.value > _WORTH_TIMING * min(other.value for other in self._results):
                continue
            motion = self._motion([result.curve], result.start.arrival)
            if motion is not None and motion.ranking < best:
                best, self._latest = motion.ranking, (motion, result)
                yield motion
        while self._composed and not budget.over:
            motion = self._descended(*self._composed.pop(0), budget)
            if motion is not None and motion.ranking < best:
                best = motion.ranking
                yield motion

    def _stopping(self, best: float) -> Iterator[Motion]:
        """Yield a motion along the latest path itself, for costs that nothing descends along."""
        for path in self._lattice.found.paths[-1:]:
            motion = self._along(*self._ends.joined(path))
            if motion.ranking < best:
                yield motion

    def _enter(self, budget: Budget) -> None:
        """Let rough starts become short and smooth, and keep them in the order of J, the best first."""
        assert self._descents is not None
        while self._rough and not budget.over:
            start = self._rough.pop(0)
            short = start if start.curve is not None else self._shortened(start, budget)
            if short is None:
                continue
            descent = self._descents.descended(short, _LOOK, budget)
            if descent is None:
                continue
            looked = [(descent.value, short)]
            for slower in _paced(short) if descent.gap < 0.0 else ():  # somebody may be let pass
                descent = self._descents.descended(slower, _LOOK, budget)
                looked += [(descent.value, slower)] if descent is not None else []
            self._untried += sorted(looked, key=lambda one: one[0])[:_PACES_KEPT]
        self._untried.sort(key=lambda one: one[0])


    def _shortened(self, start: Start, budget: Budget) -> Start | None:
        assert self._shortening is not None
        descent = self._shortening.descended(start, COARSE, budget)
        if descent is None:
            return None
        curve = start.kind.curve(descent.controls)
        return replace(start, path=Path(curve.even(_POSED)), curve=curve)

    def _along_lattice(self) -> list[tuple[Route, int]]:
        """Return routes along the latest paths of the lattice that were not entered yet."""
        paths = self._lattice.found.paths
        latest, self._entered = paths[max(self._entered, len(paths) - _LATEST) :], len(paths)
        joined = [self._ends.joined(path) for path in reversed(latest)]
        return [(route, arrival) for whole, arrival in joined if whole.length > 0.0 for route in routes(whole)]

    def _posed(self) -> list[Start]:
        """Return starts with the arm in other postures along the best curve."""
        objective = self._request.objective
        if self._latest is None or objective.w == 0.0 or self._problem.start.size == 3:
            return []
        motion, result = self._latest
        self._latest = None
        arms = carry_postures(motion.trajectory, self._problem, as_if_still(objective), self._rng)
        assert isinstance(result.curve, RollingSpline)
        curves = [replace(result.curve, controls=with_posture(result.curve.controls, arm)) for arm in arms]
        return [replace(result.start, path=Path(curve.even(_POSED)), curve=curve) for curve in curves]

    def _along_ways(self, *, first: bool = False) -> list[tuple[Route, int]]:
        """Return routes along ways over the floor, those that are tried first in front; or along the shortest alone."""
        if self._shortening is None or not isinstance(self._request.planner, DriveLattice):
            return []
        if self._ways is not None:
            return self._ways
        start, found = self._problem.start, list[tuple[Route, int]]()
        for arrival, goal in enumerate(self._problem.goals[: 1 if first else _GOALS]):
            over = ways(self._request.objective.scene, start, goal)
            chosen = list(islice(over, _SHORTEST)) if first else list(over)
            found += [(route, arrival) for route in along_ways(chosen, start, goal, self._base.reverse)]
        if not first:
            self._ways = found
        return found

    def _descended(self, route: Route, arrival: int, budget: Budget) -> Motion | None:
        """Return a motion along a route whose legs descend one after the other."""
        assert self._descents is not None
        chosen: list[RollingSpline | ArmMove] = []
        legs = sum(isinstance(part, Leg) for part in route)
        for part in route:
            if not isinstance(part, Leg):
                chosen.append(part)
                continue
            with budget.share(budget.remaining_seconds / legs) as share:
                results = list(descend_from([self._start(part, arrival)], self._descents, share, self._rng))
            legs -= 1
            if not results:
                return None
            chosen.append(min(results, key=lambda one: one.value).curve)
        return self._motion(chosen, arrival)

    def _coarse(self, route: Route, arrival: int, budget: Budget) -> tuple[float, Drive] | None:
        """Return a drive along a route whose legs became short and smooth, and its cost; None if one is not free."""
        if self._shortening is None:
            return None
        chosen: list[RollingSpline | ArmMove] = []
        value = 0.0
        for part in route:
            if not isinstance(part, Leg):
                chosen.append(part)
                continue
            found = self._shortening.first(self._start(part, arrival), budget)
            if found is None:
                return None
            chosen.append(found.curve)
            value += found.value
        return value, self._joined(chosen, arrival)

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

    def _joined(self, parts: Sequence[RollingSpline | ArmMove], arrival: int) -> Drive:
        return joined(self._ends.departure.q[-1], parts, self._ends.arrivals[arrival].q[0])

    def _motion(self, parts: Sequence[RollingSpline | ArmMove], arrival: int) -> Motion | None:
        drive = self._joined(parts, arrival)
        return self._timed(drive, Path(drive.grid(1).q), arrival)

    def _along(self, whole: Path, arrival: int) -> Motion:
        """Return a motion along a path itself, with a stop at each of its corners."""
        trajectory = self._request.constraints.retimed(whole, deviation=0.0, speed=self._request.speed)
        return costed(whole, trajectory, arrival, self._request)

    def _timed(self, drive: Drive, whole: Path, arrival: int) -> Motion | None:
        """Time a drive; None if no timing keeps the constraints."""
        request = self._request
        try:
            trajectory = request.constraints.timed(drive, speed=request.speed)
            restraint = slower(drive, trajectory.t, trajectory.qd)
            if restraint is not None:
                trajectory = request.constraints.timed(drive, speed=request.speed, slower=restraint)
        except RetimingError:
            return None
        motion = costed(whole, trajectory, arrival, request)
        return replace(motion, ranking=motion.ranking + _INTO * self._drives_into_somebody(motion.trajectory))

    def _drives_into_somebody(self, motion: Trajectory) -> bool:
        """Tell whether the sound robot touches an entity that moves, by the fast checker."""
        among = self._request.objective.among_moving
        if among is None:
            return False
        moves = np.abs(motion.qd).max(axis=1) > _STANDING
        gap, _, _ = among.moving.gaps(motion.q[moves], motion.t[moves], 0.0)
        return bool((gap < 0.0).any())


def slower(drive: Drive, t: Float[Array, " point"], qd: Float[Array, "point nq"]) -> Restraint | None:
    """Return limits on the path speed at the shares that a drive has of its fastest motion; None if it has all of it.

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


def as_if_still(of: SceneObjective) -> SceneObjective:
    """Return the objective as if nobody moved."""
    return of.objective.bind(as_if_nobody_moved(of.scene), of.paces) if of.scene.moving else of


def _search_as_if_nobody_moved(request: Request, problem: SceneProblem, rng: np.random.Generator) -> PausedSearch:
    """Return a search for paths: it knows no times, at which somebody might be in the way."""
    of = request.objective
    if of.scene.moving and not isinstance(request.planner, FloorInTime):
        of = as_if_still(of)
        held = request.constraints.on(of.scene)
        problem = replace(problem, kernels=held.kernels, constraints=held)
    return PausedSearch(request.planner, problem, of, rng)


def _paced(start: Start) -> Iterator[Start]:
    """Yield a start at slower paces."""
    assert isinstance(start.curve, RollingSpline)
    along = np.linspace(0.0, 1.0, len(start.curve.controls))
    for slow, begin, end in _PACES:
        controls = start.curve.controls.copy()
        controls[:, -1] = np.where((along >= begin) & (along <= end), np.log(slow), 0.0)
        yield replace(start, curve=replace(start.curve, controls=controls))


def _is_single(route: Route) -> bool:
    return len(route) == 1 and isinstance(route[0], Leg)


def _without_impact(request: Request) -> SceneObjective:
    of = request.objective
    return of.objective.with_weight(0.0).bind(of.scene, of.paces)
