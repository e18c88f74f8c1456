"""Variants of the bundled scenes, with objects moved, removed and added, that no constant was fitted on.

Each variant is a few lines of data and a seed. Objects stay on their supports. Every end of a task differs from the
bundled scene, and some tasks carry objects that no bundled task carries. `problems` lists the errors of a variant;
there must be none.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np

import graceful_plan as gp
from benchmarks.variant_table import VARIANTS, Thing, Variant
from graceful_plan.exceptions import SceneError, UnknownNameError
from graceful_plan.scene.elements import ObjectNote, TaskNote

Array = np.ndarray

TOUCHES = 0.001
"""Largest penetration of objects [m]."""
_GAP = 0.004
"""Least distance between moved objects [m]."""
_ROOM = 0.01
"""Least clearance at the ends of a task [m], unless the bundled task has less, such as objects on a support."""
_TRIES = 4000
_END_SPREAD = 0.12
"""Standard deviation of each joint at the ends of a task from the bundled task [rad]."""


@cache
def load(name: str) -> gp.Scene:
    """Build a variant.

    Raises:
        UnknownNameError: If no variant has this name.
    """
    if name not in VARIANTS:
        raise UnknownNameError("variant", name, VARIANTS)
    variant = VARIANTS[name]
    base = gp.load_scene(variant.base)
    rng = np.random.default_rng(variant.seed)
    spec = base.spec.copy()
    for body in variant.remove:
        spec.delete(spec.body(body))
    for body, angle in variant.turn.items():
        spec.body(body).quat = [math.cos(angle / 2.0), 0.0, 0.0, math.sin(angle / 2.0)]
    for body, thing in variant.add.items():
        _add(spec, body, thing, variant.area)
    notes = replace(base.notes, name=name, file=None, entities=_entities(base, variant), tasks={}, keyframes={})
    notes = replace(notes, objects={key: note for key, note in notes.objects.items() if key not in variant.remove})
    _place(gp.Scene.build(spec.copy(), notes), spec, variant, rng)
    return _with_tasks(gp.Scene.build(spec, notes), base, variant, rng)


def problems(scene: gp.Scene) -> list[str]:
    """Return the errors of a scene: objects in each other, or out of reach."""
    data = _at_home(scene)
    return [
        f"{first} and {second} are {-distance * 1e3:.1f} mm in each other"
        for first, second, distance in _distances(scene.model, data, _free(scene), scene)
        if distance < -TOUCHES
    ]


def _entities(base: gp.Scene, variant: Variant) -> dict[str, gp.EntityAnnotation]:
    kept = {key: note for key, note in base.notes.entities.items() if key not in variant.remove}
    added = {key: gp.EntityAnnotation(category=x.category, severity=x.severity) for key, x in variant.add.items()}
    return kept | added


def _add(spec: mujoco.MjSpec, name: str, thing: Thing, area: tuple[float, ...]) -> None:
    kinds = {"box": mujoco.mjtGeom.mjGEOM_BOX, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER}
    size = [*thing.size, 0.0][:3]
    body = spec.worldbody.add_body(name=name, pos=[area[0], area[1], area[4] + thing.half_height])
    body.add_freejoint(name=name)
    body.add_geom(name=name, type=kinds[thing.kind], size=size, density=600.0, condim=4)


# --- positions -----------------------------------------------------------------------------------------------------


def _free(scene: gp.Scene) -> dict[str, int]:
    """Return the bodies that can move freely, by name."""
    model = scene.model
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    return {model.body(int(model.jnt_bodyid[j])).name: int(model.jnt_bodyid[j]) for j in free}


def _at_home(scene: gp.Scene) -> mujoco.MjData:
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.home_qpos
    mujoco.mj_kinematics(scene.model, data)
    return data


def _place(scene: gp.Scene, spec: mujoco.MjSpec, variant: Variant, rng: np.random.Generator) -> None:
    """Draw positions of the free bodies, one after the other, until none penetrates another, and store them."""
    model, data, bodies = scene.model, _at_home(scene), _free(scene)
    # Added objects may stand anywhere. The largest have the least choice and are placed first.
    size = {
        name: 2.0 if name in variant.keep else max(variant.add[name].size[:2]) for name in (*variant.keep, *variant.add)
    }
    order = sorted(bodies, key=lambda name: -size.get(name, 0.0))
    placed: list[str] = []
    for name in order:
        address = int(model.jnt_qposadr[model.body_jntadr[bodies[name]]])
        before = data.qpos[address : address + 7].copy()
        supports = _below(scene, data, bodies[name])
        others = {key: bodies[key] for key in placed}
        for attempt in range(_TRIES):
            # If small steps find no free position, larger ones are tried.
            data.qpos[address : address + 7] = _drawn(before, variant, name, 1.0 + attempt // 500, rng)
            mujoco.mj_kinematics(model, data)
            if name in variant.keep or _stands(scene, data, bodies[name], others, supports):
                break
        else:
            raise SceneError(f"there is no room for {name!r}")
        placed.append(name)
        body = spec.body(name)
        body.pos, body.quat = data.qpos[address : address + 3].copy(), data.qpos[address + 3 : address + 7].copy()


def _drawn(before: Array, variant: Variant, name: str, reach: float, rng: np.random.Generator) -> Array:
    pose = before.copy()
    if name in variant.keep:
        return pose
    if name in variant.add:
        pose[:2] = rng.uniform(variant.area[:2], variant.area[2:4])
        angle = rng.uniform(-math.pi, math.pi)
    else:
        pose[:2] += rng.uniform(-1.0, 1.0, size=2) * variant.shift.distance * reach
        angle = rng.uniform(-1.0, 1.0) * variant.shift.turn
    turn = np.array([math.cos(angle / 2.0), 0.0, 0.0, math.sin(angle / 2.0)])
    mujoco.mju_mulQuat(pose[3:], turn, before[3:])
    return pose


def _below(scene: gp.Scene, data: mujoco.MjData, body: int) -> set[int]:
    """Return the fixed geoms that a body touches, within a tolerance."""
    model = scene.model
    return {g for g in _fixed(scene) for own in _own(model, body) if _distance(model, data, own, g) < _GAP}


def _stands(scene: gp.Scene, data: mujoco.MjData, body: int, others: Mapping[str, int], supports: set[int]) -> bool:
    """Whether a body keeps its distance from all but its support, and its whole foot is on the support."""
    model, own = scene.model, _own(scene.model, body)
    moved = [g for other in others.values() for g in _own(model, other)]
    apart = all(_distance(model, data, a, b) >= _GAP for a in own for b in moved)
    if not apart or any(_distance(model, data, a, b) < _GAP for a in own for b in _fixed(scene) if b not in supports):
        return False
    return all(_has_under_it(model, data, corner, supports) for corner in _foot(model, data, own))


def _foot(model: mujoco.MjModel, data: mujoco.MjData, own: list[int]) -> Array:
    """Return the corners of the box around the lowest parts, in xy [m]."""
    corners = []
    for g in own:
        centre, half = model.geom_aabb[g, :3], model.geom_aabb[g, 3:]
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        corners.append(data.geom_xpos[g] + (centre + signs * half) @ data.geom_xmat[g].reshape(3, 3).T)
    points = np.concatenate(corners)
    return points[points[:, 2] < points[:, 2].min() + 0.01][:, :2]


def _has_under_it(model: mujoco.MjModel, data: mujoco.MjData, xy: Array, supports: set[int]) -> bool:
    for g in supports:
        at = (np.array([*xy, data.geom_xpos[g][2]]) - data.geom_xpos[g]) @ data.geom_xmat[g].reshape(3, 3)
        off = np.abs(at - model.geom_aabb[g, :3]) - model.geom_aabb[g, 3:]
        if (off[:2] <= 0.0).all():
            return True
    return False


def _own(model: mujoco.MjModel, body: int) -> list[int]:
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return np.flatnonzero((model.geom_bodyid == body) & collides).tolist()


def _fixed(scene: gp.Scene) -> list[int]:
    """Return the geoms that collide, do not move and are not the robot's."""
    model = scene.model
    still = (model.body_weldid[model.geom_bodyid] == 0) & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    return [g for g in np.flatnonzero(still).tolist() if int(model.geom_bodyid[g]) not in scene.robot_bodies]


def _distance(model: mujoco.MjModel, data: mujoco.MjData, first: int, second: int) -> float:
    return mujoco.mj_geomDistance(model, data, first, second, 0.05, None)


def _distances(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: Mapping[str, int], scene: gp.Scene
) -> list[tuple[str, str, float]]:
    found, names = [], list(bodies)
    for i, name in enumerate(names):
        for own in _own(model, bodies[name]):
            for other in names[i + 1 :]:
                found += [(name, other, _distance(model, data, own, g)) for g in _own(model, bodies[other])]
            for g in _fixed(scene):
                found.append((name, model.body(int(model.geom_bodyid[g])).name, _distance(model, data, own, g)))
    return found


# --- tasks ---------------------------------------------------------------------------------------------------------


def _with_tasks(scene: gp.Scene, base: gp.Scene, variant: Variant, rng: np.random.Generator) -> gp.Scene:
    """Return a variant with the bundled tasks reversed and between other ends, and with additional tasks."""
    objects = dict(scene.notes.objects)
    for name, height in variant.carry.items():
        X_TO = np.diag([1.0, -1.0, -1.0, 1.0])  # the tool points down, the object stands
        X_TO[2, 3] = height
        objects[name] = ObjectNote(body=name, X_TO=X_TO, fingers=0.03)
    scene = gp.Scene.build(scene.spec, replace(scene.notes, objects=objects))
    given = [(name, task) for name, task in base.tasks.items() if task.object_name in objects]
    todo = [(f"{name}_back", task, str(task.object_name)) for name, task in given]
    todo += [(f"{name}_with_{thing}", task, thing) for thing in variant.carry for name, task in given[:2]]
    tasks: dict[str, TaskNote] = {}
    for name, task, thing in todo:
        held = scene.attach(thing, support=task.support)
        start, goal = (_end(held, base_end, task, rng) for base_end in (task.goal[0], task.start))
        tasks[name] = TaskNote(start=start, goal=(goal,), object_name=thing, support=task.support)
    return gp.Scene.build(scene.spec, replace(scene.notes, tasks=tasks))


def _end(scene: gp.Scene, q: Array, task: gp.Task, rng: np.random.Generator) -> tuple[float, ...]:
    """Return a configuration near an end of a bundled task with at least its clearance."""
    room = min(_ROOM, float(gp.clearance(q, task.scene)))
    low, high = scene.limits.position.T
    for attempt in range(_TRIES):
        spread = _END_SPREAD * (1.0 + attempt // 200)
        near = np.clip(q + rng.normal(scale=spread, size=len(q)), low + 0.02, high - 0.02)
        if room > 0.0 and float(gp.clearance(near, scene)) >= room:
            return tuple(near.round(4).tolist())
        if room <= 0.0 and gp.clearance(near, scene) >= _ROOM:  # here the object is held in the air
            return tuple(near.round(4).tolist())
    raise SceneError(f"an end of {task.name!r} is not free")
