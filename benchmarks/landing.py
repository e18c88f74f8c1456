"""Algorithm 1 of the paper at the ballistic landing point of the object, to account for speed and height.

For each geom of an entity, the boxes of the carried object move along the flight of its centre of mass until the lowest
box is at the height of that geom's top. Everything else is as in the paper, including the comparison of heights at the
release: see `graceful_plan.judge.reference_cost`.
"""

from __future__ import annotations

import mujoco
import numpy as np

import graceful_plan as gp
from graceful_plan.array_types import Float
from graceful_plan.scene.placement import Placement

Array = np.ndarray

GRAVITY = 9.81
_AHEAD = 1e-5
"""Time step of the finite difference of velocities [s]."""


def landed_probability(scene: gp.Scene, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Float[Array, "n entity"]:
    """Return P(the carried object hits the entity) by Algorithm 1 at the landing point.

    Args:
        scene: Scene with an object in the gripper.
        q: Configurations at the release.
        qd: Velocities at the release.
    """
    parts = list(scene.components["carried"].geoms)
    low, high, velocity = _object(scene, parts, q, qd)
    still = Placement(scene).place(q[0])
    area = np.prod((high - low)[..., :2], axis=-1).sum(axis=1)
    bottom, peak = low[..., 2].min(axis=1), high[..., 2].max(axis=1)
    P = np.zeros((len(q), len(scene.entities)))
    for column, entity in zip(P.T, scene.entities.values(), strict=True):
        geoms = list(entity.geoms)
        floors, tops = _boxes(scene, still.geom_xpos[geoms], still.geom_xmat[geoms], geoms)
        overlap, whole = np.zeros(len(q)), float(np.prod((tops - floors)[:, :2], axis=-1).sum())
        for floor, top in zip(floors, tops, strict=True):
            drop = np.maximum(0.0, bottom - top[2])
            time = (velocity[:, 2] + np.sqrt(velocity[:, 2] ** 2 + 2.0 * GRAVITY * drop)) / GRAVITY
            shift = (velocity[:, :2] * np.maximum(0.0, time)[:, None])[:, None]
            common = np.minimum(high[..., :2] + shift, top[:2]) - np.maximum(low[..., :2] + shift, floor[:2])
            overlap += np.prod(np.maximum(0.0, common), axis=-1).sum(axis=1)
        above = bottom > tops[:, 2].max()
        beside = np.minimum(peak, tops[:, 2].max()) > np.maximum(bottom, floors[:, 2].min())
        column[:] = np.where(above | beside, overlap * np.maximum(1.0 / whole if whole else 0.0, 1.0 / area), 0.0)
    return np.minimum(P, 1.0)


def _object(
    scene: gp.Scene, parts: list[int], q: Float[Array, "n nq"], qd: Float[Array, "n nq"]
) -> tuple[Float[Array, "n geom 3"], Float[Array, "n geom 3"], Float[Array, "n 3"]]:
    """Return lower and upper corners of the carried object's boxes [m] and the velocity of its centre of mass [m/s]."""
    assert scene.carried is not None
    placement, body = Placement(scene), scene.model.body(scene.carried.body).id
    corners, velocity = [], np.empty((len(q), 3))
    for i, (configuration, rate) in enumerate(zip(q, qd, strict=True)):
        ahead, behind = (_centre(placement.place(configuration + dt * rate), body) for dt in (_AHEAD, -_AHEAD))
        velocity[i] = (ahead - behind) / (2.0 * _AHEAD)
        data = placement.place(configuration)
        corners.append(_boxes(scene, data.geom_xpos[parts], data.geom_xmat[parts], parts))
    return np.array([low for low, _ in corners]), np.array([high for _, high in corners]), velocity


def _centre(data: mujoco.MjData, body: int) -> Array:
    return data.xipos[body].copy()


def _boxes(scene: gp.Scene, xpos: Array, xmat: Array, geoms: list[int]) -> tuple[Array, Array]:
    turned, aabb = xmat.reshape(-1, 3, 3), scene.model.geom_aabb[geoms]
    centre = xpos + np.einsum("gij,gj->gi", turned, aabb[:, :3])
    half = np.einsum("gij,gj->gi", np.abs(turned), aabb[:, 3:])
    return centre - half, centre + half
