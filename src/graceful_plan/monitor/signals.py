"""Signals that a monitor watches: deviations of readings from the motion, and statistics of them over short windows.

A signal is zero in a perfect robot. Three statistics show faults of different speed: its present size, its mean over
the last tenth of a second, and the change of this mean from that of the fifth of a second before. The change does not
respond to errors of a model, such as a wrong mass, which last.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, ShapeError, UnsupportedError
from graceful_plan.judge.torque_check import joint_torques
from graceful_plan.path import real_array
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

READINGS = ("speed", "torque", "opening")
"""Readings that a robot may have in addition to joint positions."""
STATISTICS = ("size", "mean", "change")
"""Statistics of each signal."""
_RECENT, _BEFORE = 0.1, 0.2
"""Windows of the mean, and of the mean before it, with which the change compares it [s]."""
_MODEL_STEP = 0.01
"""Time between states in which the expected torque is computed; in between it is interpolated [s]."""


class Reading(NamedTuple):
    """Readings of a robot at one time; NaN where a reading is missing."""

    t: float
    q: Float[Array, " nq"]
    speed: Float[Array, " nq"] | None
    torque: Float[Array, " nq"] | None
    opening: Float[Array, " 1"] | None

    @property
    def complete(self) -> bool:
        """Whether no reading is missing."""
        return all(bool(np.isfinite(part).all()) for part in self[1:] if part is not None)


class Signals:
    """Signals of one execution of a motion, sample by sample.

    Args:
        trajectory: The executed motion.
        scene: Robot and carried object.
        readings: Readings that the robot has in addition to joint positions, of `READINGS`.
    """

    def __init__(self, trajectory: Trajectory, scene: Scene, readings: tuple[str, ...]) -> None:
        self._trajectory = trajectory
        self.readings = readings
        self.sizes = signal_sizes(readings, len(trajectory.joints))
        self._torque = _expected_torque(trajectory, scene) if "torque" in readings else None
        self._opening: Float[Array, " 1"] | None = None
        self._last: Reading | None = None
        self.history: deque[tuple[float, Array]] = deque()
        """Times and signals of the last samples, oldest first."""

    def add(self, reading: Reading) -> Float[Array, "statistic signal"]:
        """Return the statistics of all signals after a further complete sample."""
        now = self._signals(reading)
        history, t = self.history, reading.t
        history.append((t, now))
        while t - history[0][0] > _RECENT + _BEFORE:
            history.popleft()
        recent = [x for at, x in history if t - at <= _RECENT]
        before = [x for at, x in history if t - at > _RECENT]
        mean = np.mean(recent, axis=0)
        whole = t - history[0][0] > 0.5 * (_RECENT + _BEFORE)
        change = mean - np.mean(before, axis=0) if before and whole else np.zeros_like(mean)
        whole_mean = mean if before else np.zeros_like(mean)
        self._last = reading
        return np.abs(np.stack([now, whole_mean, change]))

    def _signals(self, reading: Reading) -> Float[Array, " signal"]:
        t, q, speed, torque, opening = reading
        ideal = self._trajectory.at(min(max(t, float(self._trajectory.t[0])), float(self._trajectory.t[-1])))
        parts = [q - ideal.q]
        if speed is not None:
            last = self._last
            step = np.zeros_like(q)
            if last is not None and last.speed is not None:
                step = q - last.q - 0.5 * (t - last.t) * (speed + last.speed)
            parts += [speed - ideal.qd, step]
        if torque is not None and self._torque is not None:
            parts.append(torque - self._torque(t))
        if opening is not None:
            self._opening = opening if self._opening is None else self._opening
            parts.append(opening - self._opening)
        return np.concatenate(parts)


def signal_sizes(readings: tuple[str, ...], nq: int) -> dict[str, int]:
    """Return the signals and the number of values in each, in their order.

    "position", "speed" and "torque" are readings minus the motion's. "consistency" is the change of the position
    readings from one sample to the next, minus the integral of the speed readings. "opening" is the opening of the
    gripper minus that at the first sample.
    """
    sizes = {"position": nq}
    if "speed" in readings:
        sizes |= {"speed": nq, "consistency": nq}
    if "torque" in readings:
        sizes["torque"] = nq
    if "opening" in readings:
        sizes["opening"] = 1
    return sizes


def checked_motion(trajectory: object, scene: Scene) -> Trajectory:
    """Return a motion of the scene's joints.

    Raises:
        SettingError: If it is no trajectory, or has other joints than the scene.
        UnsupportedError: If the scene's robot drives.
    """
    if not isinstance(trajectory, Trajectory):
        raise SettingError("trajectory", trajectory, "a Trajectory")
    if scene.base is not None:
        raise UnsupportedError("a monitor watches arms; this robot drives")
    if trajectory.joints != scene.joints:
        raise SettingError("joints of the trajectory", trajectory.joints, f"those of the scene: {scene.joints}")
    return trajectory


def reading_rows(name: str, value: object, size: int) -> Float[Array, " n"]:
    """Return one sample of a reading, with NaN where a value is missing.

    Raises:
        ShapeError: If it has another shape.
    """
    found = np.full(size, np.nan) if value is None else real_array(name, value)
    if found.shape != (size,):
        raise ShapeError(name, found.shape, f"({size},)")
    return found


def _expected_torque(trajectory: Trajectory, scene: Scene) -> Callable[[float], Float[Array, " nq"]]:
    """Return a function from time [s] to the joint torques that the motion needs [N m or N]."""
    count = max(2, int(np.ceil(trajectory.duration / _MODEL_STEP)) + 1)
    times = np.linspace(trajectory.t[0], trajectory.t[-1], count)
    state = trajectory.at(times)
    state.qd[-1] = state.qdd[-1] = 0.0
    table = joint_torques(state.q, state.qd, state.qdd, scene)
    start, step = float(times[0]), float(times[1] - times[0])

    def at(t: float) -> Float[Array, " nq"]:
        place = min(max((t - start) / step, 0.0), count - 1.000001) if step > 0.0 else 0.0
        row = int(place)
        return table[row] + (place - row) * (table[row + 1] - table[row])

    return at
