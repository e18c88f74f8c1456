"""Checks of positions, velocities and accelerations against the limits of joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.judge.motion_samples import MotionSamples
from graceful_plan.path import Path
from graceful_plan.result import Check
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

LIMIT_TOLERANCE = 1e-6
"""Tolerance: absolute for positions and end points [rad or m], relative for velocities and accelerations."""
_ROUNDINGS = 32.0
"""Rounding error of a piece's acceleration times the square of its duration, in roundings of positions."""


def position_check(samples: MotionSamples, motion: Path | Trajectory, scene: Scene, start_tolerance: float) -> Check:
    """Check positions between samples, too; the start may be outside of a limit by a tolerance."""
    lower, upper = scene.limits.position.T
    # Hinges without limits are planned within a few turns, but may turn on.
    lower, upper = np.where(scene.endless, -np.inf, lower), np.where(scene.endless, np.inf, upper)
    if start_tolerance > 0.0:
        outside = np.maximum(lower - motion.q[0], motion.q[0] - upper) <= start_tolerance
        lower = np.where(outside, np.minimum(lower, motion.q[0]), lower)
        upper = np.where(outside, np.maximum(upper, motion.q[0]), upper)
    if isinstance(motion, Trajectory):
        q, at = _turning_points(motion)
    else:
        q, at = motion.q, np.append(0.0, np.cumsum(motion.segment_lengths))
    excess = np.maximum(lower - q, q - upper)
    if excess.max() > LIMIT_TOLERANCE:
        # The samples for collisions are dense and show when the violation begins.
        beyond = np.maximum(lower - samples.q, samples.q - upper)
        excess, at = np.concatenate([excess, beyond]), np.append(np.full(len(q), np.nan), samples.at)
    check = _limit_check(excess, at, scene.joints, LIMIT_TOLERANCE, "beyond its position limit [rad or m]")
    if check.worst > 0.0:
        return check
    nearest = scene.joints[int(np.argmax(excess)) % excess.shape[1]]
    return replace(check, detail=f"joint {nearest!r}: {-check.worst:.6g} inside its position limit [rad or m]")


def dynamics_checks(
    trajectory: Trajectory, scene: Scene, leaving: Float[Array, " nq"], arriving: Float[Array, " nq"]
) -> dict[str, Check]:
    """Check the samples and the extremes of the cubics between them, and the velocities at both ends [rad/s or m/s]."""
    velocity, acceleration = scene.limits.velocity, scene.limits.acceleration
    h = np.diff(trajectory.t)[:, None]
    v0, v1 = trajectory.qd[:-1], trajectory.qd[1:]
    mean_velocity, mean_acceleration = np.diff(trajectory.q, axis=0) / h, np.diff(trajectory.qd, axis=0) / h
    # The largest deviation of q from the mean is h^2 a / 4: from rest to rest with full acceleration in between.
    stray = (mean_velocity - 0.5 * (v0 + v1)) / h / (0.25 * acceleration)
    a0, a1 = trajectory.piece_accelerations
    # On short pieces, rounding of positions dominates the accelerations; its bound is subtracted.
    largest = np.abs(trajectory.q).max(axis=0, initial=1.0)
    rounding = _ROUNDINGS * np.finfo(float).eps * largest / h**2
    steepest = np.maximum(np.maximum(np.abs(a0), np.abs(a1)) - rounding, np.abs(mean_acceleration))
    t, pieces = trajectory.t, trajectory.t[:-1]
    both = np.concatenate([t, pieces])
    most = 1.0 + LIMIT_TOLERANCE
    steps = np.abs(np.stack([trajectory.qd[0] - leaving, trajectory.qd[-1] - arriving]))

    def of(samples: Array, between: Array, limit: Array, words: str) -> Check:
        values = np.abs(np.concatenate([samples, between])) / limit
        return _limit_check(values, both, scene.joints, most, words)

    return {
        "velocity_limits": of(trajectory.qd, _fastest_between(trajectory), velocity, "of its velocity limit"),
        "acceleration_limits": of(trajectory.qdd, steepest, acceleration, "of its acceleration limit"),
        "consistency": _limit_check(
            np.abs(stray), pieces, scene.joints, most, "of the allowed deviation of positions from velocities"
        ),
        "rest": _limit_check(
            steps, t[[0, -1]], scene.joints, LIMIT_TOLERANCE, "step of the velocity [rad/s or m/s] at an end"
        ),
    }


def _turning_points(trajectory: Trajectory) -> tuple[Float[Array, "n nq"], Float[Array, " n"]]:
    """Return the samples and the turning points of joints between them, with times [s]; they bound all positions.

    A row of turning points holds one of each joint, at its own time; the time of the row is that of the piece.
    """
    if len(trajectory) == 1:
        return trajectory.q, trajectory.t
    h = np.diff(trajectory.t)[:, None]
    a0, a1 = trajectory.piece_accelerations
    v0, jerk = trajectory.qd[:-1], (a1 - a0) / h
    # The roots of v0 + a0 u + jerk u^2 / 2, in the form without cancellation.
    sum_ = -(a0 + np.copysign(np.sqrt(np.maximum(a0**2 - 2.0 * jerk * v0, 0.0)), a0))
    turning = []
    for above, below in ((sum_, jerk), (2.0 * v0, sum_)):
        u = np.divide(above, below, out=np.zeros_like(above), where=below != 0.0)
        u = np.minimum(np.maximum(u, 0.0), h)
        turning.append(trajectory.q[:-1] + u * (v0 + u * (a0 / 2.0 + u * jerk / 6.0)))
    return np.concatenate([trajectory.q, *turning]), np.concatenate([trajectory.t, *[trajectory.t[:-1]] * 2])


def _fastest_between(trajectory: Trajectory) -> Float[Array, "piece nq"]:
    """Return the velocities of the cubics where their accelerations change sign; elsewhere those at the beginning."""
    h = np.diff(trajectory.t)[:, None]
    a0, a1 = trajectory.piece_accelerations
    at = np.where(a0 * a1 < 0.0, -a0 * h / np.where(a1 == a0, 1.0, a1 - a0), 0.0)
    return trajectory.qd[:-1] + 0.5 * a0 * at


def _limit_check(
    values: Float[Array, "n nq"], at: Float[Array, " n"], joints: tuple[str, ...], limit: float, words: str
) -> Check:
    """Check that no value exceeds a limit; rows have times, columns are joints."""
    if len(values) == 0:
        return Check(passed=True, worst=0.0, limit=limit, detail=words)
    row, column = divmod(int(np.argmax(values)), values.shape[1])
    worst, first = float(values[row, column]), None
    if not worst <= limit:
        bad = at[(values > limit).any(axis=1)]
        bad = bad[np.isfinite(bad)]
        first = float(bad.min()) if len(bad) else None
    detail = f"joint {joints[column]!r}: {worst:.6g} {words}"
    return Check(passed=worst <= limit, worst=worst, limit=limit, first=first, detail=detail)
