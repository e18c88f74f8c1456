"""From what a search found to timed motions, the best first.

A search compares paths by what they cost at a mean pace. What counts is the motion as it will be executed: so the best
paths become smooth curves that descend along J of their own timing (`MotionDescents`), and these are compared with each
other, and with the polylines that were found, by J of the trajectory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import (
    DRIVING_TIME_PRICE,
    LONG,
    Effort,
    Landed,
    MotionDescents,
    Start,
    time_price,
)
from graceful_plan.planners.native import native_space
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.resampling import evenly
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.departure import best_departure
from graceful_plan.query.ends import Ends
from graceful_plan.query.request import Request
from graceful_plan.query.search import KEPT, Search, thinned
from graceful_plan.result import CostBreakdown
from graceful_plan.timing.blend import merge_near_vertices, rounded_corners
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

DEVIATIONS = (0.1, 0.03, 0.01, 0.0)
"""How far the motion may cut a corner of a polyline [rad], from swift to exact; 0 stops at the corner."""
_MOST_STARTS = 5
"""Paths from which smooth motions begin."""
_MOST_TIMED = 4
"""Smooth motions that are compared by the J of their trajectories."""
_POLISH = Effort(screens=False)
"""What is done with motions that are known to be good."""
_CAREFUL_SHARE = 0.6
"""Of the time for descents where a liquid is carried, for those that leave sloshing its share of the angle."""
_DARED = 2
"""Motions that then descend once more."""
_LEAST_TIGHT = 0.15
"""Least length at a tight end along which the spheres do not count [rad]."""
_POINTS = (8, 16, 32)
"""Of a polyline through which a smooth curve follows it; with fewer, it keeps farther from the corners."""
STRAYS = 0.005
"""Clearance that descents keep where there is room for it [m]: a healthy robot, and what is in its fingers, stray from
the path by up to 6 mm (FailBench's Panda at half of its speed, six tasks), and with 3 mm a chart grazed a cabinet. Not
where a vessel is kept level: that is a clearance for the core, too, and J of a watering can rose by a third."""
_ROOMY = 0.8
"""Of that, what a descent that ended with less is pressed for once more."""
_LOOKED_AT = 1000
"""Configurations of a motion that are looked at with the fast checker."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A timed motion, not yet judged."""

    path: Path
    trajectory: Trajectory
    cost: CostBreakdown
    arrival: int
    """Which of the ways to a goal it takes; see `Ends`."""
    ranking: float
    """What motions are compared by."""
    estimate: float | None = None
    """The total cost that its descent ended with, if it comes from one."""


def motions(
    searched: Search,
    request: Request,
    ends: Ends,
    problem: SceneProblem,
    means: tuple[Budget, np.random.Generator],
    known: Sequence[Motion] = (),
) -> tuple[list[Motion], str]:
    """Return motions along or near paths, the best first, and why there is none if so.

    Args:
        searched: The paths that were found.
        request: What they were found for.
        ends: Both ends.
        problem: What was searched in.
        means: Time for descents, and chance for hops.
        known: Motions that compete, and are descended from as well.
    """
    paths = searched.paths
    chosen = [paths[k] for k in thinned(len(paths))]
    wholes = [ends.joined(path) for path in [*chosen[:1], *searched.others, *chosen[1:]]]
    wholes = wholes[: max(_MOST_STARTS, 1 + len(searched.others))]
    firsts = [ends.joined(path) for path in searched.firsts[:_MOST_STARTS]]
    begun = [*wholes, *((motion.path, motion.arrival) for motion in known), *firsts]
    effort = Effort() if wholes else _POLISH
    if searched.stopped:
        effort = Effort(bends=0, hops=0)
    found = [*known, *_descended(begun, request, ends, problem, means, effort=effort, raw=len(firsts))]
    if request.objective.descended() is None and request.constraints.level:
        found += [motion for path, k in wholes for motion in _followed(path, k, request, ends)]
    why_not = ""
    for whole, arrival in wholes[: _worth_timing(searched, found)]:
        if not _is_time_for_another(found, request):
            break
        try:
            found.append(_along(whole, arrival, request, ends))
        except RetimingError as error:
            why_not = str(error)
    return sorted(found, key=lambda motion: motion.ranking), why_not


def _descended(
    wholes: Sequence[tuple[Path, int]],
    request: Request,
    ends: Ends,
    problem: SceneProblem,
    means: tuple[Budget, np.random.Generator],
    *,
    effort: Effort,
    raw: int,
) -> list[Motion]:
    """Do what `smooth` does; where a liquid is carried, descend from its motions once more, with less held back."""
    daring = request.constraints.daring
    if daring is request.constraints:
        return smooth(wholes, request, ends, problem, means, effort=effort, raw=raw)
    budget, rng = means
    with budget.share(_CAREFUL_SHARE * budget.remaining_seconds, budget.remaining_iterations) as part:
        found = smooth(wholes, request, ends, problem, (part, rng), effort=effort, raw=raw)
    best = sorted(found, key=lambda motion: motion.ranking)[:_DARED]
    dared = replace(problem, kernels=daring.kernels, constraints=daring)
    asked = replace(request, constraints=daring)
    return [*found, *smooth([(m.path, m.arrival) for m in best], asked, ends, dared, means, effort=_POLISH)]


def _worth_timing(searched: Search, found: Sequence[Motion]) -> int:
    """How many polylines to time: the best if it promises more than smooth motions keep, several if there are none."""
    if not found:
        return KEPT
    return int(bool(searched.trace) and searched.trace[-1].total <= min(motion.cost.total for motion in found))


def along(path: Path, request: Request, ends: Ends, *, swift: bool = True) -> Iterator[Motion]:
    """Yield motions along a polyline that cut its corners less and less.

    Args:
        path: As found by a search.
        request: What it was found for.
        ends: Both ends.
        swift: Whether to begin with corners cut as far as the fast checker allows.
    """
    whole, arrival = ends.joined(path)
    ways = (lambda: _along(whole, arrival, request, ends),) if swift else ()
    exact = tuple(partial(_cut, whole, deviation, arrival, request) for deviation in DEVIATIONS[1:])
    for motion in (*ways, *exact):
        if not request.clock.has_room("timing", "judging"):
            return
        try:
            yield motion()
        except RetimingError:
            continue


def smooth(
    wholes: Sequence[tuple[Path, int]],
    request: Request,
    ends: Ends,
    problem: SceneProblem,
    means: tuple[Budget, np.random.Generator],
    *,
    effort: Effort,
    raw: int = 0,
) -> list[Motion]:
    """Return smooth motions that descended from paths, the most promising first; none if the objective has no descents.

    Args:
        wholes: Paths from the real start to a real goal, and which arrival each takes.
        request: What to descend along.
        ends: Both ends.
        problem: What was searched in.
        means: Time for descents, and chance for hops.
        effort: How much of what there is to do.
        raw: How many of the last paths wide bends begin with; all if 0.
    """
    descents = motion_descents(request, problem, effort)
    if descents is None:
        return []
    wholes = [(whole, arrival) for whole, arrival in wholes if whole.length > 0.0]
    starts = [start_of(whole, arrival, ends) for whole, arrival in wholes]
    landed = descents.run(starts, *means, raw=raw)
    request.clock.ended(means[0].elapsed - means[0].time_limit)
    found: list[Motion] = []
    for one in landed[:_MOST_TIMED]:
        if not _is_time_for_another(found, request):
            break
        motion = _of(one, wholes[one.start][1], request, ends)
        found += [motion] if motion is not None else []
    return found


def motion_descents(request: Request, problem: SceneProblem, effort: Effort) -> MotionDescents | None:
    """Return descents for what was asked; None if the objective has none."""
    objective = request.objective.descended()
    if objective is None:
        return None
    scene, speed = objective.scene, request.speed

    def keeps(margin: float) -> Callable[[Spline, Start], bool]:
        free = replace(problem, margin=margin).states_free

        def is_free(curve: Spline, start: Start) -> bool:
            q = curve.grid(1).q
            done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
            clear = (done >= start.tight_start) & (done <= done[-1] - start.tight_end)
            return bool(free(q[clear]).all())

        return is_free

    ends = problem.kernels.clearance(np.vstack([problem.start, problem.goals]))
    wanted = 0.0 if request.constraints.level else min(STRAYS, 0.5 * float(ends.min()))
    keeping = replace(problem, margin=max(problem.margin, wanted))
    return MotionDescents(
        space=native_space(keeping, objective),
        velocity=speed * scene.limits.velocity,
        acceleration=speed**2 * scene.limits.acceleration,
        is_free=keeps(0.5 * problem.margin),
        has_room=keeps(_ROOMY * keeping.margin) if wanted else None,
        felt=request.constraints.charged,
        careful=request.constraints.level,
        counts_points=objective.objective.exposure == "waypoints",
        effort=_adapted(effort, request, objective),
    )


def _adapted(effort: Effort, request: Request, objective: SceneObjective) -> Effort:
    """Spare wide bends where nothing but length counts, and evaluations where Python answers for states."""
    if objective.w == 0.0 and not request.constraints.charged:
        effort = replace(effort, bends=0, hops=0)
    return replace(effort, middle=LONG) if objective.kernel is None else effort


def start_of(whole: Path, arrival: int, ends: Ends) -> Start:
    """Return a path to descend from, told where it is tight."""
    return Start(whole, _tight(ends.departure), _tight(ends.arrivals[arrival]))


def _followed(whole: Path, arrival: int, request: Request, ends: Ends) -> Iterator[Motion]:
    """Yield smooth motions that follow a polyline: its corners would jolt what is carried."""
    for points in _POINTS:
        if whole.length > 0.0:
            curve = Spline.through(evenly(whole.q, points))
            motion = _of(Landed(curve, np.nan, 0), arrival, request, ends)
            if motion is not None:
                yield replace(motion, estimate=None)


def _tight(way: Path) -> float:
    """How far from an end the spheres may come too close, if they do there [rad]; the judge looks at it exactly."""
    return max(_LEAST_TIGHT, 3.0 * way.length) if way.length > 0.0 else 0.0


def _of(landed: Landed, arrival: int, request: Request, ends: Ends) -> Motion | None:
    with request.clock.measured("timing"):
        motion = timed_curve(landed, arrival, request)
        if motion and ends.in_the_clear(arrival) and not _keeps_clear(motion.trajectory, request.constraints):
            return None
        return motion


def timed_curve(landed: Landed, arrival: int, request: Request) -> Motion | None:
    """Time what a descent ended with, None if that cannot be done."""
    try:
        trajectory = request.constraints.timed(landed.curve, speed=request.speed)
    except RetimingError:
        return None
    estimate = landed.value - price_of_time(request) * trajectory.duration
    return replace(charged(trajectory.path, trajectory, arrival, request), estimate=estimate)


def _is_time_for_another(found: Sequence[Motion], request: Request) -> bool:
    """Whether to time another motion: the first if that can be judged in time, more if that is sure."""
    clock = request.clock
    return clock.has_plenty("timing", "judging") if found else clock.may_do("timing", "judging")


def _along(whole: Path, arrival: int, request: Request, ends: Ends) -> Motion:
    """Time a polyline, each corner cut as far as the fast checker allows."""
    clear = ends.in_the_clear(arrival)
    with request.clock.measured("timing"):
        return _cut(whole, _free_deviations(whole, request) if clear else DEVIATIONS[0], arrival, request)


def _cut(whole: Path, deviation: float | Float[Array, " corner"], arrival: int, request: Request) -> Motion:
    """Time a polyline, its corners cut by so much."""
    trajectory = request.constraints.retimed(whole, deviation=deviation, speed=request.speed)
    return charged(whole, trajectory, arrival, request)


def _free_deviations(whole: Path, request: Request) -> Float[Array, " corner"]:
    """How far each corner may be cut so that nothing comes too close [rad]."""
    q = merge_near_vertices(whole)
    chosen = np.full(max(0, len(q) - 2), DEVIATIONS[0])
    kernels = request.constraints.kernels
    for wider, narrower in pairwise(DEVIATIONS):
        open_ = np.flatnonzero(chosen == wider)
        if len(open_) == 0:
            break
        corners = rounded_corners(q, wider)[open_]
        free = kernels.free(corners.reshape(-1, q.shape[1])).reshape(corners.shape[:2]).all(axis=1)
        chosen[open_[~free]] = narrower
    return chosen


def recharged(motion: Motion, request: Request) -> Motion:
    """Return a motion as it was, charged for what was asked."""
    return charged(motion.path, motion.trajectory, motion.arrival, request)


def charged(whole: Path, trajectory: Trajectory, arrival: int, request: Request) -> Motion:
    """Return a timed motion with what it costs; where something moves, it waits for the best moment to go."""
    objective = request.objective
    if objective.scene.moving:
        trajectory, cost = best_departure(trajectory, objective, request.max_wait)
    else:
        cost = objective.breakdown(trajectory)
    total = cost.total if request.preference is None else request.preference.total(trajectory)
    return Motion(
        path=whole,
        trajectory=trajectory,
        cost=cost,
        arrival=arrival,
        ranking=total + price_of_time(request) * trajectory.duration,
    )


def price_of_time(request: Request) -> float:
    """Return what a second of a motion counts when motions are compared."""
    if request.objective.scene.base is not None:
        return DRIVING_TIME_PRICE
    return time_price(careful=request.constraints.level)


def _keeps_clear(trajectory: Trajectory, constraints: SceneConstraints) -> bool:
    samples = trajectory.sample(max(trajectory.duration / _LOOKED_AT, 1e-3)).q
    return bool(np.all(constraints.kernels.free(samples)))
