"""A robot as few balls, whatever its arm does: how far it is from those who move, in any posture."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.moving.outlines import outlines, outside
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_LARGEST = 0.12
"""Radius of a ball, unless a single sphere of the robot is larger [m]."""
FAR = 0.5
"""Beyond this, gaps are only known to be at least what they are said to be [m]."""
_AT_ONCE = 400_000
"""Rows times balls that are looked at at once, to bound memory."""


@final
class Balls:
    """Balls around the spheres that cover a robot and what it carries.

    Args:
        scene: With the robot.
    """

    def __init__(self, scene: Scene) -> None:
        compiled = compile_scene(scene)
        robot, self._kernels = compiled.robot, compiled.kernels
        links = np.unique(robot.sphere_link[robot.sphere_link > 0])
        divided = [np.array(_divided(robot.sphere[robot.sphere_link == link])) for link in links]
        self._groups = [(int(k), robot.bound[k], balls) for k, balls in zip(links, divided, strict=True)]

    def gap(self, q: Float[Array, "n nq"], entity: MovingEntity, t: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return how far the robot is from somebody at times, as predicted [m]; farther than `FAR` it is at least that.

        Args:
            q: Configurations.
            entity: Who moves.
            t: When [s].
        """
        there = entity.at(t)
        shape, height = outlines(entity, there.position[:, :2], there.yaw), there.position[:, 2]
        gap, poses = np.full(len(q), np.inf), self._kernels.link_poses(q)
        place = shape, height, float(entity.half_size[2])
        for link, bound, balls in self._groups:
            around = outside(poses[:, link], bound[None], *place)
            near = np.flatnonzero(around < np.minimum(gap, FAR))
            gap = np.where(around < FAR, gap, np.minimum(gap, around))
            for rows in np.array_split(near, -(-len(near) * len(balls) // _AT_ONCE) or 1):
                found = outside(poses[rows, link], balls, shape[rows], height[rows], place[2])
                gap[rows] = np.minimum(gap[rows], found)
        return gap


def _divided(spheres: Float[Array, "sphere 4"]) -> list[Float[Array, " 4"]]:
    """Return balls that hold all spheres: halves of a row of them, again and again, until each is small."""
    low, high = spheres[:, :3].min(axis=0), spheres[:, :3].max(axis=0)
    centre = 0.5 * (low + high)
    radius = float((np.linalg.norm(spheres[:, :3] - centre, axis=1) + spheres[:, 3]).max())
    if len(spheres) == 1 or radius <= _LARGEST:
        return [np.append(centre, radius)]
    axis = int(np.argmax(high - low))
    left = spheres[:, axis] <= centre[axis]
    if left.all():  # all in one place
        return [np.append(centre, radius)]
    return [*_divided(spheres[left]), *_divided(spheres[~left])]
