"""Checks that a robot does not move into moving entities at their predicted positions, with exact geometry.

Only times at which the robot moves count, whether it drives, turns in place or moves its arm: while it stands still,
entities may walk into it, and into links that no planned joint moves at any time. The spread of the predicted positions
is part of the impact, not of this check.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, reduce

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.judge.motion_samples import motion_samples
from graceful_plan.result import Check
from graceful_plan.scene.edit import StaticBody
from graceful_plan.scene.model_parts import colliding_geoms, subtree
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.per_scene import per_layout, per_scene
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

_STANDING = 0.01
"""Speed of every joint below which a robot stands still [m/s or rad/s]."""
_STEP = 0.02
"""Largest displacement of any point of the robot, and of the entities, between two evaluated times [m]."""
_MOST = 20_000
"""Largest number of times at which entities are evaluated."""
_FAR = 1.0
"""Clearance beyond which it is not measured [m]."""
_PARTS = 4
"""Number of spheres that cover a geom."""
_ROUNDING = 1e-6
"""Error of distances between shapes, which MuJoCo computes iteratively [m]."""


def is_moving(qd: Float[Array, "n nq"]) -> Bool[Array, " n"]:
    """Tell at which joint velocities a robot moves; see `_STANDING`."""
    return np.abs(qd).max(axis=1) > _STANDING


def passing_check(motion: Trajectory, scene: Scene) -> Check:
    """Check a trajectory at its own times; the worst value is the least clearance to a moving entity [m].

    Bounds from spheres select the pairs and times to measure: only those that can have the least distance or the first
    overlap are measured exactly.
    """
    t = _times(motion, scene)
    state = motion.at(t)
    rows = np.flatnonzero(is_moving(state.qd))
    ruler = _Ruler(scene)
    pairs = _near_pairs(scene, t[rows], state.q[rows], ruler)
    names, worst, whom = tuple(scene.moving), _FAR, ""

    @cache
    def measure(k: int) -> float:
        return ruler.distance(int(pairs.geom[k]), pairs.X_WG[k], names[pairs.entity[k]], pairs.X_WE[k])

    for k in np.argsort(pairs.least, kind="stable").tolist():
        if pairs.least[k] >= worst:
            break
        distance = measure(k)
        if distance < worst:
            worst, whom = distance, names[pairs.entity[k]]
    if worst >= 0.0:
        told = f"{worst:.3g} m to {whom!r}" if whom else f"more than {_FAR:g} m to all moving entities"
        return Check(passed=True, worst=worst, detail=told)
    overlaps = np.flatnonzero(pairs.least < 0.0)
    by_time = overlaps[np.argsort(pairs.row[overlaps], kind="stable")].tolist()
    first = next(k for k in by_time if measure(k) < 0.0)
    detail = f"{'moves' if scene.base is None else 'drives'} into {whom!r}: {1e3 * worst:.3g} mm"
    return Check(worst=worst, first=float(t[rows[pairs.row[first]]]), detail=detail)


@dataclass(frozen=True, eq=False)
class _NearPairs:
    """Pairs of a time and a robot geom that may be nearer to an entity than `_FAR` and than all other pairs."""

    row: Int[Array, " pair"]
    """Index of the time."""
    entity: Int[Array, " pair"]
    geom: Int[Array, " pair"]
    """Id of the robot's geom."""
    least: Float[Array, " pair"]
    """Lower bound of the distance [m]."""
    X_WG: Float[Array, "pair 4 4"]
    """Pose of that geom [m]."""
    X_WE: Float[Array, "pair 4 4"]
    """Pose of the entity [m]."""


def _near_pairs(scene: Scene, t: Float[Array, " n"], q: Float[Array, "n nq"], ruler: _Ruler) -> _NearPairs:
    """Return the pairs that may be nearer than the measured distance of the nearest pair by bounding spheres."""
    own, known = np.array(_robot_geoms(scene), dtype=int), kinematics(scene)
    poses = known.poses(q, known.geoms[own])
    spheres = _covers(scene)
    found, upper = [], _FAR
    for number, entity in enumerate(scene.moving.values()):
        there = entity.at(t)
        X_WE = _upright(there.position, there.yaw)
        away = _to_upright(entity, X_WE, poses[..., :3, 3]) - scene.model.geom_rbound[own][:, None]
        if away.min(initial=upper) < upper:
            g, k = np.unravel_index(np.argmin(away), away.shape)
            upper = min(upper, max(0.0, ruler.distance(int(own[g]), poses[g, k], entity.name, X_WE[k])))
        geom, row = np.nonzero(away - _ROUNDING < max(upper, _ROUNDING))
        centres = np.einsum("kij,ksj->ksi", poses[geom, row, :3, :3], spheres.centre[geom])
        centres += poses[geom, row, None, :3, 3]
        least = (_to_upright(entity, X_WE[row, None], centres) - spheres.radius[geom]).min(axis=1) - _ROUNDING
        found.append((row, geom, np.full(len(row), number), least, X_WE[row]))
    row, geom, entities, least, places = (np.concatenate(column) for column in zip(*found, strict=True))
    near = np.flatnonzero(least < max(upper, _ROUNDING))
    return _NearPairs(
        row=row[near],
        entity=entities[near],
        geom=own[geom[near]],
        least=least[near],
        X_WG=poses[geom[near], row[near]],
        X_WE=places[near],
    )


class _Ruler:
    """MuJoCo's distances between robot geoms at given poses and moving entities. Create one instance per thread."""

    def __init__(self, scene: Scene) -> None:
        self._model = model = _with_walkers(scene)
        self._data = mujoco.MjData(model)
        self._geom = {name: int(model.body_geomadr[model.body(name).id]) for name in scene.moving}

    def distance(self, geom: int, X_WG: Float[Array, "4 4"], entity: str, X_WE: Float[Array, "4 4"]) -> float:
        """Return a signed distance, at most `_FAR` [m]."""
        other = self._geom[entity]
        for each, X in ((geom, X_WG), (other, X_WE)):
            self._data.geom_xpos[each], self._data.geom_xmat[each] = X[:3, 3], X[:3, :3].ravel()
        return mujoco.mj_geomDistance(self._model, self._data, geom, other, _FAR, None)


def _upright(position: Float[Array, "n 3"], yaw: Float[Array, " n"]) -> Float[Array, "n 4 4"]:
    X, c, s = np.tile(np.eye(4), (len(yaw), 1, 1)), np.cos(yaw), np.sin(yaw)
    X[:, 0, 0], X[:, 0, 1], X[:, 1, 0], X[:, 1, 1], X[:, :3, 3] = c, -s, s, c, position
    return X


def _to_upright(
    entity: MovingEntity, X_WE: Float[Array, "*n 4 4"], points: Float[Array, "*batch 3"]
) -> Float[Array, "*batch"]:
    """Return signed distances of points from an upright cylinder or box [m]."""
    x, y, z = np.moveaxis(points - X_WE[..., :3, 3], -1, 0)
    if entity.is_round:
        beyond = np.hypot(x, y) - entity.size[0], np.abs(z) - entity.size[1]
    else:
        c, s = X_WE[..., 0, 0], X_WE[..., 1, 0]
        beyond = tuple(np.abs(u) - half for u, half in zip((c * x + s * y, c * y - s * x, z), entity.size, strict=True))
    outside = np.sqrt(sum(np.square(np.maximum(u, 0.0)) for u in beyond))
    return outside + np.minimum(reduce(np.maximum, beyond), 0.0)


@dataclass(frozen=True, eq=False)
class _Covers:
    """Spheres that cover the geoms of the robot, in the frames of the geoms."""

    centre: Float[Array, "geom sphere 3"]
    radius: Float[Array, "geom 1"]


@per_layout
def _covers(scene: Scene) -> _Covers:
    """Cut the boxes around geoms across their longest axis, and put a sphere around each part."""
    boxes = scene.model.geom_aabb[list(_robot_geoms(scene))]
    middle, half = boxes[:, :3], boxes[:, 3:]
    longest = np.eye(3)[np.argmax(half, axis=1)] * half.max(axis=1)[:, None]
    along = (2.0 * np.arange(_PARTS) + 1.0) / _PARTS - 1.0
    return _Covers(
        centre=middle[:, None] + along[:, None] * longest[:, None],
        radius=np.linalg.norm(half - longest * (1.0 - 1.0 / _PARTS), axis=1)[:, None],
    )


def _times(motion: Trajectory, scene: Scene) -> Float[Array, " n"]:
    """Return times dense enough that neither robot nor entities move far between them [s]."""
    walks = max(entity.top_speed for entity in scene.moving.values())
    n = int(np.clip(np.ceil(motion.duration * walks / _STEP), 1, _MOST))
    even = motion.t[0] + motion.duration * np.linspace(0.0, 1.0, n + 1)
    return np.union1d(even, motion_samples(motion, scene, _STEP).at)


def _robot_geoms(scene: Scene) -> tuple[int, ...]:
    """Return the ids of the colliding geoms that planned joints move."""
    carried = set() if scene.carried is None else subtree(scene.model, scene.model.body(scene.carried.body).id)
    bodies = scene.robot_bodies | carried
    link = kinematics(scene).geoms.link
    return tuple(geom for geom in colliding_geoms(scene.model, bodies) if link[geom] > 0)


@per_scene
def _with_walkers(scene: Scene) -> mujoco.MjModel:
    """Return the scene's model with a body for each moving entity, after all others."""
    spec = scene.spec.copy()
    for entity in scene.moving.values():
        pose = np.eye(4)
        pose[:3, 3] = entity.position[0]
        kind = "cylinder" if entity.is_round else "box"
        StaticBody(name=entity.name, kind=kind, size=entity.size, pose=pose).add_to(spec)
        spec.body(entity.name).mocap = True
    return spec.compile()
