"""Scene files: YAML next to an MJCF world; docs/scene-files.md describes the format. Unknown keys are errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import mujoco

from graceful_plan.exceptions import GracefulPlanError, SceneError
from graceful_plan.scene import roles
from graceful_plan.scene.elements import (
    Notes,
    Opening,
)
from graceful_plan.scene.harm.severity import SeverityTable
from graceful_plan.scene.loading.concave import divide_surroundings
from graceful_plan.scene.loading.entries import (
    base_entry,
    contact_entry,
    entity_entry,
    fingers_entry,
    limits_entry,
    moving_entry,
    numbers_entry,
    object_entry,
    quaternion_entry,
    severity_entry,
    state_entry,
    task_entry,
)
from graceful_plan.scene.loading.robot_models import robot_file, robots
from graceful_plan.scene.loading.self_contacts import link_contacts
from graceful_plan.scene.mobile.wheels import described_drive
from graceful_plan.scene.model_parts import add_tool
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
            scene = scene.in_state(state_entry(state))
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
        fingers=fingers_entry(root.get("fingers")),
        limits=limits_entry(robot.get("limits")),
        velocity=numbers_entry(robot.get("velocity")),
        acceleration=numbers_entry(robot.get("acceleration")),
        torque=numbers_entry(robot.get("torque")),
        base=base_entry(root.get("base")),
        entities=lines.table(root, "entities", entity_entry),
        severity=SeverityTable.shipped(),
        overrides=lines.table(root, "severity", lambda _, block: severity_entry(block)),
        objects=lines.table(root, "objects", object_entry),
        moving=lines.table(root, "moving", moving_entry),
        keyframes=lines.table(root, "keyframes", lambda _, block: block.numbers()),
        tasks=lines.table(root, "tasks", task_entry),
        allowed=tuple(contact_entry(block) for block in allowed.entries()) if allowed else (),
        file=str(file),
        lines=lines.at,
    )


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
        quat=quaternion_entry(quaternion) if quaternion else (1.0, 0.0, 0.0, 0.0),
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
