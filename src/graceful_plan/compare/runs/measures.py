"""What is measured of a motion besides its cost: jerk and exact clearance. Nothing of it is in any time."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Int
from graceful_plan.judge.motion_samples import motion_samples
from graceful_plan.path import Path
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

JERK_STEP = 0.02
"""Time between the waypoints that jerk is computed from [s], a usual rate of commands to an arm."""
CLEARANCE_STEP = 0.01
"""No point of the robot moves farther than this between two measurements of clearance [m]."""
FARTHEST = 1.0
"""Clearances are not measured beyond this [m]."""


def jerk(trajectory: Trajectory) -> tuple[float, float]:
    """Return the peak and the root mean square of the waypoint jerk [rad/s^3].

    The acceleration of a timed path may jump, so its jerk has no greatest value. What an arm is sent are waypoints:
    positions every `JERK_STEP`. Their third difference over the cube of the step is taken, from rest before the start
    to rest after the end; of its vectors the lengths count.
    """
    steps = int(np.ceil(trajectory.duration / JERK_STEP)) + 6
    q = trajectory.at(trajectory.t[0] + JERK_STEP * (np.arange(steps + 1) - 3.0)).q
    size = np.linalg.norm(np.diff(q, n=3, axis=0), axis=1) / JERK_STEP**3
    return float(size.max()), float(np.sqrt(np.mean(size**2)))


def exact_clearance(motion: Path | Trajectory, scene: Scene) -> tuple[float, float]:
    """Return least distances [m] of what must not touch, by MuJoCo's geometry: to the surroundings, and to itself.

    The robot and what it carries count; what a carried object may stand on at the ends of a motion does not. At most
    `FARTHEST`; negative if something overlaps.
    """
    at_ends = scene.allowed_pairs("ends")
    pairs = np.array([pair for pair in scene.collision_pairs().tolist() if tuple(sorted(pair)) not in at_ends])
    if not len(pairs):
        return FARTHEST, FARTHEST
    own = np.isin(pairs[:, 1], np.unique(pairs[:, 0]))
    samples, placement = motion_samples(motion, scene, CLEARANCE_STEP), Placement(scene)
    least = [FARTHEST, FARTHEST]
    for q in samples.q:
        data = placement.place(q)
        for i, kind in enumerate((pairs[~own], pairs[own])):
            least[i] = _nearest(placement.model, data, kind, least[i])
    return least[0], least[1]


def _nearest(model: mujoco.MjModel, data: mujoco.MjData, pairs: Int[Array, "pair 2"], least: float) -> float:
    """Return the least distance of pairs in one configuration, or `least` if nothing is nearer."""
    first, second = pairs.T
    # Bounding spheres say which pairs can matter; a plane has none.
    radius = model.geom_rbound[first] + model.geom_rbound[second]
    apart = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1) - radius
    unbounded = (model.geom_rbound[first] == 0.0) | (model.geom_rbound[second] == 0.0)
    bound = np.where(unbounded, -np.inf, apart)
    for i in np.argsort(bound):
        if bound[i] >= least:
            break
        a, b = pairs[i].tolist()
        least = min(least, mujoco.mj_geomDistance(model, data, a, b, max(least, 0.0), None))
    return least
