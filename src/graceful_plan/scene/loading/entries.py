"""Entries of scene files (entities, objects, tasks, contacts and others) as dataclasses; unknown keys are errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

import mujoco
import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.scene.elements import (
    Adhesion,
    AllowedContact,
    Contents,
    EntityAnnotation,
    Fingers,
    Granular,
    Liquid,
    ObjectNote,
    Opening,
    TaskNote,
)
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.yaml_file import Block

_MOVING_KEYS = ("class", "size", "t", "position", "yaw", "spread", "growth", "severity")


def state_entry(block: Block) -> dict[str, Any] | str:
    """Read the state of joints and free bodies, or the name of a keyframe."""
    if not block.is_mapping:
        return block.string()
    return {name: child.numbers() if child.is_list else child.number() for name, child in block.items()}


def base_entry(block: Block | None) -> DiffDrive | None:
    """Read the drive of a mobile base."""
    if block is None:
        return None
    block.only(*(item.name for item in fields(DiffDrive)))
    given: dict[str, Any] = {}
    for name, child in block.items():
        if name in ("joints", "wheels"):
            given[name] = child.strings()
        elif name == "reverse":
            given[name] = child.flag()
        else:
            given[name] = child.number()
    missing = [i.name for i in fields(DiffDrive) if i.default is MISSING and i.name not in given]
    if missing:
        raise block.error(f"base needs {', '.join(missing)}")
    try:
        return DiffDrive(**given)
    except SettingError as error:
        raise block.error(str(error)) from None


def limits_entry(block: Block | None) -> dict[str, tuple[float, float]]:
    """Read the lower and upper limit of joints."""
    found = {name: pair.numbers(2) for name, pair in block.items()} if block else {}
    return {name: (pair[0], pair[1]) for name, pair in found.items()}


def entity_entry(_name: str, block: Block) -> EntityAnnotation:
    """Read the class of an entity, with severities if given."""
    if not block.is_mapping:
        return EntityAnnotation(category=block.string())
    block.only("class", "severity")
    severity = block.get("severity")
    return EntityAnnotation(category=block["class"].string(), severity=severity_entry(severity) if severity else None)


def moving_entry(name: str, block: Block) -> MovingEntity:
    """Read a moving entity."""
    block.only(*_MOVING_KEYS)
    yaw, spread, growth, severity = (block.get(key) for key in ("yaw", "spread", "growth", "severity"))
    return MovingEntity(
        name,
        block["class"].string(),
        size=np.array(block["size"].numbers()),
        t=np.array(block["t"].numbers()),
        position=np.array([row.numbers(3) for row in block["position"].entries()]).reshape(-1, 3),
        yaw=np.array(yaw.numbers()) if yaw else None,
        spread=spread.number() if spread else 0.0,
        growth=growth.number() if growth else 0.0,
        severity=severity_entry(severity) if severity else None,
    )


def object_entry(name: str, block: Block) -> ObjectNote:
    """Read an object that can be carried."""
    block.only("body", "class", "grasp", "fingers", "grip", "contents")
    body, object_class, grasp, contents = (block.get(key) for key in ("body", "class", "grasp", "contents"))
    return ObjectNote(
        body=body.string() if body else name,
        X_TO=_pose(grasp) if grasp else None,
        object_class=object_class.string() if object_class else None,
        contents=_contents(contents) if contents else None,
        fingers=fingers_entry(block.get("fingers")),
        grip=_grip(block.get("grip")),
    )


def task_entry(_name: str, block: Block) -> TaskNote:
    """Read a task."""
    block.only("description", "start", "goal", "object", "support")
    description, object_name, support = block.get("description"), block.get("object"), block.get("support")
    if support is not None:
        support.only("start", "goal")
        if object_name is None:
            raise support.error("a task without an object has no support")
    return TaskNote(
        start=_end(block["start"]),
        goal=_goals(block["goal"]),
        description=description.string() if description else "",
        object_name=object_name.string() if object_name else None,
        support=tuple(dict.fromkeys(child.string() for _, child in support.items())) if support else (),
    )


def contact_entry(block: Block) -> AllowedContact:
    """Read an allowed contact."""
    block.only("first", "second", "when")
    when = block.get("when")
    word = when.string() if when else "always"
    if word not in ("always", "ends"):
        raise block.error(f"when is {word!r}, expected always or ends")
    return AllowedContact(block["first"].string(), block["second"].string(), word)


def fingers_entry(block: Block | None) -> Fingers | None:
    """Read the position of fingers, by joint if it is a mapping, or an opening."""
    if block is None or not (block.is_mapping and block.get("opening")):
        return None if block is None else severity_entry(block)
    block.only("opening")
    opening = block["opening"]
    return Opening(None if opening.is_string and opening.string() == "object" else opening.number())


def quaternion_entry(block: Block) -> tuple[float, ...]:
    """Read a unit quaternion, wxyz."""
    values = np.array(block.numbers(4))
    length = np.linalg.norm(values)
    if not 0.9 < length < 1.1:
        raise block.error(f"{block.name} has length {length:g}, expected 1 (wxyz)")
    return tuple((values / length).tolist())


def severity_entry(block: Block) -> float | Mapping[str, float]:
    """Read a number, or numbers by name."""
    return {name: child.number() for name, child in block.items()} if block.is_mapping else block.number()


def numbers_entry(block: Block | None) -> tuple[float, ...] | None:
    """Read a list of numbers, None if it is absent."""
    return None if block is None else block.numbers()


def _grip(block: Block | None) -> Adhesion | None:
    if block is None:
        return None
    block.only("force", "radius", "friction")
    friction = block.get("friction")
    given = {"friction": friction.number()} if friction else {}
    return Adhesion(force=block["force"].number(), radius=block["radius"].number(), **given)


def _contents(block: Block) -> Contents:
    block.only("kind", "volume", "temperature", "geoms")
    kind, temperature, geoms = block["kind"].string(), block.get("temperature"), block.get("geoms")
    names = geoms.strings() if geoms else ()
    volume = block["volume"].number()
    if kind == "dry":
        if temperature is not None:
            raise temperature.error("dry contents have no temperature")
        return Granular(volume, names)
    if kind not in ("water", "oil"):
        raise block["kind"].error(f"kind {kind!r}, expected water, oil or dry")
    return Liquid(volume, temperature.number() if temperature else 20.0, kind, names)


def _end(block: Block) -> str | tuple[float, ...]:
    return block.numbers() if block.is_list else block.string()


def _goals(block: Block) -> tuple[str | tuple[float, ...], ...]:
    if not block.is_list:
        return (block.string(),)
    children = block.entries()
    if not children:
        raise block.error("needs at least one goal")
    if any(child.is_list or child.is_string for child in children):
        return tuple(_end(child) for child in children)
    return (block.numbers(),)


def _pose(block: Block) -> np.ndarray:
    block.only("position", "quaternion")
    X = np.eye(4)
    position, quaternion = block.get("position"), block.get("quaternion")
    X[:3, 3] = position.numbers(3) if position else 0.0
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, np.array(quaternion_entry(quaternion) if quaternion else (0.0, 1.0, 0.0, 0.0)))
    X[:3, :3] = R.reshape(3, 3)
    return X
