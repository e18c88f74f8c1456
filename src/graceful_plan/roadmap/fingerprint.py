"""What a roadmap depends on, as hashes: one per part, so that a difference can be named.

Severities, keyframes, tasks and looks are no part of it.
"""

from __future__ import annotations

import hashlib
import weakref
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import mujoco
import numpy as np

from graceful_plan._version import __version__
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.scene import Scene

Array = np.ndarray
Fingerprint = dict[str, str]
"""Hash of each part."""

MOVING = "moving entities"
_DECIMALS = 9
"""Poses are compared to a nanometre, since other machines round otherwise."""
_known: weakref.WeakKeyDictionary[Scene, Fingerprint] = weakref.WeakKeyDictionary()


def scene_fingerprint(scene: Scene) -> Fingerprint:
    """Return hashes of all of a scene that collisions and probabilities of impacts depend on."""
    if scene not in _known:
        data = scene.data_at(scene.model.qpos0[scene.qpos_adr])
        held = _subtree(scene, scene.notes.held.body) if scene.notes.held is not None else frozenset()
        rest = frozenset(range(scene.model.nbody)) - scene.robot_bodies - held
        tool = data.site(scene.tool)
        limits = scene.limits
        _known[scene] = {
            "library": __version__,
            "robot": _hash(_bodies(scene, data, scene.robot_bodies), tool.xpos, tool.xmat, scene.notes.body_class),
            "joints and limits": _hash(scene.joints, limits.position, limits.velocity),
            "carried object": _hash(_bodies(scene, data, held), *_carried(scene)),
            "surroundings": _hash(_bodies(scene, data, rest), scene.model.opt.gravity),
            "allowed contacts": _hash(_geom_names(scene, scene.collision_pairs().ravel().tolist())),
            "entities": _hash([(e.name, e.category, _geom_names(scene, e.geoms)) for e in scene.entities.values()]),
            MOVING: _hash([_prediction(entity) for entity in scene.moving.values()]),
        }
    return _known[scene]


def fingerprint(scene: Scene, objective: Objective) -> Fingerprint:
    """Return hashes of all that a roadmap depends on: the scene, and the objective but for its weight.

    Raises:
        SettingError: If a cost of one's own is not made of numbers, words and arrays.
    """
    impact: object = objective.impact
    if type(impact) is ImpactCost:  # with names of presets looked up
        model = impact.interaction
        impact = (impact.components, model, model.prior if isinstance(model, Footprint) else None)
    costs = _hash(objective.motion, impact, objective.exposure, objective.paces)
    return {**scene_fingerprint(scene), "costs": costs}


def same_but_for_severity(first: Scene, second: Scene) -> bool:
    """Tell quickly whether one scene comes of the other by `Scene.with_severity`; False if that is not certain."""
    if first.model is not second.model:
        return False
    names = (field.name for field in fields(first.notes) if field.name not in ("severity", "overrides"))
    pairs = ((getattr(first.notes, name), getattr(second.notes, name)) for name in names)
    return all(a is b or a == b for a, b in pairs)


def differences(first: Mapping[str, str], second: Mapping[str, str]) -> list[str]:
    """Name the parts that differ."""
    return [part for part in dict.fromkeys([*first, *second]) if first.get(part) != second.get(part)]


def _subtree(scene: Scene, name: str) -> frozenset[int]:
    model, root = scene.model, scene.model.body(name).id
    found = {root}
    for body in range(root + 1, model.nbody):  # parents come first
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return frozenset(found)


def _carried(scene: Scene) -> tuple[object, ...]:
    carried, components = scene.carried, scene.components
    parts = [(c.name, c.component_class, _geom_names(scene, c.geoms)) for c in components.values()]
    return (None if carried is None else (carried.X_TO, carried.object_class)), scene.contents, parts


def _prediction(entity: MovingEntity) -> dict[str, object]:
    return {field.name: getattr(entity, field.name) for field in fields(entity) if field.name != "severity"}


def _geom_names(scene: Scene, geoms: Iterable[int]) -> list[str]:
    """Name geoms by their bodies and their place in these, since ids change with what is added elsewhere."""
    model = scene.model
    ids = np.asarray(list(geoms), dtype=int)
    bodies = model.geom_bodyid[ids]
    return [
        f"{model.body(int(b)).name}:{int(g) - int(model.body_geomadr[b])}" for g, b in zip(ids, bodies, strict=True)
    ]


def _bodies(scene: Scene, data: mujoco.MjData, bodies: frozenset[int]) -> list[object]:
    """Everything about some bodies that matters, at the reference configuration."""
    model = scene.model
    parts = [g for owner in (*scene.entities.values(), *scene.components.values()) for g in owner.geoms]
    matters = set(scene.collision_pairs().ravel().tolist()) | set(parts)
    rows: list[object] = []
    for b in sorted(bodies):
        joints = [_joint(model, j) for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])]
        first, count = int(model.body_geomadr[b]), int(model.body_geomnum[b])
        geoms = [_geom(model, g) for g in range(first, first + count) if g in matters]
        if not (geoms or joints or b in scene.robot_bodies):
            continue
        mass = model.body_mass[b], model.body_inertia[b], model.body_ipos[b], model.body_iquat[b]
        rows.append((model.body(b).name, data.xpos[b], data.xmat[b], mass, joints, geoms))
    return rows


def _joint(model: mujoco.MjModel, j: int) -> tuple[object, ...]:
    dof = int(model.jnt_dofadr[j])
    forces = model.dof_armature[dof], model.dof_damping[dof], model.dof_frictionloss[dof]
    return int(model.jnt_type[j]), model.jnt_axis[j], model.jnt_pos[j], forces


def _geom(model: mujoco.MjModel, g: int) -> tuple[object, ...]:
    shape = int(model.geom_type[g]), model.geom_size[g], model.geom_pos[g], model.geom_quat[g], model.geom_aabb[g]
    mesh = int(model.geom_dataid[g])
    if model.geom_type[g] != mujoco.mjtGeom.mjGEOM_MESH or mesh < 0:
        return shape
    first = int(model.mesh_vertadr[mesh])
    return *shape, model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]


def _hash(*values: object) -> str:
    digest = hashlib.sha256()
    _feed(digest, values)
    return digest.hexdigest()


def _feed(digest: Any, value: object) -> None:
    """Add a value to a hash, with its type and length, so that no two values look alike."""
    if value is None or isinstance(value, str | bool | int):
        digest.update(f"{type(value).__name__}:{value!r};".encode())
    elif isinstance(value, np.ndarray | np.generic | float):
        array = np.asarray(value)
        if array.dtype.kind == "f":
            array = np.round(array.astype(np.float64), _DECIMALS) + 0.0
        elif array.dtype.kind not in "biu":
            raise _unknown(value)
        digest.update(f"array{array.shape}{array.dtype.kind}:".encode() + np.ascontiguousarray(array).tobytes())
    elif is_dataclass(value) and not isinstance(value, type):
        _feed(digest, f"{type(value).__module__}.{type(value).__qualname__}")
        _feed(digest, {field.name: getattr(value, field.name) for field in fields(value)})
    elif isinstance(value, Mapping):
        digest.update(f"mapping{len(value)}:".encode())
        for key in sorted(value, key=str):
            _feed(digest, key)
            _feed(digest, value[key])
    elif isinstance(value, Sequence):
        digest.update(f"sequence{len(value)}:".encode())
        for item in value:
            _feed(digest, item)
    else:
        raise _unknown(value)


def _unknown(value: object) -> SettingError:
    return SettingError(
        "objective", value, "costs that are dataclasses of numbers, words and arrays, to tell them apart"
    )
