"""plan(): check, compile, search, time, verify, return."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from graceful_plan.analysis.certificate import certificate_of
from graceful_plan.analysis.risk_measures import RiskMeasure
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import CHECK_STEP, FINE_STEP
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import Objective, SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners import Planner
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.arguments import (
    FAILURE_AWARE,
    checked_cancelled,
    checked_objective,
    checked_planner,
    checked_risk,
    checked_seed,
    checked_speed,
    checked_time_limit,
    checked_wait,
)
from graceful_plan.query.departure import RESERVE, search_among_moving
from graceful_plan.query.ends import Ends, ways_out
from graceful_plan.query.finish import Finished, finish
from graceful_plan.query.goals import Configuration, Goal, resolve_goal, resolve_start
from graceful_plan.query.prefer import Preference
from graceful_plan.query.search import Callback, Search, search
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_CAUTION = ((0.002, CHECK_STEP), (0.005, FINE_STEP), (0.01, FINE_STEP))
"""Clearance to keep [m] and step of edge checks [rad], for the first search and for those after the judge objected."""
_RESERVE = 0.1
"""Seconds kept for timing and verification, at most a quarter of the time limit: they take 0.03 to 0.08."""
_AWARE_RESERVE = 0.15
"""Seconds kept besides for failure-aware timing."""
_TIMING_RESERVE = RESERVE + 0.2
"""Seconds kept besides to time candidates and to evaluate the chosen one if something moves."""


def plan(
    start: Configuration,
    goal: Goal,
    scene: Scene,
    w: float | None = None,
    *,
    planner: str | Planner = "auto",
    objective: Objective | None = None,
    time_limit: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
    speed: float | str = 1.0,
    risk: str | RiskMeasure = "expectation",
    max_wait: float = 0.0,
    callback: Callback | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> PlanResult:
    """Plan a motion that costs little and along which a failure at any moment does little harm.

    Args:
        start: Configuration [rad or m], or the name of a keyframe.
        goal: Configuration, keyframe, several of them, or a `PoseGoal` for the tool.
        scene: Robot, surroundings and what is carried.
        w: Safety weight: how much motion [rad] a unit of impact times length is worth; default: the objective's, or 1.
        planner: Name of a planner (see `PLANNERS`) or a settings object.
        objective: What to minimise, if not joint length plus `w` times the impact of carried object and contents.
        time_limit: Seconds for the whole call; 1 by default, none if `iterations` is given.
        iterations: Planner iterations; with these alone, the result depends on the seed only.
        seed: Of all random numbers.
        speed: In (0, 1]: fraction of the velocity limits to use; or "failure_aware": as fast as the limits allow, but
            slower where that lowers the integral of 1 + w times impact over time (see `retime`).
        risk: What of the distribution of impact counts: "expectation", "cvar" (the mean of the worst tenth; another
            share with a `RiskMeasure`) or "worst". Searching is by expectation in any case, since only that adds up
            along a path; of the paths found the best by the measure is taken and refined by it (see `prefer`).
        max_wait: How long the robot may wait before it goes [s], in a scene where something moves (see `departure`);
            the trajectory then begins with a stretch at rest.
        callback: Called with every improvement; returning True ends the search.
        cancelled: Asked every few milliseconds, such as `threading.Event().is_set`; once it returns True the search
            ends, and the best path so far is timed and judged as ever. Without one the status is CANCELLED.

    Returns:
        The result, SOLVED only if the independent judge passed the timed trajectory.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside of their range.
    """
    started = time.perf_counter()
    solver, rng = checked_planner(planner), checked_seed(seed)
    wait = checked_wait(max_wait, scene)
    limit, measure = checked_time_limit(time_limit, iterations), checked_risk(risk)
    stop = checked_cancelled(cancelled)
    bound = checked_objective(objective, w, checked_speed(speed)).bind(scene)
    preference = None if measure.kind == "expectation" else Preference(measure, bound)
    resolved_start = resolve_start(start, scene)
    if not len(resolved_start.q):
        return PlanResult(status=PlanStatus.INVALID_START, detail=resolved_start.detail)
    resolved_goal = resolve_goal(goal, scene, resolved_start.q[0], seed=seed, cancelled=stop)
    if stop():
        return PlanResult(status=PlanStatus.CANCELLED, detail="before the search")
    if not len(resolved_goal.q):
        return PlanResult(status=PlanStatus.INVALID_GOAL, detail=resolved_goal.detail)
    ends = ways_out(resolved_start.q[0], resolved_goal.q, compile_scene(scene), scene, rng, stop)
    if isinstance(ends, PlanResult):
        return ends
    try:
        result = _search_and_finish(
            ends,
            solver,
            bound,
            Budget(limit, iterations, stop, started),
            rng,
            callback,
            goal,
            speed,
            preference,
            wait,
        )
        found = time.perf_counter()
        certificate = certificate_of(result, bound, goal if isinstance(goal, PoseGoal) else resolved_goal.q)
    except NonFiniteCostError as error:
        return PlanResult(status=PlanStatus.NONFINITE, detail=str(error))
    notes = [*resolved_start.notes, *resolved_goal.notes, *([result.detail] if result.detail else [])]
    index = None if result.goal_index is None else resolved_goal.index[result.goal_index]
    ended = time.perf_counter()
    stats = {**result.stats, "certificate_time": ended - found, "total_time": ended - started}
    return replace(result, certificate=certificate, detail="; ".join(notes), goal_index=index, stats=stats)


def _search_and_finish(
    ends: Ends,
    planner: Planner,
    objective: SceneObjective,
    budget: Budget,
    rng: np.random.Generator,
    callback: Callback | None,
    goal: Goal,
    speed: float | str,
    preference: Preference | None,
    max_wait: float,
) -> PlanResult:
    """Search, judge, and search more cautiously for as long as the judge objects and the budget lasts."""
    moving = objective.scene.moving
    reserve = _RESERVE + (_AWARE_RESERVE if speed == FAILURE_AWARE else 0.0) + (_TIMING_RESERVE if moving else 0.0)
    budget.time_limit -= min(reserve, budget.time_limit / 4.0)
    pose = goal if isinstance(goal, PoseGoal) else None
    found, refused = Search(), None
    stats: dict[str, float] = {}
    for margin, check_step in _CAUTION:
        problem = SceneProblem(
            kernels=ends.compiled.kernels,
            start=ends.departure.q[-1],
            goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
            margin=min(margin, 0.5 * ends.clearance),
            check_step=check_step,
        )
        if preference is None and moving:
            found = search_among_moving(planner, problem, ends, objective, budget, rng, callback, speed, max_wait)
        elif preference is None:
            found = search(planner, problem, objective, budget, rng, callback)
        else:
            found = preference.search(planner, problem, budget, rng, callback)
        stats = {"search_time": budget.elapsed, "iterations": float(budget.spent)}
        for path in reversed(found.paths):
            whole, index = ends.joined(path)
            done = finish(whole, objective.scene, objective, pose, speed, ends.in_the_clear(index), max_wait)
            if done.verdict.passed:
                return _solved(whole, done, found, ends.goal_index[index], stats)
            refused = refused or done
        if budget.exhausted or found.stopped or not (found.paths or found.refused):
            break
    return _failed(found, refused, budget, stats)


def _solved(path: Path, done: Finished, found: Search, index: int, stats: dict[str, float]) -> PlanResult:
    return PlanResult(
        status=PlanStatus.SOLVED,
        path=path,
        trajectory=done.trajectory,
        cost=done.cost,
        verdict=done.verdict,
        trace=tuple(found.trace),
        goal_index=index,
        stats=stats,
    )


def _failed(found: Search, refused: Finished | None, budget: Budget, stats: dict[str, float]) -> PlanResult:
    ended = PlanStatus.CANCELLED if budget.cancelled() else PlanStatus.TIMEOUT
    if refused is None:
        status = ended if budget.exhausted else PlanStatus.INFEASIBLE
        return PlanResult(status=status, detail=f"no path after {budget.elapsed:.3f} s", stats=stats)
    trace = tuple(found.trace)
    if not refused.verdict.checks:
        return PlanResult(status=PlanStatus.RETIMING_FAILED, detail=refused.problem, trace=trace, stats=stats)
    objections = "; ".join(f"{name}: {refused.verdict.checks[name].detail}" for name in refused.verdict.failures)
    detail = f"the judge refused every path found; the best for {objections}"
    return PlanResult(status=ended, detail=detail, verdict=refused.verdict, trace=trace, stats=stats)
