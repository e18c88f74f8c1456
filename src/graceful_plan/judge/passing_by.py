"""Whether a robot that drives into nobody who moves: where they are predicted to be, with exact geometry.

Only what the robot does counts, be it that it drives, turns in place or moves its arm: while it stands still, others
may walk into it. Places are those of the prediction; its spread is part of the impact, not of this check.
"""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.result import Check
from graceful_plan.scene.edit import Solid
from graceful_plan.scene.model_parts import colliding_geoms
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_STANDING = 0.01
"""Speed of every joint below which a robot stands still [m/s or rad/s]."""
_STEP = 0.02
"""How far robot and others move at most between two looks [m]."""
_MOST = 20_000
_FAR = 1.0
"""Clearance beyond which it is not measured [m]."""


def is_moving(qd: Float[Array, "n nq"]) -> Bool[Array, " n"]:
    """Tell at which velocities of its joints a robot does not stand still."""
    return np.abs(qd).max(axis=1) > _STANDING


def passing_check(motion: Trajectory, scene: Scene) -> Check:
    """Check a trajectory at its own times; the worst is the least clearance to somebody who moves [m]."""
    t = _times(motion, scene)
    state = motion.at(t)
    moves = is_moving(state.qd)
    model = _with_walkers(scene)
    placement, robot = Placement(scene, model), _robot_geoms(scene)
    worst, first, whom = _FAR, None, ""
    for name, entity in scene.moving.items():
        (geom,) = np.flatnonzero(model.geom_bodyid == model.body(name).id)
        body, there = int(model.body_mocapid[model.body(name).id]), entity.at(t)
        for k in np.flatnonzero(moves & _near(state.q, there.position, model, robot, int(geom))):
            placement.data.mocap_pos[body] = there.position[k]
            half = 0.5 * float(there.yaw[k])
            placement.data.mocap_quat[body] = [np.cos(half), 0.0, 0.0, np.sin(half)]
            data = placement.place(state.q[k])
            distance = min(mujoco.mj_geomDistance(model, data, own, int(geom), worst, None) for own in robot)
            if distance < 0.0 and first is None:
                first = float(t[k])
            if distance < worst:
                worst, whom = distance, name
    if first is not None:
        return Check(worst=worst, first=first, detail=f"drives into {whom!r}: {1e3 * worst:.3g} mm")
    told = f"{worst:.3g} m to {whom!r}" if whom else f"more than {_FAR:g} m to everybody"
    return Check(passed=True, worst=worst, detail=told)


def _times(motion: Trajectory, scene: Scene) -> Float[Array, " n"]:
    """Return times close enough that nobody moves far between them [s]."""
    walks = max(entity.top_speed for entity in scene.moving.values())
    drives = float(np.linalg.norm(motion.qd[:, :2], axis=1).max(initial=0.0))
    n = int(np.clip(np.ceil(motion.duration * (walks + drives) / _STEP), 1, _MOST))
    return motion.t[0] + motion.duration * np.linspace(0.0, 1.0, n + 1)


def _near(
    q: Float[Array, "n nq"],
    position: Float[Array, "n 3"],
    model: mujoco.MjModel,
    robot: tuple[int, ...],
    geom: int,
) -> Array:
    """Tell when somebody may be nearer than what is measured: no point of the robot is farther from its base."""
    reach = float(sum(np.linalg.norm(model.body_pos[b]) for b in {int(model.geom_bodyid[g]) for g in robot}))
    reach += float((model.geom_rbound[list(robot)] + np.linalg.norm(model.geom_pos[list(robot)], axis=1)).max())
    return np.linalg.norm(q[:, :2] - position[:, :2], axis=1) < reach + float(model.geom_rbound[geom]) + _FAR


def _robot_geoms(scene: Scene) -> tuple[int, ...]:
    bodies = scene.robot_bodies | ({scene.model.body(scene.carried.body).id} if scene.carried is not None else set())
    return colliding_geoms(scene.model, bodies)


@per_scene
def _with_walkers(scene: Scene) -> mujoco.MjModel:
    """Return the scene's model with a body for each entity that moves, behind all others."""
    spec = scene.spec.copy()
    for entity in scene.moving.values():
        pose = np.eye(4)
        pose[:3, 3] = entity.position[0]
        kind = "cylinder" if entity.is_round else "box"
        Solid(name=entity.name, kind=kind, size=entity.size, pose=pose).add_to(spec)
        spec.body(entity.name).mocap = True
    return spec.compile()
