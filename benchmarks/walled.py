"""Scenes of `unseen/` with walls put up beside the ways of their tasks: what flies against them falls down in front.

Each wall is a fixed box, from a low board to a high partition, at any angle and any distance from the tool's straight
way at which the ends of all tasks stay free. No constant was fitted, and nothing else chosen, on any of these scenes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import mujoco
import numpy as np

import graceful_plan as gp
from benchmarks import suite
from graceful_plan.exceptions import SceneError, UnknownNameError

Array = np.ndarray

VERSIONS = 2
"""Of each scene, with other walls."""
WALLS = 2
"""In each version."""
_SEED = 5200
"""Step 0 of the drop model was chosen by looking at drops in those of 4100."""
_ROOM = 0.02
"""Least clearance of the ends of tasks [m]."""
_TRIES = 400
_THICK = 0.02
"""Half of a wall's thickness [m]."""
_HALF_LENGTH, _HEIGHT = (0.08, 0.3), (0.1, 0.7)
"""Least and greatest, height above the support [m]."""
_BESIDE = (0.05, 0.3)
"""How far from the tool's straight way [m]."""


class _Wall(NamedTuple):
    centre: Array
    yaw: float
    half: Array


def names() -> tuple[str, ...]:
    """Return the names of all versions of all scenes."""
    return tuple(f"{scene}_walled_{k}" for scene in suite.unseen_scenes() for k in range(1, VERSIONS + 1))


@cache
def load(name: str) -> gp.Scene:
    """Build a version of a scene.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if name not in names():
        raise UnknownNameError("walled scene", name, names())
    scene = suite.scene(name.rsplit("_walled_", 1)[0])
    rng = np.random.default_rng(_SEED + names().index(name))
    for k in range(WALLS):
        scene = _with_wall(scene, f"wall_{k + 1}", name, rng)
    return scene


def _with_wall(scene: gp.Scene, wall: str, name: str, rng: np.random.Generator) -> gp.Scene:
    entities = {**scene.notes.entities, wall: gp.EntityAnnotation(category="table")}
    for _ in range(_TRIES):
        x = _drawn(scene, rng)
        if not _is_free(scene, x):
            continue
        spec = scene.spec.copy()
        quat = [math.cos(x.yaw / 2.0), 0.0, 0.0, math.sin(x.yaw / 2.0)]
        body = spec.worldbody.add_body(name=wall, pos=x.centre, quat=quat)
        body.add_geom(name=wall, type=mujoco.mjtGeom.mjGEOM_BOX, size=x.half, condim=4)
        found = gp.Scene.build(spec, replace(scene.notes, name=name, file=None, entities=entities))
        ends = [(task, np.vstack([task.start, *task.goal])) for task in found.tasks.values()]
        if all(np.min(gp.clearance(q, task.scene)) >= _ROOM for task, q in ends):
            return found
    raise SceneError(f"there is no room for {wall!r} in {name!r}")


def _drawn(scene: gp.Scene, rng: np.random.Generator) -> _Wall:
    """Draw a wall beside the straight way of a task; it stands where that task's things do."""
    tasks = list(scene.tasks.values())
    task = tasks[rng.integers(len(tasks))]
    share = rng.uniform()
    q = (1.0 - share) * task.start + share * task.goal[0]
    place = gp.StateBatch(task.scene, q[None]).tool_poses[0, :3, 3]
    support = min(_lowest(task.scene, end) for end in (task.start, task.goal[0]))
    yaw, height = rng.uniform(-math.pi, math.pi), rng.uniform(*_HEIGHT)
    away = rng.uniform(*_BESIDE) + _THICK
    along = rng.uniform(-0.1, 0.1)
    centre = place[:2] + away * np.array([math.cos(yaw), math.sin(yaw)])
    centre = centre + along * np.array([-math.sin(yaw), math.cos(yaw)])
    half = np.array([_THICK, rng.uniform(*_HALF_LENGTH), height / 2.0])
    return _Wall(np.array([*centre, support + height / 2.0]), yaw, half)


def _lowest(scene: gp.Scene, q: Array) -> float:
    """Return how low what is carried reaches, as it stands at the end of a task [m]."""
    data, geoms = scene.data_at(q), list(scene.components["carried"].geoms)
    mujoco.mj_kinematics(scene.model, data)
    R = data.geom_xmat[geoms].reshape(-1, 3, 3)
    half, middle = scene.model.geom_aabb[geoms, 3:], scene.model.geom_aabb[geoms, :3]
    z = data.geom_xpos[geoms][:, 2] + np.einsum("gj,gj->g", R[:, 2], middle)
    return float(np.min(z - np.einsum("gj,gj->g", np.abs(R[:, 2]), half)))


def _is_free(scene: gp.Scene, wall: _Wall) -> bool:
    """Whether a wall stands apart from all things, seen as balls, but for what is wide: floors, tables, shelves."""
    model = scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = scene.home_qpos
    mujoco.mj_kinematics(model, data)
    x, y = np.array([math.cos(wall.yaw), math.sin(wall.yaw)]), np.array([-math.sin(wall.yaw), math.cos(wall.yaw)])
    for geom in range(model.ngeom):
        if int(model.geom_bodyid[geom]) in scene.robot_bodies or model.geom_contype[geom] == 0:
            continue
        away, reach = data.geom_xpos[geom] - wall.centre, model.geom_aabb[geom, 3:].max()
        off = np.array([abs(x @ away[:2]), abs(y @ away[:2]), abs(away[2])]) - wall.half
        moves = model.body_weldid[model.geom_bodyid[geom]] != 0
        if moves and np.linalg.norm(np.maximum(off, 0.0)) < reach + 0.004:
            return False
    return True
