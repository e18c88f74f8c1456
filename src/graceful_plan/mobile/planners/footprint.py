"""Discs around a robot, the floor map around its start and goals, and paths through points on the floor."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.mobile.planners.postures import BASE
from graceful_plan.scene.scene import Scene

_SLICES = 5
"""Largest number of discs of a cover."""
NEAR = 2.5
"""Distance from entities within which impact is evaluated [m]; a base that fails at 2 m/s hardly goes farther."""
_FLOOR = 0.03
"""Height up to which a base drives over objects [m]."""


def footprint(scene: Scene, q: Float[Array, " nq"]) -> tuple[Float[Array, "disc 3"], float]:
    """Return discs in the frame of the base that cover the robot in a posture, seen from above, and its height [m].

    The robot's spheres are divided along the heading, and each part gets the disc around its box. A robot that nothing
    can collide with has no spheres, and is a point.
    """
    robot = compile_scene(scene).robot
    at = np.concatenate([np.zeros(BASE), q[BASE:]])
    poses = compile_scene(scene).kernels.link_poses(at)
    link, spheres = np.asarray(robot.sphere_link), np.asarray(robot.sphere)
    own = np.asarray(link) > 0
    if not own.any():
        return np.zeros((1, 3)), 0.0
    centre = np.einsum("sij,sj->si", poses[link, :3, :3], spheres[:, :3]) + poses[link, :3, 3]
    centre, radius = centre[own], spheres[own, 3]
    low, high = float((centre[:, 0] - radius).min()), float((centre[:, 0] + radius).max())
    width = float((np.abs(centre[:, 1]) + radius).max())
    n = int(np.clip(math.ceil((high - low) / max(width, 1e-3)), 1, _SLICES))
    edges = np.linspace(low, high, n + 1)
    discs = []
    for a, b in pairwise(edges):
        inside = (centre[:, 0] - radius < b) & (centre[:, 0] + radius > a)
        if not inside.any():
            continue
        bottom, top = (centre[inside, 1] - radius[inside]).min(), (centre[inside, 1] + radius[inside]).max()
        discs.append([0.5 * (a + b), 0.5 * (bottom + top), math.hypot(0.5 * (b - a), 0.5 * (top - bottom))])
    return np.array(discs), float((centre[:, 2] + radius).max())


def radii(discs: Float[Array, "disc 3"]) -> tuple[float, float]:
    """Return the radius of the largest disc, and that of a disc around all of them centred on the base's origin [m]."""
    return float(discs[:, 2].max()), float((np.hypot(discs[:, 0], discs[:, 1]) + discs[:, 2]).max())


def floor_around(scene: Scene, top: float, ends: Float[Array, "end 2"], settings: tuple[float, float]) -> OccupancyGrid:
    """Cut the floor map around a base's start and goals from a scene.

    Args:
        scene: The scene.
        top: Height of the robot [m].
        ends: Start and goals [m].
        settings: Width of a cell, and extent of the map beyond the ends, within the limits of the base [m].
    """
    resolution, around = settings
    bounds = []
    for values, (low, high) in zip(ends.T, scene.limits.position[:2], strict=True):
        bounds += [max(low, values.min() - around) - 0.5, min(high, values.max() + around) + 0.5]
    heights = _FLOOR, max(top, 2.0 * _FLOOR)
    return OccupancyGrid.from_scene(scene, heights=heights, resolution=resolution, bounds=bounds)


def near_entities(xy: Float[Array, "row column 2"], scene: Scene) -> Bool[Array, "row column"]:
    """Return which places are near a static entity."""
    data = scene.data_at(np.clip(np.zeros(len(scene.joints)), *scene.limits.position.T))
    near = np.zeros(xy.shape[:2], dtype=bool)
    for entity in scene.entities.values():
        for geom in entity.geoms:
            reach = NEAR + float(scene.model.geom_rbound[geom])
            near |= np.linalg.norm(xy - data.geom_xpos[geom, :2], axis=-1) < reach
    return near


def turns_and_straights(
    xy: Float[Array, "point 2"],
    start: Float[Array, " nq"],
    goal: Float[Array, " nq"],
    gears: Bool[Array, " edge"] | None = None,
) -> Float[Array, "vertex nq"]:
    """Return the path through points with a turn in place at each; headings are continuous beyond pi.

    Args:
        xy: The points.
        start: Replaces the first point.
        goal: Replaces the last point.
        gears: Whether each stretch is driven forward; default: all of them.
    """
    points = np.concatenate([start[None, :2], xy[1:-1], goal[None, :2]])
    ahead = np.ones(len(points) - 1, dtype=bool) if gears is None else gears
    poses, yaw = [start[:BASE]], float(start[2])
    for a, b, forward in zip(points[:-1], points[1:], ahead, strict=True):
        if np.hypot(*(b - a)) > 0.0:
            direction = math.atan2(b[1] - a[1], b[0] - a[0]) + (0.0 if forward else math.pi)
            yaw += math.remainder(direction - yaw, 2.0 * math.pi)
            poses += [np.array([*a, yaw]), np.array([*b, yaw])]
    q = np.column_stack([poses, np.tile(start[BASE:], (len(poses), 1))])
    return np.concatenate([q, goal[None]])
