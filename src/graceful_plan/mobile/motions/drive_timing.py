"""Time drives and evaluate the cost of the resulting motions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import RetimingError
from graceful_plan.judge.passing_by import is_moving
from graceful_plan.mobile.motions.drive import Drive
from graceful_plan.path import Path
from graceful_plan.query.candidates.motions import Motion, costed, price_of_time, with_cost
from graceful_plan.query.request import Request
from graceful_plan.result import CostBreakdown
from graceful_plan.timing.blend import CurveGrid
from graceful_plan.timing.topp import Restraint
from graceful_plan.timing.trajectory import Trajectory

_INTO = 1e6
"""Added to the ranking of motions that collide with a moving entity."""
_FREE = 1e9
"""Squared path speed where there is no restraint."""


def timed_drive(drive: Drive, arrival: int, request: Request, *, charge: bool = True) -> Motion | None:
    """Time a drive at its shares of the fastest speed; None if no timing satisfies the constraints.

    Args:
        drive: The drive.
        arrival: Index of the arrival at a goal that it takes.
        request: Planning request.
        charge: Whether the cost includes the impact, which takes most of the time.
    """
    try:
        trajectory = request.constraints.timed(drive, speed=request.speed)
        restraint = slower(drive, trajectory.t, trajectory.qd)
        if restraint is not None:
            trajectory = request.constraints.timed(drive, speed=request.speed, slower=restraint)
    except RetimingError:
        return None
    if not charge:
        return _uncharged(trajectory, arrival, request)
    return _ranked(costed(trajectory.path, trajectory, arrival, request), request)


def _uncharged(trajectory: Trajectory, arrival: int, request: Request) -> Motion:
    """Return a motion whose cost is its length alone."""
    length = trajectory.path.length
    cost = CostBreakdown(motion=length, impact=0.0, w=0.0, impact_by_entity={}, impact_by_component={})
    ranking = length + price_of_time(request) * trajectory.duration
    motion = Motion(path=trajectory.path, trajectory=trajectory, cost=cost, arrival=arrival, ranking=ranking)
    return _ranked(motion, request)


def recosted(motion: Motion, request: Request) -> Motion:
    """Return a motion, planned for another weight, with its cost under this request."""
    return _ranked(with_cost(motion, request), request)


def along(whole: Path, arrival: int, request: Request) -> Motion:
    """Return a motion along a path itself, with a stop at each of its corners.

    Raises:
        RetimingError: If the path has no timing.
    """
    trajectory = request.constraints.retimed(whole, deviation=0.0, speed=request.speed)
    return _ranked(costed(whole, trajectory, arrival, request), request)


def slower(drive: Drive, t: Float[Array, " point"], qd: Float[Array, "point nq"]) -> Restraint | None:
    """Return limits on the path speed from the shares of a drive's fastest motion; None if it drives at full speed.

    A drive so short that its timing merges points of the grid, which takes microseconds, has no such limits either.

    Args:
        drive: The drive.
        t: Times of its fastest motion [s], at the points of a grid.
        qd: Velocities there [rad/s or m/s].
    """
    grid = next((g for g in map(drive.grid, (1, 2, 4)) if len(g.q) == len(t)), None)
    share = None if grid is None else drive.share(grid)
    if grid is None or share is None:
        return None
    slope = np.linalg.norm(np.concatenate([grid.slope[:, 0], grid.slope[-1:, 1]]), axis=1)
    cap = (share * np.linalg.norm(qd, axis=1) / np.maximum(slope, 1e-12)) ** 2
    cap = np.where((share < 1.0) & ~grid.stop, cap, _FREE)

    def limits(of: CurveGrid) -> Float[Array, "interval limit 3"]:
        at = np.interp(of.s, grid.s, cap)
        steps, zero, one = np.diff(of.s), np.zeros(len(of.s) - 1), np.ones(len(of.s) - 1)
        begin = np.stack([zero, one, at[:-1]], axis=-1)
        end = np.stack([2.0 * steps, one, at[1:]], axis=-1)
        return np.stack([begin, end], axis=1)

    return limits


def _ranked(motion: Motion, request: Request) -> Motion:
    """Rank motions that collide with a moving entity behind all others."""
    return replace(motion, ranking=motion.ranking + _INTO * _hits_moving_entity(motion.trajectory, request))


def _hits_moving_entity(motion: Trajectory, request: Request) -> bool:
    """Return whether the healthy robot collides with a moving entity, according to the fast checker."""
    among = request.objective.timed_impact
    if among is None:
        return False
    moves = is_moving(motion.qd)  # a moving entity that walks into a standing robot does not count
    gap, _, _ = among.moving.gaps(motion.q[moves], motion.t[moves], 0.0)
    return bool((gap < 0.0).any())
