"""Named configurations and tasks of a scene, resolved from the notes."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from types import MappingProxyType

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError
from graceful_plan.scene.elements import Limits, Notes
from graceful_plan.scene.facts import SceneFacts

_LOG = logging.getLogger(__name__)

_SLACK = 1e-6


def model_keyframes(model: mujoco.MjModel, qpos_adr: Int[Array, " nq"]) -> dict[str, tuple[float, ...]]:
    """Return the model's own keyframes, restricted to the planned joints."""
    return {
        model.key(i).name: tuple(model.key_qpos[i][qpos_adr].tolist()) for i in range(model.nkey) if model.key(i).name
    }


def find_keyframes(notes: Notes, nq: int) -> Mapping[str, Float[Array, " nq"]]:
    """Return the keyframes of the notes as read-only arrays.

    Raises:
        ShapeError: If one has the wrong number of joints.
    """
    found = {}
    for name, values in notes.keyframes.items():
        with notes.about(f"keyframes.{name}"):
            found[name] = _configuration(f"keyframe {name!r}", values, nq)
    return MappingProxyType(found)


def check_keyframes(notes: Notes, limits: Limits) -> None:
    """Check declared keyframes against the limits. A model's own are exempt: many models have some outside the limits.

    Raises:
        SettingError: If a keyframe is outside the limits.
    """
    for name, q in notes.keyframes.items():
        with notes.about(f"keyframes.{name}"):
            _check_limits(f"keyframe {name!r}", np.array(q), limits)


def named_configuration(name: str, scene: SceneFacts) -> Float[Array, " nq"]:
    """Return the configuration of a keyframe; log a warning if the keyframe has anything else elsewhere than the scene.

    Raises:
        UnknownNameError: If there is no such keyframe.
    """
    if name not in scene.keyframes:
        raise UnknownNameError("keyframe", name, scene.keyframes)
    elsewhere = scene.state_differences(name)
    if elsewhere:
        _LOG.warning(
            "only planned joints are taken from the keyframe %r; in it, %s; with_state(keyframe=%r) sets the rest",
            name,
            ", ".join(elsewhere),
            name,
        )
    return scene.keyframes[name]


def task_ends(scene: SceneFacts, name: str) -> tuple[Float[Array, " nq"], Float[Array, "goal nq"]]:
    """Return start and goals of a declared task.

    Raises:
        UnknownNameError: If the task names a keyframe, an object or a support that does not exist.
    """
    note = scene.notes.tasks[name]
    with scene.notes.about(f"tasks.{name}"):
        if note.object_name is not None and note.object_name not in scene.notes.objects:
            raise UnknownNameError("object", note.object_name, scene.notes.objects)
        for support in note.support:
            scene.geoms_named(support)
        goals = np.stack([_end(scene, goal) for goal in note.goal])
        goals.flags.writeable = False
        return _end(scene, note.start), goals


def _end(scene: SceneFacts, given: str | tuple[float, ...]) -> Float[Array, " nq"]:
    if not isinstance(given, str):
        q = _configuration("configuration", given, len(scene.joints))
    else:
        q = named_configuration(given, scene)
    _check_limits("configuration" if not isinstance(given, str) else f"keyframe {given!r}", q, scene.limits)
    return q


def _configuration(name: str, values: tuple[float, ...], nq: int) -> Float[Array, " nq"]:
    q = np.array(values, dtype=float)
    if q.shape != (nq,):
        raise ShapeError(name, q.shape, f"({nq},), one number for each planned joint")
    q.flags.writeable = False
    return q


def _check_limits(name: str, q: Float[Array, " nq"], limits: Limits) -> None:
    lower, upper = limits.position.T
    outside = np.flatnonzero((q < lower - _SLACK) | (q > upper + _SLACK))
    if len(outside):
        j = int(outside[0])
        raise SettingError(f"joint {j} of {name}", float(q[j]), f"between {lower[j]:g} and {upper[j]:g}")
