"""plan(): check, compile, search, time, verify, return."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from graceful_plan.analysis.risk_measures import RiskMeasure
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints, grasp_warnings
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.judge.verification import VerificationSettings
from graceful_plan.planners import Planner
from graceful_plan.planners.planner import Budget
from graceful_plan.query.answer import BestVerified
from graceful_plan.query.arguments import (
    checked_callback,
    checked_cancelled,
    checked_candidates,
    checked_flag,
    checked_objective,
    checked_planner,
    checked_risk,
    checked_seed,
    checked_speed,
    checked_start_tolerance,
    checked_stop,
    checked_time_limit,
    checked_verification,
    checked_wait,
    driving_planner,
)
from graceful_plan.query.base_planning import base_planning
from graceful_plan.query.candidates.candidates import motions_to_verify
from graceful_plan.query.candidates.departure import at_time
from graceful_plan.query.candidates.risk_ranking import Preference
from graceful_plan.query.candidates.search import Callback
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.endpoints import find_endpoints
from graceful_plan.query.endpoints.goals import Goal, poses_of
from graceful_plan.query.endpoints.moving_goal import find_goal
from graceful_plan.query.endpoints.moving_start import find_start
from graceful_plan.query.endpoints.real_start import START_TOLERANCE
from graceful_plan.query.preparation import prepared
from graceful_plan.query.prepared_stops import plan_stops, stops_check
from graceful_plan.query.request import Request, Stop
from graceful_plan.query.via.legs import plan_through
from graceful_plan.query.via.stages import Via, checked_via
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.timing.trajectory import State

_PASSING_SHARE = 0.2
"""Share of the remaining time in which a moving base goes over from its present arc to the motion found."""


def plan(
    start: Configuration | State,
    goal: Goal | State,
    scene: Scene,
    w: float | None = None,
    *,
    via: Sequence[Via] = (),
    planner: str | Planner = "auto",
    objective: Objective | None = None,
    time_limit: float | None = None,
    iterations: int | None = None,
    stop: Stop | None = None,
    refine: bool = True,
    seed: int = 0,
    speed: float = 1.0,
    risk: str | RiskMeasure = "expectation",
    max_wait: float = 0.0,
    candidates: int = 1,
    start_tolerance: float = START_TOLERANCE,
    constraints: Iterable[Constraint] | None = None,
    verification: VerificationSettings | None = None,
    stoppable: bool = False,
    callback: Callback | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> PlanResult:
    """Plan a motion of low cost along which a failure at any moment does little harm.

    Args:
        start: Configuration [rad or m], the name of a keyframe, or the state of a moving robot, such as
            `trajectory.at(t)`. The motion then leaves with that velocity. A configuration is a robot at rest.
        goal: Configuration, name of a keyframe, `PoseGoal` for the tool, or several of these, such as a set of grasps.
            Or the state of an arm: the motion then ends with that velocity, and `detail` says if the robot could not
            stop beyond it.
        scene: Robot, surroundings and carried object.
        w: Safety weight: radians of joint motion that the planner accepts to avoid one second in which a failure would
            do harm of severity 1. Default: the weight of the objective, or 0.3.
        via: Configurations, keyframes and `PoseGoal`s to pass in this order, without a stop if the clearance allows.
            The callback then gets only the whole motion. See `query.via.legs`.
        planner: Name of a planner (see `PLANNERS`) or a settings object.
        objective: Objective to minimise; default: joint length plus `w` times the impact of carried object and
            contents.
        time_limit: Time budget of the whole call, compiling the scene included [s]. Default: 1 s without the time to
            compile the scene at its first use (see `prepare`); unlimited if `iterations` is given.
        iterations: Planner iterations. Without a time limit, the result then depends only on the seed. With
            `iterations`, `time_limit` only stops the call early.
        stop: When to end. "first": with the first verified motion. "converged": once 32 descents in a row have
            improved the best motion by less than 0.1 %. "time_limit": when the time limit or the iterations are used
            up. Default: "time_limit" if either limit is given, else "converged", at most after 1 s.
        refine: Whether to turn paths into smooth motions that descend along the objective. If False, the motion
            follows the planner's path and rounds its corners where that is free; mobile robots stop at corners.
        seed: Seed of all random numbers.
        speed: Fraction of the velocity limits to use, in (0, 1].
        risk: Measure of the distribution of impact: "expectation", "cvar" (mean of the worst tenth; a `RiskMeasure`
            sets another fraction) or "worst". The search always uses the expectation, the only one that is additive
            along a path. The best path by the measure is then selected and refined by it (see `prefer`).
        max_wait: Longest wait before the motion starts [s], in a scene with moving entities (see `departure`). The
            trajectory then begins with a stretch at rest.
        candidates: Largest number of motions in `result.candidates`: motions of different homotopy classes or postures
            that the search meets anyway, at least 0.3 rad apart (see `query.candidates.distinct`) and at most twice as
            costly as the best. They take no more planning time: a fifth of the time limit at most is reserved to verify
            them.
        start_tolerance: Distance outside of a limit at which a joint may start [rad or m]; a tenth of it is the depth
            of a contact in which the robot may start [m]. The motion then begins with a verified piece that leads back
            inside, and `detail` says so.
        constraints: Constraints along the motion, in addition to collision. Default: those that the scene declares,
            and that the contents of a carried vessel stay in it (`KeepContents`). An empty list turns all off.
        verification: Resolution of the judge; default: checks at most 2 mm apart, with exact geometry where bounding
            spheres do not prove that the state is free.
        stoppable: Whether to plan stops along the motion, too: `result.stops`, one every 0.1 s. The check "stops" of
            the verdict warns where none keeps the constraints and ends before the motion does; see `plan_stops`. The
            stops are planned after the time limit, in about 10 ms each, with an open vessel 30 ms.
        callback: Called with the first path at its estimated cost, then with every better verified motion; without
            `refine`, with better paths, too. Once it returns True, the call ends with a verified motion.
        cancelled: Called every few milliseconds, e.g. `threading.Event().is_set`. Once it returns True, the call ends
            with the best verified motion, or with one near the first path. Without a path the status is CANCELLED.

    Returns:
        The result; SOLVED only if the independent judge passed the timed trajectory.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside their range.
    """
    chosen = driving_planner(
        checked_planner(planner), checked_scene(scene)
    )  # imports what bases need, which takes 0.2 s
    started = time.perf_counter()
    share, measure = checked_speed(speed), checked_risk(risk)
    ready = prepared(scene, checked_objective(objective, w), constraints, share)
    bound, asked = ready.objective, ready.constraints
    passed, tolerance = checked_via(via, scene), checked_start_tolerance(start_tolerance)
    if passed and isinstance(goal, State):
        raise UnsupportedError("`via` with a goal that has a velocity; plan to it without `via`")
    request = Request(
        planner=chosen,
        objective=bound,
        constraints=asked,
        preference=None if measure.kind == "expectation" or bound.w == 0.0 else Preference(measure, bound),
        speed=share,
        max_wait=checked_wait(max_wait, scene),
        verification=checked_verification(verification),
        refine=checked_flag("refine", refine),
        stop=checked_stop(stop, limited=not (time_limit is None and iterations is None)),
        callback=checked_callback(callback),
        candidates=checked_candidates(candidates, via=bool(passed)),
    )
    rng, limit = checked_seed(seed), checked_time_limit(time_limit, iterations)
    # Compiling counts against a time limit that the caller has set, not against the default one.
    budget = Budget(limit, iterations, checked_cancelled(cancelled), started + (time_limit is None) * ready.total)
    also_stops = checked_flag("stoppable", stoppable)
    begun = find_start(
        start, asked, tolerance, share, late=lambda: budget.over, max_wait=request.max_wait, stops=bool(passed)
    )
    if isinstance(begun, PlanResult):
        return _with_times(begun, ready.total, started)
    real, lead = begun
    aimed = find_goal(goal, asked, real.q, share, late=lambda: budget.over)
    if isinstance(aimed, PlanResult):
        return _with_times(aimed, ready.total, started)
    goal, run_in = aimed
    settings = {"planner": planner, "objective": bound.objective, "refine": refine, "seed": seed}
    leg = partial(
        plan,
        constraints=asked.constraints,
        speed=share,
        risk=measure,
        verification=verification,
        cancelled=budget.cancelled,
        **settings,
    )
    if passed:
        through = plan_through((real.q, passed, goal), partial(leg, stop=stop), request, budget, seed)
        result = real.completed(through, request)
        return _with_stops(result, asked, budget) if also_stops else result
    if real.passes and real.first is not None:
        seconds = budget.remaining_seconds
        onward = leg(
            real.q,
            goal,
            at_time(scene, real.first.duration),
            stop=request.stop,
            time_limit=None if np.isinf(seconds) else (1.0 - _PASSING_SHARE) * seconds,
            iterations=iterations,
            candidates=request.candidates,
            callback=callback,
        )
        result = real.completed(onward, request)
        return _with_times(_with_stops(result, asked, budget) if also_stops else result, ready.total, started)
    try:
        ends = find_endpoints(
            real.q, goal, asked, rng, objective=bound, seed=seed, cancelled=budget.cancelled, late=budget.is_late
        )
    except NonFiniteCostError as error:
        return PlanResult(status=PlanStatus.NONFINITE, detail=str(error))
    notes = [*ready.notes(limit), *(grasp_warnings(scene) if constraints is None else ())]
    if (driving := base_planning(scene)) is not None and not isinstance(ends, PlanResult):
        ends = driving.ends(ends)
    if isinstance(ends, PlanResult):
        return _with_times(_with_notes(ends, notes), ready.total, started)
    ends = ends if lead is None else lead.leading_to(ends)
    ends = ends if run_in is None else run_in.ending(ends)
    request = replace(request, constraints=ends.constraints, poses=poses_of(goal, ends.goal_index))
    request = replace(request, lead=lead, run_in=run_in, takeover=real.takeover if real.first is None else None)
    try:
        best = BestVerified(request, ends, budget)
        for motion in motions_to_verify(request, ends, budget, rng, best):
            best.consider(motion)
        result = real.completed(best.result(), request)
    except NonFiniteCostError as error:
        return PlanResult(status=PlanStatus.NONFINITE, detail=str(error))
    result = _with_notes(result, [*notes, *ends.notes, *_waived(asked)])
    result = _with_stops(result, asked, budget) if also_stops else result
    return _with_times(result, ready.total, started)


def _with_notes(result: PlanResult, notes: Sequence[str]) -> PlanResult:
    return replace(result, detail="; ".join([*notes, *([result.detail] if result.detail else [])]))


def _with_times(result: PlanResult, compiled: float, started: float) -> PlanResult:
    times = {"compile_time": compiled, "total_time": time.perf_counter() - started}
    return replace(result, stats={**result.stats, **times})


def _with_stops(result: PlanResult, held: SceneConstraints, budget: Budget) -> PlanResult:
    """Return the result with stops along its trajectory, and a warning where there are none."""
    if result.status is not PlanStatus.SOLVED or result.trajectory is None:
        return result
    began = time.perf_counter()
    stops = plan_stops(result.trajectory, held.scene, constraints=held.constraints, cancelled=budget.cancelled)
    check = stops_check(stops)
    found = replace(
        result,
        stops=stops,
        verdict=replace(result.verdict, checks={**result.verdict.checks, "stops": check}),
        stats={**result.stats, "stops_time": time.perf_counter() - began},
    )
    return found if check.passed else _with_notes(found, [check.detail])


def _waived(held: SceneConstraints) -> list[str]:
    """Return a note for each default constraint that the caller has switched off."""
    asked = {type(constraint) for constraint in held.constraints}
    return [f"{c.name} is switched off" for c in default_constraints(held.scene) if type(c) not in asked]
