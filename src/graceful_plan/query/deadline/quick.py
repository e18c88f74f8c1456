"""A first motion soon: for who stops a search at its first path or cancels it, and for calls with little time left.

A coarse descent from the path takes a millisecond or two, where descents to the end take twenty. Its curve is as good
as any if the judge passes it; if not, the polyline itself is timed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from graceful_plan.planners.motion_descent import COARSE, Effort, Landed, MotionDescents, Start, go_on
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.ends import Ends
from graceful_plan.query.motions import Motion, along, motion_descents, start_of, timed_curve
from graceful_plan.query.request import Request
from graceful_plan.query.search import Search
from graceful_plan.timing.spline import Spline

SOON = 0.1
"""Who stops a search earlier than this wants a motion soon [s]; later, 20 to 40 ms of finer descents hardly count."""

_HALF = replace(COARSE, evaluations=COARSE.evaluations // 2)
_COARSE = 0.01
"""Limit of a coarse descent after a search was cancelled [s]."""


def wants_it_soon(found: Search) -> bool:
    """Whether the search was stopped so early that what follows should not take longer."""
    return found.stopped and bool(found.paths) and found.trace[-1].time < SOON


def quick_motions(
    found: Search, request: Request, ends: Ends, problem: SceneProblem, budget: Budget
) -> Iterator[Motion]:
    """Yield motions near the best path that was found: a smooth one if one comes quickly, then along its polyline."""
    path = found.paths[-1]
    whole, arrival = ends.joined(path)
    descents = motion_descents(request, problem, Effort(bends=0, hops=0))
    if descents is not None and whole.length > 0.0 and request.clock.has_room("timing", "judging"):
        start = start_of(whole, arrival, ends)
        # Who cancelled left nothing of the budget, but a coarse descent hardly counts.
        landed = _landed(descents, start, Budget(time_limit=_COARSE) if budget.cancelled() else budget)
        if landed is not None:
            with request.clock.measured("timing"):
                motion = timed_curve(landed, arrival, request)
            if motion is not None:
                yield motion
    yield from along(path, request, ends)


def _landed(descents: MotionDescents, start: Start, budget: Budget) -> Landed | None:
    """Descend coarsely; None if the curve is not free halfway: then it hardly ever is at the end."""
    landed = None
    descent = descents.descended(start, _HALF, budget)
    while descent is not None and descents.is_free(curve := Spline(descent.controls), start):
        if landed is not None:
            return Landed(curve, descent.value, 0)
        landed = Landed(curve, descent.value, 0)
        go_on(descent, COARSE.evaluations - _HALF.evaluations, budget)
    return landed
