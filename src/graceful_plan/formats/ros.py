"""Trajectories as trajectory_msgs/JointTrajectory, in plain Python values. No ROS package is imported.

Angles are in rad, lengths in m. Times count from the start of the motion, with nanoseconds as integers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from graceful_plan import untrusted_yaml
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError
from graceful_plan.formats.samples import TimedSamples, text_of
from graceful_plan.path import finite_array, is_whole

Names = Mapping[str, str] | Callable[[str], str]
"""Maps a joint name here to its name in ROS."""

NANO = 1_000_000_000


def to_message(
    samples: TimedSamples, names: Names | None = None, *, frame: str = "", accelerations: bool = False
) -> dict[str, Any]:
    """Return the message as a dictionary of its fields.

    Args:
        samples: The samples; the first one gets time 0.
        names: Maps joint names here to names in the message; by default they are equal.
        frame: `header.frame_id`.
        accelerations: Whether to send accelerations. Without them, controllers interpolate by cubics, as trajectories
            do.

    Raises:
        UnknownNameError: If `names` is a mapping that lacks a joint.
        SettingError: If two joints would get the same name, or two samples the same time in nanoseconds.
    """
    joints = _mapped(samples.joints, names)
    nanoseconds = np.rint((samples.t - samples.t[0]) * NANO).astype(np.int64)
    if np.any(np.diff(nanoseconds) <= 0):
        i = int(np.argmax(np.diff(nanoseconds) <= 0)) + 1
        raise SettingError(f"t[{i}]", float(samples.t[i]), "at least a nanosecond after the previous sample")
    points = [
        {
            "positions": q,
            "velocities": qd,
            "accelerations": qdd if accelerations else [],
            "effort": [],
            "time_from_start": {"sec": time // NANO, "nanosec": time % NANO},
        }
        for q, qd, qdd, time in zip(
            samples.q.tolist(), samples.qd.tolist(), samples.qdd.tolist(), nanoseconds.tolist(), strict=True
        )
    ]
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}
    return {"header": header, "joint_names": list(joints), "points": points}


def to_yaml(message: Mapping[str, Any]) -> str:
    """Return a message as YAML for `ros2 topic pub` and `ros2 action send_goal`."""
    return yaml.dump(dict(message), Dumper=_QuotingDumper, sort_keys=False, default_flow_style=None, width=1_000_000)


class _QuotingDumper(yaml.SafeDumper):
    """Also quotes texts that are numbers by YAML 1.2 only, such as 1e3."""


def _text_node(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    is_text = isinstance(untrusted_yaml.scalar_value(text), str)
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if is_text else "'")


_QuotingDumper.add_representer(str, _text_node)


def from_message(
    source: Any,
    joints: Sequence[str] | None = None,
    names: Names | None = None,
) -> TimedSamples:
    """Read a JointTrajectory.

    Args:
        source: The message as a dictionary, as an object with the fields as attributes, or as YAML text or file.
        joints: The joints to return, in this order, by their names here. The default is the keys of `names` if it is a
            mapping, else the joints of the message. Other joints of the message must stand still.
        names: Maps these to names in the message; by default they are equal.

    Returns:
        The samples. Missing accelerations are those of the cubics through positions and velocities.

    Raises:
        FormatError: If `source` is not such a message, has no velocities, or moves joints outside of `joints`.
        UnknownNameError: If the message lacks a joint.
        SettingError: If two joints have the same name.
        NonFiniteError: If a number is NaN or infinite.
        ShapeError: If a point does not have one value per joint.
    """
    label, message = _opened(source)
    given = _names_in(label, message)
    points = _sequence(label, message, "points")
    if not points:
        raise FormatError(label, "there are no points")
    wanted = tuple(joints or (names if isinstance(names, Mapping) else given))
    columns = _columns(label, given, _mapped(wanted, names))
    t = np.array([_seconds(label, _field(label, point, "time_from_start")) for point in points])
    q, qd = (_table(label, points, key, len(given)) for key in ("positions", "velocities"))
    qdd = None if not _has(points, "accelerations") else _table(label, points, "accelerations", len(given))
    others = [i for i in range(len(given)) if i not in columns]
    if others and np.any(np.ptp(q[:, others], axis=0) > 0.0):
        moving = ", ".join(given[i] for i in others if np.ptp(q[:, i]) > 0.0)
        raise FormatError(label, f"it moves {moving} as well, beyond the requested {', '.join(wanted)}")
    q, qd = q[:, columns], qd[:, columns]
    return TimedSamples(t, q, qd, _cubic(t, q, qd) if qdd is None else qdd[:, columns], wanted)


def _mapped(joints: Iterable[str], names: Names | None) -> tuple[str, ...]:
    """Return the names of joints in the message."""
    ours = tuple(joints)
    if isinstance(names, Mapping):
        missing = next((joint for joint in ours if joint not in names), None)
        if missing is not None:
            raise UnknownNameError("joint in names", missing, names)
        theirs = tuple(names[joint] for joint in ours)
    else:
        theirs = ours if names is None else tuple(names(joint) for joint in ours)
    twice = next((name for name in theirs if theirs.count(name) > 1), None)
    if twice is not None:
        raise SettingError("names", twice, "a distinct name for every joint")
    return theirs


def _opened(source: Any) -> tuple[str, Any]:
    """Return the label of a message in errors, and the message."""
    if not isinstance(source, str | Path):
        return "message", source
    label, text = text_of(
        source, lambda text: "\n" in text or text.lstrip().startswith("{"), "YAML", untrusted_yaml.MOST_BYTES
    )
    return label, untrusted_yaml.parse_yaml_values(text, label)


def _field(label: str, message: Any, name: str) -> Any:
    """Return a field of a message that is a mapping or an object with attributes."""
    value = message.get(name) if isinstance(message, Mapping) else getattr(message, name, None)
    if value is None:
        raise FormatError(label, f"not a JointTrajectory: {name} is missing")
    return value


def _sequence(label: str, message: Any, name: str) -> list[Any]:
    """Return a field with several values, such as a list, tuple or array, as a list."""
    value = _field(label, message, name)
    if not hasattr(value, "__len__") or isinstance(value, str | Mapping):
        raise FormatError(label, f"{name} has to be a list")
    return list(value)


def _names_in(label: str, message: Any) -> list[str]:
    names = _sequence(label, message, "joint_names")
    if not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise FormatError(label, "joint_names has to be a list of different names")
    return names


def _columns(label: str, given: list[str], wanted: Sequence[str]) -> list[int]:
    for name in wanted:
        if name not in given:
            raise UnknownNameError(f"joint in {label}", name, given)
    return [given.index(name) for name in wanted]


def _seconds(label: str, duration: Any) -> float:
    sec, nano = (_field(label, duration, key) for key in ("sec", "nanosec"))
    if not (is_whole(sec) and is_whole(nano) and 0 <= sec < 2**31 and 0 <= nano < NANO):
        raise FormatError(label, "sec and nanosec of time_from_start have to be whole numbers, nanosec below a second")
    return (int(sec) * NANO + int(nano)) / NANO


def _has(points: Sequence[Any], key: str) -> bool:
    """Return whether the points have a field, judging by the first point."""
    value = points[0].get(key) if isinstance(points[0], Mapping) else getattr(points[0], key, None)
    return value is not None and (not hasattr(value, "__len__") or len(value) > 0)


def _table(label: str, points: Sequence[Any], key: str, count: int) -> Float[Array, "time nq"]:
    if not _has(points, key):
        hint = "; time it again: retime(Path(positions), ..)" if key == "velocities" else ""
        raise FormatError(label, f"points lack {key}{hint}")
    return finite_array(f"{key} of {label}", [_sequence(label, point, key) for point in points], ndim=2, last=count)


def _cubic(t: Float[Array, " time"], q: Float[Array, "time nq"], qd: Float[Array, "time nq"]) -> Array:
    """Return the accelerations of the cubics just after each sample, and just before the last one."""
    if len(t) == 1:
        return np.zeros_like(q)
    h = np.diff(t)[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # Trajectory refuses times that do not increase
        mean = np.diff(q, axis=0) / h
        begins = (6.0 * mean - 4.0 * qd[:-1] - 2.0 * qd[1:]) / h
        last = (-6.0 * mean[-1] + 2.0 * qd[-2] + 4.0 * qd[-1]) / h[-1]
    return np.concatenate([begins, last[None]])
