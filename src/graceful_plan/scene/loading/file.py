"""Scene files: YAML next to an MJCF world; docs/scene-files.md describes the format. Unknown keys are errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import mujoco
import numpy as np

from graceful_plan.exceptions import GracefulPlanError, SceneError, SettingError
from graceful_plan.scene import roles
from graceful_plan.scene.elements import (
    Adhesion,
    AllowedContact,
    Contents,
    EntityAnnotation,
    Fingers,
    Granular,
    Liquid,
    Notes,
    ObjectNote,
    Opening,
    TaskNote,
)
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.loading.concave import divide_surroundings
from graceful_plan.scene.loading.robot_models import robot_file, robots
from graceful_plan.scene.loading.self_contacts import link_contacts
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.wheels import described_drive
from graceful_plan.scene.model_parts import add_tool
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.scene import Scene, warn_of_mistakes
from graceful_plan.scene.specs import load_spec
from graceful_plan.scene.tasks import check_keyframes
from graceful_plan.yaml_file import Block, read_yaml

T = TypeVar("T")

_KEYS = (
    "version", "name", "description", "world", "convex", "self_collision", "robot", "base", "tool", "fingers", "state",
    "entities", "severity", "objects", "moving", "keyframes", "tasks", "allowed_contacts",
)  # fmt: skip
_ROBOT_KEYS = ("model", "prefix", "position", "quaternion", "body_class", "velocity", "acceleration", "torque",
                "limits", "joints")  # fmt: skip
_MOVING_KEYS = ("class", "size", "t", "position", "yaw", "spread", "growth", "severity")


def read_scene(file: Path) -> Scene:
    """Load a scene file.

    Raises:
        SceneError: If it or its world is broken or hostile, with file and line.
        UnsupportedError: If the model has unsupported features.
    """
    root = read_yaml(file)
    root.only(*_KEYS)
    root.check_version("scene files")
    notes = _notes(root, file)
    spec = _spec(root, file, notes.robot)
    add_tool(spec, notes.tool)
    convex = root.get("convex")
    with notes.about("convex"):
        divide_surroundings(spec, notes.robot, convex.string() if convex else None)
    self_collision = root.get("self_collision")
    with notes.about("self_collision"):
        kind = self_collision.string() if self_collision else "model"
        overlaps = link_contacts(spec, notes.robot, notes.tool, kind, notes.allowed, notes.joints)
    with notes.about("base"):
        base = notes.base or described_drive(spec, notes.robot, notes.joints)
    scene = Scene.build(spec, replace(notes, base=base, allowed=(*overlaps, *notes.allowed)))
    state = root.get("state")
    if state is not None:
        with scene.notes.about("state"):
            scene = scene.in_state(_state(state))
    _check_promises(scene)
    warn_of_mistakes(scene)
    return replace(scene, notes=replace(scene.notes, file=None, lines={}))


def _check_promises(scene: Scene) -> None:
    """Check objects and tasks now, with line numbers, rather than when a task is planned."""
    notes = scene.notes
    check_keyframes(notes, scene.limits)
    for name in notes.objects:
        with notes.about(f"objects.{name}"):
            X_TO = roles.FROM_ABOVE if notes.objects[name].X_TO is None else None  # the start of a task decides
            held = roles.held_note(scene.model, notes, scene.robot_bodies, name, X_TO=X_TO)
            if X_TO is not None and isinstance(held.fingers, Opening):
                held = replace(held, fingers=None)  # fingers cannot close at a grasp that is not known yet
            Scene.assemble(scene.posed, replace(notes, held=held, file=None))
    scene.tasks  # noqa: B018  raises if a task refers to a missing name


@dataclass
class _Lines:
    """Records the line numbers of named entries."""

    at: dict[str, int] = field(default_factory=dict)

    def table(self, root: Block, key: str, read: Callable[[str, Block], T]) -> dict[str, T]:
        """Read a mapping of named entries; return an empty one if it is absent."""
        found = {}
        section = root.get(key)
        for name, block in section.items() if section else ():
            self.at[f"{key}.{name}"] = block.line
            try:
                found[name] = read(name, block)
            except SceneError:
                raise
            except GracefulPlanError as error:
                raise block.error(f"{block.name}: {error}") from error
        return found


def _notes(root: Block, file: Path) -> Notes:
    lines = _Lines({key: block.line for key, block in root.items()})
    robot = root["robot"]
    robot.only(*_ROBOT_KEYS)
    prefix = _prefix(robot)
    name, description, tool, allowed = (root.get(key) for key in ("name", "description", "tool", "allowed_contacts"))
    body_class, joints = robot.get("body_class"), robot.get("joints")
    return Notes(
        name=name.string() if name else file.stem,
        description=description.string() if description else "",
        robot=prefix,
        tool=tool.string() if tool else f"{prefix}tool",
        joints=joints.strings() if joints else None,
        body_class=body_class.string() if body_class else "arm_collapse",
        fingers=_fingers(root.get("fingers")),
        limits=_limits(robot.get("limits")),
        velocity=_optional_numbers(robot.get("velocity")),
        acceleration=_optional_numbers(robot.get("acceleration")),
        torque=_optional_numbers(robot.get("torque")),
        base=_base(root.get("base")),
        entities=lines.table(root, "entities", _entity),
        severity=SeverityTable.shipped(),
        overrides=lines.table(root, "severity", lambda _, block: _number_or_numbers(block)),
        objects=lines.table(root, "objects", _object),
        moving=lines.table(root, "moving", _moving),
        keyframes=lines.table(root, "keyframes", lambda _, block: block.numbers()),
        tasks=lines.table(root, "tasks", _task),
        allowed=tuple(_allowed(block) for block in allowed.entries()) if allowed else (),
        file=str(file),
        lines=lines.at,
    )


def _state(block: Block) -> dict[str, Any] | str:
    if not block.is_mapping:
        return block.string()
    return {name: child.numbers() if child.is_list else child.number() for name, child in block.items()}


def _base(block: Block | None) -> DiffDrive | None:
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


def _limits(block: Block | None) -> dict[str, tuple[float, float]]:
    found = {name: pair.numbers(2) for name, pair in block.items()} if block else {}
    return {name: (pair[0], pair[1]) for name, pair in found.items()}


def _prefix(robot: Block) -> str:
    model, prefix = robot.get("model"), robot.get("prefix")
    if prefix is not None:
        return prefix.string()
    if model is None:
        raise robot.error("the robot needs a model, or the prefix of its bodies in the world")
    return f"{Path(model.string()).stem}/"


def _spec(root: Block, file: Path, prefix: str) -> mujoco.MjSpec:
    """Compose world and robot into one MjSpec."""
    world = _relative(file, root["world"])
    spec = load_spec(world)
    block = root["robot"].get("model")
    if block is None:
        return spec
    model = robot_file(block.string()) if block.string() in robots() else _relative(file, block)
    position, quaternion = root["robot"].get("position"), root["robot"].get("quaternion")
    frame = spec.worldbody.add_frame(
        pos=position.numbers(3) if position else (0.0, 0.0, 0.0),
        quat=_quaternion(quaternion) if quaternion else (1.0, 0.0, 0.0, 0.0),
    )
    try:
        spec.attach(load_spec(model), prefix=prefix, frame=frame)
    except ValueError as error:
        raise root["robot"].error(" ".join(str(error).split())) from None
    return spec


def _relative(file: Path, block: Block) -> Path:
    """Return a file in the folder of the scene file or below it."""
    given = Path(block.string())
    if "\0" in str(given):
        raise block.error(f"{str(given)!r} is not a file name")
    path = (file.parent / given).resolve()
    if given.is_absolute() or ".." in given.parts or not path.is_relative_to(file.parent.resolve()):
        raise block.error(f"{str(given)!r} is outside of the folder of the scene")
    if given.suffix != ".xml":
        raise block.error(f"{str(given)!r} is neither a MJCF file (.xml) nor a bundled robot: {', '.join(robots())}")
    if not path.is_file():
        raise block.error(f"there is no file {str(given)!r}")
    return path


def _entity(_name: str, block: Block) -> EntityAnnotation:
    if not block.is_mapping:
        return EntityAnnotation(category=block.string())
    block.only("class", "severity")
    severity = block.get("severity")
    return EntityAnnotation(
        category=block["class"].string(), severity=_number_or_numbers(severity) if severity else None
    )


def _moving(name: str, block: Block) -> MovingEntity:
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
        severity=_number_or_numbers(severity) if severity else None,
    )


def _object(name: str, block: Block) -> ObjectNote:
    block.only("body", "class", "grasp", "fingers", "grip", "contents")
    body, object_class, grasp, contents = (block.get(key) for key in ("body", "class", "grasp", "contents"))
    return ObjectNote(
        body=body.string() if body else name,
        X_TO=_pose(grasp) if grasp else None,
        object_class=object_class.string() if object_class else None,
        contents=_contents(contents) if contents else None,
        fingers=_fingers(block.get("fingers")),
        grip=_grip(block.get("grip")),
    )


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


def _task(_name: str, block: Block) -> TaskNote:
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


def _allowed(block: Block) -> AllowedContact:
    block.only("first", "second", "when")
    when = block.get("when")
    word = when.string() if when else "always"
    if word not in ("always", "ends"):
        raise block.error(f"when is {word!r}, expected always or ends")
    return AllowedContact(block["first"].string(), block["second"].string(), word)


def _pose(block: Block) -> np.ndarray:
    block.only("position", "quaternion")
    X = np.eye(4)
    position, quaternion = block.get("position"), block.get("quaternion")
    X[:3, 3] = position.numbers(3) if position else 0.0
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, np.array(_quaternion(quaternion) if quaternion else (0.0, 1.0, 0.0, 0.0)))
    X[:3, :3] = R.reshape(3, 3)
    return X


def _quaternion(block: Block) -> tuple[float, ...]:
    values = np.array(block.numbers(4))
    length = np.linalg.norm(values)
    if not 0.9 < length < 1.1:
        raise block.error(f"{block.name} has length {length:g}, expected 1 (wxyz)")
    return tuple((values / length).tolist())


def _number_or_numbers(block: Block) -> float | Mapping[str, float]:
    return {name: child.number() for name, child in block.items()} if block.is_mapping else block.number()


def _fingers(block: Block | None) -> Fingers | None:
    if block is None or not (block.is_mapping and block.get("opening")):
        return None if block is None else _number_or_numbers(block)
    block.only("opening")
    opening = block["opening"]
    return Opening(None if opening.is_string and opening.string() == "object" else opening.number())


def _optional_numbers(block: Block | None) -> tuple[float, ...] | None:
    return None if block is None else block.numbers()
