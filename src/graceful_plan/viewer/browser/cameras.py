"""Cameras of the page: the initial view, and the view of two copies of the scene side by side."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.question import Question

_GAP = 0.4
"""Distance between two copies of the scene [m]."""
_ASIDE = 0.35
"""Angle of the camera to the line from the robot to its workspace [rad]; also used as a distance [m]."""


@final
class Cameras:
    """Cameras of all present and future browsers of a page.

    Args:
        server: viser's server.
        question: Request whose start and goal determine the initial view.
    """

    def __init__(self, server: Any, question: Question) -> None:
        self._server, self._shifted = server, np.zeros(3)
        ends = np.stack([question.handle_pose(question.start)[:3, 3], question.goal_pose()[:3, 3]])
        middle, way = ends.mean(axis=0), ends[1] - ends[0]
        length = float(np.linalg.norm(way))
        if question.scene.base is not None:  # from above the walls, with the path from left to right
            yaw, out, up, far = float(np.arctan2(way[1], way[0])) - 0.5 * np.pi, 0.45, 0.9, 2.0 + 0.75 * length
        else:
            ahead = middle - _first_joint(question)
            yaw = float(np.arctan2(ahead[1], ahead[0])) + _ASIDE if np.hypot(*ahead[:2]) > _ASIDE else -0.8
            out, up, far = 1.0, 0.7, max(1.2, 1.2 * length)
        camera = server.initial_camera
        camera.look_at, camera.up = middle, (0.0, 0.0, 1.0)
        camera.position = middle + far * np.array([out * np.cos(yaw), out * np.sin(yaw), up])
        self._right = np.array([-np.sin(yaw), np.cos(yaw), 0.0])

    def beside(self, scene: Scene) -> Float[Array, " 3"]:
        """Return the offset of a second copy of the scene [m], along x or y, to the right in the initial view."""
        axis = int(np.argmax(np.abs(self._right)))
        return (_extent(scene)[axis] + _GAP) * np.sign(self._right[axis]) * np.eye(3)[axis]

    def take_in(self, shift: Float[Array, " 3"]) -> None:
        """Move the cameras to include a copy of the scene at an offset [m]; an offset of 0 moves them back."""
        more, farther = shift - self._shifted, float(np.linalg.norm(shift) - np.linalg.norm(self._shifted))
        self._shifted = shift
        if not more.any():
            return
        for camera in (self._server.initial_camera, *(client.camera for client in self._server.get_clients().values())):
            position, target = np.asarray(camera.position), np.asarray(camera.look_at)
            back = (position - target) / np.linalg.norm(position - target)
            camera.position = position + 0.5 * more + 0.6 * farther * back
            camera.look_at = target + 0.5 * more


def _first_joint(question: Question) -> Float[Array, " 3"]:
    """Return the position of the robot's first joint at the start, in W [m]."""
    scene = question.scene
    return np.array(scene.data_at(question.start).joint(scene.joints[0]).xanchor)


def _extent(scene: Scene) -> Float[Array, " 2"]:
    """Return the extent of the scene along x and y without planes [m]."""
    model, data = scene.model, scene.data_at(scene.model.qpos0[scene.qpos_adr])
    geoms = np.flatnonzero((model.geom_rbound > 0.0) & (model.geom_group < 3))
    R = data.geom_xmat[geoms].reshape(-1, 3, 3)
    centre = data.geom_xpos[geoms] + np.einsum("nij,nj->ni", R, model.geom_aabb[geoms, :3])
    half = np.einsum("nij,nj->ni", np.abs(R), model.geom_aabb[geoms, 3:])
    return np.asarray((centre + half).max(axis=0) - (centre - half).min(axis=0))[:2]
