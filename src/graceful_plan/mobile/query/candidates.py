"""Motions of a base near paths of straight stretches and turns in place: smooth where that is free, timed, charged.

None is worse by J than what is had without any regard for impact: the motions for a weight of 0 are made as well, and
nothing is returned that costs more than the best of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from graceful_plan.exceptions import RetimingError
from graceful_plan.mobile.among.pacing import paced
from graceful_plan.mobile.among.walkers import Walkers
from graceful_plan.mobile.motions.drive_curve import Drive, connected
from graceful_plan.mobile.motions.drives import joined_ends, smooth_all, stopping
from graceful_plan.mobile.motions.postures import BASE
from graceful_plan.mobile.motions.reposed import reposed
from graceful_plan.mobile.motions.slowing import slower_where_it_pays
from graceful_plan.mobile.motions.smoothing import Smoother
from graceful_plan.mobile.motions.stages import stages
from graceful_plan.mobile.planners.drive_lattice import DriveLattice
from graceful_plan.mobile.query.clock import Clock
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.motions import Motion, costed, costed_anew, price_of_time
from graceful_plan.query.candidates.search import KEPT, Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.topp import Restraint
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_PLANE_SHARE, _AMONG_SHARE = 0.35, 0.6
"""Of the time for motions, for those whose arm stays while the base moves: where nobody moves, and among those who do.
"""
_CURVE_SHARE = 0.5
"""Of the time that is left, for one curve."""
_ORDINARY_SHARE, _ORDINARY_AMONG = 0.1, 0.4
"""Of the time that is left, for motions of a weight of 0. Where nobody moves, the first is nearly as good as all, and
the others' time is better spent on curves that have regard for impact; among those who move it takes several to pass
them, and these are where to begin with any weight."""
_REPOSED, _LINES = 8, 2
"""How often postures are chosen along a motion, and along how many that the arm stays in."""
_WORTH = 1e-3
"""Relative gain below which no more postures are chosen."""
_SLOWER = (0.6, 0.4, 0.8)
"""Shares of the speed at which curves among those who move are made as well."""
_INTO = 1e6
"""What is added to the ranking of motions that drive into somebody."""


@dataclass(frozen=True, eq=False)
class Ordinary:
    """What is made without any regard for impact.

    | field     | meaning                                                                            |
    |-----------|------------------------------------------------------------------------------------|
    | made      | motions and what they are along, the best first, charged for a weight of 0         |
    | reference | the best of them, charged by J as `Drives.motions` are, None if it drives into somebody |
    | along     | motions along the same curve, also with the law of time that pays, charged so      |
    """

    made: Sequence[tuple[Motion, Drive]] = ()
    reference: Motion | None = None
    along: Sequence[Motion] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Drives:
    """What motions of a base are made for.

    Args:
        request: What is asked.
        ends: Both ends.
        problem: What was searched in.
        clock: The time that the call has.
        cancelled: Whether the call is to end.
        insured: Whether there is a motion already that passes the judge.
    """

    request: Request
    ends: Endpoints
    problem: SceneProblem
    clock: Clock
    cancelled: Callable[[], bool] = lambda: False
    insured: bool = False
    walkers: Walkers | None = field(init=False)
    """Those who move, if anybody does."""

    def __post_init__(self) -> None:
        objective = self.request.objective
        object.__setattr__(self, "walkers", Walkers(objective) if objective.scene.moving else None)

    def without_regard_for_impact(self) -> Drives:
        """Return the same for a weight of 0."""
        of = self.request.objective
        objective = of.objective.with_weight(0.0).bind(of.scene, of.paces)
        return replace(self, request=replace(self.request, objective=objective, preference=None, callback=None))

    def ordinary(self, searched: Search, budget: Budget) -> Ordinary:
        """Return motions near paths that were found for a weight of 0."""
        if not searched.paths or budget.exhausted:
            return Ordinary()
        share = _ORDINARY_SHARE if self.walkers is None else _ORDINARY_AMONG
        with budget.share(share * budget.remaining_seconds) as part:
            made = self.without_regard_for_impact()._made(searched, part, np.random.default_rng(0))
        if not made:
            return Ordinary()
        best, drive = made[0]
        along = [motion for motion, _ in self._timed(drive, best.path, best.arrival)]
        return Ordinary(made, costed_anew(best, self._closely) if best.ranking < _INTO else None, along)

    def soon(self, ordinary: Ordinary) -> list[Motion]:
        """Return motions that take no further search and no descent, the best first."""
        return self._in_order(list(ordinary.along), ordinary.reference)

    def motions(
        self,
        searched: Search,
        ordinary: Ordinary,
        budget: Budget,
        rng: np.random.Generator,
    ) -> list[Motion]:
        """Return motions near paths, the best first, and none before the reference that costs more.

        Among those who move they are charged closely; see `in_full`.

        Args:
            searched: The paths that were found, the best at the end.
            ordinary: What was made for a weight of 0, along which the law of time that pays is found as well.
            budget: Time for descents.
            rng: Chance for postures.
        """
        found = list(ordinary.along)
        found += [motion for motion, _ in self._made(searched, budget, rng, some=bool(found))]
        for motion, drive in ordinary.made[1:KEPT]:
            if budget.over or not self._has_plenty():
                break
            found += [other for other, _ in self._timed(drive, motion.path, motion.arrival)]
        return self._in_order(found, ordinary.reference)

    def stops(self, searched: Search) -> list[Motion]:
        """Return motions along the best path itself, with a stop at each of its corners; none if it leads nowhere."""
        if not searched.paths:
            return []
        whole, arrival = self.ends.joined(searched.paths[-1])
        if whole.length == 0.0:
            scene = self.request.objective.scene
            return [costed(whole, retime(whole, scene.limits, scene.joints), arrival, self.request)]
        made = self._timed(connected(list(stopping(whole.q))), whole, arrival)
        return sorted((motion for motion, _ in made), key=lambda one: one.ranking)

    def in_full(self, motion: Motion) -> Motion:
        """Return a motion charged for what was asked; ranked behind all others if it was."""
        if self.walkers is None:
            return motion
        full = costed_anew(motion, replace(self.request, max_wait=0.0))
        return replace(full, ranking=full.ranking + _INTO * (motion.ranking >= _INTO))

    @property
    def _closely(self) -> Request:
        """The request with an objective that is close to the asked one and fast; the law of time knows when to go."""
        if self.walkers is None:
            return self.request
        return replace(self.request, max_wait=0.0, objective=self.walkers.rough)

    def _in_order(self, found: list[Motion], reference: Motion | None) -> list[Motion]:
        """Return motions, the best first; what costs more than the reference comes behind it."""
        found = sorted(found, key=lambda one: one.ranking)
        if reference is None:
            return found
        if self.request.preference is not None:
            return sorted([*found, reference], key=lambda one: one.ranking)
        better = [one for one in found if one.cost.total <= reference.cost.total and one.ranking < _INTO]
        return [*better, reference, *(one for one in found if one not in better)]

    def _made(
        self, searched: Search, budget: Budget, rng: np.random.Generator, *, some: bool = False
    ) -> list[tuple[Motion, Drive]]:
        """Return motions near paths and what they are along, the best first; none is late if there are some."""
        smoother, moves_arm = self._smoother(), self._moves_arm
        share = (_PLANE_SHARE if self.walkers is None else _AMONG_SHARE) if moves_arm else 1.0
        with budget.share(share * budget.remaining_seconds) as part:
            found = list(self._in_the_plane(searched, part, yielded=some))
        found.sort(key=lambda one: one[0].ranking)
        for number in range(_REPOSED if moves_arm and found else 0):
            if budget.exhausted or not self._has_plenty():
                break
            # The second best may be on a better line than the best; what comes of them is gone on with.
            motion, drive = found[number if number < min(_LINES, len(found)) else 0]
            for better in reposed(drive, smoother, self.problem, budget, rng):
                found += self._timed(better, motion.path, motion.arrival)
            if number >= _LINES - 1:
                before = found[0][0].ranking
                found.sort(key=lambda one: one[0].ranking)
                if number >= _LINES and found[0][0].ranking > (1.0 - _WORTH) * before:
                    break
        return sorted(found, key=lambda one: one[0].ranking)

    @property
    def _moves_arm(self) -> bool:
        """Whether it may be worth it that the arm moves while the base does."""
        problem, planner = self.problem, self.request.planner
        if problem.start.size <= BASE or not isinstance(planner, DriveLattice) or not planner.moves_arm:
            return False
        return self.request.objective.w > 0.0 or bool((problem.goals[:, BASE:] != problem.start[BASE:]).any())

    def _in_the_plane(self, searched: Search, budget: Budget, *, yielded: bool) -> Iterator[tuple[Motion, Drive]]:
        """Yield motions whose arm stays while the base moves, and what they are along."""
        among = self.walkers is not None
        for path, smoother in self._chosen(searched.paths):
            whole, arrival = self.ends.joined(path)
            if whole.length == 0.0 or (yielded and (budget.over or not self._has_plenty())):
                continue
            for parts in joined_ends(stages(whole)):
                if yielded and among and budget.over:
                    return
                wait: float | None = 0.0
                while wait is not None:
                    with budget.share(_CURVE_SHARE * budget.remaining_seconds) as part:
                        curves = smooth_all(parts, replace(smoother, begins=wait), self.problem, part)
                        drive = connected(list(curves))
                    made = self._timed(drive, whole, arrival)
                    yielded = yielded or bool(made)
                    yield from made
                    # Who waits meets others elsewhere: once more, for setting out then.
                    again = among and bool(made) and wait == 0.0 and not budget.over
                    wait = _wait(made[0][0].trajectory) if again else None

    def _chosen(self, paths: Sequence[Path]) -> Iterator[tuple[Path, Smoother]]:
        """Yield paths, and what curves near them descend along."""
        smoother = self._smoother()
        for path in reversed(paths[-(KEPT if self.problem.start.size == BASE else 1) :]):
            yield path, smoother
            if smoother.walkers is not None:
                # Who is slower meets them elsewhere, where there may be room to pass; the law of time follows.
                slower = [replace(smoother, speed=share * smoother.speed) for share in _SLOWER]
                # The last is for whom the law of time alone lets pass.
                for other in (*slower, replace(smoother, walkers=None)):
                    yield path, other

    def _smoother(self) -> Smoother:
        objective = self.request.objective
        base = objective.scene.base
        assert base is not None
        return Smoother(
            objective=objective if self.walkers is None else self.walkers.still,
            base=base,
            clearance=self.problem.clearance_gradient,
            time_price=price_of_time(self.request),
            speed=self.request.speed,
            walkers=self.walkers,
        )

    def _timed(self, drive: Drive, whole: Path, arrival: int) -> list[tuple[Motion, Drive]]:
        """Return motions along a curve: as fast as can be, and with the law of time that pays."""
        if not drive.stretches:
            return []
        request, price = self.request, price_of_time(self.request)
        if self.walkers is not None:
            return [(motion, drive) for motion in self._in_time(drive, whole, arrival, self.walkers)]
        with self.clock.measured("timing"):
            try:
                fast = self._trajectory(drive)
                found = [costed(whole, fast, arrival, request)]
                if (slower := slower_where_it_pays(drive, fast, request.objective, price)) is not None:
                    found.append(costed(whole, self._trajectory(drive, slower), arrival, request))
            except RetimingError:
                return []
        return [(motion, drive) for motion in found]

    def _in_time(self, drive: Drive, whole: Path, arrival: int, walkers: Walkers) -> Iterator[Motion]:
        """Do so among those who move, charged closely; motions that drive into somebody rank behind all others."""
        request = self._closely
        with self.clock.measured("timing"):
            try:
                fast = self._trajectory(drive)
                slower, wait = paced(
                    drive, fast, walkers, price_of_time(request), self.request.max_wait, self.cancelled
                )
                laws = [fast]
                if slower is not None or wait > 0.0:
                    laws = [self._trajectory(drive, slower).delayed(wait), fast]
            except RetimingError:
                return
            for trajectory in laws:
                motion = costed(whole, trajectory, arrival, request)
                yield replace(motion, ranking=motion.ranking + _INTO * walkers.meets(trajectory))

    def _trajectory(self, drive: Drive, slower: Restraint | None = None) -> Trajectory:
        return self.request.constraints.timed(drive, speed=self.request.speed, slower=slower)

    def _has_plenty(self) -> bool:
        return self.clock.has_plenty("timing", "judging", insured=self.insured)


def _wait(trajectory: Trajectory) -> float | None:
    """Return for how long a motion rests before it goes, None if it does not [s]."""
    waits = len(trajectory) > 1 and np.array_equal(trajectory.q[0], trajectory.q[1])
    return float(trajectory.t[1] - trajectory.t[0]) if waits else None
