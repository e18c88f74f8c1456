"""Named configurations and tasks of a scene, resolved from the notes."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from jaxtyping import Float, Int

from graceful_plan.elements import Limits, Notes, Task, TaskNote
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError

if TYPE_CHECKING:
    from graceful_plan.scene import Scene

Array = np.ndarray

_SLACK = 1e-6


def model_keyframes(model: mujoco.MjModel, qpos_adr: Int[Array, " nq"]) -> dict[str, tuple[float, ...]]:
    """Return the model's own keyframes, as far as the planned joints go."""
    return {
        model.key(i).name: tuple(model.key_qpos[i][qpos_adr].tolist()) for i in range(model.nkey) if model.key(i).name
    }


def find_keyframes(notes: Notes) -> Mapping[str, Float[Array, " _"]]:
    """Return the keyframes of the notes as arrays that cannot be written to."""
    found = {name: np.array(q, dtype=float) for name, q in notes.keyframes.items()}
    for q in found.values():
        q.flags.writeable = False
    return MappingProxyType(found)


def check_keyframes(notes: Notes, limits: Limits) -> None:
    """Check declared keyframes. Those of a model are not: many models have some outside of their limits.

    Raises:
        ShapeError: If one has the wrong number of joints.
        SettingError: If one is outside of the limits.
    """
    for name, q in notes.keyframes.items():
        with notes.about(f"keyframes.{name}"):
            _configuration(f"keyframe {name!r}", q, limits)


def find_tasks(scene: Scene) -> Mapping[str, Task]:
    """Return the tasks of a scene by name.

    Raises:
        UnknownNameError: If a task names a keyframe or an object that does not exist.
    """
    tasks = {}
    for name, note in scene.notes.tasks.items():
        with scene.notes.about(f"tasks.{name}"):
            tasks[name] = _task(scene, name, note)
    return MappingProxyType(tasks)


def _task(scene: Scene, name: str, note: TaskNote) -> Task:
    if note.object_name is not None and note.object_name not in scene.notes.objects:
        raise UnknownNameError("object", note.object_name, scene.notes.objects)
    for support in note.support:
        scene.geoms_named(support)
    goals = np.stack([_end(scene, goal) for goal in note.goal])
    goals.flags.writeable = False
    return Task(
        name=name,
        start=_end(scene, note.start),
        goal=goals,
        description=note.description,
        object_name=note.object_name,
        support=note.support,
        world=scene,
    )


def _end(scene: Scene, given: str | tuple[float, ...]) -> Float[Array, " nq"]:
    if not isinstance(given, str):
        return _configuration("configuration", given, scene.limits)
    if given not in scene.keyframes:
        raise UnknownNameError("keyframe", given, scene.keyframes)
    return scene.keyframes[given]


def _configuration(name: str, values: tuple[float, ...], limits: Limits) -> Float[Array, " nq"]:
    q = np.array(values, dtype=float)
    lower, upper = limits.position.T
    if q.shape != lower.shape:
        raise ShapeError(name, q.shape, f"({len(lower)},), one number for each planned joint")
    outside = np.flatnonzero((q < lower - _SLACK) | (q > upper + _SLACK))
    if len(outside):
        j = int(outside[0])
        raise SettingError(f"joint {j} of {name}", float(q[j]), f"between {lower[j]:g} and {upper[j]:g}")
    return q
