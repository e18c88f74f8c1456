"""Motions of a base near paths of straight stretches and turns in place: smooth where that is free, timed, charged."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.driving.drive_lattice import DriveLattice
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.resampling import evenly
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.driving.pacing import paced
from graceful_plan.query.driving.postures import BASE
from graceful_plan.query.driving.reposed import reposed
from graceful_plan.query.driving.slowing import slower_where_it_pays
from graceful_plan.query.driving.smoothing import Smoother
from graceful_plan.query.driving.stages import DriveStage, Move, stages
from graceful_plan.query.driving.walkers import Walkers
from graceful_plan.query.ends import Ends
from graceful_plan.query.motions import Motion, charged, price_of_time
from graceful_plan.query.request import Request
from graceful_plan.query.search import KEPT, Search
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.bspline import DEGREE
from graceful_plan.timing.drive_curve import Drive, Roll, Straight, Stretch, connected
from graceful_plan.timing.retiming import retime, timed
from graceful_plan.timing.topp import Restraint
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_SPACINGS = (0.8, 0.4, 0.2, 0.1)
"""Between control points [m], tried until a curve is free: the wider, the smoother."""
_FEWEST, _MOST = DEGREE + 3, 60
"""Control points."""
_PLANE_SHARE = 0.35
"""Of the time for motions, for those whose arm stays while the base moves."""
_CURVE_SHARE = 0.5
"""Of the time that is left, for one curve."""
_REPOSED, _LINES = 8, 2
"""How often postures are chosen along a motion, and along how many that the arm stays in."""
_WORTH = 1e-3
"""Relative gain below which no more postures are chosen."""
_INTO = 1e6
"""What is added to the ranking of motions that drive into somebody."""
_PACE = 0.75
"""Mean share of the fastest speed, to tell when a later stage of a drive begins."""
_JOINED = 0.45 * np.pi
"""Turns at either end up to which a curve may turn instead [rad]."""


def driven(
    searched: Search,
    request: Request,
    ends: Ends,
    problem: SceneProblem,
    means: tuple[Budget, np.random.Generator],
) -> tuple[list[Motion], str]:
    """Return motions near paths, the best first, and why there is none if so.

    The last is the best path itself, with a stop at each of its corners: what a search found can be driven.

    Args:
        searched: The paths that were found, the best at the end.
        request: What they were found for.
        ends: Both ends.
        problem: What was searched in.
        means: Time for descents, and chance for postures.
    """
    budget, rng = means
    smoother, has_arm = _smoother(request, problem), problem.start.size > BASE
    moves_arm = has_arm and isinstance(request.planner, DriveLattice) and request.planner.moves_arm
    with budget.share((_PLANE_SHARE if moves_arm else 1.0) * budget.remaining_seconds) as part:
        found = list(_in_the_plane(searched, request, ends, problem, part))
    found.sort(key=lambda one: one[0].ranking)
    for number in range(_REPOSED if moves_arm and found else 0):
        if budget.exhausted or not _has_plenty(request):
            break
        # The second best may be on a better line than the best; what comes of them is gone on with.
        motion, drive = found[number if number < min(_LINES, len(found)) else 0]
        for better in reposed(drive, smoother, problem, budget, rng):
            found += [(other, better) for other in _timed(better, motion.path, motion.arrival, request)]
        if number >= _LINES - 1:
            before = found[0][0].ranking
            found.sort(key=lambda one: one[0].ranking)
            if number >= _LINES and found[0][0].ranking > (1.0 - _WORTH) * before:
                break
    found.sort(key=lambda one: one[0].ranking)
    # Among those who move, laws of time take a while: that along the path itself was tried before.
    last = [] if smoother.walkers is not None and found else stops(searched, request, ends)
    return [*(motion for motion, _ in found), *last], ""


def _in_the_plane(
    searched: Search, request: Request, ends: Ends, problem: SceneProblem, budget: Budget
) -> Iterator[tuple[Motion, Drive]]:
    """Yield motions whose arm stays while the base moves, and what they are along."""
    yielded = False
    kept = KEPT if problem.start.size == BASE else 1
    for path, smoother in _chosen(searched.paths, _smoother(request, problem), kept):
        whole, arrival = ends.joined(path)
        if whole.length == 0.0 or (yielded and (budget.remaining_seconds <= 0.0 or not _has_plenty(request))):
            continue
        for parts in _joined_ends(stages(whole)):
            if yielded and smoother.walkers is not None and budget.remaining_seconds <= 0.0:
                return
            wait: float | None = 0.0
            while wait is not None:
                with budget.share(_CURVE_SHARE * budget.remaining_seconds) as part:
                    drive = connected(list(_smooth_all(parts, replace(smoother, begins=wait), problem, part)))
                made = _timed(drive, whole, arrival, request)
                for motion in made:
                    yielded = True
                    yield motion, drive
                # Who waits meets others elsewhere: once more, for setting out then.
                wait = _wait(made[0].trajectory) if made and wait == 0.0 and budget.remaining_seconds > 0.0 else None
                wait = wait if smoother.walkers is not None else None


def _wait(trajectory: Trajectory) -> float | None:
    """Return for how long a motion rests before it goes, None if it does not [s]."""
    waits = len(trajectory) > 1 and np.array_equal(trajectory.q[0], trajectory.q[1])
    return float(trajectory.t[1] - trajectory.t[0]) if waits else None


def _smooth_all(
    parts: Sequence[DriveStage], smoother: Smoother, problem: SceneProblem, budget: Budget
) -> Iterator[Stretch]:
    """Yield what replaces stages, each for about when it begins."""
    begins = smoother.begins
    for stage in parts:
        yield from _smooth(stage, replace(smoother, begins=begins), problem, budget)
        way = np.abs(np.diff(stage.q, axis=0))
        metres, turn = float(np.hypot(way[:, 0], way[:, 1]).sum()), float(way[:, 2].sum())
        speed = _PACE * smoother.speed
        begins += metres / (speed * smoother.base.v_max)
        begins += 0.0 if _rolls(stage) else turn / (speed * smoother.base.omega_max)


def _has_plenty(request: Request) -> bool:
    return request.clock.has_plenty("timing", "judging")


def _chosen(paths: Sequence[Path], smoother: Smoother, kept: int) -> Iterator[tuple[Path, Smoother]]:
    """Yield paths, and what curves near them descend along.

    First what an ordinary planner would return, which takes little time: nobody is to get less.
    """
    unaware, best = replace(smoother, walkers=None), list(reversed(paths[-kept:]))
    if smoother.walkers is not None and best:  # a search over time found it
        yield best[0], smoother
    if smoother.objective.w > 0.0 and paths:
        yield paths[0], unaware.shortest()
    for path in best:
        if smoother.walkers is None or path is not best[0]:
            yield path, smoother
        if smoother.walkers is not None:  # whom the law of time alone lets pass
            yield path, unaware


def stops(searched: Search, request: Request, ends: Ends) -> list[Motion]:
    """Return the motion along the best path itself, with a stop at each of its corners; none if it leads nowhere."""
    if not searched.paths:
        return []
    whole, arrival = ends.joined(searched.paths[-1])
    if whole.length == 0.0:
        scene = request.objective.scene
        return [charged(whole, retime(whole, scene.limits, scene.joints), arrival, request)]
    return _timed(connected(list(_stopping(whole.q))), whole, arrival, request)


def _smoother(request: Request, problem: SceneProblem) -> Smoother:
    base, walkers = request.objective.scene.base, _walkers(request)
    assert base is not None
    return Smoother(
        objective=request.objective if walkers is None else walkers.still,
        base=base,
        clearance=problem.clearance_gradient,
        time_price=price_of_time(request),
        speed=request.speed,
        walkers=walkers,
    )


def _walkers(request: Request) -> Walkers | None:
    return Walkers(request.objective) if request.objective.scene.moving else None


def _timed(drive: Drive, whole: Path, arrival: int, request: Request) -> list[Motion]:
    """Return motions along a curve: as fast as can be, and with the law of time that pays."""
    if not drive.stretches:
        return []
    walkers, price = _walkers(request), price_of_time(request)
    if walkers is not None:
        return _in_time(drive, whole, arrival, request, walkers)
    with request.clock.measured("timing"):
        try:
            fast = _trajectory(drive, request)
            found = [charged(whole, fast, arrival, request)]
            if (slower := slower_where_it_pays(drive, fast, request.objective, price)) is not None:
                found.append(charged(whole, _trajectory(drive, request, slower), arrival, request))
            return found
        except RetimingError:
            return []


def _in_time(drive: Drive, whole: Path, arrival: int, request: Request, walkers: Walkers) -> list[Motion]:
    """Do so among those who move; motions that drive into somebody rank behind all others."""
    found, at_once = [], replace(request, max_wait=0.0)  # the law of time knows when to go
    try:
        fast = _trajectory(drive, request)
        slower, wait = paced(drive, fast, walkers, price_of_time(request), request.max_wait)
        laws = [fast] if slower is None and wait == 0.0 else [_trajectory(drive, request, slower).delayed(wait), fast]
    except RetimingError:
        return []
    with request.clock.measured("timing"):
        for trajectory in laws:
            motion = charged(whole, trajectory, arrival, at_once)
            into = _INTO * walkers.meets(trajectory)
            found.append(replace(motion, ranking=motion.ranking + into))
    return found


def _trajectory(drive: Drive, request: Request, slower: Restraint | None = None) -> Trajectory:
    scene = request.objective.scene

    def timing(limits: Restraint) -> Trajectory:
        def both(grid: CurveGrid) -> Array:
            return limits(grid) if slower is None else np.concatenate([limits(grid), slower(grid)], axis=1)

        return timed(drive, scene.limits, scene.joints, speed=request.speed, restraint=both)

    return request.constraints.timed(timing)


def _joined_ends(parts: Sequence[DriveStage]) -> Iterator[list[DriveStage]]:
    """Yield the stages with small turns at both ends left to the curves beside them, then as they are."""
    joined = list(parts)
    if len(joined) > 1 and joined[0].kind is Move.TURN and _rolls(joined[1]) and _turn(joined[0]) < _JOINED:
        joined[:2] = [replace(joined[1], q=np.concatenate([joined[0].q[:1], joined[1].q[1:]]))]
    if len(joined) > 1 and joined[-1].kind is Move.TURN and _rolls(joined[-2]) and _turn(joined[-1]) < _JOINED:
        joined[-2:] = [replace(joined[-2], q=np.concatenate([joined[-2].q[:-1], joined[-1].q[-1:]]))]
    if len(joined) < len(parts):
        yield joined
    yield list(parts)


def _rolls(stage: DriveStage) -> bool:
    return stage.kind in (Move.FORWARD, Move.BACKWARD)


def _turn(stage: DriveStage) -> float:
    return float(np.abs(np.diff(stage.q[:, 2])).sum())


def _smooth(stage: DriveStage, smoother: Smoother, problem: SceneProblem, budget: Budget) -> Iterator[Stretch]:
    """Yield what replaces a stage: one smooth curve if one is free, else its edges with rests between them."""
    if not _rolls(stage):
        yield from _stopping(stage.q)
        return
    for spacing in _SPACINGS:
        roll = _fitted(stage, spacing)
        for curve in (smoother.descended(roll, budget), roll):
            if problem.states_free(curve.samples(2)[1][0]).all():
                yield curve
                return
    yield from _stopping(stage.q)


def _stopping(q: Float[Array, "vertex nq"]) -> Iterator[Stretch]:
    """Yield the edges of a path; what is drawn on the way is straight, moves that go on are one."""
    for stage in stages(Path(q)):
        if not _rolls(stage):
            yield from (Straight(a, b) for a, b in zip(stage.q[:-1], stage.q[1:], strict=True))
            continue
        forward, corner = stage.kind is Move.FORWARD, 0
        moves = np.abs(np.diff(stage.q[:, :2], axis=0)).max(axis=1) > 0.0
        for k in range(1, len(stage.q)):
            if k == len(stage.q) - 1 or moves[k] != moves[k - 1]:
                a, b = stage.q[corner], stage.q[k]
                if moves[k - 1]:
                    line = a[:2] + np.linspace(0.0, 1.0, DEGREE + 1)[:, None] * (b[:2] - a[:2])
                    yield Roll(line, a, b, forward)
                else:
                    yield Straight(a, b)
                corner = k


def _fitted(stage: DriveStage, spacing: float) -> Roll:
    """Return the spline whose control points lie evenly along a stage, with the headings that it has at both ends."""
    corners = Path(stage.q[:, :2]).without_duplicates()
    n = int(np.clip(np.ceil(corners.length / spacing) + 1, _FEWEST, _MOST))
    controls = evenly(corners.q, n)
    forward = stage.kind is Move.FORWARD
    step = corners.length / (n - 1) * (1.0 if forward else -1.0)
    for end, beside, away in ((0, 1, step), (-1, -2, -step)):
        heading = stage.q[end, 2]
        controls[beside] = controls[end] + away * np.array([np.cos(heading), np.sin(heading)])
    return Roll(controls, stage.q[0], stage.q[-1], forward)
