"""Roles of bodies in a model: components that can do harm, entities that can be harmed, obstacles that are neither."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError, UnsupportedError
from graceful_plan.path import finite_array
from graceful_plan.scene.elements import (
    BODY_CLASSES,
    CARRIED_CLASSES,
    COMPONENTS,
    Adhesion,
    Component,
    Contents,
    Entity,
    EntityAnnotation,
    Fingers,
    Notes,
    ObjectNote,
)
from graceful_plan.scene.harm.severity import ITSELF, SeverityTable, check_severity
from graceful_plan.scene.loading.naming import lookup
from graceful_plan.scene.model_parts import collides, colliding_geoms, find, names, subtree
from graceful_plan.scene.moving import MovingEntity

_OBJ = mujoco.mjtObj
_Severity = float | Mapping[str, float]

FROM_ABOVE = np.diag([1.0, -1.0, -1.0, 1.0])
FROM_ABOVE.flags.writeable = False
"""A grasp X_TO: the object's origin at the tool, upright while the tool points down."""


def find_components(model: mujoco.MjModel, notes: Notes, robot: Collection[int]) -> Mapping[str, Component]:
    """Return the components by name: the moving links, the held object and its contents.

    Raises:
        SceneError: If a component has no colliding geoms.
        UnknownNameError: If a class or a geom does not exist.
    """
    moving = [b for b in robot if model.body_weldid[b] != 0]
    found = [_component("body", colliding_geoms(model, moving), notes.body_class, BODY_CLASSES)]
    if notes.held is not None:
        held = subtree(model, find(model, _OBJ.mjOBJ_BODY, "body", notes.held.body))
        inside = _contents_geoms(model, notes.held, held)
        outside = tuple(g for g in colliding_geoms(model, held) if g not in inside)
        found.append(_component("carried", outside, notes.held.object_class or "", CARRIED_CLASSES))
        if notes.held.contents is not None:
            found.append(_component("contents", inside, notes.held.contents.component_class, notes.severity.components))
    return MappingProxyType({component.name: component for component in found})


def _component(name: str, geoms: tuple[int, ...], component_class: str, valid: Collection[str]) -> Component:
    if component_class not in valid:
        raise UnknownNameError(f"class of component {name!r}", component_class, valid)
    if not geoms:
        raise SceneError(f"component {name!r} has no geoms that collide")
    return Component(name=name, geoms=geoms, component_class=component_class)


def _contents_geoms(model: mujoco.MjModel, held: ObjectNote, bodies: frozenset[int]) -> tuple[int, ...]:
    if held.contents is None:
        return ()
    in_object = {model.geom(g).name: g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in bodies}
    wanted = held.contents.geoms or (f"{held.body}_contents",)
    for name in wanted:
        if name not in in_object:
            raise UnknownNameError(f"geom for the contents of {held.body!r}", name, in_object)
    return tuple(sorted(in_object[name] for name in wanted))


def custom_entities(model: mujoco.MjModel) -> dict[str, EntityAnnotation]:
    """Read entity classes from the model's custom text `entity/BODY = CLASS`."""
    found = {}
    for i in range(model.ntext):
        name = bytes(model.names[model.name_textadr[i] :]).partition(b"\0")[0].decode()
        start = int(model.text_adr[i])
        category = bytes(model.text_data[start : start + int(model.text_size[i])]).rstrip(b"\0").decode()
        prefix, marker, body = name.partition("entity/")  # an attached model has its prefix before
        if marker and (not prefix or prefix.endswith("/")):
            found[prefix + body] = EntityAnnotation(category=category)
    return found


def find_entities(
    model: mujoco.MjModel, notes: Notes, robot: Collection[int], components: Mapping[str, Component]
) -> Mapping[str, Entity]:
    """Return the entities by name, in the order of declaration, without the held object.

    An entity has the colliding geoms of its body's subtree, except those of other entities in the subtree.

    Raises:
        SceneError: If an entity is part of the robot or has no geoms, or a severity is undefined.
        UnknownNameError: If a body or a class does not exist.
    """
    bodies = {}
    for name in notes.entities:
        with notes.about(f"entities.{name}"):
            bodies[name] = find(model, _OBJ.mjOBJ_BODY, "entity (body)", name)
            if bodies[name] in robot:
                raise SceneError(f"the entity {name!r} is part of the robot")
    by_entity, by_class = _split_overrides(notes)
    table = notes.severity.with_overrides(by_class)
    held = held_bodies(model, notes)
    entities = {}
    for name, note in notes.entities.items():
        with notes.about(f"entities.{name}"):
            table.check_class(note.category)
            if bodies[name] in held:
                continue
            inside = subtree(model, bodies[name])
            others = (subtree(model, b) for b in bodies.values() if b in inside and b != bodies[name])
            geoms = colliding_geoms(model, inside.difference(held, *others))
            if not geoms:
                raise SceneError(f"the entity {name!r} has no geoms that collide")
            severity = _severity_against(name, note, by_entity, table, components)
            entities[name] = Entity(name=name, category=note.category, geoms=geoms, severity=severity)
    return MappingProxyType(entities)


def moving_severities(
    model: mujoco.MjModel, notes: Notes, components: Mapping[str, Component]
) -> Mapping[str, Mapping[str, float]]:
    """Return the severity of each component against each moving entity.

    Raises:
        SceneError: If a moving entity has the name of a body or entity, or a severity is undefined.
        UnknownNameError: If a class does not exist.
    """
    by_entity, by_class = _split_overrides(notes)
    table = notes.severity.with_overrides(by_class)
    found = {}
    for name, entity in notes.moving.items():
        with notes.about(f"moving.{name}"):
            if name in notes.entities or lookup(model, _OBJ.mjOBJ_BODY, name) >= 0:
                raise SceneError(f"the name of the moving entity {name!r} is taken by a body of the scene")
            found[name] = _severity_against(name, entity, by_entity, table, components)
    return MappingProxyType(found)


def own_severity(notes: Notes, components: Mapping[str, Component]) -> float:
    """Return the severity of losing the carried object itself; 0 if nothing is carried or the table lacks a value."""
    if "carried" not in components:
        return 0.0
    _, by_class = _split_overrides(notes)
    row = notes.severity.with_overrides(by_class).rows.get(ITSELF, {})
    return row.get(components["carried"].component_class, 0.0)


def _severity_against(
    name: str,
    entity: EntityAnnotation | MovingEntity,
    by_entity: Mapping[str, _Severity],
    table: SeverityTable,
    components: Mapping[str, Component],
) -> Mapping[str, float]:
    """Return the severity of each component: the one declared for the entity, else the table's."""
    table.check_class(entity.category)
    declared = [_declared(name, value, table.components) for value in (by_entity.get(name), entity.severity)]
    found = {}
    for c in components.values():
        own = [row[key] for row in declared for key in (c.name, c.component_class) if key in row]
        found[c.name] = own[0] if own else table.severity(entity.category, c.component_class)
    return MappingProxyType(found)


def _split_overrides(notes: Notes) -> tuple[dict[str, Any], dict[str, Any]]:
    by_entity: dict[str, Any] = {}
    by_class: dict[str, Any] = {}
    for name, value in notes.overrides.items():
        with notes.about(f"severity.{name}"):
            if name in notes.entities or name in notes.moving:
                _declared(name, value, notes.severity.components)
                by_entity[name] = value
            elif name in notes.severity.classes:
                notes.severity.with_overrides({name: value})
                by_class[name] = value
            else:
                raise UnknownNameError(
                    "entity or entity class", name, {*notes.entities, *notes.moving, *notes.severity.classes}
                )
    return by_entity, by_class


def _declared(name: str, value: _Severity | None, classes: Collection[str]) -> dict[str, float]:
    """Check the severities declared for an entity: one for all components, or by component or component class."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        return dict.fromkeys(COMPONENTS, check_severity(f"severity of {name}", value))
    valid = (*COMPONENTS, *classes)
    for component in value:
        if component not in valid:
            raise UnknownNameError("component or component class", component, valid)
    return {
        component: check_severity(f"severity of {name} hit by {component}", number)
        for component, number in value.items()
    }


def held_bodies(model: mujoco.MjModel, notes: Notes) -> frozenset[int]:
    """Return the bodies in the gripper."""
    return frozenset() if notes.held is None else subtree(model, model.body(notes.held.body).id)


def unlabelled_bodies(model: mujoco.MjModel, notes: Notes, robot: Collection[int]) -> tuple[str, ...]:
    """Return the bodies with colliding geoms that belong neither to the robot, the held object nor an entity."""
    known = set(robot) | held_bodies(model, notes)
    for name in notes.entities:
        known |= subtree(model, model.body(name).id)
    having = np.unique(model.geom_bodyid[collides(model)]).tolist()
    rest = [b for b in having if b not in known]
    return tuple(names(model, _OBJ.mjOBJ_BODY, rest))


# --- held objects -----------------------------------------------------------------------------------------------------


def held_note(
    model: mujoco.MjModel,
    notes: Notes,
    robot: Collection[int],
    name: str,
    *,
    X_TO: ArrayLike | None = None,
    contents: Contents | None = None,
    object_class: str | None = None,
    fingers: Fingers | None = None,
    grip: Adhesion | None = None,
) -> ObjectNote:
    """Return how an object of the notes, or any other body, is held, with all defaults resolved.

    Raises:
        SettingError: If neither the object declares a grasp nor one is given.
        UnknownNameError: If there is no such object or body.
        UnsupportedError: If it cannot be held because it is part of the robot, a child of another body, or articulated.
    """
    note = notes.objects.get(name)
    if note is None:
        loose = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0 and b not in robot]
        valid = names(model, _OBJ.mjOBJ_BODY, loose)
        if lookup(model, _OBJ.mjOBJ_BODY, name) < 0:
            raise UnknownNameError("object or body that can be held", name, {*notes.objects, *valid})
        note = ObjectNote(body=name)
    body = find(model, _OBJ.mjOBJ_BODY, "body", note.body)
    _check_holdable(model, body, robot)
    pose = note.X_TO if X_TO is None else X_TO
    if pose is None:
        raise SettingError(
            f"grasp of {name!r}",
            None,
            "at=, a configuration in which the gripper holds it where it is, or X_TO=, such as FROM_ABOVE",
        )
    return replace(
        note,
        X_TO=rigid_pose("X_TO", pose),
        contents=note.contents if contents is None else contents,
        fingers=note.fingers if fingers is None else fingers,
        grip=note.grip if grip is None else grip,
        object_class=object_class or note.object_class or _class_by_mass(float(model.body_subtreemass[body])),
    )


def free_joint(model: mujoco.MjModel, body: int) -> int:
    """Return the address in qpos of a body's free joint; -1 if it has none."""
    joint = int(model.body_jntadr[body])
    is_free = joint >= 0 and int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_FREE)
    return int(model.jnt_qposadr[joint]) if is_free else -1


def _check_holdable(model: mujoco.MjModel, body: int, robot: Collection[int]) -> None:
    name = model.body(body).name
    if body in robot:
        raise UnsupportedError(f"{name!r} is part of the robot and cannot be held")
    if model.body_parentid[body] != 0:
        raise UnsupportedError(f"{name!r} is attached to another body and cannot be held")
    joints = sum(int(model.body_jntnum[b]) for b in subtree(model, body))
    if joints > (free_joint(model, body) >= 0):
        raise UnsupportedError(f"{name!r} has joints of its own; only rigid objects can be held")


def _class_by_mass(mass: float) -> str:
    return "light" if mass < 0.2 else "medium" if mass <= 1.0 else "heavy"


def rigid_pose(name: str, value: ArrayLike) -> Float[Array, "4 4"]:
    """Return a pose as a read-only 4 x 4 matrix.

    Raises:
        SettingError: If it is not a rotation and a translation.
    """
    pose = finite_array(name, value, ndim=2, last=4)
    R = pose[:3, :3]
    square = pose.shape == (4, 4) and pose[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    if not square or not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0.0:
        raise SettingError(name, pose.tolist(), "a 4 x 4 matrix of a rotation and a translation")
    pose = pose.copy()
    pose.flags.writeable = False
    return pose
