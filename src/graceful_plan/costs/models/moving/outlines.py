"""Upright outlines of moving entities, and distances of points from them."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray


def outlines(entity: MovingEntity, place: Float[Array, "n 2"], yaw: Float[Array, " n"]) -> Float[Array, "n 7"]:
    """Return the outline of an entity at positions [m] with these yaw angles [rad], as in `CoastTables.shape`."""
    shape = np.zeros((len(place), 7))
    shape[:, :2] = place
    shape[:, 2], shape[:, 3] = np.cos(yaw), np.sin(yaw)
    if entity.is_round:
        shape[:, 6] = entity.size[0]
    else:
        shape[:, 4:6] = entity.size[:2]
    return shape


def outside(
    X: Float[Array, "row 4 4"],
    balls: Float[Array, "ball 4"],
    shape: Float[Array, "row 7"],
    height: Float[Array, " row"],
    half: float,
) -> Float[Array, " row"]:
    """Compute the distance of a link's spheres from upright outlines [m].

    Args:
        X: Poses of the link in W.
        balls: Centres in the link, and radii [m].
        shape: An outline for each pose.
        height: Height of the centre of each outline [m].
        half: Half of the height of the outlines [m].
    """
    p = balls[:, :3] @ X[:, :3, :3].swapaxes(1, 2) + X[:, None, :3, 3]
    beside = _beside(p[..., :2], shape)
    above = np.maximum(np.abs(p[..., 2] - height[:, None]) - half, 0.0)
    away = np.where(above > 0.0, np.hypot(np.maximum(beside, 0.0), above), beside)
    return (away - balls[:, 3]).min(axis=1)


def _beside(p: Float[Array, "row ball 2"], shape: Float[Array, "row 7"]) -> Float[Array, "row ball"]:
    """Return the signed distance of points from outlines in top view [m]."""
    d, x, y = p - shape[:, None, :2], shape[:, 2, None], shape[:, 3, None]
    along = np.abs(x * d[..., 0] + y * d[..., 1]) - shape[:, 4, None]
    across = np.abs(x * d[..., 1] - y * d[..., 0]) - shape[:, 5, None]
    away = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return away + np.minimum(np.maximum(along, across), 0.0) - shape[:, 6, None]
