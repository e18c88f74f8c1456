"""Scene data of the body model: inertias, drives, and the entity of each obstacle.

Frames: W world, F a frame of the arm: 0 is the base, k + 1 moves with planned joint k.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.frames import body_frames
from graceful_plan.core.link_groups import link_geoms
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

ROWS = ("body", "carried")
"""Components that the model supports, in this order."""


@final
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BodyTables:
    """Tables of the body model.

    | field      | meaning                                                                | unit        | shape     |
    |------------|------------------------------------------------------------------------|-------------|-----------|
    | mass       | of all bodies on a frame, including the carried object                 | kg          | frame     |
    | centre     | centre of mass in F                                                    | m           | frame 3   |
    | inertia    | about that centre, in the axes of F                                    | kg m^2      | frame 3 3 |
    | lower      | lower position limit                                                   | rad         | nq        |
    | upper      | upper position limit                                                   | rad         | nq        |
    | armature   | inertia of the rotor                                                   | kg m^2      | nq        |
    | damping    | viscous resistance of a joint without power                            | N m s/rad   | nq        |
    | friction   | dry friction                                                           | N m         | nq        |
    | speed      | velocity limit                                                         | rad/s       | nq        |
    | link_row   | index into `ROWS` of the spheres of each link, -1 for the base or none |             | link      |
    | entity     | entity of each obstacle, -1 for none                                   |             | obstacle  |
    | n_row      | 2 if something is carried, 1 otherwise                                 |             |           |
    """

    mass: Float[Array, " frame"]
    centre: Float[Array, "frame 3"]
    inertia: Float[Array, "frame 3 3"]
    lower: Float[Array, " nq"]
    upper: Float[Array, " nq"]
    armature: Float[Array, " nq"]
    damping: Float[Array, " nq"]
    friction: Float[Array, " nq"]
    speed: Float[Array, " nq"]
    link_row: Int[Array, " link"]
    entity: Int[Array, " obstacle"]
    n_row: int


@per_scene
def body_tables(scene: Scene) -> BodyTables:
    """Return the tables of a scene; they are cached per scene.

    Raises:
        UnsupportedError: If the scene cannot be compiled.
    """
    model, compiled = scene.model, compile_scene(scene)
    mass, centre, inertia = _inertias(scene)
    joints = [model.joint(name).id for name in scene.joints]
    dofs = model.jnt_dofadr[joints]
    owner = {geom: k for k, entity in enumerate(scene.entities.values()) for geom in entity.geoms}
    geoms = compiled.world.geom
    return BodyTables(
        mass=mass,
        centre=centre,
        inertia=inertia,
        lower=compiled.robot.lower.copy(),
        upper=compiled.robot.upper.copy(),
        armature=model.dof_armature[dofs].astype(float),
        damping=np.ravel(model.dof_damping[dofs]).astype(float),
        friction=model.dof_frictionloss[dofs].astype(float),
        speed=scene.limits.velocity.copy(),
        link_row=_rows(scene),
        entity=np.array([owner.get(int(geom), -1) for geom in geoms], dtype=int),
        n_row=2 if scene.carried is not None else 1,
    )


def _rows(scene: Scene) -> Int[Array, " link"]:
    held = set(scene.components["carried"].geoms) if "carried" in scene.components else set()
    robot = compile_scene(scene).robot
    frame = np.where(robot.joint >= 0, np.arange(len(robot.parent)), robot.parent)
    return np.array(
        [
            -1 if not geoms or frame[link] <= 0 else int(bool(held & set(geoms)))
            for link, geoms in enumerate(link_geoms(scene))
        ],
        dtype=int,
    )


def _inertias(scene: Scene) -> tuple[Float[Array, " frame"], Float[Array, "frame 3"], Float[Array, "frame 3 3"]]:
    """Compute the composite inertia of all bodies on each frame, with the fingers at their held position."""
    model, n_frame = scene.model, len(scene.joints) + 1
    reference = model.qpos0[scene.qpos_adr].astype(float)
    data = scene.data_at(reference)
    frame_of = body_frames(scene)
    X_WF = compile_scene(scene).kernels.link_poses(reference)[:n_frame]
    moving = set(scene.robot_bodies)
    if scene.carried is not None:
        root = model.body_rootid[model.body(scene.carried.body).id]
        moving |= {body for body in range(model.nbody) if model.body_rootid[body] == root}
    mass, moment, second = np.zeros(n_frame), np.zeros((n_frame, 3)), np.zeros((n_frame, 3, 3))
    for body in sorted(moving):
        frame, m = frame_of[body], float(model.body_mass[body])
        if frame == 0 or m == 0.0:  # the base does not move
            continue
        R_WF, p_WF = X_WF[frame, :3, :3], X_WF[frame, :3, 3]
        R = R_WF.T @ data.ximat[body].reshape(3, 3)
        p = R_WF.T @ (data.xipos[body] - p_WF)
        mass[frame] += m
        moment[frame] += m * p
        second[frame] += R @ np.diag(model.body_inertia[body]) @ R.T + m * _spread(p)
    centre = moment / np.maximum(mass, np.finfo(float).tiny)[:, None]
    return mass, centre, np.array([second[f] - mass[f] * _spread(centre[f]) for f in range(n_frame)])


def _spread(p: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    """Return the inertia of a unit mass at p about the origin."""
    return np.dot(p, p) * np.eye(3) - np.outer(p, p)


def native_rows(tables: BodyTables, sphere_link: Int[Array, " sphere"]) -> Int[Array, " group"]:
    """Return the rows of the links that have spheres; the core numbers groups of spheres in this order."""
    return tables.link_row[np.unique(sphere_link)]
