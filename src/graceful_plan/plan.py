"""plan(): check, compile, search, time, verify, return."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np

from graceful_plan.analysis.risk_measures import RiskMeasure
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.core.kernels import CHECK_STEP, FINE_STEP
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.judge.verification import Verification
from graceful_plan.planners import Planner
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.arguments import (
    checked_callback,
    checked_cancelled,
    checked_objective,
    checked_planner,
    checked_risk,
    checked_seed,
    checked_speed,
    checked_time_limit,
    checked_verification,
    checked_wait,
    driving_planner,
)
from graceful_plan.query.cheaper import beginning_with, is_enough, known_motions
from graceful_plan.query.deadline.clock import Clock, paces_of
from graceful_plan.query.deadline.quick import quick_motions, wants_it_soon
from graceful_plan.query.departure import RESERVE, search_among_moving
from graceful_plan.query.driving.among_moving import search_among_walkers
from graceful_plan.query.driving.drives import driven, stops
from graceful_plan.query.driving.postures import BASE
from graceful_plan.query.driving.tight import rolling_ends
from graceful_plan.query.ends import Ends, find_ends
from graceful_plan.query.finish import Judged, first_verified
from graceful_plan.query.goals import Configuration, Goal, poses_of
from graceful_plan.query.motions import Motion, along, motions
from graceful_plan.query.prefer import Preference
from graceful_plan.query.request import Request
from graceful_plan.query.restarts import search_for_motions
from graceful_plan.query.search import ALL, KEPT, Callback, Search, search
from graceful_plan.query.via.legs import plan_through
from graceful_plan.query.via.stages import Via, checked_via
from graceful_plan.result import PlanResult, PlanStatus, TracePoint
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_CAUTION = ((0.002, CHECK_STEP), (0.005, FINE_STEP), (0.01, FINE_STEP))
"""Clearance to keep [m] and step of edge checks [rad], for the first search and for those after the judge objected."""
_TIMING_RESERVE = RESERVE + 0.2
"""Seconds kept besides to time candidates and to evaluate the chosen one if something moves, at most a quarter of all.
"""
_DRIVE_SHARE, _ARM_DRIVE_SHARE = 0.5, 0.3
"""Of the time, for the search of a base's path, of one without and with an arm or among those who move; the rest is for
curves near it."""
_COMPILED_SOON = 0.1
"""Compiling is not worth a word if it took less [s]: several times what bundled scenes take."""
_UNVERIFIED = "a path was found, but there was no time to judge a motion along it: it is NOT verified"


_NOT_FOR_CORNERS = frozenset(
    ("position_limits", "velocity_limits", "acceleration_limits", "consistency", "rest", "start", "goal", "cost")
)
"""What the judge may object to that it would also say of a motion which keeps nearer to the polyline."""


def plan(
    start: Configuration,
    goal: Goal,
    scene: Scene,
    w: float | None = None,
    *,
    via: Sequence[Via] = (),
    planner: str | Planner = "auto",
    objective: Objective | None = None,
    time_limit: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
    speed: float = 1.0,
    risk: str | RiskMeasure = "expectation",
    max_wait: float = 0.0,
    constraints: Iterable[Constraint] | None = None,
    verification: Verification | None = None,
    callback: Callback | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> PlanResult:
    """Plan a motion that costs little and along which a failure at any moment does little harm.

    Args:
        start: Configuration [rad or m], or the name of a keyframe.
        goal: Configuration, keyframe, a `PoseGoal` for the tool, or several of any of these, such as a set of grasps.
        scene: Robot, surroundings and what is carried.
        w: Safety weight: how many radians of joint motion it is worth to spare one second in which a failure would do
            harm of severity 1; default: the objective's, or 0.3.
        via: Configurations, keyframes and `PoseGoal`s to pass on the way, in this order, and without a stop where there
            is room; the callback is then told of the motion alone. See `query.via.legs`.
        planner: Name of a planner (see `PLANNERS`) or a settings object.
        objective: What to minimise, if not joint length plus `w` times the impact of carried object and contents.
        time_limit: Seconds for the whole call; 1 by default, none if `iterations` is given.
        iterations: Planner iterations; with these alone, the result depends on the seed only.
        seed: Of all random numbers.
        speed: In (0, 1]: fraction of the velocity limits to use.
        risk: What of the distribution of impact counts: "expectation", "cvar" (the mean of the worst tenth; another
            share with a `RiskMeasure`) or "worst". Searching is by expectation in any case, since only that adds up
            along a path; of the paths found the best by the measure is taken and refined by it (see `prefer`).
        max_wait: How long the robot may wait before it goes [s], in a scene where something moves (see `departure`);
            the trajectory then begins with a stretch at rest.
        constraints: What has to hold on the way, besides not to collide; by default what the scene asks for, and that
            the contents of a carried vessel stay in it (`KeepContents`). An empty list asks for nothing.
        verification: How closely the judge looks at motions; by default every 2 mm, with exact geometry wherever
            spheres do not prove that nothing is near.
        callback: Called with every improvement, at last with the motion itself; returning True ends the search.
        cancelled: Asked every few milliseconds, such as `threading.Event().is_set`; once it returns True the search
            ends, and a motion near the best path so far is timed and judged, which takes some hundredths of a second.
            Without one the status is CANCELLED.

    Returns:
        The result, SOLVED only if the independent judge passed the timed trajectory.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside of their range.
    """
    started = time.perf_counter()
    share, measure = checked_speed(speed), checked_risk(risk)
    bound = checked_objective(objective, w).bind(scene, search_paces(share))  # compiles the scene
    held = SceneConstraints(scene, default_constraints(scene) if constraints is None else constraints)
    compiled = time.perf_counter() - started
    request = Request(
        planner=driving_planner(checked_planner(planner), scene),
        objective=bound,
        constraints=held,
        preference=None if measure.kind == "expectation" else Preference(measure, bound),
        speed=share,
        max_wait=checked_wait(max_wait, scene),
        verification=checked_verification(verification),
        callback=checked_callback(callback),
    )
    rng, stop, limit = checked_seed(seed), checked_cancelled(cancelled), checked_time_limit(time_limit, iterations)
    if passed := checked_via(via, scene):
        asked = {"planner": planner, "objective": bound.objective, "seed": seed, "speed": share, "risk": measure}
        leg = partial(
            plan, scene=scene, constraints=held.constraints, verification=verification, cancelled=stop, **asked
        )
        return plan_through((start, passed, goal), leg, request, Budget(limit, iterations, stop, started), seed)
    ends = find_ends(
        start,
        goal,
        held,
        rng,
        seed=seed,
        cancelled=stop,
        late=lambda part: time.perf_counter() > started + part * limit,
    )
    if scene.base is not None and isinstance(ends, Ends):
        ends = rolling_ends(ends)
    said = _compiled(compiled, limit)
    if isinstance(ends, PlanResult):
        return _with_notes(ends, said)
    # Of what the ends have left there has to be a share for the search, too, however long the last steps once took.
    elapsed = time.perf_counter() - started
    clock = Clock(started + limit, paces_of(scene), max(limit - elapsed, 0.0))
    poses = poses_of(goal, ends.goal_index)
    request = replace(request, constraints=ends.constraints, poses=poses, clock=clock)
    budget = Budget(_until_last_steps(request, elapsed), iterations, stop, started)
    try:
        result = _search_and_finish(request, ends, budget, rng)
    except NonFiniteCostError as error:
        return PlanResult(status=PlanStatus.NONFINITE, detail=str(error))
    result = _with_notes(result, [*said, *ends.notes, *_waived(held)])
    return replace(result, stats={**result.stats, "total_time": time.perf_counter() - started})


def _compiled(seconds: float, limit: float) -> list[str]:
    """Say how long compiling took, if it is what a call was late for or had little time left after."""
    took_long = seconds > max(_COMPILED_SOON, min(limit / 10.0, 1.0))
    return [f"compiled for {seconds:.1f} s"] if took_long else []


def _with_notes(result: PlanResult, notes: Sequence[str]) -> PlanResult:
    return replace(result, detail="; ".join([*notes, *([result.detail] if result.detail else [])]))


def _until_last_steps(request: Request, elapsed: float) -> float:
    """Return how much of its time a call may spend before it has to time and to judge what was found [s].

    Args:
        request: What is asked for.
        elapsed: How much it has spent [s].
    """
    clock = request.clock
    if not np.isfinite(clock.limit):
        return clock.limit
    departing = min(_TIMING_RESERVE, clock.limit / 4.0) if request.objective.scene.moving else 0.0
    return elapsed + clock.left - clock.reserve(clock.limit) - departing


def _waived(held: SceneConstraints) -> list[str]:
    """Say which of the constraints that go without saying were switched off."""
    asked = {type(constraint) for constraint in held.constraints}
    return [f"{c.name} is switched off" for c in default_constraints(held.scene) if type(c) not in asked]


def _search_and_finish(request: Request, ends: Ends, budget: Budget, rng: np.random.Generator) -> PlanResult:
    """Search, time, judge, and search more cautiously for as long as the judge objects and the budget lasts."""
    found, refused, why_not, clock = Search(), None, "", request.clock
    stats: dict[str, float] = {}
    for margin, check_step in _CAUTION:
        problem = SceneProblem(
            kernels=request.constraints.kernels,
            start=ends.departure.q[-1],
            goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
            margin=min(margin, 0.5 * ends.clearance),
            check_step=check_step,
            constraints=request.constraints,
        )
        drives = request.objective.scene.base is not None
        known = [] if drives else known_motions(request, problem, ends, budget, rng)
        asked = replace(request, planner=beginning_with(known, request))
        known_is_enough = bool(known) and request.preference is None and is_enough(request)
        found = Search() if known_is_enough else _searched(asked, problem, ends, budget, rng)
        stats = {"search_time": budget.elapsed, "iterations": float(budget.spent)}
        cancelled, first = budget.cancelled(), None
        soon = cancelled or wants_it_soon(found)
        if (found.paths or known) and (soon or drives or clock.can_insure):
            quick = _quick_motions(found, request, ends, problem, budget) if found.paths else ()
            first = first_verified(chain(known if cancelled or not found.paths else (), quick), request)
            # Now it is known what timing and judging take here.
            budget.time_limit = min(budget.time_limit, _until_last_steps(request, budget.elapsed))
            late = budget.remaining_seconds <= 0.0 and drives and bool(request.objective.scene.moving)
            soon = soon or (late and first is not None and first.verdict.passed)  # each curve takes a while there
        judged = first if soon else None
        if judged is None or not judged.verdict.passed:
            candidates, why_not = _motions(found, request, ends, problem, (budget, rng), known)
            judged = first_verified(candidates, request) or judged
        for path in reversed(found.paths[-KEPT:]):
            if drives or judged is None or not set(judged.verdict.failures) - _NOT_FOR_CORNERS:
                break
            judged = first_verified(along(path, request, ends, swift=False), request) or judged
        if first is not None and first.verdict.passed and (judged is None or not judged.verdict.passed):
            judged = first
        if judged is not None and judged.verdict.passed:
            return replace(
                _solved(judged, found, request, budget, stats), goal_index=ends.goal_index[judged.motion.arrival]
            )
        refused = refused or judged
        if budget.exhausted or found.stopped or not (found.paths or found.refused or known):
            break
    return _failed((found, ends), refused, why_not, budget, stats)


def _quick_motions(
    found: Search, request: Request, ends: Ends, problem: SceneProblem, budget: Budget
) -> Iterable[Motion]:
    """Return motions that take little time to make."""
    drives = request.objective.scene.base is not None
    return stops(found, request, ends) if drives else quick_motions(found, request, ends, problem, budget)


def _motions(
    found: Search,
    request: Request,
    ends: Ends,
    problem: SceneProblem,
    means: tuple[Budget, np.random.Generator],
    known: Sequence[Motion],
) -> tuple[list[Motion], str]:
    """Return motions along or near the paths, the best first, and why there is none if so."""
    if request.objective.scene.base is not None:
        return driven(found, request, ends, problem, means)
    return motions(found, request, ends, problem, means, known)


def _searched(request: Request, problem: SceneProblem, ends: Ends, budget: Budget, rng: np.random.Generator) -> Search:
    """Search by J; by a measure of risk or at the times of what moves where these decide."""
    if request.objective.scene.base is not None:
        share = _DRIVE_SHARE if problem.start.size == BASE else _ARM_DRIVE_SHARE
        if request.objective.scene.moving:
            return search_among_walkers(request, problem, budget, rng, share=_ARM_DRIVE_SHARE)
        means = budget, rng, request.callback
        return search(request.planner, problem, request.objective, *means, kept=ALL, share=share)
    if request.preference is not None:
        return request.preference.search(request.planner, problem, budget, rng, request.callback)
    if request.objective.scene.moving:
        return search_among_moving(request, problem, ends, budget, rng)
    return search_for_motions(request, problem, budget, rng)


def _solved(judged: Judged, found: Search, request: Request, budget: Budget, stats: dict[str, float]) -> PlanResult:
    motion = judged.motion
    last = TracePoint(
        time=budget.elapsed, total=motion.cost.total, motion=motion.cost.motion, impact=motion.cost.impact
    )
    if request.callback is not None and not found.stopped:
        request.callback(last)
    # Paths are charged at the paces of a search. Those that promised more than any motion has kept are no improvements.
    trace = (*(point for point in found.trace if point.total > last.total), last)
    stats = stats if motion.estimate is None else {**stats, "estimated_total": motion.estimate}
    checks = judged.verdict.checks
    return PlanResult(
        status=PlanStatus.SOLVED,
        detail="; ".join(f"{name}: {checks[name].detail}" for name in judged.verdict.warnings),
        path=motion.path,
        trajectory=motion.trajectory,
        cost=motion.cost,
        verdict=judged.verdict,
        trace=trace,
        stats=stats,
    )


def _failed(
    searched: tuple[Search, Ends], refused: Judged | None, why_not: str, budget: Budget, stats: dict[str, float]
) -> PlanResult:
    found, ends = searched
    ended = PlanStatus.CANCELLED if budget.cancelled() else PlanStatus.TIMEOUT
    trace = tuple(found.trace)
    if refused is None and why_not:
        return PlanResult(status=PlanStatus.RETIMING_FAILED, detail=why_not, trace=trace, stats=stats)
    if refused is None and found.paths:
        path, _ = ends.joined(found.paths[-1])
        return PlanResult(status=ended, path=path, detail=_UNVERIFIED, trace=trace, stats=stats)
    if refused is None:
        status = ended if budget.exhausted else PlanStatus.INFEASIBLE
        return PlanResult(status=status, detail=f"no path after {budget.elapsed:.3f} s", stats=stats)
    objections = "; ".join(f"{name}: {refused.verdict.checks[name].detail}" for name in refused.verdict.failures)
    detail = f"the judge refused every path found; the best for {objections}"
    return PlanResult(status=ended, detail=detail, verdict=refused.verdict, trace=trace, stats=stats)
