"""Between scenes and floor maps: discs around a robot, the map around where it may be, and ways over points."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.mobile.floor.floor_map import FloorMap
from graceful_plan.mobile.planners.postures import BASE
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_SLICES = 5
"""Discs of a cover, at most."""
NEAR = 2.5
"""How far from entities impact is looked at [m]: a base that fails at 2 m/s hardly goes farther."""
_FLOOR = 0.03
"""Heights that a base drives over [m]."""


def footprint(scene: Scene, q: Float[Array, " nq"]) -> tuple[Float[Array, "disc 3"], float]:
    """Return discs in the frame of the base that cover the robot in a posture, seen from above, and its height [m].

    The robot's spheres are divided along the heading, and each part gets the disc around its box.
    """
    robot = compile_scene(scene).robot
    at = np.concatenate([np.zeros(BASE), q[BASE:]])
    poses = compile_scene(scene).kernels.link_poses(at)
    link, spheres = np.asarray(robot.sphere_link), np.asarray(robot.sphere)
    own = np.asarray(link) > 0
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
    """Return the radii of the largest disc and of one around all of them, about the origin of the base [m]."""
    return float(discs[:, 2].max()), float((np.hypot(discs[:, 0], discs[:, 1]) + discs[:, 2]).max())


def floor_around(scene: Scene, top: float, ends: Float[Array, "end 2"], settings: tuple[float, float]) -> FloorMap:
    """Cut the map around where a base may be out of a scene.

    Args:
        scene: The scene.
        top: How high the robot is [m].
        ends: Start and goals [m].
        settings: Width of a cell, and how far beyond the ends the map reaches, if the limits of the base let it [m].
    """
    resolution, around = settings
    bounds = []
    for values, (low, high) in zip(ends.T, scene.limits.position[:2], strict=True):
        bounds += [max(low, values.min() - around) - 0.5, min(high, values.max() + around) + 0.5]
    heights = _FLOOR, max(top, 2.0 * _FLOOR)
    return FloorMap.from_scene(scene, heights=heights, resolution=resolution, bounds=bounds)


def near_entities(xy: Float[Array, "row column 2"], scene: Scene) -> Bool[Array, "row column"]:
    """Tell which places are near somebody who stands, or something that can be harmed."""
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
    """Return the way through points with a turn in place at each; headings go on beyond pi.

    Args:
        xy: The points.
        start: Takes the place of the first.
        goal: Takes the place of the last.
        gears: Whether each stretch is driven forward; all of them by default.
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
