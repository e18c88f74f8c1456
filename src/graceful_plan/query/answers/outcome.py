"""What comes of a search: a result with a motion, or one that says why there is none; and how cautiously to look."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from graceful_plan.core.kernels import CHECK_STEP, FINE_STEP
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.departure import RESERVE
from graceful_plan.query.ends import Ends
from graceful_plan.query.finish import Judged
from graceful_plan.query.request import Request
from graceful_plan.query.search import Search
from graceful_plan.result import PlanResult, PlanStatus, TracePoint

_CAUTION = ((0.002, CHECK_STEP), (0.005, FINE_STEP), (0.01, FINE_STEP))
"""Clearance to keep [m] and step of edge checks [rad], for the first search and for those after the judge objected."""
_TIMING_RESERVE = RESERVE + 0.2
"""Seconds kept besides to time candidates and to evaluate the chosen one if something moves past an arm, at most a
quarter of all.
"""
_UNVERIFIED = "a path was found, but there was no time to judge a motion along it: it is NOT verified"


def problems(request: Request, ends: Ends) -> Iterator[SceneProblem]:
    """Yield what to search in, more and more cautiously."""
    for margin, check_step in _CAUTION:
        yield SceneProblem(
            kernels=request.constraints.kernels,
            start=ends.departure.q[-1],
            goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
            margin=min(margin, 0.5 * ends.clearance),
            check_step=check_step,
            constraints=request.constraints,
        )


def until_last_steps(request: Request, elapsed: float, *, insured: bool = False) -> float:
    """Return how much of its time a call may spend before it has to time and to judge what was found [s].

    Args:
        request: What is asked for.
        elapsed: How much it has spent [s].
        insured: Whether there is a motion already that passes the judge.
    """
    clock = request.clock
    if not np.isfinite(clock.limit):
        return clock.limit
    scene = request.objective.scene
    departing = min(_TIMING_RESERVE, clock.limit / 4.0) if scene.moving and scene.base is None else 0.0
    return elapsed + clock.left - clock.reserve(clock.limit, insured=insured) - departing


def solved(
    judged: Judged, searched: tuple[Search, Ends], request: Request, budget: Budget, stats: dict[str, float]
) -> PlanResult:
    """Return the result of a motion that the judge passed."""
    found, ends = searched
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
        goal_index=ends.goal_index[motion.arrival],
    )


def failed(
    searched: tuple[Search, Ends], refused: Judged | None, why_not: str, budget: Budget, stats: dict[str, float]
) -> PlanResult:
    """Return what there is to say if no motion passed."""
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
