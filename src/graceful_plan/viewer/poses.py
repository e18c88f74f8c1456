"""Poses of all drawn parts for a batch of configurations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.shapes import Part


class Poses(NamedTuple):
    """Poses of parts in W at several moments."""

    position: Float[Array, "n part 3"]
    """Positions [m]."""
    quaternion: Float[Array, "n part 4"]
    """Quaternions wxyz."""


def poses_along(
    scene: Scene, drawn: Sequence[Part], q: Float[Array, "n nq"], t: Float[Array, " n"]
) -> tuple[Poses, Float[Array, "n 4 4"]]:
    """Return the poses of parts for each configuration, and the poses of the tool X_WT.

    Args:
        scene: Robot and surroundings.
        drawn: Parts of the scene.
        q: Configurations [rad or m].
        t: Times of the configurations, on the clock of the scene's predictions [s].
    """
    placement = Placement(scene)
    bodies = [part.body for part in drawn if part.body >= 0]
    moving = [scene.moving[part.name] for part in drawn if part.body < 0]
    position, quaternion = np.zeros((len(q), len(drawn), 3)), np.zeros((len(q), len(drawn), 4))
    X_WT = np.tile(np.eye(4), (len(q), 1, 1))
    site = scene.model.site(scene.tool).id
    for i, configuration in enumerate(q):
        data = placement.place(configuration)
        position[i, : len(bodies)], quaternion[i, : len(bodies)] = data.xpos[bodies], data.xquat[bodies]
        X_WT[i, :3, :3], X_WT[i, :3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    for k, entity in enumerate(moving, start=len(bodies)):
        place = entity.at(t)
        position[:, k] = place.position
        quaternion[:, k, 0], quaternion[:, k, 3] = np.cos(0.5 * place.yaw), np.sin(0.5 * place.yaw)
    return Poses(position, quaternion), X_WT


def quaternion_of(R: Float[Array, "3 3"]) -> Float[Array, " 4"]:
    """Return the quaternion wxyz of a rotation matrix."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R, dtype=float).ravel())
    return quaternion


def pose_of(position: Float[Array, " 3"], quaternion: Float[Array, " 4"]) -> Float[Array, "4 4"]:
    """Return a pose as a 4 x 4 matrix; the quaternion wxyz is normalised."""
    q, R, X = np.asarray(quaternion, dtype=float).copy(), np.empty(9), np.eye(4)
    mujoco.mju_normalize4(q)
    mujoco.mju_quat2Mat(R, q)
    X[:3, :3], X[:3, 3] = R.reshape(3, 3), position
    return X
