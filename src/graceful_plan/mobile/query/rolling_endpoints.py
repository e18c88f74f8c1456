"""Endpoints of a drive: a base cannot leave a tight place sideways."""

from __future__ import annotations

from dataclasses import replace

from graceful_plan.mobile.query.arm_detours import with_arm_detours
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.result import PlanResult, PlanStatus

_TIGHT = "{}: free, but with less than 2 mm of clearance in the planner's sphere model; a base cannot step out of it"


def rolling_endpoints(ends: Endpoints) -> Endpoints | PlanResult:
    """Return the ends that a base can leave and reach by rolling, or a failed result if there are none."""
    if len(ends.departure) > 1:
        return PlanResult(status=PlanStatus.INVALID_START, detail=_TIGHT.format("start"))
    clear = [k for k, arrival in enumerate(ends.arrivals) if len(arrival) == 1]
    if not clear:
        return PlanResult(status=PlanStatus.INVALID_GOAL, detail=_TIGHT.format("goal"))
    arrivals, index = (tuple(of[k] for k in clear) for of in (ends.arrivals, ends.goal_index))
    return with_arm_detours(replace(ends, arrivals=arrivals, goal_index=index))
