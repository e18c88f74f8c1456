"""A trajectory: a path with its timing, and its JSON and CSV forms."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float, Int
from graceful_plan.exceptions import FormatError, SettingError, ShapeError
from graceful_plan.path import Path, finite_array

Array = np.ndarray

_SCHEMA = "graceful_plan.trajectory"
_VERSION = 1
_UNITS = {"t": "s", "q": "rad or m", "qd": "rad/s or m/s", "qdd": "rad/s^2 or m/s^2"}

_REST = 1e-6
"""Greatest speed of a joint at rest [rad/s or m/s]."""


class State(NamedTuple):
    """Position, velocity and acceleration of the joints at one or more times."""

    q: Float[Array, "*time nq"]
    qd: Float[Array, "*time nq"]
    qdd: Float[Array, "*time nq"]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A timed motion of the joints: samples, and between them the cubic that meets q and qd at both ends.

    Positions and velocities are continuous everywhere; the acceleration is linear within a piece and may jump at a
    sample, where `qdd` holds the value just after it (at the last sample, just before it).

    Args:
        t: Sample times [s], strictly increasing.
        q: Joint positions [rad or m].
        qd: Joint velocities [rad/s or m/s].
        qdd: Joint accelerations [rad/s^2 or m/s^2].
        joints: Names of the joints, in the order of the columns.

    Raises:
        ShapeError: If the arrays do not fit together.
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

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    @cached_property
    def path(self) -> Path:
        """The polyline through the samples."""
        return Path(self.q)

    def at(self, t: ArrayLike) -> State:
        """Evaluate at one or more times; before the first and after the last sample the motion stands still.

        Args:
            t: Times [s] on the clock of `self.t`.
        """
        times = finite_array("t", t)
        flat = np.clip(times.reshape(-1), self.t[0], self.t[-1])
        if len(self) == 1:
            parts = [np.repeat(x, len(flat), axis=0) for x in (self.q, self.qd, self.qdd)]
        else:
            parts = self._cubic(flat)
        outside = (times.reshape(-1) < self.t[0]) | (times.reshape(-1) > self.t[-1])
        parts[1][outside] = parts[2][outside] = 0.0
        return State(*(x.reshape(*times.shape, -1) for x in parts))

    def positions(self, t: Float[Array, " n"]) -> Float[Array, "n nq"]:
        """Evaluate the positions alone at finite times on the clock of `self.t` [rad or m]."""
        if len(self) == 1:
            return np.repeat(self.q, len(t), axis=0)
        i, u, v0, a0, jerk = self._pieces_at(np.clip(t, self.t[0], self.t[-1]))
        return self.q[i] + u * (v0 + u * (0.5 * a0 + u * (jerk / 6.0)))

    def _cubic(self, t: Float[Array, " n"]) -> list[Float[Array, "n nq"]]:
        i, u, v0, a0, jerk = self._pieces_at(t)
        return [
            self.q[i] + u * (v0 + u * (a0 / 2.0 + u * jerk / 6.0)),
            v0 + u * (a0 + u * jerk / 2.0),
            a0 + u * jerk,
        ]

    def _pieces_at(self, t: Float[Array, " n"]) -> tuple[Int[Array, " n"], Array, Array, Array, Array]:
        """Return the piece at each time, the time since it began, and its first velocity, acceleration and jerk."""
        i = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self) - 2)
        a0, a1 = self.piece_accelerations
        jerk = (a1 - a0) / np.diff(self.t)[:, None]
        return i, (t - self.t[i])[:, None], self.qd[i], a0[i], jerk[i]

    @cached_property
    def piece_accelerations(self) -> tuple[Float[Array, "piece nq"], Float[Array, "piece nq"]]:
        """Acceleration of the interpolating cubic at the beginning and at the end of each piece [rad/s^2]."""
        h = np.diff(self.t)[:, None]
        mean = np.diff(self.q, axis=0) / h
        v0, v1 = self.qd[:-1], self.qd[1:]
        return (6.0 * mean - 4.0 * v0 - 2.0 * v1) / h, (-6.0 * mean + 2.0 * v0 + 4.0 * v1) / h

    def delayed(self, seconds: float) -> Trajectory:
        """Return the same motion after a wait at its start [s]: a first stretch at rest. It has to start at rest.

        Raises:
            SettingError: If the wait is not a time of at least 0, or the motion does not start at rest.
        """
        if not (np.isfinite(seconds) and seconds >= 0.0):
            raise SettingError("seconds", seconds, "a finite time of at least 0 s")
        if np.any(np.abs(self.qd[0]) > _REST):
            raise SettingError("qd[0]", self.qd[0].tolist(), "rest: a moving robot cannot wait")
        if seconds == 0.0:
            return self
        t = np.append(self.t[0], self.t + seconds)
        q, qd, qdd = (x[np.maximum(np.arange(len(self) + 1) - 1, 0)] for x in (self.q, self.qd, self.qdd))
        qd[0] = qdd[0] = 0.0
        return Trajectory(t, q, qd, qdd, self.joints)

    def sample(self, dt: float) -> Trajectory:
        """Sample evenly, every `dt` [s]; the last sample is exactly the end, so the last piece may be shorter.

        The samples lie on this trajectory. Interpolating them again blurs jumps of the acceleration: where it goes from
        full speeding up to full braking within one step, the new cubic has up to 5/3 of the limit, and the judge says
        so. Keep the original where limits must hold between samples, or plan with a lower `speed`.
        """
        if not (np.isfinite(dt) and dt > 0.0):
            raise SettingError("dt", dt, "a finite time > 0 s")
        # A rest shorter than a millionth of a step would only make a piece that is too short to differentiate.
        steps = int(np.ceil(self.duration / dt - 1e-6))
        t = self.t[0] + np.append(dt * np.arange(steps), self.duration) if steps else self.t[:1]
        state = self.at(t)
        q, qd, qdd = (x.copy() for x in state)
        q[-1], qd[-1], qdd[-1] = self.q[-1], self.qd[-1], self.qdd[-1]
        return Trajectory(t, q, qd, qdd, self.joints)

    def to_json(self, file: str | FilePath | None = None) -> str:
        """Return the trajectory as JSON text with schema version and units; write it to `file` if one is given."""
        document = {"schema": _SCHEMA, "version": _VERSION, "units": _UNITS, "joints": list(self.joints)}
        document |= {name: getattr(self, name).tolist() for name in _UNITS}
        text = json.dumps(document, allow_nan=False) + "\n"
        if file is not None:
            FilePath(file).write_text(text, encoding="utf-8")
        return text

    @classmethod
    def from_json(cls, source: str | FilePath) -> Trajectory:
        """Read what `to_json` wrote, from a file or from JSON text (a string that starts with a brace).

        Raises:
            FormatError: If it is not such a document, of another version or in other units.
            ShapeError: If its arrays do not fit together.
            NonFiniteError: If a number is NaN or infinite.
            SettingError: If its times do not increase.
        """
        is_text = isinstance(source, str) and source.lstrip().startswith("{")
        name = "JSON text" if is_text else str(source)
        try:
            document = json.loads(str(source) if is_text else FilePath(source).read_text(encoding="utf-8"))
        except (ValueError, RecursionError) as error:
            raise FormatError(name, f"not JSON: {error}") from None
        _check_document(name, document)
        arrays = (finite_array(key, document[key], ndim=1 if key == "t" else 2) for key in _UNITS)
        return cls(*arrays, joints=tuple(document["joints"]))

    def to_csv(self, file: str | FilePath | None = None) -> str:
        """Return the samples as CSV text, one row a time, with units in the header; write it to `file` if given."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        columns = [(key, joint) for key in ("q", "qd", "qdd") for joint in self.joints]
        writer.writerow(["t [s]", *(f"{key} {joint} [{_UNITS[key]}]" for key, joint in columns)])
        for row in np.column_stack([self.t, self.q, self.qd, self.qdd]).tolist():
            writer.writerow([repr(x) for x in row])
        if file is not None:
            FilePath(file).write_text(out.getvalue(), encoding="utf-8")
        return out.getvalue()


def _check_document(name: str, document: Any) -> None:
    """Refuse anything but the keys, version, units and value types that `to_json` writes."""
    if not isinstance(document, dict):
        raise FormatError(name, f"an object is expected, not {type(document).__name__}")
    expected = {"schema", "version", "units", "joints", *_UNITS}
    for problem, keys in (("missing", expected - document.keys()), ("unknown", document.keys() - expected)):
        if keys:
            valid = ", ".join(sorted(expected))
            raise FormatError(name, f"{problem} keys: {', '.join(sorted(keys))}; expected: {valid}")
    for key, value in (("schema", _SCHEMA), ("version", _VERSION), ("units", _UNITS)):
        if document[key] != value:
            raise FormatError(name, f"{key} is {document[key]!r}, this version reads {value!r}")
    joints = document["joints"]
    if not isinstance(joints, list) or not all(isinstance(joint, str) for joint in joints):
        raise FormatError(name, "joints must be a list of names")
    for key in _UNITS:
        if not isinstance(document[key], list) or not _only_numbers(document[key]):
            raise FormatError(name, f"{key} must be a list of numbers")


def _only_numbers(values: Sequence[Any]) -> bool:
    leaves = (_only_numbers(x) if isinstance(x, list) else type(x) in (int, float) for x in values)
    return all(leaves)


def _frozen(array: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    array = array.copy()
    array.flags.writeable = False
    return array
