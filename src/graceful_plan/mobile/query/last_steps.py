"""The last steps of a base's call within its time, and its result.

Timing and verifying a drive take tenths of a second, so here the clock decides which of them is begun; see `clock`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from graceful_plan.mobile.query.clock import Clock
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.candidates import CAUTION, problem_of
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.candidates.search import Search
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.query.verification import Judged, judged
from graceful_plan.result import PlanResult, PlanStatus, TracePoint

SOON = 0.1
"""A caller that stops the search earlier than this wants a motion soon [s]."""
_UNVERIFIED = "a path was found, but there was no time to judge a motion along it: it is NOT verified"


def problems(request: Request, ends: Endpoints) -> Iterator[SceneProblem]:
    """Yield problems that keep more and more clearance."""
    for caution in CAUTION:
        yield problem_of(request, ends, *caution)


def until_last_steps(clock: Clock, elapsed: float, *, insured: bool = False) -> float:
    """Return how much of its time a call may spend before it has to time and to verify a motion [s].

    Args:
        clock: Of the call.
        elapsed: How much it has spent [s].
        insured: Whether there is a verified motion already.
    """
    if not np.isfinite(clock.limit):
        return clock.limit
    return elapsed + clock.left - clock.reserve(clock.limit, insured=insured)


def wants_it_soon(found: Search) -> bool:
    """Whether the search was stopped so early that what follows should not take longer."""
    return found.stopped and bool(found.paths) and found.trace[-1].time < SOON


def first_verified(motions: Iterable[Motion], request: Request, clock: Clock) -> Judged | None:
    """Return the first motion that passes the judge, better without a warning; else the first one with its violations.

    None if there are no motions, or there was no time to judge one.
    """
    warned, refused = None, None
    for motion in motions:
        if not (clock.has_room("judging") if warned or refused else clock.may_do("judging")):
            break
        with clock.measured("judging"):
            found = judged(motion, request)
        if found.verdict.passed and not found.verdict.warnings:
            return found
        if found.verdict.passed:
            warned = warned or found
        else:
            refused = refused or found
    return warned or refused


def solved(
    best: Judged, found: Search, ends: Endpoints, request: Request, budget: Budget, stats: dict[str, float]
) -> PlanResult:
    """Return the result of a motion that passed the judge."""
    motion = best.motion
    cost = motion.cost
    last = TracePoint(time=budget.elapsed, total=cost.total, motion=cost.motion, impact=cost.impact)
    if request.callback is not None and not found.stopped:
        request.callback(last)
    # A search estimates costs of paths. Those that promised more than any motion has kept are no improvements.
    trace = (*(point for point in found.trace if point.total > last.total), last)
    checks = best.verdict.checks
    return PlanResult(
        status=PlanStatus.SOLVED,
        detail="; ".join(f"{name}: {checks[name].detail}" for name in best.verdict.warnings),
        path=motion.path,
        trajectory=motion.trajectory,
        cost=cost,
        verdict=best.verdict,
        trace=trace,
        stats=stats,
        goal_index=ends.goal_index[motion.arrival],
    )


def failed(
    found: Search, ends: Endpoints, refused: Judged | None, budget: Budget, stats: dict[str, float]
) -> PlanResult:
    """Return why there is no motion."""
    ended = PlanStatus.CANCELLED if budget.cancelled() else PlanStatus.TIMEOUT
    trace = tuple(found.trace)
    if refused is None and found.paths:
        path, _ = ends.joined(found.paths[-1])
        return PlanResult(status=ended, path=path, detail=_UNVERIFIED, trace=trace, stats=stats)
    if refused is None:
        status = ended if budget.exhausted else PlanStatus.INFEASIBLE
        return PlanResult(status=status, detail=f"no path after {budget.elapsed:.3f} s", stats=stats)
    objections = "; ".join(f"{name}: {refused.verdict.checks[name].detail}" for name in refused.verdict.failures)
    detail = f"the judge refused every path found; the best for {objections}"
    return PlanResult(status=ended, detail=detail, verdict=refused.verdict, trace=trace, stats=stats)
