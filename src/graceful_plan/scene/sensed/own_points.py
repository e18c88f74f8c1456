"""Points of a cloud that lie on the robot or the object in its gripper, by exact shapes of the collision geometry."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.model_parts import colliding_geoms

_GEOM = mujoco.mjtGeom
_AT_A_TIME = 2_000_000
"""Number of heights of points over faces that are computed at a time; 16 MB."""


def on_robot(
    scene: SceneFacts, q: Float[Array, " nq"], points: Float[Array, "point 3"], margin: float
) -> Bool[Array, " point"]:
    """Return which points are within a margin of the robot or the object in its gripper.

    Near edges and corners of meshes, points up to a little farther away count as well.

    Args:
        scene: The scene.
        q: Configuration.
        points: Points in W [m].
        margin: Largest distance [m].
    """
    model, data = scene.model, scene.data_at(q)
    found = np.zeros(len(points), dtype=bool)
    for geom in colliding_geoms(model, scene.robot_bodies | scene.held_bodies):
        away = points - data.geom_xpos[geom]
        near = np.flatnonzero(~found & (np.einsum("ni,ni->n", away, away) <= (model.geom_rbound[geom] + margin) ** 2))
        inside = _distance(model, geom, away[near] @ data.geom_xmat[geom].reshape(3, 3)) <= margin
        found[near[inside]] = True
    return found


def _distance(model: mujoco.MjModel, geom: int, p: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Return the signed distance of points in the frame of a geom [m]: for meshes a bound, for ellipsoids linear."""
    kind, (a, b, c) = _GEOM(int(model.geom_type[geom])), model.geom_size[geom].tolist()
    if kind == _GEOM.mjGEOM_MESH:
        return _hull_distance(model, int(model.geom_dataid[geom]), p)
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        scaled = np.linalg.norm(p / [a, b, c], axis=1)
        slope = np.linalg.norm(p / np.square([a, b, c]), axis=1)  # times `scaled`: that of `scaled`
        return (scaled - 1.0) * scaled / np.maximum(slope, 1e-12)
    if kind == _GEOM.mjGEOM_CAPSULE:
        p = p - np.stack([0.0 * p[:, 0], 0.0 * p[:, 1], np.clip(p[:, 2], -b, b)], axis=1)
    if kind in (_GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_SPHERE):
        return np.linalg.norm(p, axis=1) - a
    if kind == _GEOM.mjGEOM_CYLINDER:
        over = np.stack([np.hypot(p[:, 0], p[:, 1]) - a, np.abs(p[:, 2]) - b], axis=1)
    else:
        over = np.abs(p) - [a, b, c]
    return np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1, initial=-np.inf), 0.0)


def _hull_distance(model: mujoco.MjModel, mesh: int, p: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """Return the greatest height of points over the faces of a mesh's hull, as MuJoCo computed them [m]."""
    faces = slice(int(model.mesh_polyadr[mesh]), int(model.mesh_polyadr[mesh] + model.mesh_polynum[mesh]))
    corner = model.mesh_polyvert[model.mesh_polyvertadr[faces]] + model.mesh_vertadr[mesh]
    normal = model.mesh_polynormal[faces]
    offset = np.einsum("fi,fi->f", normal, model.mesh_vert[corner])
    parts = np.array_split(p, max(1, len(p) * len(normal) // _AT_A_TIME))
    return np.concatenate([(part @ normal.T - offset).max(axis=1) for part in parts])
