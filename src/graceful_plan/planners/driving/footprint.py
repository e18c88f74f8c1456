"""What of a robot counts on a floor map: discs around it from above, and how high it is."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.planners.driving.postures import BASE
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_SLICES = 5
"""Discs of a cover, at most."""


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
