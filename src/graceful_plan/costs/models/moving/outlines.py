"""Upright outlines of moving entities."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.moving import MovingEntity


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
