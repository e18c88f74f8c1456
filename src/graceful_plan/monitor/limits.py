r"""Limits of a monitor, from healthy runs, for a stated rate of false alarms.

Each statistic of each signal has its own limit. The largest values in blocks of a quarter of a second have a tail
beyond their 80 % quantile u, which is taken as exponential: its mean excess m is the maximum-likelihood estimate. With
r blocks per hour beyond u, a limit is exceeded f times per hour at

.. math:: u + m \ln (r / f)

The allowed rate is divided by the number of limits. Alarms of different limits often coincide, so the rate of all
together is below the stated one.

References:
    [Pickands1975] J. Pickands, "Statistical inference using extreme order statistics", Annals of Statistics 3(1):
    exceedances of a high threshold. Here the tail has the shape parameter 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.monitor.signals import (
    READINGS,
    Reading,
    Signals,
    checked_motion,
    reading_rows,
    signal_sizes,
)
from graceful_plan.path import real_array
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.setting_checks import positive
from graceful_plan.timing.trajectory import Trajectory

_BLOCK = 0.25
"""Length of a block [s], longer than the correlation of the signals of a servo."""
_USUAL = 0.8
"""Quantile of the largest values in blocks beyond which the tail begins."""
_FEWEST = 40
"""Least number of blocks: with fewer, less than eight values are in the tail."""
_LEAST = MappingProxyType({"position": 1e-3, "speed": 1e-2, "consistency": 1e-3, "torque": 0.1, "opening": 1e-3})
"""Smallest limits by signal [rad or m, and their units by second; N m or N; m]: a few steps of a sensor. They matter
for simulated healthy runs without noise only."""
_GAPS = 2.5
"""The limit of missing samples is at least this many times the usual time between samples."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MonitorRecord:
    """Readings of a healthy robot along a motion.

    | field      | meaning                                             | unit         | shape  |
    |------------|-----------------------------------------------------|--------------|--------|
    | trajectory | the executed motion                                 |              |        |
    | scene      | robot and carried object                            |              |        |
    | t          | times of the samples, on the clock of the motion    | s            | n      |
    | q          | positions of the joints                             | rad or m     | n nq   |
    | qd         | their speeds; None if the robot does not tell them  | rad/s or m/s | n nq   |
    | torque     | torques of the drives, or None                      | N m or N     | n nq   |
    | opening    | opening of the gripper in any unit, or None         | m            | n      |
    """

    trajectory: Trajectory
    scene: Scene
    t: ArrayLike
    q: ArrayLike
    qd: ArrayLike | None = None
    torque: ArrayLike | None = None
    opening: ArrayLike | None = None

    @property
    def readings(self) -> tuple[str, ...]:
        """Names of the readings other than positions."""
        given = zip(READINGS, (self.qd, self.torque, self.opening), strict=True)
        return tuple(name for name, value in given if value is not None)


@dataclass(frozen=True, kw_only=True, eq=False)
class MonitorLimits:
    """Limits of a monitor. Made by `fit`.

    | field        | meaning                                                                   |
    |--------------|---------------------------------------------------------------------------|
    | joints       | names of the joints                                                       |
    | readings     | readings that the monitor needs, beyond positions                        |
    | limit        | by signal, then statistic and joint: the value that raises an alarm       |
    | usual        | in the same layout: the value that a healthy robot seldom exceeds         |
    | gap          | time without a complete sample that raises an alarm [s]                   |
    | false_alarms | greatest expected number of false alarms [1/h]                            |
    | hours        | length of the healthy runs [h]                                            |
    """

    joints: tuple[str, ...]
    readings: tuple[str, ...]
    limit: Mapping[str, Float[Array, "statistic n"]]
    usual: Mapping[str, Float[Array, "statistic n"]]
    gap: float
    false_alarms: float
    hours: float

    @classmethod
    def fit(cls, healthy: Iterable[MonitorRecord], *, false_alarms: float = 1.0) -> MonitorLimits:
        """Derive limits from runs of a healthy robot, along any motions.

        The runs should vary as later ones will: other loads, speeds and temperatures. Limits hold for the robot,
        sensors and sampling period of these runs.

        Args:
            healthy: The runs, at least ten seconds together, all with the same joints and readings.
            false_alarms: Greatest expected number of false alarms [1/h].

        Raises:
            SettingError: If the runs differ in joints or readings, are too short together, or `false_alarms` is no
                finite number > 0.
            ShapeError: If readings have another shape than times and joints ask for.
        """
        positive("false_alarms", false_alarms, "a finite number > 0 [1/h]")
        records = list(healthy)
        if not records:
            raise SettingError("healthy", records, "at least one run")
        joints, readings = records[0].trajectory.joints, records[0].readings
        for record in records:
            if (record.trajectory.joints, record.readings) != (joints, readings):
                raise SettingError("healthy", record.readings, f"runs with the same joints and readings: {readings}")
        blocks, gaps, seconds = [], [], 0.0
        for record in records:
            found, wait, lasted = _largest(record)
            blocks += found
            gaps.append(wait)
            seconds += lasted
        if len(blocks) < _FEWEST:
            raise SettingError("healthy", f"{seconds:.3g} s", f"at least {_FEWEST * _BLOCK:g} s of healthy runs")
        hours = seconds / 3600.0
        most = np.array(blocks)
        usual = np.quantile(most, _USUAL, axis=0)
        beyond = most > usual
        excess = np.where(beyond, most - usual, 0.0).sum(axis=0) / np.maximum(beyond.sum(axis=0), 1)
        rate = np.maximum(beyond.sum(axis=0), 1) / hours
        allowed = false_alarms / (most.shape[1] * most.shape[2] + 1)
        limit = usual + excess * np.log(np.maximum(rate / allowed, 1.0))
        sizes = signal_sizes(readings, len(joints))
        least = np.concatenate([np.full(n, _LEAST[name]) for name, n in sizes.items()])
        return cls(
            joints=joints,
            readings=readings,
            limit=_by_signal(np.maximum(limit, least), sizes),
            usual=_by_signal(np.maximum(usual, 0.5 * least), sizes),
            gap=_gap_limit(np.concatenate(gaps), hours, allowed),
            false_alarms=float(false_alarms),
            hours=hours,
        )


def _by_signal(values: Float[Array, "statistic signal"], sizes: Mapping[str, int]) -> Mapping[str, Array]:
    ends = np.cumsum(list(sizes.values()))[:-1]
    return MappingProxyType(dict(zip(sizes, np.split(values, ends, axis=1), strict=True)))


def _largest(record: MonitorRecord) -> tuple[list[Array], Float[Array, " gap"], float]:
    """Return the largest statistics in each block of a run, the times between complete samples, and its length [s]."""
    scene = checked_scene(record.scene)
    signals = Signals(checked_motion(record.trajectory, scene), scene, record.readings)
    found: list[Array] = []
    begins, last, gaps = None, None, []
    samples = list(samples_of(record))
    for sample in samples:
        if not sample.complete:
            continue
        values = signals.add(sample)
        if last is not None:
            gaps.append(sample.t - last)
        last = sample.t
        if begins is None or sample.t - begins >= _BLOCK:
            begins = sample.t
            found.append(values)
        else:
            np.maximum(found[-1], values, out=found[-1])
    return found, np.array(gaps), samples[-1].t - samples[0].t if samples else 0.0


def samples_of(record: MonitorRecord) -> Iterable[Reading]:
    """Yield the samples of a run.

    Raises:
        ShapeError: If readings have another shape than times and joints ask for.
        SettingError: If times do not increase.
    """
    nq = len(record.trajectory.joints)
    t = real_array("t", record.t)
    if t.ndim != 1:
        raise ShapeError("t", t.shape, "(n,)")
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise SettingError("t", t, "finite times that increase [s]")
    columns: dict[str, Array | None] = {}
    for name, value, shape in (
        ("q", record.q, (len(t), nq)),
        ("qd", record.qd, (len(t), nq)),
        ("torque", record.torque, (len(t), nq)),
        ("opening", record.opening, (len(t),)),
    ):
        rows = None if value is None else real_array(name, value)
        if rows is not None and rows.shape != shape:
            raise ShapeError(name, rows.shape, str(shape))
        columns[name] = rows if rows is None or rows.ndim == 2 else rows[:, None]
    for i, time in enumerate(t.tolist()):
        q, qd, torque, opening = (None if rows is None else rows[i] for rows in columns.values())
        yield Reading(time, reading_rows("q", q, nq), qd, torque, opening)


def _gap_limit(gaps: Float[Array, " gap"], hours: float, allowed: float) -> float:
    """Return the longest time without a complete sample that a healthy robot exceeds at the allowed rate [s]."""
    usual = float(np.median(gaps))
    beyond = gaps[gaps > 1.5 * usual]
    if not len(beyond):
        return _GAPS * usual
    excess, rate = float(np.mean(beyond - usual)), len(beyond) / hours
    return max(_GAPS * usual, usual + excess * float(np.log(max(rate / allowed, 1.0))))
