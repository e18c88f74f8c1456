"""Configurations along a motion, dense enough that no point of the robot moves far between two of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.path import Path
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

ClearanceBound = Callable[[Float[Array, "n nq"]], Float[Array, " n"]]
"""Lower bound of the clearance of configurations [m]: if positive, all checked pairs are at least this far apart."""

PROVED = 2e-4
"""Least bound that proves a configuration free [m]: several times the rounding error of single precision, also for
joints after many turns."""
AUDITED = 64
"""One in this many configurations that are proved free is checked exactly, too."""
_STRIDE = 8
"""Stride of the samples at which the bound is evaluated first; for bare arms these prove six in seven samples."""
_STRETCH = 0.05
"""Largest displacement of any point on the stretches into which a motion is first cut [m]."""
_NEIGHBOURHOOD = 0.3
"""Largest displacement of any point between the centres of neighbourhoods, each with a single bound on levers [m]. With
0.3 instead of 0.1, sampling takes two thirds of the time and gives 14 % more samples."""
_FARTHEST = 0.5 * (_NEIGHBOURHOOD + _STRETCH)


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Configurations along a path or a trajectory, including both ends."""

    q: Float[Array, "sample nq"]
    at: Float[Array, " sample"]
    """Time [s] on a trajectory, path length [rad] on a path."""
    proved: Bool[Array, " sample"]
    """Whether a bound of the clearance proves each sample free of contact; all False without a bound."""

    @classmethod
    def of(cls, q: Float[Array, "sample nq"], at: Float[Array, " sample"]) -> MotionSamples:
        """Return samples none of which is proved free."""
        return cls(q, at, np.zeros(len(q), dtype=bool))


def motion_samples(
    motion: Path | Trajectory, scene: Scene, step: float, clearance: ClearanceBound | None = None
) -> MotionSamples:
    """Sample a motion so that no point of the robot or the carried object moves farther than `step` [m] in between.

    Args:
        motion: The motion to sample.
        scene: The scene.
        step: Largest displacement of any point between two samples [m].
        clearance: Lower bound that marks samples as proved free; it does not change the samples.
    """
    if len(motion) == 1:
        at = motion.t if isinstance(motion, Trajectory) else np.zeros(1)
        return _proved(MotionSamples.of(motion.q, at), step, clearance)
    travel = joint_travel(motion)
    farthest = travel @ reach(scene)
    coarse = _subdivided(np.arange(len(motion)), farthest, _STRETCH)
    share, piece = np.diff(coarse), coarse[:-1].astype(int)
    lever = _levers_along(motion, coarse, share * farthest[piece], scene)
    moved = share * (travel[piece] * lever).sum(axis=1)
    return _proved(at_places(motion, _subdivided(coarse, moved, step)), step, clearance)


def _levers_along(
    motion: Path | Trajectory, coarse: Float[Array, " end"], moved: Float[Array, " stretch"], scene: Scene
) -> Float[Array, "stretch nq"]:
    """Bound levers on stretches of a motion, with common bounds for each neighbourhood.

    Args:
        motion: The motion.
        coarse: Ends of the stretches, in fractional pieces.
        moved: Bound of the displacement of any point on each stretch [m].
        scene: The scene.
    """
    done = np.append(0.0, np.cumsum(moved))
    # The midpoint of a stretch is within half a neighbourhood of its centre, and its ends half a stretch farther.
    hood = (0.5 * (done[:-1] + done[1:]) / _NEIGHBOURHOOD).astype(int)
    centres = np.minimum((np.arange(hood[-1] + 1) + 0.5) * _NEIGHBOURHOOD, done[-1])
    return _levers_near(at_places(motion, np.interp(centres, done, coarse)).q, scene)[hood]


def _proved(samples: MotionSamples, step: float, clearance: ClearanceBound | None) -> MotionSamples:
    """Mark samples as proved free: first from the clearance of every `_STRIDE`-th sample, then from their own.

    No point moves farther than `step` [m] between neighbouring samples, so the distance of two points changes by at
    most twice that.
    """
    if clearance is None:
        return samples
    last, away = len(samples.q) - 1, 2.0 * step * np.arange(_STRIDE + 1.0)
    known = clearance(samples.q[np.append(np.arange(0, last, _STRIDE), last)])
    # One row per stretch between them; for the last one, which may be shorter, this subtracts too much.
    least = np.maximum(known[:-1, None] - away[:-1], known[1:, None] - away[:0:-1])
    proved = np.append(least.ravel()[:last], known[-1]) > PROVED
    doubtful = np.flatnonzero(~proved)
    proved[doubtful] = clearance(samples.q[doubtful]) > PROVED
    return replace(samples, proved=proved)


def joint_travel(motion: Path | Trajectory) -> Float[Array, "piece nq"]:
    """Bound the travel of each joint on each piece between samples or vertices."""
    if isinstance(motion, Path):
        return np.abs(np.diff(motion.q, axis=0))
    h = np.diff(motion.t)[:, None]
    a0, a1 = motion.piece_accelerations
    # The velocity is quadratic on a piece; its end values plus the change from the accelerations bound it.
    fastest = np.maximum(np.abs(motion.qd[:-1]), np.abs(motion.qd[1:]))
    return h * (fastest + np.where(a0 * a1 < 0.0, 0.5 * h * np.minimum(np.abs(a0), np.abs(a1)), 0.0))


def at_places(motion: Path | Trajectory, place: Float[Array, " sample"]) -> MotionSamples:
    """Evaluate a motion at fractional piece numbers."""
    if isinstance(motion, Trajectory):
        at, q = motion.at_places(place)
        return MotionSamples.of(q, at)
    index = np.minimum(place.astype(int), len(motion) - 2)
    share = (place - index)[:, None]
    along = np.concatenate([[0.0], np.cumsum(motion.segment_lengths)])
    q = (1.0 - share) * motion.q[index] + share * motion.q[index + 1]
    return MotionSamples.of(q, np.interp(place, np.arange(len(along)), along))


def _levers_near(q: Float[Array, "n nq"], scene: Scene) -> Float[Array, "n nq"]:
    """Bound distances from the joints' axes, as `reach` does, but only in the neighbourhood of each configuration.

    In that neighbourhood no point is farther than `_FARTHEST` from its position in the configuration.
    """
    known, moved = kinematics(scene), _moved_geoms(scene)
    links, nq = np.stack(list(known.links(q))), q.shape[1]
    axes = known.joint_axes(links)[:, :, :3]
    centre = (links[moved.link] @ moved.centre[:, None])[:, :, :3, 0].transpose(1, 2, 0)
    along = axes.transpose(1, 3, 0, 2).reshape(len(q), 2 * nq, 3) @ centre
    point, axis = (axes[..., k].transpose(1, 0, 2) for k in (0, 1))
    # With r from a point of the axis to the centre: |r|^2 - (axis . r)^2.
    squared = np.square(centre).sum(axis=1)[:, None] - 2.0 * along[:, :nq] + np.square(point).sum(axis=2)[..., None]
    squared -= np.square(along[:, nq:] - (axis * point).sum(axis=2)[..., None])
    levers = (np.sqrt(np.maximum(squared, 0.0)) + moved.radius).max(axis=2)
    return np.where(known.slides, 1.0, np.minimum(levers + _FARTHEST, reach(scene)))


@dataclass(frozen=True, eq=False)
class _MovedGeoms:
    """Geoms that planned joints move."""

    link: Int[Array, " geom"]
    """Link of each geom, as in `Frames`."""
    centre: Float[Array, "geom 4 1"]
    """Centre with all planned joints at 0, in homogeneous coordinates [m]."""
    radius: Float[Array, "nq geom"]
    """Radius of the bounding sphere [m]; -inf where a joint does not move the geom."""


@per_layout
def _moved_geoms(scene: Scene) -> _MovedGeoms:
    known = kinematics(scene)
    geoms = known.geoms
    rows = np.flatnonzero(geoms.link > 0)
    link = geoms.link[rows]
    moves = known.carries[:, link]
    return _MovedGeoms(link, geoms.X_WF[rows, :, 3:], np.where(moves, scene.model.geom_rbound[rows], -np.inf))


def _subdivided(
    ends: Float[Array, " end"] | Int[Array, " end"], moved: Float[Array, " piece"], step: float
) -> Float[Array, " sample"]:
    """Return the ends of pieces and, between them, those of equal parts on which nothing moves more than `step`."""
    begin = np.zeros(len(ends))
    np.cumsum(np.maximum(1.0, np.ceil(moved / step)), out=begin[1:])
    return np.interp(np.arange(begin[-1] + 1.0), begin, ends)


@per_layout
def reach(scene: Scene) -> Float[Array, " nq"]:
    """Bound the distance of any moving point from each planned joint's axis, over all configurations.

    A hinge that turns by dq moves no point farther than reach * dq; the reach of a slide is 1.
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
    """Bound, for each body, the distance of any point on it and its descendants from its origin.

    Args:
        model: The model.
        held: A body, and the radius around its origin of an object attached to it.
    """
    radius = np.zeros(model.nbody)
    for body in range(model.nbody - 1, 0, -1):  # children have higher ids than their parents
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
