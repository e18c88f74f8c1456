"""Motions of a base: curves descend from short floor paths and from lattice paths, and are timed.

Floor paths ignore headings. They are found in milliseconds, and most of them are good initial guesses. Where no curve
near a floor path is collision-free, the lattice finds a path with turns in place and changes of gear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.static_objective import static_objective
from graceful_plan.mobile.motions.carry_postures import carry_postures
from graceful_plan.mobile.motions.drive import Drive, joined
from graceful_plan.mobile.motions.drive_routes import DriveRoutes
from graceful_plan.mobile.motions.drive_starts import DriveStarts, smooth
from graceful_plan.mobile.motions.drive_timing import along, recosted, timed_drive
from graceful_plan.mobile.motions.legs import ArmMove, RollingLeg, Route
from graceful_plan.mobile.motions.rolling_spline import RollingSpline
from graceful_plan.path import Path
from graceful_plan.planners.descent_rounds import descend_from
from graceful_plan.planners.motion_descent import (
    DescentResult,
    DescentSettings,
    MotionDescents,
    Start,
)
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.departure import at_time
from graceful_plan.query.candidates.descents import motion_descents
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.candidates.search import Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import TracePoint

_SETTINGS = DescentSettings(bends=0)
"""No random bends of starts: most of them end in a wall."""
_SPACING = 0.6
"""Largest length of a leg per control point [m]."""
_SEARCH_SHARE, _PREPARING_SHARE = 0.3, 0.4
"""Share of a round for preparing starts, and share of that for searching paths."""
_PLAIN_SHARE = 0.6
"""Share of the time for starts that goes to motions planned with w = 0, whose curves become starts."""
_COMPOSED_SHARE = 0.3
"""Share of the rest of a round for one route of several legs."""
_WORTH_TIMING = 1.1
"""Largest ratio of a curve's J to the best J at which the curve is timed."""
_TRIED, _COMPARED = 8, 3
"""Largest number of routes tried for a first motion, and number of free ones among which the best is taken."""
_STARTS = 3
"""Number of new curves that descend in a round."""
_BASE = 3
"""Number of joints of the base, which precede those of the arm."""
_DRAW_SECONDS = 0.1
"""Upper bound on the time of one draw of postures [s]."""
_ANOTHER_DRAW = 0.3
"""Duration of a round above which postures are drawn again along the same curve [s]."""


@final
class DriveSource:
    """Generates timed motions of a base with their costs for a request; none of them is verified.

    Args:
        request: Planning request.
        ends: Start and goals.
        problem: Planning problem for the search.
        rng: Random generator.
        charge: Whether costs of motions include the impact.
    """

    def __init__(
        self,
        request: Request,
        ends: Endpoints,
        problem: SceneProblem,
        rng: np.random.Generator,
        *,
        charge: bool = True,
    ) -> None:
        self._request, self._ends, self._problem, self._rng, self._charge = request, ends, problem, rng, charge
        found = motion_descents(request, problem, _SETTINGS) if request.refine else None
        self._descents = None if found is None else replace(found, spacing=_SPACING)
        self._starts = None if self._descents is None else DriveStarts(self._descents)
        self._plain: DriveSource | None = None
        of = request.objective
        if of.w > 0.0 and self._descents is not None:
            short = of.objective.with_weight(0.0).bind(of.scene, of.paces)
            plain = replace(request, objective=short, preference=None)
            self._plain = DriveSource(plain, ends, problem, rng.spawn(1)[0], charge=False)
            self._routes = self._plain._routes
        else:
            self._routes = DriveRoutes(request, ends, problem, rng.spawn(1)[0])
        self._rough: list[Start] = []
        self._composed: list[tuple[Route, int]] = []
        self._new_composed: list[tuple[Route, int]] = []
        self._first: tuple[Drive, int] | None = None
        self._results: list[DescentResult] = []
        self.best: Start | None = None
        """Curve of the best motion of one leg."""
        self._best_motion: Motion | None = None
        self._posed: Motion | None = None
        self._curves: list[Start] = []
        self._path_cost = np.inf
        self._driven_path: Path | None = None
        self._call = Budget()
        self._timing_seconds = 0.0

    @property
    def path_cost(self) -> float:
        """Least cost of a searched path, as the search estimates it."""
        return self._path_cost if self._plain is None else self._plain.path_cost

    @property
    def restarts(self) -> bool:
        """Whether the source works in rounds of increasing duration."""
        return True

    @property
    def effort(self) -> int:
        """Number of completed descents."""
        own = 0 if self._descents is None else self._descents.effort.descents
        return own + (0 if self._plain is None else self._plain.effort)

    def search_first(self, budget: Budget) -> Search:
        """Search until there is a drive or a path; return the search."""
        self._call = budget
        if self._plain is not None:
            return self._plain.search_first(budget)
        found: list[tuple[float, Drive, Start | None, int]] = []
        for route, arrival in self._routes.shortest()[:_TRIED]:
            drive = self._coarse(route, arrival, budget)
            found += [(*drive, arrival)] if drive is not None else []
            if len(found) == _COMPARED or (found and budget.over):
                break
        if not found:
            self._routes.search(budget, to_first=True)
            return self._routes.searched
        value, drive, self.best, arrival = min(found, key=lambda one: one[0])
        self._first = drive, arrival
        path = Path(drive.grid(1).q)
        point = TracePoint(time=budget.elapsed, total=value, motion=path.length, impact=0.0)
        return Search(paths=[path], trace=[point])

    def first(self, budget: Budget) -> Iterator[Motion]:
        """Yield motions near the first path: smooth ones, then one along a path of the planner itself.

        Raises:
            RetimingError: If that path has no timing.
        """
        if self._plain is not None:
            for plain in self._plain.first(budget):
                motion = recosted(plain, self._request)
                self.best, self._best_motion = self._plain.best, motion
                yield motion
            return
        if self._first is not None:
            motion = self._driven(*self._first)
            if motion is not None:
                self._best_motion = motion
                yield motion
        if not self._routes.searched.paths:
            self._routes.search(budget, to_first=True)
        for path in self._routes.searched.paths[-1:]:
            for route, arrival in self._routes.along(path):
                drive = self._coarse(route, arrival, budget)
                motion = None if drive is None else self._driven(drive[1], arrival)
                if motion is not None:
                    yield motion
            yield along(*self._ends.joined(path), self._request)

    def round(self, budget: Budget, best: float) -> Iterator[Motion]:
        """Yield those motions of one round that improve on the best ranking."""
        for motion in self._made(budget):
            if motion.ranking < best:
                best = motion.ranking
                yield motion

    def others(self, is_new: Callable[[Float[Array, "n nq"]], bool]) -> Iterator[Motion]:
        """Yield motions of one leg along curves of earlier descents, by increasing estimated cost.

        Args:
            is_new: Whether a curve is worth timing, by its samples.
        """
        for result in sorted(self._results, key=lambda one: one.value):
            if is_new(result.curve.samples):
                arrival = result.start.arrival
                motion = self._driven(self._joined([_rolled(result)], arrival), arrival)
                if motion is not None:
                    yield motion

    def _made(self, budget: Budget) -> Iterator[Motion]:
        """Yield the motions of a round."""
        with budget.share(
            _PREPARING_SHARE * budget.remaining_seconds, _PREPARING_SHARE * budget.remaining_iterations
        ) as part:
            yield from self._prepared(part)
        if self._descents is None or self._starts is None:
            return
        yield from self._timed(one for one in self._pose(budget) if one.value < self._ranking)
        if self._composed:
            with budget.share(_COMPOSED_SHARE * budget.remaining_seconds) as part:
                motion = self._descended(*self._composed.pop(0), part)
            if motion is not None:
                yield motion
        starts = self._starts.take(_STARTS, again=not self._results)
        with budget.share(budget.remaining_seconds - self._timing_seconds) as part:
            results = descend_from(starts, self._descents, part, self._rng, self._results)
            yield from self._timed(self._worth_timing(results))

    def _prepared(self, budget: Budget) -> Iterator[Motion]:
        """Add starts for descents; yield motions along starts that are good enough without a descent."""
        if self._plain is not None:
            with budget.share(
                _PLAIN_SHARE * budget.remaining_seconds, _PLAIN_SHARE * budget.remaining_iterations
            ) as part:
                for plain in self._plain.round(part, np.inf):
                    yield recosted(plain, self._request)
            curves, routes = self._plain.take()
            self._rough = curves[::-1] + self._rough
            self._composed += routes
        else:
            with budget.share(_SEARCH_SHARE * budget.remaining_seconds) as part:
                self._routes.search(part)
            found = self._routes.searched
            if found.trace:
                self._path_cost = min(self._path_cost, found.trace[-1].total)
            for route, arrival in self._routes.new():
                leg = route[0]
                if len(route) == 1 and isinstance(leg, RollingLeg):
                    self._rough.append(self._routes.start(leg, arrival))
                else:
                    self._composed.append((route, arrival))
                    self._new_composed.append((route, arrival))
        if self._descents is None or self._starts is None:  # no descents for this request
            for path in self._routes.searched.paths[-1:]:
                if path is not self._driven_path:
                    self._driven_path = path
                    yield along(*self._ends.joined(path), self._request)
            return
        while self._rough and not budget.over:
            start = self._rough.pop(0)
            curve = start if start.curve is not None else smooth(start, self._descents, budget)
            if curve is not None:
                self._curves.append(curve)
                yield from self._timed(one for one in self._starts.add(curve) if one.value < self._ranking)

    def take(self) -> tuple[list[Start], list[tuple[Route, int]]]:
        """Take the curves and multi-leg routes found since the last call, for use as starts in another source."""
        taken = self._curves, self._new_composed
        self._curves, self._new_composed = [], []
        return taken

    def _worth_timing(self, results: Iterator[DescentResult]) -> Iterator[DescentResult]:
        """Store results of descents; yield those that are nearly as good as the best."""
        for result in results:
            self._results.append(result)
            if result.value <= _WORTH_TIMING * min(other.value for other in self._results):
                self._curves.append(replace(result.start, curve=result.curve))
                yield result

    def _timed(self, results: Iterable[DescentResult]) -> Iterator[Motion]:
        """Yield motions along curves of one leg while the call has time for one more."""
        for result in results:
            if self._call.over or self._call.remaining_seconds < self._timing_seconds:
                return
            began, arrival = self._call.elapsed, result.start.arrival
            motion = self._driven(self._joined([_rolled(result)], arrival), arrival)
            self._timing_seconds = self._call.elapsed - began
            if motion is not None:
                if motion.ranking < self._ranking:
                    self._best_motion, self.best = motion, replace(result.start, curve=result.curve)
                yield motion

    @property
    def _ranking(self) -> float:
        """Ranking of the best motion along a curve of one leg."""
        return np.inf if self._best_motion is None else self._best_motion.ranking

    def _pose(self, budget: Budget) -> Iterator[DescentResult]:
        """Start variants of the best curve with other arm postures, if the curve is new or time allows another draw."""
        objective, motion = self._request.objective, self._best_motion
        if self._starts is None or motion is None or self.best is None:
            return
        known = motion is self._posed and budget.remaining_seconds < _ANOTHER_DRAW
        moves_arm = self._problem.start.size > _BASE and self._routes.moves_arm
        if known or not moves_arm or objective.w == 0.0 or self._call.remaining_seconds < _DRAW_SECONDS:
            return
        self._posed = motion
        arms = carry_postures(motion.trajectory, self._problem, static_objective(objective), self._rng)
        yield from self._starts.pose(self.best, arms)

    def _descended(self, route: Route, arrival: int, budget: Budget) -> Motion | None:
        """Return a motion along a route whose legs descend one after the other.

        Among moving entities, a leg begins at the time when the parts before it end.
        """
        chosen: list[RollingSpline | ArmMove] = []
        legs = sum(isinstance(part, RollingLeg) for part in route)
        for part in route:
            if not isinstance(part, RollingLeg):
                chosen.append(part)
                continue
            with budget.share(budget.remaining_seconds / legs) as share:
                start, descents = self._routes.start(part, arrival), self._descents_after(chosen)
                if descents is None:
                    return None
                results = list(descend_from([start], descents, share, self._rng))
            legs -= 1
            if not results:
                return None
            chosen.append(_rolled(min(results, key=lambda one: one.value)))
        return self._driven(self._joined(chosen, arrival), arrival)

    def _descents_after(self, parts: Sequence[RollingSpline | ArmMove]) -> MotionDescents | None:
        """Return descents that begin when these parts end; None if the parts cannot be timed."""
        descents, request, of = self._descents, self._request, self._request.objective
        if descents is None or not parts or not of.scene.moving:
            return descents
        last = parts[-1]
        end = last.samples[-1] if isinstance(last, RollingSpline) else last[-1]
        driven = timed_drive(joined(self._ends.departure.q[-1], parts, end), 0, request, charge=False)
        if driven is None:
            return None
        later = of.objective.bind(at_time(of.scene, driven.trajectory.duration), of.paces)
        found = motion_descents(replace(request, objective=later), self._problem, _SETTINGS)
        return None if found is None else replace(found, spacing=_SPACING, effort=descents.effort)

    def _coarse(self, route: Route, arrival: int, budget: Budget) -> tuple[float, Drive, Start | None] | None:
        """Return the total cost of coarsely descended legs, the drive, and its start if it has one leg.

        None if a leg is not collision-free.
        """
        if self._descents is None:
            return None
        chosen: list[RollingSpline | ArmMove] = []
        value, start = 0.0, None
        for part in route:
            if not isinstance(part, RollingLeg):
                chosen.append(part)
                continue
            found = self._descents.first(self._routes.start(part, arrival), budget)
            if found is None:
                return None
            chosen.append(_rolled(found))
            value, start = value + found.value, replace(found.start, curve=found.curve)
        return value, self._joined(chosen, arrival), start if len(route) == 1 else None

    def _driven(self, drive: Drive, arrival: int) -> Motion | None:
        return timed_drive(drive, arrival, self._request, charge=self._charge)

    def _joined(self, parts: Sequence[RollingSpline | ArmMove], arrival: int) -> Drive:
        """Return a drive from the start along the parts to a goal, including the arm's motion there."""
        q = self._ends.arrivals[arrival].q
        return joined(self._ends.departure.q[-1], [*parts, *(np.stack(edge) for edge in pairwise(q))], q[-1])


def _rolled(found: DescentResult) -> RollingSpline:
    assert isinstance(found.curve, RollingSpline)
    return found.curve
