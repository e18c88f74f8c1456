"""Timing: from a path to the fastest trajectory that keeps the limits of velocity, acceleration and torque.

Corners of the path are rounded first (`blend`), then the curve is timed (`topp`), then the result is checked again and,
where sampling let it exceed a limit by a little, slowed down evenly until it does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import RetimingError, SettingError, ShapeError
from graceful_plan.path import Path, real_array
from graceful_plan.scene.elements import Limits
from graceful_plan.timing.blend import Curve, CurveGrid, Polyline, merge_near_vertices, rounded
from graceful_plan.timing.topp import InverseDynamics, Restraint, fastest, fastest_with_toppra
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_LONGEST = 1e6
"""Path that is timed [rad or m]: beyond, the pieces of a grid are lost in rounding."""
_ROUNDING = 1e-9
"""Relative reserve below the limits, for what rounding adds when somebody else evaluates the trajectory."""
SHORTEST_PIECE = 1e-5
"""Pieces of a motion are merged where they would be shorter [s]: no controller can tell their ends apart."""
ACCEPTED_SLOWDOWN = 1.02
"""The grid is refined while checking against the limits would slow the motion down by more than this."""


def retime(
    path: Path,
    limits: Limits,
    joints: tuple[str, ...] | None = None,
    *,
    deviation: float | Float[Array, " corner"] = 0.05,
    speed: float = 1.0,
    inverse_dynamics: InverseDynamics | None = None,
    restraint: Restraint | None = None,
) -> Trajectory:
    """Time a path as fast as the limits allow, from rest to rest.

    Args:
        path: Polyline in configuration space; start and end are kept exactly.
        limits: Velocity and acceleration limits; torque limits too if `inverse_dynamics` is given.
        joints: Names of the joints; "0", "1"... if None.
        deviation: How far the motion may cut a corner of the path [rad, Euclidean], the same everywhere or one for each
            inner vertex. With 0 it follows the polyline exactly and stops at the corner.
        speed: In (0, 1]: velocities are scaled by it, accelerations by its square.
        inverse_dynamics: Joint torques of (q, qd, qdd), to keep torque limits too.
        restraint: Further limits on path acceleration and speed, such as those of a full cup.

    Returns:
        A trajectory that keeps the limits at every time, not only at its samples. A path without length gives a single
        sample.

    Raises:
        RetimingError: If the limits cannot be kept.
        ShapeError: If path, limits and joints are of different sizes.
        SettingError: If a setting is outside of its range.
    """
    nq = path.q.shape[1]
    joints = tuple(str(i) for i in range(nq)) if joints is None else tuple(joints)
    if len(joints) != nq:
        raise ShapeError("path", path.q.shape, f"(n, {len(joints)} joints)")
    if not 0.0 < speed <= 1.0:
        raise SettingError("speed", speed, "0 < speed <= 1")
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
    )


def timed(
    curve: Curve,
    limits: Limits,
    joints: tuple[str, ...],
    *,
    speed: float = 1.0,
    inverse_dynamics: InverseDynamics | None = None,
    restraint: Restraint | None = None,
) -> Trajectory:
    """Travel a curve as fast as the limits allow, from rest to rest; otherwise as `retime`."""
    _check_limits(limits, joints)
    robot = _Robot(limits, joints, inverse_dynamics, None if restraint is None else _at_speed(restraint, speed))
    return slowed(_refined(curve, robot), 1.0 / speed)


def _at_speed(restraint: Restraint, speed: float) -> Restraint:
    """Return what a restraint says of a motion that is slowed down afterwards."""

    def limits(grid: CurveGrid) -> Float[Array, "interval limit 3"]:
        return restraint(grid) * np.array([1.0, 1.0, 1.0 / speed**2])

    return limits


def slowed(trajectory: Trajectory, factor: float) -> Trajectory:
    """Stretch the time of a trajectory by `factor`; positions stay."""
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
        value = np.asarray(getattr(limits, name))
        if value.shape != (len(joints),):
            raise ShapeError(f"limits.{name}", value.shape, f"({len(joints)},)")
        bad = np.flatnonzero(~((value > 0.0) & (np.isfinite(value) | (name == "velocity"))))
        if len(bad):
            raise RetimingError(f"the {name} limit of joint {joints[bad[0]]!r} is {value[bad[0]]}, it must be > 0")


@dataclass(frozen=True, eq=False)
class _Robot:
    """What a robot can do, as far as timing asks."""

    limits: Limits
    joints: tuple[str, ...]
    inverse_dynamics: InverseDynamics | None
    """Torque limits are kept only with these."""
    restraint: Restraint | None


def _refined(curve: Curve, robot: _Robot) -> Trajectory:
    """Time a curve on finer and finer grids until it hardly exceeds a limit between their points."""
    for density in (1, 2, 4):
        trajectory = without_short_pieces(_on_grid(curve.grid(density), robot))
        factor = slowdown(trajectory, robot.limits, robot.inverse_dynamics)
        if factor <= ACCEPTED_SLOWDOWN:
            break
    return slowed(trajectory, factor * (1.0 + _ROUNDING))


def _on_grid(grid: CurveGrid, robot: _Robot) -> Trajectory:
    limits, torques = robot.limits, robot.inverse_dynamics
    if torques is not None and robot.restraint is not None:
        raise SettingError("restraint", robot.restraint, "None where torque limits are kept: toppra is not told of it")
    velocity, acceleration = np.asarray(limits.velocity, float), np.asarray(limits.acceleration, float)
    if torques is None:
        speeds = fastest(grid, velocity, acceleration, None if robot.restraint is None else robot.restraint(grid))
    else:
        _check_holdable(grid, np.asarray(limits.torque, float), robot.joints, torques)
        speeds = fastest_with_toppra(grid, velocity, acceleration, np.asarray(limits.torque, float), torques)
    return _trajectory(grid, speeds, robot.joints)


def _trajectory(grid: CurveGrid, speeds: Float[Array, " point"], joints: tuple[str, ...]) -> Trajectory:
    """Integrate path speeds to times, with constant path acceleration on each interval."""
    mean = 0.5 * (speeds[:-1] + speeds[1:])
    if not np.all(mean > 0.0):
        raise RetimingError(f"the motion comes to a halt {grid.s[int(np.argmin(mean))]:.3g} rad along the path")
    step = np.diff(grid.s)
    push = 0.5 * np.diff(speeds**2) / step
    qd = np.concatenate([grid.slope[:, 0], grid.slope[-1:, 1]]) * speeds[:, None]
    qdd = grid.slope[:, 0] * push[:, None] + grid.bend[:, 0] * speeds[:-1, None] ** 2
    last = grid.slope[-1] * push[-1] + grid.bend[-1] * speeds[-1] ** 2
    t = np.concatenate([[0.0], np.cumsum(step / mean)])
    return Trajectory(t, grid.q, qd, np.concatenate([qdd, last[1:]]), joints)


def without_short_pieces(trajectory: Trajectory) -> Trajectory:
    """Drop samples that come sooner than `SHORTEST_PIECE` after the one before; where a motion rests they stay.

    Between the others the cubics hardly change, and limits are checked afterwards.
    """
    t = trajectory.t
    if np.diff(t).min(initial=np.inf) >= SHORTEST_PIECE:
        return trajectory
    stays = np.max(np.abs(trajectory.qd), axis=1) == 0.0
    stays[[0, -1]] = True
    kept: list[int] = []
    for i in range(len(t)):
        if not kept or stays[i] or t[i] - t[kept[-1]] >= SHORTEST_PIECE:
            while kept and not stays[kept[-1]] and t[i] - t[kept[-1]] < SHORTEST_PIECE:
                kept.pop()
            kept.append(i)
    return Trajectory(t[kept], trajectory.q[kept], trajectory.qd[kept], trajectory.qdd[kept], trajectory.joints)


def slowdown(trajectory: Trajectory, limits: Limits, inverse_dynamics: InverseDynamics | None) -> float:
    """By what factor, at least 1, to stretch the time so that the cubics between the samples keep all limits."""
    a0, a1 = trajectory.piece_accelerations
    acceleration = np.maximum(np.abs(a0), np.abs(a1))
    acceleration = np.maximum(acceleration, np.abs(trajectory.qdd[:-1]))
    factor = max(1.0, float(np.sqrt((acceleration / limits.acceleration).max())))
    # Within a piece the velocity peaks where the linear acceleration changes sign.
    crossing = np.where(a0 * a1 < 0.0, a0 / np.where(a0 == a1, 1.0, a0 - a1), 0.0) * np.diff(trajectory.t)[:, None]
    peak = np.maximum(np.abs(trajectory.qd[:-1] + 0.5 * a0 * crossing), np.abs(trajectory.qd[:-1]))
    factor = max(factor, float((peak / limits.velocity).max()))
    if inverse_dynamics is not None:
        factor = max(factor, _torque_slowdown(trajectory, np.asarray(limits.torque, float), inverse_dynamics))
    return factor


def _torque_slowdown(trajectory: Trajectory, torque: Float[Array, " nq"], inverse_dynamics: InverseDynamics) -> float:
    """Torque is gravity plus a part that shrinks with the square of the slowdown."""
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
