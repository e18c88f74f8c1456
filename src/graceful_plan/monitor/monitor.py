"""Monitor of a motion: it compares a robot's readings with the motion and with limits from healthy runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.monitor.limits import MonitorLimits
from graceful_plan.monitor.signals import STATISTICS, Reading, Signals, checked_motion, reading_rows
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.setting_checks import finite
from graceful_plan.timing.trajectory import Trajectory

MISSING = "missing"
"""Kind of the notice of samples that are missing, incomplete or older than earlier ones."""


@dataclass(frozen=True, kw_only=True)
class Notice:
    """A deviation that a healthy robot shows too seldom.

    Args:
        kind: The signal: "position", "speed", "torque", "consistency" of positions and speeds, "opening" of the
            gripper; or "missing" samples.
        where: Name of the joint, "gripper" or "samples".
        statistic: "size", "mean" or "change" of the signal; "gap" for missing samples.
        time: Time of the alarm, on the clock of the motion [s].
        since: Time since which the signal is unusual, not earlier than 0.3 s before the alarm [s].
        value: Value of the statistic, in the unit of the signal; seconds for missing samples.
        limit: Its limit.
    """

    kind: str
    where: str
    statistic: str
    time: float
    since: float
    value: float
    limit: float

    def __str__(self) -> str:
        return (
            f"{self.kind} of {self.where} since {self.since:.3f} s: {self.statistic} {self.value:.3g}, "
            f"limit {self.limit:.3g} (noticed at {self.time:.3f} s)"
        )


class Monitor:
    """Watches one execution of a motion. Call `update` with each sample of the robot.

    An update takes about 0.1 ms. Not thread-safe.

    Args:
        trajectory: The executed motion.
        scene: Robot and carried object; torques are compared with those of its model.
        limits: Limits from healthy runs of the same robot, see `MonitorLimits.fit`.

    Raises:
        SettingError: If the motion or the limits have other joints than the scene.
        UnsupportedError: If the scene's robot drives.
    """

    def __init__(self, trajectory: Trajectory, scene: Scene, limits: MonitorLimits) -> None:
        if not isinstance(limits, MonitorLimits):
            raise SettingError("limits", limits, "MonitorLimits, made by MonitorLimits.fit")
        trajectory = checked_motion(trajectory, checked_scene(scene))
        if limits.joints != trajectory.joints:
            raise SettingError("joints of the limits", limits.joints, f"those of the scene: {trajectory.joints}")
        self.limits = limits
        self.notice: Notice | None = None
        """The first notice; None before."""
        self._joints = trajectory.joints
        self._signals = Signals(trajectory, scene, limits.readings)
        self._limit, self._usual = (np.hstack(list(part.values())) for part in (limits.limit, limits.usual))
        self._complete: float | None = None
        """Time of the last complete sample [s]."""

    def update(
        self,
        t: float,
        q: ArrayLike | None,
        qd: ArrayLike | None = None,
        torque: ArrayLike | None = None,
        opening: float | None = None,
    ) -> Notice | None:
        """Compare a sample with the motion. After a notice, all later calls return the same one.

        None and NaN stand for readings that are missing, and a sample with a time before that of the last one for a
        sample that came too late. These raise an alarm once the limits' `gap` has passed without a complete sample.

        Args:
            t: Time of the sample, on the clock of the motion [s]. Call with `q=None` if there is no sample.
            q: Positions of the joints [rad or m].
            qd: Their speeds [rad/s or m/s]. This and further readings are ignored if the limits do not have them.
            torque: Torques of the drives [N m or N].
            opening: Opening of the gripper, in the unit of the healthy runs.

        Raises:
            ShapeError: If a reading does not have a value for each joint.
            SettingError: If `t` is not a finite number.
        """
        finite("t", t, "a finite time [s]")
        reading = self._reading(float(t), q, qd, torque, opening)
        if self.notice is not None:
            return self.notice
        if self._complete is None:
            self._complete = reading.t
        wait = reading.t - self._complete
        if wait > self.limits.gap:
            self.notice = Notice(
                kind=MISSING,
                where="samples",
                statistic="gap",
                time=reading.t,
                since=self._complete,
                value=wait,
                limit=self.limits.gap,
            )
        elif reading.complete and (wait > 0.0 or not self._signals.history):
            self._complete = reading.t
            self.notice = self._judged(self._signals.add(reading), reading.t)
        return self.notice

    def _reading(
        self, t: float, q: ArrayLike | None, qd: ArrayLike | None, torque: ArrayLike | None, opening: float | None
    ) -> Reading:
        nq, needed = len(self._joints), self.limits.readings
        speed = reading_rows("qd", qd, nq) if "speed" in needed else None
        force = reading_rows("torque", torque, nq) if "torque" in needed else None
        width = reading_rows("opening", None if opening is None else [opening], 1) if "opening" in needed else None
        return Reading(t, reading_rows("q", q, nq), speed, force, width)

    def _judged(self, values: Float[Array, "statistic signal"], t: float) -> Notice | None:
        """Return a notice of the statistic that exceeds its limit the most; None if none does."""
        excess = values / self._limit
        row, column = (int(i) for i in np.unravel_index(int(np.argmax(excess)), excess.shape))
        if not excess[row, column] > 1.0:
            return None
        kind, joint = self._place(column)
        return Notice(
            kind=kind,
            where="gripper" if kind == "opening" else self._joints[joint],
            statistic=STATISTICS[row],
            time=t,
            since=self._since(column),
            value=float(values[row, column]),
            limit=float(self._limit[row, column]),
        )

    def _place(self, column: int) -> tuple[str, int]:
        """Return the signal and the joint of a column."""
        for kind, size in self._signals.sizes.items():
            if column < size:
                return kind, column
            column -= size
        raise AssertionError(column)

    def _since(self, column: int) -> float:
        """Return the time since which a signal has been unusually large without a break [s]."""
        since = self._signals.history[-1][0]
        for at, values in reversed(self._signals.history):
            if abs(values[column]) <= self._usual[0, column]:
                break
            since = at
        return since
