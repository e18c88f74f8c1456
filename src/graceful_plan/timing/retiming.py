"""Timing: from a path to the fastest trajectory within limits of velocity, acceleration and torque.

Corners of the path are rounded first (`blend`), then the curve is timed (`topp`). The result is checked again. Where
sampling let it exceed a limit slightly, the whole trajectory is slowed down until it satisfies the limit.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.exceptions import RetimingError, SettingError, ShapeError
from graceful_plan.path import Path, real_array
from graceful_plan.scene.elements import Limits
from graceful_plan.setting_checks import not_negative, positive_fraction
from graceful_plan.timing.blend import Curve, CurveGrid, Polyline, merge_near_vertices, rounded
from graceful_plan.timing.topp import (
    AT_REST,
    EndSpeeds,
    InverseDynamics,
    Restraint,
    SpecificForceLevels,
    fastest,
    fastest_with_toppra,
    travelled,
)
from graceful_plan.timing.trajectory import Trajectory

_LONGEST = 1e6
"""Longest path that is timed [rad or m]: beyond it, grid intervals are lost in rounding."""
_FINEST = 4
"""Density of the finest grid."""
_ROUNDING = 1e-9
"""Relative reserve below the limits, for rounding errors when another program evaluates the trajectory."""
ACCEPTED_SLOWDOWN = 1.02
"""The grid is refined as long as the final check would slow the motion down by more than this factor."""


def retime(
    path: Path,
    limits: Limits,
    joints: tuple[str, ...] | None = None,
    *,
    deviation: float | Float[Array, " corner"] = 0.05,
    speed: float = 1.0,
    inverse_dynamics: InverseDynamics | None = None,
    restraint: Restraint | None = None,
    felt: SpecificForceLevels | None = None,
    start_speed: float = 0.0,
    end_speed: float = 0.0,
) -> Trajectory:
    """Time a path as fast as the limits allow, from rest to rest unless it has a speed at an end.

    Args:
        path: Polyline in configuration space; start and end are kept exactly.
        limits: Velocity and acceleration limits; torque limits apply only if `inverse_dynamics` is given.
        joints: Names of the joints; "0", "1"... if None.
        deviation: Distance by which the motion may cut a corner of the path [rad, Euclidean], one value for all corners
            or one for each inner vertex. With 0 the motion follows the polyline exactly and stops at each corner.
        speed: In (0, 1]: scales velocities, and by its square accelerations.
        inverse_dynamics: Function from (q, qd, qdd) to joint torques; if given, torque limits are enforced.
        restraint: Further limits on path acceleration and speed.
        felt: Limits on the specific force of a carried object such as a full cup; see
            `SceneConstraints.felt_levels`.
        start_speed: Size of the velocity at the start, along the path [rad/s, Euclidean].
        end_speed: Size of the velocity at the end, along the path [rad/s, Euclidean].

    Returns:
        A trajectory within the limits at every time, not only at its samples. A path without length gives a single
        sample.

    Raises:
        RetimingError: If no timing satisfies the limits.
        ShapeError: If path, limits and joints differ in size.
        SettingError: If a setting is outside its range.
    """
    nq = path.q.shape[1]
    joints = tuple(str(i) for i in range(nq)) if joints is None else tuple(joints)
    if len(joints) != nq:
        raise ShapeError("path", path.q.shape, f"(n, {len(joints)} joints)")
    positive_fraction("speed", speed, "0 < speed <= 1")
    if not (real_array("deviation", deviation) >= 0.0).all() or np.isinf(deviation).any():
        raise SettingError("deviation", deviation, "a finite distance >= 0 rad")
    if not path.length <= _LONGEST:
        raise RetimingError(f"the path is {path.length:.3g} rad long, at most {_LONGEST:g} rad are timed")
    _check_corners(path, deviation)
    pieces = rounded(path, deviation)
    if not pieces:
        still = np.zeros((1, nq))
        return Trajectory(np.zeros(1), path.q[:1], still, still, joints)
    return timed(
        Polyline(pieces, path.q[-1]),
        limits,
        joints,
        speed=speed,
        inverse_dynamics=inverse_dynamics,
        restraint=restraint,
        felt=felt,
        ends=EndSpeeds(start_speed, end_speed),
    )


def timed(
    curve: Curve,
    limits: Limits,
    joints: tuple[str, ...],
    *,
    speed: float = 1.0,
    inverse_dynamics: InverseDynamics | None = None,
    restraint: Restraint | None = None,
    felt: SpecificForceLevels | None = None,
    ends: EndSpeeds = AT_REST,
) -> Trajectory:
    """Time a curve as fast as the limits allow; arguments and errors as in `retime`."""
    _check_limits(limits, joints)
    for name, size in (("start_speed", ends.start), ("end_speed", ends.end)):
        not_negative(name, size, "a finite speed of at least 0 rad/s")
        if size and inverse_dynamics is not None:
            raise SettingError(name, size, "0 with torque limits: toppra times from rest to rest")
    if inverse_dynamics is not None:
        if restraint is not None or felt is not None:
            raise SettingError("restraint", restraint, "None with torque limits: toppra does not get it")
        return slowed(_refined_with_torque(curve, limits, joints, inverse_dynamics), 1.0 / speed)
    velocity, acceleration = np.asarray(limits.velocity, float), np.asarray(limits.acceleration, float)
    for density in (1, 2, _FINEST):
        grid = curve.grid(density)
        limit = None if restraint is None else np.ascontiguousarray(restraint(grid))
        try:
            found = fastest(
                grid,
                velocity,
                acceleration,
                limit=limit,
                felt=felt,
                speed=speed,
                ends=ends,
            )
        except RetimingError:
            if ends == AT_REST or density == _FINEST:
                raise
            continue  # on a finer grid, a motion with a given speed at an end needs less room below the limits
        if found.excess <= ACCEPTED_SLOWDOWN:
            break
    return Trajectory(found.t, found.q, found.qd, found.qdd, joints)


def slowed(trajectory: Trajectory, factor: float) -> Trajectory:
    """Stretch the time of a trajectory by `factor`; positions are unchanged."""
    return Trajectory(
        trajectory.t * factor,
        trajectory.q,
        trajectory.qd / factor,
        trajectory.qdd / factor**2,
        trajectory.joints,
    )


def _check_corners(path: Path, deviation: float | Float[Array, " corner"]) -> None:
    corners = max(0, len(merge_near_vertices(path)) - 2)
    if np.ndim(deviation) and np.shape(deviation) != (corners,):
        raise ShapeError("deviation", np.shape(deviation), f"({corners},), the inner vertices of the path")


def _check_limits(limits: Limits, joints: tuple[str, ...]) -> None:
    for name in ("velocity", "acceleration"):
        value = real_array(f"limits.{name}", getattr(limits, name))
        if value.shape != (len(joints),):
            raise ShapeError(f"limits.{name}", value.shape, f"({len(joints)},)")
        bad = np.flatnonzero(~((value > 0.0) & (np.isfinite(value) | (name == "velocity"))))
        if len(bad):
            raise RetimingError(f"the {name} limit of joint {joints[bad[0]]!r} is {value[bad[0]]}, it must be > 0")


def _refined_with_torque(
    curve: Curve, limits: Limits, joints: tuple[str, ...], inverse_dynamics: InverseDynamics
) -> Trajectory:
    """Time a curve with torque limits, refining the grid until torques hardly exceed a limit between grid points."""
    velocity, acceleration, torque = (
        np.asarray(x, float) for x in (limits.velocity, limits.acceleration, limits.torque)
    )
    for density in (1, 2, _FINEST):
        grid = curve.grid(density)
        _check_holdable(grid, torque, joints, inverse_dynamics)
        speeds = fastest_with_toppra(grid, velocity, acceleration, torque, inverse_dynamics)
        found = travelled(grid, speeds, velocity, acceleration)
        trajectory = Trajectory(found.t, found.q, found.qd, found.qdd, joints)
        factor = max(found.excess, _torque_slowdown(trajectory, torque, inverse_dynamics))
        if factor <= ACCEPTED_SLOWDOWN:
            break
    return slowed(trajectory, factor * (1.0 + _ROUNDING))


def slowdown(trajectory: Trajectory, limits: Limits) -> float:
    """Return the least factor >= 1 to stretch time by so that the cubics between samples meet all limits."""
    return _native.excess(
        t=trajectory.t,
        q=trajectory.q,
        qd=trajectory.qd,
        qdd=trajectory.qdd,
        velocity=np.ascontiguousarray(limits.velocity, dtype=np.float64),
        acceleration=np.ascontiguousarray(limits.acceleration, dtype=np.float64),
    )


def _torque_slowdown(trajectory: Trajectory, torque: Float[Array, " nq"], inverse_dynamics: InverseDynamics) -> float:
    """Return the time stretch that meets torque limits: all but gravity scales with 1/stretch^2."""
    a0, a1 = trajectory.piece_accelerations
    rest = np.zeros(len(torque))
    worst = 1.0
    for i in range(len(a0)):
        for k, qdd in ((i, a0[i]), (i + 1, a1[i])):
            q, qd = trajectory.q[k], trajectory.qd[k]
            hold = inverse_dynamics(q, rest, rest)
            motion = inverse_dynamics(q, qd, qdd) - hold
            room = np.where(motion > 0.0, torque - hold, torque + hold)
            worst = max(worst, float((np.abs(motion) / np.maximum(room, 1e-12)).max()))
    return float(np.sqrt(worst))


def _check_holdable(
    grid: CurveGrid, torque: Float[Array, " nq"], joints: tuple[str, ...], inverse_dynamics: InverseDynamics
) -> None:
    rest = np.zeros(grid.q.shape[1])
    for q in grid.q:
        hold = np.abs(inverse_dynamics(q, rest, rest))
        worst = int(np.argmax(hold - torque))
        if hold[worst] >= torque[worst]:
            need = f"{hold[worst]:.3g} N m to hold still on the path"
            raise RetimingError(f"joint {joints[worst]!r} needs {need}, its limit is {torque[worst]:.3g}")
