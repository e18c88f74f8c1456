"""Motions of a moving base that go over from its present arc to a planned motion without a rest.

A plan begins at rest, where the base can stop on its present arc. Where the plan drives on in the same gear, also after
a turn in place, a spline replaces the arc and the first drive. It begins with the present heading and curvature, so it
can be driven from the present velocity on. It either follows the arc, or leads to a later place of the drive directly.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.exceptions import RetimingError
from graceful_plan.mobile.motions.arc_stops import speed_and_turn
from graceful_plan.mobile.motions.drive import Drive
from graceful_plan.mobile.motions.rolling_spline import RollingSpline
from graceful_plan.path import Path
from graceful_plan.query.request import Request
from graceful_plan.query.via.legs import one_after_the_other
from graceful_plan.timing.topp import EndSpeeds
from graceful_plan.timing.trajectory import State, Trajectory

_SLOWEST = 0.05
"""Least speed at which a base follows a curve from its present velocity [m/s]; below it, the curvature may be large."""
_SPACINGS = (0.6, 0.3, 0.15)
"""Lengths of a curve per knot interval to try [m]: short ones stay closer to arc and plan, but turn more sharply."""
_AHEAD = (0.3, 0.6, 1.2, 2.4)
"""Distances along the drive at which a direct curve reaches it [m]."""
_DIRECT_SPACING = 0.3
"""Length of a direct curve per knot interval [m]."""
_FEWEST, _MOST = 4, 80
"""Least and largest number of knot intervals."""
_POINTS = 8
"""Points for each knot interval, to which a curve is fitted."""
_BENDING = 1e-4
"""Weight of the squared second derivative of a curve [m] relative to that of squared distances from points [m]."""
_DENSE = 1000
"""Samples of arc and plan that measure their length."""
_STILL = 1e-9
"""Speed of a joint below which a sample is at rest [rad/s or m/s]."""
_DRIVES = 1e-3
"""Length above which a section is no turn in place [m]."""
_RESERVE = 1e-5
"""Relative reserve of the first speed for rounding, where a limit of the base holds it; the given one replaces it."""
_SAME = 1e-6
"""Largest difference of equal headings [rad]."""


@dataclass(frozen=True, eq=False)
class _Guide:
    """Configurations to which a curve is fitted, and their distances along it [m]; without any on a first stretch."""

    q: Float[Array, "n nq"]
    length: Float[Array, " n"]

    @property
    def whole(self) -> float:
        """Length of the curve [m]."""
        return float(self.length[-1])


def passing_motions(stop: Trajectory, onward: Trajectory, request: Request) -> Iterator[Trajectory]:
    """Yield motions that begin with the velocity of a stop on the present arc, and go over to a planned motion.

    Args:
        stop: Stop of the moving base.
        onward: Motion from the end of the stop, from rest.
        request: The request that the motion serves.
    """
    begun = State(stop.q[0], stop.qd[0])
    v, _, turn = speed_and_turn(begun)
    drive, turned = _first_drive(onward)
    if abs(v) < _SLOWEST or drive is None or not _same_gear(drive, forward=v > 0.0):
        return
    after, end = onward.since(float(drive.t[-1])), drive.q[-1]
    guides = [] if turned else [(spacing, _along([stop, drive])) for spacing in _SPACINGS]
    guides += [(_DIRECT_SPACING, guide) for ahead in _AHEAD if (guide := _directly(begun.q, drive, ahead)) is not None]
    for spacing, guide in guides:
        spans = int(np.clip(np.ceil(guide.whole / spacing), _FEWEST, _MOST))
        controls = _fitted(guide, end, spans, begun, turn / abs(v), forward=v > 0.0)
        curve = RollingSpline(controls, v > 0.0, float(begun.q[2]))
        if abs(curve.samples[-1, 2] - end[2]) > _SAME:  # it turns the other way round
            continue
        size = (1.0 - _RESERVE) * float(np.linalg.norm(begun.qd))
        try:
            driven = request.constraints.timed(Drive((curve,)), speed=request.speed, ends=EndSpeeds(start=size))
        except RetimingError:
            continue
        yield one_after_the_other([_between(driven, begun, end), after])


def _first_drive(motion: Trajectory) -> tuple[Trajectory | None, bool]:
    """Return the first part that drives, from rest to rest, and whether a turn in place comes before it."""
    first, turned = 0, False
    for last in np.flatnonzero(np.abs(motion.qd).max(axis=1) <= _STILL).tolist():
        if last == first:
            continue
        rows = slice(first, last + 1)
        if Path(motion.q[rows, :2]).length > _DRIVES:
            t, q, qd, qdd = (part[rows] for part in (motion.t, motion.q, motion.qd, motion.qdd))
            return Trajectory(t, q, qd, qdd, motion.joints), turned
        first, turned = last, True
    return None, turned


def _same_gear(drive: Trajectory, *, forward: bool) -> bool:
    """Return whether a motion drives in one direction only."""
    middle = drive.at(np.linspace(drive.t[0], drive.t[-1], _DENSE)[1:-1])
    along = middle.qd[:, 0] * np.cos(middle.q[:, 2]) + middle.qd[:, 1] * np.sin(middle.q[:, 2])
    return bool((along > 0.0).all() if forward else (along < 0.0).all())


def _along(motions: Sequence[Trajectory]) -> _Guide:
    """Return all configurations of motions one after the other."""
    q = np.concatenate([motion.at(np.linspace(motion.t[0], motion.t[-1], _DENSE)).q for motion in motions])
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q[:, :2], axis=0), axis=1)))
    moves = np.append(True, np.diff(length) > 1e-9)
    return _Guide(q[moves], length[moves])


def _directly(begin: Float[Array, " nq"], drive: Trajectory, ahead: float) -> _Guide | None:
    """Return the configurations of a drive from a distance along it on; None if it is shorter."""
    guide = _along([drive])
    later = guide.length >= ahead
    if not later.any():
        return None
    q, length = guide.q[later], guide.length[later]
    return _Guide(q, length - length[0] + float(np.linalg.norm(q[0, :2] - begin[:2])))


def _fitted(
    guide: _Guide, end: Float[Array, " nq"], spans: int, begun: State, curvature: float, *, forward: bool
) -> Float[Array, "control column"]:
    """Return control points of a spline near a guide, with little bending, and the present direction and curvature.

    Both ends and the heading at the last one are exact, and the arm begins with its present velocity.
    """
    u = np.linspace(0.0, spans, _POINTS * spans + 1)
    value, slope, bend = _native.spline(np.eye(spans + 3), u)
    step, sign = guide.whole / spans, 1.0 if forward else -1.0
    known = u * step >= guide.length[0]
    columns = [np.interp(u[known] * step, guide.length, column) for column in np.delete(guide.q, 2, axis=1).T]
    points = np.stack(columns, axis=1)
    first, last = (sign * np.array([np.cos(yaw), np.sin(yaw)]) for yaw in (begun.q[2], end[2]))
    begins = np.concatenate([step * first, step / float(np.linalg.norm(begun.qd[:2])) * begun.qd[3:]])
    bends = np.zeros(len(begins))
    bends[:2] = step**2 * curvature * np.array([-first[1], first[0]])
    ends = np.delete(np.stack([begun.q, end]), 2, axis=1)
    rows, wanted = np.stack([value[0], value[-1], slope[0], bend[0]]), np.stack([*ends, begins, bends])
    A = value[known]
    cost = A.T @ A + _BENDING * bend.T @ bend
    controls = np.zeros((spans + 3, len(begins) + 1))  # the last column: at full speed
    controls[:, 2:-1] = _least(cost, A.T @ points[:, 2:], rows, wanted[:, 2:])
    rows, wanted = np.concatenate([rows, slope[-1:]]), np.concatenate([wanted[:, :2], [step * last]])
    controls[:, :2] = _least(cost, A.T @ points[:, :2], rows, wanted)
    controls[[0, -1], :-1] = ends
    return controls


def _least(
    cost: Float[Array, "control control"],
    force: Float[Array, "control column"],
    rows: Float[Array, "m control"],
    wanted: Float[Array, "m column"],
) -> Float[Array, "control column"]:
    """Return x with the least x' cost x / 2 - force' x among those with rows x = wanted."""
    n, m = len(cost), len(rows)
    KKT = np.zeros((n + m, n + m))
    KKT[:n, :n], KKT[n:, :n], KKT[:n, n:] = cost, rows, rows.T
    return np.linalg.solve(KKT, np.concatenate([force, wanted]))[:n]


def _between(driven: Trajectory, begun: State, end: Float[Array, " nq"]) -> Trajectory:
    """Return a motion with exact ends; a base slips sideways by less than a millimetre per second."""
    q, qd = driven.q.copy(), driven.qd.copy()
    q[0], q[-1], qd[0] = begun.q, end, begun.qd
    return Trajectory(driven.t, q, qd, driven.qdd, driven.joints)


def cheaper(motions: Sequence[Trajectory], than: Trajectory, request: Request, price: float) -> list[Trajectory]:
    """Return the motions that rank before another one by J and the price of time [1/s], the cheapest first."""

    def ranking(motion: Trajectory) -> float:
        return request.objective.breakdown(motion).total + price * motion.duration

    ranked = sorted(((ranking(motion), k) for k, motion in enumerate(motions)))
    least = ranking(than) if motions else np.inf
    return [motions[k] for value, k in ranked if value < least]
