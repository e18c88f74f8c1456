"""Measures of a motion other than its cost: jerk and exact clearance, computed outside of the timed calls."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Int
from graceful_plan.judge.motion_samples import motion_samples
from graceful_plan.path import Path
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

JERK_STEP = 0.02
"""Time between waypoints for the jerk [s], a usual command period of an arm."""
CLEARANCE_STEP = 0.01
"""Maximum travel of any point of the robot between two measurements of clearance [m]."""
FARTHEST = 1.0
"""Maximum measured clearance [m]."""


def jerk(trajectory: Trajectory) -> tuple[float, float]:
    """Compute the peak and the root mean square of the waypoint jerk [rad/s^3].

    The acceleration of a timed path may jump, so its exact jerk is unbounded. The waypoint jerk is the third difference
    of positions every `JERK_STEP`, as sent to an arm, divided by the cube of the step. The motion is extended by rest
    at both ends; the measure is the norm of the jerk vector.
    """
    steps = int(np.ceil(trajectory.duration / JERK_STEP)) + 6
    q = trajectory.at(trajectory.t[0] + JERK_STEP * (np.arange(steps + 1) - 3.0)).q
    size = np.linalg.norm(np.diff(q, n=3, axis=0), axis=1) / JERK_STEP**3
    return float(size.max()), float(np.sqrt(np.mean(size**2)))


def exact_clearance(motion: Path | Trajectory, scene: Scene) -> tuple[float, float]:
    """Compute the least clearance to the surroundings and the least self-clearance [m], by MuJoCo's geometry.

    Robot and carried object count; supports of the carried object at the ends of a motion do not. At most `FARTHEST`;
    negative for an overlap.
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
    """Return the minimum of `least` and the distances of pairs in one configuration [m]."""
    first, second = pairs.T
    # Bounding spheres preselect pairs; a plane has none.
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
