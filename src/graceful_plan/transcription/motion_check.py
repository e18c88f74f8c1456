"""Check of a trajectory against its limits, and the least slowdown that satisfies them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.elements import Limits
from graceful_plan.timing.retiming import slowdown
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.transcription.symbolic import SymbolicRobot

TOLERANCE = 1e-6
"""Tolerance of limits: absolute on positions [rad or m], relative on everything else."""
_FRACTIONS = np.linspace(0.0, 1.0, 5)
"""Fractions of each piece at which torques and positions are checked."""
_JUMP = 1e-4
"""Jump of the acceleration, relative to its limit, that violates continuity; checked only with a jerk limit."""


@final
@dataclass(frozen=True, kw_only=True)
class Violation:
    """A violated limit, at its worst moment."""

    limit: str
    """"position", "velocity", "acceleration", "jerk", "torque", "clearance", "duration", or a check of `verify`."""
    joint: str = ""
    """Name of the joint; empty if the limit is not about a joint."""
    time: float | None = None
    """Time of the worst violation [s]; None if the limit has no moment."""
    value: float
    """Value reached, in the unit of the limit."""
    bound: float
    """Value allowed."""

    def __str__(self) -> str:
        where = f" of {self.joint}" if self.joint else ""
        when = "" if self.time is None else f" at {self.time:.3f} s"
        return f"{self.limit}{where}{when}: {self.value:.4g}, allowed {self.bound:.4g}"


@final
@dataclass(frozen=True, eq=False)
class _Loads:
    """Values of one kind with their bounds: a row per time, a column per joint."""

    limit: str
    at: Float[Array, " n"]
    value: Float[Array, "n nq"]
    bound: Float[Array, " nq"]

    def worst(self, joints: tuple[str, ...]) -> Violation | None:
        """Return the violation with the largest value relative to its bound; None if all are within bounds."""
        share = np.abs(self.value) / self.bound
        if not share.size or share.max() <= 1.0 + TOLERANCE:
            return None
        row, column = (int(i) for i in np.unravel_index(int(np.argmax(share)), share.shape))
        return Violation(
            limit=self.limit,
            joint=joints[column],
            time=float(self.at[row]),
            value=float(self.value[row, column]),
            bound=float(self.bound[column]),
        )


def violations(
    trajectory: Trajectory,
    limits: Limits,
    *,
    jerk: Float[Array, " nq"] | None = None,
    robot: SymbolicRobot | None = None,
    duration: float = np.inf,
) -> tuple[Violation, ...]:
    """Return every limit that a trajectory violates, each at its worst moment.

    Args:
        trajectory: The trajectory.
        limits: Limits of position, velocity, acceleration and, with a robot, torque.
        jerk: Limit of the jerk [rad/s^3]; None for no limit.
        robot: Robot for the torque check; None to skip it.
        duration: Longest duration [s].
    """
    found: list[Violation | None] = [_beyond_position(trajectory, limits)]
    if len(trajectory) > 1:
        found += [loads.worst(trajectory.joints) for loads in _loads(trajectory, limits, jerk, robot)]
    if trajectory.duration > duration * (1.0 + TOLERANCE):
        found.append(Violation(limit="duration", value=trajectory.duration, bound=duration))
    return tuple(violation for violation in found if violation is not None)


def within_limits(
    trajectory: Trajectory, limits: Limits, jerk: Float[Array, " nq"] | None, robot: SymbolicRobot | None
) -> Trajectory:
    """Slow a motion down just enough to meet its limits of velocity, acceleration, jerk and torque."""
    if len(trajectory) < 2:
        return trajectory
    factor = slowdown(trajectory, limits)
    if jerk is not None:
        factor = max(factor, float(np.abs(_jerks(trajectory) / jerk).max()) ** (1.0 / 3.0))
    if robot is not None:
        factor = max(factor, _slower_for_torque(trajectory, np.asarray(limits.torque), robot))
    if factor <= 1.0:
        return trajectory
    factor *= 1.0 + 1e-9  # covers rounding in other programs
    return replace(trajectory, t=trajectory.t * factor, qd=trajectory.qd / factor, qdd=trajectory.qdd / factor**2)


def _beyond_position(trajectory: Trajectory, limits: Limits) -> Violation | None:
    at = _moments(trajectory)
    q = trajectory.at(at).q
    lower, upper = limits.position.T
    excess = np.maximum(lower - q, q - upper)
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(excess)), excess.shape))
    if excess[row, column] <= TOLERANCE:
        return None
    value = float(q[row, column])
    bound = float(lower[column] if value < lower[column] else upper[column])
    return Violation(limit="position", joint=trajectory.joints[column], time=float(at[row]), value=value, bound=bound)


def _moments(trajectory: Trajectory) -> Float[Array, " n"]:
    if len(trajectory) < 2:
        return trajectory.t
    steps = np.diff(trajectory.t)[:, None] * _FRACTIONS[:-1]
    return np.append((trajectory.t[:-1, None] + steps).ravel(), trajectory.t[-1])


def _loads(
    trajectory: Trajectory, limits: Limits, jerk: Float[Array, " nq"] | None, robot: SymbolicRobot | None
) -> list[_Loads]:
    a0, a1 = trajectory.piece_accelerations
    h, t = np.diff(trajectory.t)[:, None], trajectory.t
    # Within a piece the velocity peaks where the linear acceleration changes sign.
    crossing = np.where(a0 * a1 < 0.0, a0 / np.where(a0 == a1, 1.0, a0 - a1), 0.0) * h
    peak = trajectory.qd[:-1] + 0.5 * a0 * crossing
    found = [
        _Loads("velocity", np.append(t, t[:-1]), np.concatenate([trajectory.qd, peak]), limits.velocity),
        _Loads("acceleration", np.append(t[:-1], t[1:]), np.concatenate([a0, a1]), limits.acceleration),
    ]
    if jerk is not None:
        jump = np.concatenate([a0[:1], a0[1:] - a1[:-1], -a1[-1:]])
        found.append(_Loads("jerk", t[:-1], _jerks(trajectory), jerk))
        found.append(_Loads("acceleration continuity", t, jump, _JUMP * limits.acceleration))
    if robot is not None:
        at, states = _piecewise(trajectory)
        found.append(_Loads("torque", at, robot.torques(*states), np.asarray(limits.torque)))
    return found


def _jerks(trajectory: Trajectory) -> Float[Array, "piece nq"]:
    a0, a1 = trajectory.piece_accelerations
    return (a1 - a0) / np.diff(trajectory.t)[:, None]


def _piecewise(trajectory: Trajectory) -> tuple[Float[Array, " n"], tuple[Array, Array, Array]]:
    """Return times and states on every piece, both ends included because accelerations may jump between pieces."""
    a0, a1 = trajectory.piece_accelerations
    h = np.diff(trajectory.t)
    u = _FRACTIONS[:, None]
    at = (trajectory.t[:-1, None] + h[:, None] * _FRACTIONS).ravel()
    state = trajectory.at(at)
    qdd = a0[:, None] * (1.0 - u) + a1[:, None] * u
    return at, (state.q, state.qd, qdd.reshape(state.q.shape))


def _slower_for_torque(trajectory: Trajectory, limit: Float[Array, " nq"], robot: SymbolicRobot) -> float:
    """Return the slowdown that meets the torque limits: all but gravity and damping scales with its inverse square."""
    q, qd, qdd = _piecewise(trajectory)[1]
    hold = robot.torques(q, np.zeros_like(q), np.zeros_like(q))
    motion = robot.torques(q, qd, qdd) - hold
    room = np.where(motion > 0.0, limit - hold, limit + hold)
    over = np.abs(motion) > room * (1.0 + 0.1 * TOLERANCE)
    if not over.any() or np.any(room[over] <= 0.0):  # slowing down does not help if holding still needs more
        return 1.0
    return float(np.sqrt((np.abs(motion[over]) / room[over]).max()))
