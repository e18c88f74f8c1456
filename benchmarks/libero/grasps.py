"""Grasps of objects in exported scenes: poses at which both fingers touch the object and the hand nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest

import mujoco
import numpy as np

import graceful_plan as gp
from graceful_plan.scene.model_parts import subtree

Array = np.ndarray

_YAWS = 12
_PLACES = 9
"""Greatest number of places on the object that are tried."""
_DEEP = (0.035, 0.025, 0.015, 0.005, -0.003)
"""Depths of the tool below the top of the held part [m]."""
_STROKE = 0.04
"""Opening of a finger [m]."""


def pose_of(scene: gp.Scene, body: str) -> Array:
    """Return the pose of a body in W at the exported configuration."""
    data, X = scene.data_at(scene.keyframes["exported"]), np.eye(4)
    X[:3, :3], X[:3, 3] = data.body(body).xmat.reshape(3, 3), data.body(body).xpos
    return X


def moved(X: Array, by: Sequence[float] | Array) -> Array:
    """Return a pose with its origin moved [m]."""
    X = X.copy()
    X[:3, 3] += by
    return X


def turned(X: Array, angle: float) -> Array:
    """Return a pose turned about the vertical through its origin."""
    X, c, s = X.copy(), np.cos(angle), np.sin(angle)
    X[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ X[:3, :3]
    return X


def geoms_of(scene: gp.Scene, body: str) -> list[int]:
    """Return the geoms of a body and of those below it."""
    model = scene.model
    return np.flatnonzero(np.isin(model.geom_bodyid, list(subtree(model, int(model.body(body).id))))).tolist()


def boxes(scene: gp.Scene, geoms: Sequence[int], data: mujoco.MjData) -> tuple[Array, Array]:
    """Return the lower and upper corners of the boxes around geoms, along the axes of W [m]."""
    model, R = scene.model, data.geom_xmat[geoms].reshape(-1, 3, 3)
    centre = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", R, model.geom_aabb[geoms, :3])
    half = np.einsum("gij,gj->gi", np.abs(R), model.geom_aabb[geoms, 3:])
    return centre - half, centre + half


def extent(scene: gp.Scene, geoms: Sequence[int], data: mujoco.MjData) -> tuple[Array, Array]:
    """Return the lower and upper corner of the box around all geoms [m]."""
    low, high = boxes(scene, geoms, data)
    return low.min(axis=0), high.max(axis=0)


def grasps(scene: gp.Scene, body: str) -> Iterator[tuple[Array, float]]:
    """Yield poses of the tool that points down at an object, with the opening of a finger at which both touch it.

    Places on the object take turns, far apart ones early. At each, the smallest opening comes first, since the fingers
    then press straight. The open hand touches nothing.
    """
    hand, down = _Hand(scene, geoms_of(scene, body)), np.diag([1.0, -1.0, -1.0, 1.0])
    at_place = []
    for p in _places_to_hold(scene, body):
        found = []
        for k in range(_YAWS):
            X_WT = turned(down, np.pi * k / _YAWS)
            for deep in _DEEP:
                X_WT[:3, 3] = p - [0.0, 0.0, deep]
                closed = hand.close(X_WT)
                if closed is not None:
                    found.append(closed)
                    break
        found.sort(key=lambda grasp: grasp[1])
        # The hand is alike on both sides, but the arm is not.
        at_place.append([(X, f) for X_WT, f in found for X in (X_WT, X_WT @ np.diag([-1.0, -1.0, 1.0, 1.0]))])
    for turn in zip_longest(*at_place):
        yield from (grasp for grasp in turn if grasp is not None)


def _places_to_hold(scene: gp.Scene, body: str) -> list[Array]:
    """Return points on top of an object, the nearest to its middle first, then each far from those before it.

    These are the tops of its parts, and points halfway from there to a part's ends.
    """
    data = scene.data_at(scene.keyframes["exported"])
    geoms = geoms_of(scene, body)
    low, high = boxes(scene, geoms, data)
    middle = 0.5 * (low.min(axis=0) + high.max(axis=0))
    ends = [_longest(scene, g, data) for g in geoms]
    points = [np.append(middle[:2], high[:, 2].max())]
    for a, b, end in zip(low, high, ends, strict=True):
        points += [np.append(0.5 * (a + b)[:2] + share * end, b[2]) for share in (0.0, -0.5, 0.5)]
    left = [p for p in points if p[2] > high[:, 2].max() - _DEEP[0]]  # fingers reach no deeper than these tops
    chosen = [left.pop(int(np.argmin([np.linalg.norm(p[:2] - middle[:2]) for p in left])))]
    while left and len(chosen) < _PLACES:
        gaps = [min(float(np.linalg.norm(p[:2] - c[:2])) for c in chosen) for p in left]
        chosen.append(left.pop(int(np.argmax(gaps))))
    return chosen


def _longest(scene: gp.Scene, geom: int, data: mujoco.MjData) -> Array:
    """Return the horizontal part of the longest half axis of a geom's box, in W [m]."""
    axes = (data.geom_xmat[geom].reshape(3, 3) * scene.model.geom_aabb[geom, 3:])[:2]
    return axes[:, int(np.argmax(np.linalg.norm(axes, axis=0)))]


class _Hand:
    """The hand alone, moved freely to try grasps."""

    def __init__(self, scene: gp.Scene, held: Sequence[int]) -> None:
        model = scene.model
        self.scene, self.model, self.held = scene, model, list(held)
        self.data = scene.data_at(scene.keyframes["exported"])
        site = self.data.site(scene.tool)
        self.R_WT, self.p_WT = site.xmat.reshape(3, 3).copy(), site.xpos.copy()
        gripper = sorted(scene.gripper_bodies)
        self.geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in gripper]
        self.others = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) not in scene.robot_bodies]
        self.finger = [
            [g for g in self.geoms if re.search(pattern, model.body(int(model.geom_bodyid[g])).name)]
            for pattern in ("leftfinger|joint1", "rightfinger|joint2")
        ]
        self.joints = [int(model.jnt_qposadr[model.joint(f"gripper0_finger_joint{k}").id]) for k in (1, 2)]
        self.home = {opening: self._opened(opening) for opening in np.linspace(_STROKE, 0.0, 41).round(4)}

    def close(self, X_WT: Array) -> tuple[Array, float] | None:
        """Return the pose at which both fingers touch alike, and their opening; None if the hand cannot be there."""
        if not self._free(X_WT):
            return None
        first, second = (self._touches(X_WT, finger) for finger in self.finger)
        if first is None or second is None:
            return None
        axis = self._closing(X_WT)
        centred = moved(X_WT, 0.5 * (first - second) * axis)
        return (centred, 0.5 * (first + second)) if self._free(centred) else None

    def _closing(self, X_WT: Array) -> Array:
        """Return the direction in W in which the first finger opens."""
        wide, closed = self.home[_STROKE][self.finger[0][0]][0], self.home[0.0][self.finger[0][0]][0]
        return X_WT[:3, :3] @ ((wide - closed) / np.linalg.norm(wide - closed))

    def _opened(self, opening: float) -> Mapping[int, tuple[Array, Array]]:
        """Return the poses of the hand's geoms in the tool frame."""
        self.data.qpos[self.joints] = opening, -opening
        mujoco.mj_kinematics(self.model, self.data)
        X = self.data.geom_xpos, self.data.geom_xmat
        R = self.R_WT.T
        return {g: (R @ (X[0][g] - self.p_WT), R @ X[1][g].reshape(3, 3)) for g in self.geoms}

    def _put(self, X_WT: Array, opening: float, geoms: Sequence[int]) -> None:
        for g in geoms:
            p, R = self.home[opening][g]
            self.data.geom_xpos[g] = X_WT[:3, :3] @ p + X_WT[:3, 3]
            self.data.geom_xmat[g] = (X_WT[:3, :3] @ R).ravel()

    def _distance(self, geoms: Sequence[int], others: Sequence[int]) -> float:
        gaps = [mujoco.mj_geomDistance(self.model, self.data, g, h, 0.05, None) for g in geoms for h in others]
        return min(gaps, default=0.05)

    def _free(self, X_WT: Array) -> bool:
        self._put(X_WT, _STROKE, self.geoms)
        near = [h for h in self.others if self._near(X_WT, h)]
        return self._distance(self.geoms, near) > 0.0

    def _near(self, X_WT: Array, g: int) -> bool:
        radius = self.model.geom_rbound[g]
        return radius == 0.0 or bool(np.linalg.norm(self.data.geom_xpos[g] - X_WT[:3, 3]) < radius + 0.25)

    def _touches(self, X_WT: Array, finger: Sequence[int]) -> float | None:
        """Return the opening at which a finger touches the object; None if it closes without."""
        for opening in self.home:
            self._put(X_WT, opening, finger)
            if self._distance(finger, self.held) <= 0.0:
                return float(opening)
        return None
