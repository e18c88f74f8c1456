"""Configurations along a motion, so dense that no point of the robot moves far between two of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from jaxtyping import Float

from graceful_plan.path import Path
from graceful_plan.scene import Scene
from graceful_plan.trajectory import Trajectory

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Configurations along a path or a trajectory, both ends included."""

    q: Float[Array, "sample nq"]
    at: Float[Array, " sample"]
    """Time [s] on a trajectory, path length [rad] on a path."""


def motion_samples(motion: Path | Trajectory, scene: Scene, step: float) -> MotionSamples:
    """Sample a motion so that no point of the robot or the carried object moves farther than `step` [m] in between."""
    lever = reach(scene)
    if isinstance(motion, Trajectory):
        return _along_trajectory(motion, lever, step)
    moved = np.abs(np.diff(motion.q, axis=0)) @ lever
    at = np.concatenate([[0.0], np.cumsum(motion.segment_lengths)])
    place = _subdivided(moved, step)
    index = np.minimum(place.astype(int), max(len(motion) - 2, 0))
    share = (place - index)[:, None]
    if len(motion) == 1:
        return MotionSamples(motion.q, at)
    q = (1.0 - share) * motion.q[index] + share * motion.q[index + 1]
    return MotionSamples(q, np.interp(place, np.arange(len(at)), at))


def _along_trajectory(trajectory: Trajectory, lever: Float[Array, " nq"], step: float) -> MotionSamples:
    if len(trajectory) == 1:
        return MotionSamples(trajectory.q, trajectory.t)
    h = np.diff(trajectory.t)[:, None]
    a0, a1 = trajectory.piece_accelerations
    # The velocity is quadratic on a piece; its ends and the change that the accelerations allow bound it.
    fastest = np.maximum(np.abs(trajectory.qd[:-1]), np.abs(trajectory.qd[1:]))
    bulge = np.where(a0 * a1 < 0.0, 0.5 * h * np.minimum(np.abs(a0), np.abs(a1)), 0.0)
    place = _subdivided((h * (fastest + bulge)) @ lever, step)
    t = np.interp(place, np.arange(len(trajectory)), trajectory.t)
    return MotionSamples(trajectory.at(t).q, t)


def _subdivided(moved: Float[Array, " piece"], step: float) -> Float[Array, " sample"]:
    """Split pieces evenly into parts of at most `step`: fractional piece numbers, from 0 to the number of pieces."""
    parts = np.maximum(1, np.ceil(moved / step)).astype(int)
    begin = np.concatenate([[0], np.cumsum(parts)])
    piece = np.repeat(np.arange(len(parts)), parts)
    return np.append(piece + (np.arange(begin[-1]) - begin[piece]) / parts[piece], float(len(parts)))


@lru_cache(maxsize=16)
def reach(scene: Scene) -> Float[Array, " nq"]:
    """Bound how far any moving point is from each planned joint's axis, in every configuration.

    A hinge that turns by dq moves no point farther than reach * dq; of a slide the reach is 1.
    """
    model = scene.model
    held: tuple[int, float] | None = None
    if scene.carried is not None:
        site = model.site(scene.tool)
        offset = np.linalg.norm(site.pos) + np.linalg.norm(scene.carried.X_TO[:3, 3])
        grasped = _radii(model)[model.body(scene.carried.body).id]
        held = int(model.site_bodyid[site.id]), float(offset + grasped)
    radius = _radii(model, held)
    levers = []
    for name in scene.joints:
        joint = model.joint(name).id
        slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        lever = radius[model.jnt_bodyid[joint]] + np.linalg.norm(model.jnt_pos[joint])
        levers.append(1.0 if slides else float(lever))
    return np.array(levers)


def _radii(model: mujoco.MjModel, held: tuple[int, float] | None = None) -> Float[Array, " body"]:
    """Bound for each body how far from its origin anything on it and on its descendants can be.

    Args:
        model: The model.
        held: A body, and a radius around its origin in which something else rides along.
    """
    radius = np.zeros(model.nbody)
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        geoms = slice(int(model.body_geomadr[body]), int(model.body_geomadr[body] + model.body_geomnum[body]))
        own = np.linalg.norm(model.geom_pos[geoms], axis=1) + model.geom_rbound[geoms] if geoms.start >= 0 else []
        radius[body] = max(radius[body], np.max(own, initial=0.0))
        if held is not None and body == held[0]:
            radius[body] = max(radius[body], held[1])
        joints = range(int(model.body_jntadr[body]), int(model.body_jntadr[body] + model.body_jntnum[body]))
        slides = (j for j in joints if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE)
        travel = sum(float(np.abs(model.jnt_range[j]).max()) for j in slides)
        away = np.linalg.norm(model.body_pos[body]) + travel + radius[body]
        parent = int(model.body_parentid[body])
        radius[parent] = max(radius[parent], away)
    return radius
