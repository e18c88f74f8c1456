"""A trajectory: a path with its timing. `formats` converts it from and to files and messages."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import SettingError, ShapeError, names_file
from graceful_plan.formats import csv_text, json_text, parquet_file, ros
from graceful_plan.formats.ros import Names
from graceful_plan.formats.samples import TimedSamples
from graceful_plan.path import MOST_POINTS, Path, finite_array, is_real
from graceful_plan.setting_checks import not_negative

_LATEST = 1e15
"""Largest time [s]: beyond it, the resolution of a double is worse than 0.1 s."""
_SHORTEST = 1e-9
"""Shortest piece before a splice [s]."""
REST = 1e-6
"""Largest speed of a joint that counts as at rest [rad/s or m/s]."""


_UNKNOWN = np.zeros(0)
_UNKNOWN.flags.writeable = False


class State(NamedTuple):
    r"""Position, velocity and acceleration of the joints at one or more times, in the order of the scene's joints.

    | field | meaning                                 | unit               | shape      |
    |-------|-----------------------------------------|--------------------|------------|
    | q     | positions                               | rad or m           | \\*time nq |
    | qd    | velocities                              | rad/s or m/s       | \\*time nq |
    | qdd   | accelerations; empty if unknown         | rad/s^2 or m/s^2   | \\*time nq |
    """

    q: Float[Array, "*time nq"]
    qd: Float[Array, "*time nq"]
    qdd: Float[Array, "*time nq"] = _UNKNOWN


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A timed motion of the joints: samples, interpolated by cubics that match q and qd at both ends of a piece.

    Positions and velocities are continuous everywhere; the acceleration is linear within a piece and may jump at a
    sample, where `qdd` holds the value just after it (at the last sample, just before it).

    Args:
        t: Sample times [s], strictly increasing.
        q: Joint positions [rad or m].
        qd: Joint velocities [rad/s or m/s].
        qdd: Joint accelerations [rad/s^2 or m/s^2].
        joints: Names of the joints, in the order of the columns.

    Raises:
        ShapeError: If the shapes of the arrays do not match.
        NonFiniteError: If a number is NaN or infinite.
        SettingError: If the times do not increase.
    """

    t: Float[Array, " time"]
    q: Float[Array, "time nq"]
    qd: Float[Array, "time nq"]
    qdd: Float[Array, "time nq"]
    joints: tuple[str, ...]

    def __post_init__(self) -> None:
        t = finite_array("t", self.t, ndim=1)
        if len(t) == 0:
            raise ShapeError("t", t.shape, "(n >= 1,)")
        if np.abs(t[[0, -1]]).max() > _LATEST:
            raise SettingError("t", t[[0, -1]].tolist(), f"times within {_LATEST:g} s")
        backwards = np.flatnonzero(np.diff(t) <= 0.0)
        if len(backwards):
            i = int(backwards[0]) + 1
            raise SettingError(f"t[{i}]", float(t[i]), f"more than t[{i - 1}] = {t[i - 1]}: time must increase")
        object.__setattr__(self, "joints", tuple(self.joints))
        object.__setattr__(self, "t", _frozen(t))
        for name in ("q", "qd", "qdd"):
            value = finite_array(name, getattr(self, name), ndim=2)
            if value.shape != (len(t), len(self.joints)):
                raise ShapeError(name, value.shape, f"({len(t)} times, {len(self.joints)} joints)")
            object.__setattr__(self, name, _frozen(value))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return f"Trajectory({len(self)} samples, {self.duration:.4g} s, joints {', '.join(self.joints)})"

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @cached_property
    def path(self) -> Path:
        """The polyline through the samples."""
        return Path(self.q)

    def at(self, t: ArrayLike | float) -> State:
        """Evaluate at one or more times; before the first and after the last sample the robot is at rest.

        Args:
            t: Times on the clock of `self.t` [s].
        """
        if isinstance(t, float) and math.isfinite(t) and len(self) > 1:
            return self._at_one(t)
        times = finite_array("t", t)
        flat = np.clip(times.reshape(-1), self.t[0], self.t[-1])
        if len(self) == 1:
            parts = [np.repeat(x, len(flat), axis=0) for x in (self.q, self.qd, self.qdd)]
        else:
            parts = self._cubic(flat)
        outside = (times.reshape(-1) < self.t[0]) | (times.reshape(-1) > self.t[-1])
        parts[1][outside] = parts[2][outside] = 0.0
        return State(*(x.reshape(*times.shape, len(self.joints)) for x in parts))

    def _at_one(self, t: float) -> State:
        """Evaluate at one time, in a tenth of the time that arrays take: controllers call this in their loops."""
        times = self._times
        i = min(max(bisect.bisect_right(times, t) - 1, 0), len(times) - 2)
        u = min(max(t, times[0]), times[-1]) - times[i]
        state = np.array((1.0, u, u * u, u * u * u)).dot(self._powers[i]).reshape(3, -1)
        if not times[0] <= t <= times[-1]:
            state[1:] = 0.0
        return State(state[0], state[1], state[2])

    @cached_property
    def _powers(self) -> list[Float[Array, "4 state"]]:
        """Coefficients of q, qd and qdd side by side in each piece, by the power of the time since its start."""
        q, qd, half, sixth = self.q[:-1], self.qd[:-1], self.piece_accelerations[0] / 2.0, self._jerks / 6.0
        none = np.zeros_like(q)
        rows = [(q, qd, 2.0 * half), (qd, 2.0 * half, 6.0 * sixth), (half, 3.0 * sixth, none), (sixth, none, none)]
        return list(np.stack([np.concatenate(row, axis=1) for row in rows], axis=1))

    @cached_property
    def _times(self) -> list[float]:
        return self.t.tolist()

    @cached_property
    def _jerks(self) -> Float[Array, "piece nq"]:
        """Jerk of the interpolating cubic in each piece [rad/s^3]."""
        a0, a1 = self.piece_accelerations
        return (a1 - a0) / np.diff(self.t)[:, None]

    def positions(self, t: Float[Array, " n"]) -> Float[Array, "n nq"]:
        """Evaluate only the positions at finite times on the clock of `self.t` [rad or m]."""
        if len(self) == 1:
            return np.repeat(self.q, len(t), axis=0)
        i, u, v0, a0, jerk = self._pieces_at(np.clip(t, self.t[0], self.t[-1]))
        return self.q[i] + u * (v0 + u * (0.5 * a0 + u * (jerk / 6.0)))

    def at_places(self, place: Float[Array, " n"]) -> tuple[Float[Array, " n"], Float[Array, "n nq"]]:
        """Evaluate times [s] and positions [rad or m] at fractional piece numbers, from 0 to the number of pieces."""
        if len(self) == 1:  # at rest, no pieces
            return np.full(len(place), self.t[0]), np.repeat(self.q, len(place), axis=0)
        i = np.minimum(place.astype(np.intp), len(self) - 2)
        h = np.diff(self.t)
        u = (place - i) * h.take(i)
        a0, a1 = self.piece_accelerations
        q = ((a1 - a0) / (6.0 * h[:, None])).take(i, axis=0)
        # Horner's scheme, in place and by `take`, because thousands of samples of every motion are evaluated.
        column = u[:, None]
        for coefficient in (0.5 * a0, self.qd[:-1], self.q[:-1]):
            q *= column
            q += coefficient.take(i, axis=0)
        return self.t.take(i) + u, q

    def _cubic(self, t: Float[Array, " n"]) -> list[Float[Array, "n nq"]]:
        i, u, v0, a0, jerk = self._pieces_at(t)
        return [
            self.q[i] + u * (v0 + u * (a0 / 2.0 + u * jerk / 6.0)),
            v0 + u * (a0 + u * jerk / 2.0),
            a0 + u * jerk,
        ]

    def _pieces_at(self, t: Float[Array, " n"]) -> tuple[Int[Array, " n"], Array, Array, Array, Array]:
        """Return the piece at each time, the time since its start, and its initial velocity, acceleration and jerk."""
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self) - 2)
        return i, (t - self.t[i])[:, None], self.qd[i], self.piece_accelerations[0][i], self._jerks[i]

    @cached_property
    def piece_accelerations(self) -> tuple[Float[Array, "piece nq"], Float[Array, "piece nq"]]:
        """Acceleration of the interpolating cubic at the beginning and at the end of each piece [rad/s^2]."""
        h = np.diff(self.t)[:, None]
        mean = np.diff(self.q, axis=0) / h
        v0, v1 = self.qd[:-1], self.qd[1:]
        return (6.0 * mean - 4.0 * v0 - 2.0 * v1) / h, (-6.0 * mean + 2.0 * v0 + 4.0 * v1) / h

    def delayed(self, seconds: float) -> Trajectory:
        """Return the same motion with a wait at its start [s]; a motion that waits must start at rest.

        Raises:
            SettingError: If the wait is negative or not finite, or the motion does not start at rest.
        """
        not_negative("seconds", seconds, "a finite time of at least 0 s")
        if seconds == 0.0:
            return self
        if np.any(np.abs(self.qd[0]) > REST):
            raise SettingError("qd[0]", self.qd[0].tolist(), "rest: a moving robot cannot wait")
        t = np.append(self.t[0], self.t + seconds)
        q, qd, qdd = (x[np.maximum(np.arange(len(self) + 1) - 1, 0)] for x in (self.q, self.qd, self.qdd))
        qd[0] = qdd[0] = 0.0
        return Trajectory(t, q, qd, qdd, self.joints)

    def since(self, t: float) -> Trajectory:
        """Return the rest of the motion from a time on [s], on the same clock."""
        t = float(np.clip(t, self.t[0], self.t[-1]))
        times = np.append(t, self.t[self.t > t + _SHORTEST])
        return Trajectory(times, *self.at(times), self.joints)

    def reversed(self) -> Trajectory:
        """Return the motion backwards in time, from its end to its start, on a clock that begins at the same time."""
        t, qdd = self.t[0] + self.t[-1] - self.t[::-1], self.qdd
        if len(self) > 1:
            first, last = self.piece_accelerations
            qdd = np.concatenate([last[::-1], first[:1]])
        return Trajectory(t, self.q[::-1], -self.qd[::-1], qdd, self.joints)

    def later(self, seconds: float) -> Trajectory:
        """Return the same motion on a clock that is behind by a time [s]: it starts that much later."""
        return Trajectory(self.t + seconds, self.q, self.qd, self.qdd, self.joints)

    def spliced(self, after: Trajectory) -> Trajectory:
        """Return this motion up to the start of another one on the same clock, followed by that one.

        Args:
            after: Motion that begins with the position and velocity that this one has at that time.

        Raises:
            SettingError: If the joints differ, or position or velocity jump there.
        """
        if after.joints != self.joints:
            raise SettingError("after", after, f"a trajectory of the joints {', '.join(self.joints)}")
        begins = float(after.t[0])
        here = self.at(np.clip(begins, self.t[0], self.t[-1]))
        jump = max(float(np.abs(after.q[0] - here.q).max()), float(np.abs(after.qd[0] - here.qd).max()))
        if jump > REST:
            raise SettingError("after", after, f"a motion without a jump, here {jump:.3g}, at {begins:g} s")
        mine = self.t < begins - _SHORTEST
        t, q, qd, qdd = (np.concatenate([getattr(self, x)[mine], getattr(after, x)]) for x in ("t", "q", "qd", "qdd"))
        return Trajectory(t, q, qd, qdd, self.joints)

    def sample(self, dt: float) -> Trajectory:
        """Sample every `dt` [s]; the last sample is exactly the end, so the last piece may be shorter.

        The samples lie on this trajectory, but interpolating them again blurs jumps of the acceleration. Where it jumps
        from full acceleration to full braking within one step, the new cubic reaches up to 5/3 of the limit, which the
        judge reports. Keep the original where limits must hold between samples, or plan with a lower `speed`.
        """
        if not (is_real(dt) and 0.0 < dt < np.inf and self.duration <= MOST_POINTS * dt):
            raise SettingError("dt", dt, f"a finite time > 0 s that gives at most {MOST_POINTS} samples")
        # A remainder below a millionth of a step would make a piece too short to differentiate.
        steps = int(np.ceil(self.duration / dt - 1e-6))
        t = self.t[0] + np.append(dt * np.arange(steps), self.duration) if steps else self.t[:1]
        state = self.at(t)
        q, qd, qdd = (x.copy() for x in state)
        q[-1], qd[-1], qdd[-1] = self.q[-1], self.qd[-1], self.qdd[-1]
        return Trajectory(t, q, qd, qdd, self.joints)

    def to_json(self, file: str | FilePath | None = None) -> str:
        """Return the trajectory as JSON text with schema version and units; write it to `file` if one is given."""
        return _written(json_text.to_json(self._samples), file)

    @classmethod
    @names_file
    def from_json(cls, source: str | FilePath) -> Trajectory:
        """Read the output of `to_json`, from a file or from JSON text (a string that starts with a brace).

        Raises:
            FormatError: If the document has another format, version or unit.
            ShapeError: If the shapes of its arrays do not match.
            NonFiniteError: If a number is NaN or infinite.
            SettingError: If its times do not increase.
        """
        return cls(*json_text.from_json(source))

    def to_csv(self, file: str | FilePath | None = None) -> str:
        """Return the samples as CSV text, one row per time, with units in the header; write it to `file` if given."""
        return _written(csv_text.to_csv(self._samples), file)

    @classmethod
    @names_file
    def from_csv(cls, source: str | FilePath) -> Trajectory:
        """Read the output of `to_csv`, from a file or from CSV text (a string with a line break).

        Raises the errors of `from_json`.
        """
        return cls(*csv_text.from_csv(source))

    def to_parquet(self, file: str | FilePath) -> None:
        """Write the samples as Parquet, with units in the metadata. Raises MissingArrow without pyarrow."""
        parquet_file.to_parquet(self._samples, file)

    @classmethod
    @names_file
    def from_parquet(cls, file: str | FilePath) -> Trajectory:
        """Read the output of `to_parquet`. Raises the errors of `from_json`, and MissingArrow without pyarrow."""
        return cls(*parquet_file.from_parquet(file))

    def to_ros(self, names: Names | None = None, *, frame: str = "", accelerations: bool = False) -> dict[str, Any]:
        """Return a trajectory_msgs/JointTrajectory as a dictionary of its fields; ROS is not needed.

        The points have positions and velocities, so a controller interpolates by the cubics of this trajectory.

        Args:
            names: Maps joint names here to joint names in ROS: a mapping or a function; by default they are equal.
            frame: `header.frame_id`.
            accelerations: Whether the points have accelerations as well. Controllers then interpolate by quintics.
                These differ from this trajectory where its acceleration jumps, and exceed the limits of acceleration
                there, by up to 75 % between full acceleration and full braking.

        Raises:
            UnknownNameError: If a mapping lacks a joint.
            SettingError: If two joints would get the same name, or samples are less than a nanosecond apart.
        """
        return ros.to_message(self._in_nanoseconds, names, frame=frame, accelerations=accelerations)

    def to_ros_yaml(
        self,
        file: str | FilePath | None = None,
        *,
        names: Names | None = None,
        frame: str = "",
        accelerations: bool = False,
    ) -> str:
        """Return the message of `to_ros` as YAML for the command line of ROS 2; write it to `file` if given."""
        return _written(ros.to_yaml(self.to_ros(names, frame=frame, accelerations=accelerations)), file)

    @classmethod
    @names_file
    def from_ros(cls, source: Any, joints: Sequence[str] | None = None, names: Names | None = None) -> Trajectory:
        """Read a trajectory_msgs/JointTrajectory, for example from another planner.

        Args:
            source: The message, a dictionary of its fields, or YAML as text or file.
            joints: The joints of the trajectory in order, such as `scene.joints`; by default the keys of `names`, or
                the joints of the message. Other joints of the message must stand still.
            names: As in `to_ros`.

        Raises:
            FormatError: If `source` is not such a message, has no velocities, or moves other joints as well.
            UnknownNameError: If the message lacks a joint.
            ShapeError: If the shapes of its points do not match.
            NonFiniteError: If a number is NaN or infinite.
            SettingError: If its times do not increase.
        """
        return cls(*ros.from_message(source, joints, names))

    @property
    def _in_nanoseconds(self) -> TimedSamples:
        """The motion sampled at whole nanoseconds; rounding only the times would distort the motion."""
        t = self.t[0] + np.rint((self.t - self.t[0]) * ros.NANO) / ros.NANO
        moved = (t != self.t)[:, None]
        moved[-1] = False  # the end stays exact
        state = self.at(t)
        q, qd = np.where(moved, state.q, self.q), np.where(moved, state.qd, self.qd)
        return TimedSamples(t, q, qd, self.qdd, self.joints)

    @property
    def _samples(self) -> TimedSamples:
        return TimedSamples(self.t, self.q, self.qd, self.qdd, self.joints)


def _written(text: str, file: str | FilePath | None) -> str:
    """Write a text to a file if one is given, and return it."""
    if file is not None:
        FilePath(file).write_text(text, encoding="utf-8")
    return text


def _frozen(array: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    array = array.copy()
    array.flags.writeable = False
    return array
