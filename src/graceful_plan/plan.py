"""plan(): check, compile, search, time, verify, return."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from graceful_plan.analysis.risk_measures import RiskMeasure
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints, not_held
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.judge.verification import Verification
from graceful_plan.planners import Planner
from graceful_plan.planners.planner import Budget
from graceful_plan.query.answer import BestVerified
from graceful_plan.query.arguments import (
    checked_callback,
    checked_cancelled,
    checked_objective,
    checked_planner,
    checked_refine,
    checked_risk,
    checked_seed,
    checked_speed,
    checked_stop,
    checked_time_limit,
    checked_verification,
    checked_wait,
    driving_planner,
)
from graceful_plan.query.candidates.candidates import candidates
from graceful_plan.query.candidates.prefer import Preference
from graceful_plan.query.candidates.search import Callback
from graceful_plan.query.driving import driving_of
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.endpoints import find_endpoints
from graceful_plan.query.endpoints.goals import Goal, poses_of
from graceful_plan.query.request import Request, Stop
from graceful_plan.query.via.legs import plan_through
from graceful_plan.query.via.stages import Via, checked_via
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_COMPILED_SOON = 0.1
"""Compiling is not worth a word if it took less [s]: several times what bundled scenes take."""


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
    stop: Stop | None = None,
    refine: bool = True,
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
        iterations: Planner iterations; with these alone, the result depends on the seed only. With them, a time limit
            only ends the call early.
        stop: When to end: "first" with the first verified motion, "converged" once 32 descents in a row have improved
            the best motion by less than 0.1 %, "time_limit" with the time limit and the iterations. The last is the
            default of calls that have a limit of their own; others end once they have converged, at most after 1 s.
        refine: Whether paths become smooth motions that descend along the objective. Without, the motion is along the
            planner's own path, its corners cut as far as that is free; robots that drive stop at its corners.
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
        callback: Called with the first path that the search finds, at its estimated cost, then with every verified
            motion that is better than the one before, and without `refine` with better paths, too; once it returns
            True, the call ends with a verified motion.
        cancelled: Asked every few milliseconds, such as `threading.Event().is_set`; once it returns True the call ends
            with the best verified motion, or with one near the first path. Without a path the status is CANCELLED.

    Returns:
        The result, SOLVED only if the independent judge passed the timed trajectory.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside of their range.
    """
    started = time.perf_counter()
    share, measure = checked_speed(speed), checked_risk(risk)
    bound = checked_objective(objective, w).bind(scene, search_paces(share))  # compiles the scene
    asked = SceneConstraints(scene, default_constraints(scene) if constraints is None else constraints)
    compiled = time.perf_counter() - started
    request = Request(
        planner=driving_planner(checked_planner(planner), scene),
        objective=bound,
        constraints=asked,
        preference=None if measure.kind == "expectation" or bound.w == 0.0 else Preference(measure, bound),
        speed=share,
        max_wait=checked_wait(max_wait, scene),
        verification=checked_verification(verification),
        refine=checked_refine(refine),
        stop=checked_stop(stop, limited=not (time_limit is None and iterations is None)),
        callback=checked_callback(callback),
    )
    rng, limit = checked_seed(seed), checked_time_limit(time_limit, iterations)
    budget = Budget(limit, iterations, checked_cancelled(cancelled), started)
    if passed := checked_via(via, scene):
        settings = {"planner": planner, "objective": bound.objective, "stop": stop, "refine": refine, "seed": seed}
        leg = partial(
            plan,
            scene=scene,
            constraints=asked.constraints,
            speed=share,
            risk=measure,
            verification=verification,
            cancelled=budget.cancelled,
            **settings,
        )
        return plan_through((start, passed, goal), leg, request, budget, seed)
    ends = find_endpoints(start, goal, asked, rng, seed=seed, cancelled=budget.cancelled, late=budget.is_late)
    notes = [*_compiled(compiled, limit), *(not_held(scene) if constraints is None else ())]
    if (driving := driving_of(scene)) is not None and not isinstance(ends, PlanResult):
        ends = driving.ends(ends)
    if isinstance(ends, PlanResult):
        return _with_notes(ends, notes)
    request = replace(request, constraints=ends.constraints, poses=poses_of(goal, ends.goal_index))
    try:
        best = BestVerified(request, ends, budget)
        for motion in candidates(request, ends, budget, rng, best):
            best.consider(motion)
        result = best.result()
    except NonFiniteCostError as error:
        return PlanResult(status=PlanStatus.NONFINITE, detail=str(error))
    result = _with_notes(result, [*notes, *ends.notes, *_waived(asked)])
    return replace(result, stats={**result.stats, "total_time": budget.elapsed})


def _compiled(seconds: float, limit: float) -> list[str]:
    """Say how long compiling took, if it is what a call was late for or had little time left after."""
    took_long = seconds > max(_COMPILED_SOON, min(limit / 10.0, 1.0))
    return [f"compiled for {seconds:.1f} s"] if took_long else []


def _with_notes(result: PlanResult, notes: Sequence[str]) -> PlanResult:
    return replace(result, detail="; ".join([*notes, *([result.detail] if result.detail else [])]))


def _waived(held: SceneConstraints) -> list[str]:
    """Say which of the constraints that go without saying were switched off."""
    asked = {type(constraint) for constraint in held.constraints}
    return [f"{c.name} is switched off" for c in default_constraints(held.scene) if type(c) not in asked]
