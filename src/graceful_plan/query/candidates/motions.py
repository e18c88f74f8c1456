"""Timed motions from curves and polylines. Costs are evaluated on the timed motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import DRIVING_TIME_PRICE, DescentResult, time_price
from graceful_plan.query.candidates.departure import with_best_departure
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import CostBreakdown
from graceful_plan.timing.blend import merge_near_vertices, rounded_corners
from graceful_plan.timing.trajectory import Trajectory

DEVIATIONS = (0.1, 0.03, 0.01, 0.0)
"""Distances by which a motion may cut a corner of a polyline [rad], from fast to exact; with 0 it stops there."""


_SLOWER = (1.0, 0.6, 0.35)
"""Shares of the speed to try after a stop."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A timed motion, not yet verified."""

    path: Path
    trajectory: Trajectory
    cost: CostBreakdown
    arrival: int
    """Index of the arrival, see `Endpoints`."""
    ranking: float
    """Cost for comparing motions: the total cost by the risk measure, plus `price_of_time` times the duration."""
    estimate: float | None = None
    """Estimated total cost at the end of its descent; None if it comes from a polyline."""


def timed_curve(found: DescentResult, request: Request) -> Motion | None:
    """Time the curve of a descent; return None if no timing satisfies the constraints."""
    try:
        trajectory = request.constraints.timed(found.curve, speed=request.speed, ends=request.end_speeds)
    except RetimingError:
        return None
    motion = costed(trajectory.path, trajectory, found.start.arrival, request)
    return replace(motion, estimate=found.value - price_of_time(request) * trajectory.duration)


def along(path: Path, request: Request, ends: Endpoints, late: Callable[[], bool] = lambda: False) -> Iterator[Motion]:
    """Yield motions along a polyline that cut its corners less and less.

    The first one cuts each corner as far as the fast checker finds it free. With a moving start or goal, further ones
    stop at the end of the lead-in and at the beginning of the run-in.

    Args:
        path: Path of the search.
        request: The request.
        ends: Both ends.
        late: Whether the time is up; then no motion after the first one is timed.

    Raises:
        RetimingError: If even the polyline itself cannot be timed.
    """
    whole, arrival = ends.joined(path)
    clear = ends.in_the_clear(arrival)
    choices = (_free_deviations(whole, request) if clear else DEVIATIONS[0], *DEVIATIONS[1:])
    for deviation in choices:
        try:
            yield _rounded(whole, deviation, arrival, request)
        except RetimingError:
            if deviation is choices[-1]:
                raise
        if late():
            return
        if request.lead is not None or request.run_in is not None:
            yield from _stopping(whole, deviation, arrival, request)


def costed(whole: Path, trajectory: Trajectory, arrival: int, request: Request) -> Motion:
    """Return a motion with its cost; among moving entities it departs at the best time."""
    objective = request.objective
    if objective.scene.moving:
        trajectory, cost = with_best_departure(trajectory, objective, request.max_wait)
    else:
        cost = objective.breakdown(trajectory)
    total = cost.total if request.preference is None else request.preference.total(trajectory)
    ranking = total + price_of_time(request) * trajectory.duration
    return Motion(path=whole, trajectory=trajectory, cost=cost, arrival=arrival, ranking=ranking)


def with_cost(motion: Motion, request: Request) -> Motion:
    """Return the motion with its cost under another request."""
    return costed(motion.path, motion.trajectory, motion.arrival, request)


def price_of_time(request: Request) -> float:
    """Return the cost per second of motion in rankings [rad/s]."""
    if request.objective.scene.base is not None:
        return DRIVING_TIME_PRICE
    return time_price(careful=request.constraints.level)


def _rounded(whole: Path, deviation: float | Float[Array, " corner"], arrival: int, request: Request) -> Motion:
    """Time a polyline with its corners cut by up to `deviation` [rad]."""
    trajectory = request.constraints.retimed(whole, deviation=deviation, speed=request.speed, ends=request.end_speeds)
    return costed(whole, trajectory, arrival, request)


def _stopping(
    whole: Path, deviation: float | Float[Array, " corner"], arrival: int, request: Request
) -> Iterator[Motion]:
    """Yield motions that stop between lead-in, path and run-in; with contents, which swing there, also slower ones."""
    lead, run_in = request.lead, request.run_in
    q = whole.q
    if lead is not None:
        q = q[len(lead.path) - 1 :]
    if run_in is not None:
        q = q[: len(q) + 1 - len(run_in.path)]
    leads = lead is None or (len(q) and np.array_equal(q[0], lead.path.q[-1]))
    arrives = run_in is None or (len(q) and np.array_equal(q[-1], run_in.path.q[0]))
    if len(q) < 2 or not (leads and arrives):
        return
    onward = Path(q)
    corners = deviation if np.ndim(deviation) == 0 else _free_deviations(onward, request)
    for speed in _SLOWER if request.constraints.felt else _SLOWER[:1]:
        try:
            after = request.constraints.retimed(onward, deviation=corners, speed=speed * request.speed)
        except RetimingError:
            return
        if len(after) == 1:  # too short for a motion between lead-in and run-in
            return
        if lead is not None:
            after = lead.stop.spliced(after.later(lead.stop.duration))
        if run_in is not None:
            after = after.spliced(run_in.motion.later(after.duration))
        yield costed(whole, after, arrival, request)


def _free_deviations(whole: Path, request: Request) -> Float[Array, " corner"]:
    """Return for each corner the largest of `DEVIATIONS` at which the fast checker finds it free [rad]."""
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
