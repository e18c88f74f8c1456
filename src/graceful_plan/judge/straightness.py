"""Checks of straight tool motions: distance of the tool from its line, and from the prescribed orientation there.

They share nothing with the planner of such motions: poses come from the judge's own kinematics, orientations are
quaternions, and the place of a pose on the line follows from the pose alone, not from its time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.judge.motion_samples import motion_samples
from graceful_plan.path import Path
from graceful_plan.result import Check
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory


def straightness(
    motion: Path | Trajectory, goal: PoseGoal, scene: Scene, *, deviation: float, angle: float, step: float = 0.002
) -> Mapping[str, Check]:
    """Check how straight the tool moves from its initial pose to a goal pose.

    Args:
        motion: The motion to check.
        goal: Pose at the end of the line. With free yaw only the tool's z axis counts.
        scene: The scene.
        deviation: Largest distance of the tool's origin from the line [m].
        angle: Largest angle between the tool's orientation and the one prescribed there [rad].
        step: No point of the robot moves farther than this between two samples [m].

    Returns:
        The checks "deviation" and "orientation".
    """
    samples = motion_samples(motion, scene, step)
    known = kinematics(scene)
    (X_WT,) = known.poses(samples.q, known.held[[0]])
    p_WT, quat_WT = X_WT[:, :3, 3], np.empty((len(X_WT), 4))
    for quat, R in zip(quat_WT, X_WT[:, :3, :3].reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quat, R)
    line = _Line.between((p_WT[0], quat_WT[0]), goal)
    share = line.shares(p_WT, quat_WT, weights=(1.0 / deviation, 1.0 / angle))
    off = np.linalg.norm(p_WT - line.positions(share), axis=1)
    turned = line.angles(quat_WT, share)
    return {
        "deviation": _check(off, samples.at, deviation, "distance of the tool from its line [m]"),
        "orientation": _check(turned, samples.at, angle, "angle to the tool's orientation on its line [rad]"),
    }


@dataclass(frozen=True, eq=False)
class _Line:
    """A straight motion between poses: position and quaternion at the start, translation and rotation vector in W."""

    p: Float[Array, " 3"]
    quat: Float[Array, " 4"]
    translation: Float[Array, " 3"]
    rotation: Float[Array, " 3"]
    free_yaw: bool

    @classmethod
    def between(cls, start: tuple[Float[Array, " 3"], Float[Array, " 4"]], goal: PoseGoal) -> _Line:
        p, quat = start
        rotation = np.zeros(3)
        if goal.free_yaw:
            z, wanted = _z_axis(quat), goal.X_WT[:3, 2]
            axis = np.cross(z, wanted)
            sine = float(np.linalg.norm(axis))
            if sine > 0.0:
                rotation = axis / sine * np.arctan2(sine, float(z @ wanted))
        else:
            last, turn = np.empty(4), np.empty(4)
            mujoco.mju_mat2Quat(last, goal.X_WT[:3, :3].ravel())
            mujoco.mju_mulQuat(turn, last, quat * [1.0, -1.0, -1.0, -1.0])
            mujoco.mju_quat2Vel(rotation, turn, 1.0)
        return cls(p.copy(), quat.copy(), goal.X_WT[:3, 3] - p, rotation, goal.free_yaw)

    def positions(self, share: Float[Array, " n"]) -> Float[Array, "n 3"]:
        return self.p + share[:, None] * self.translation

    def orientations(self, share: Float[Array, " n"]) -> Float[Array, "n 4"]:
        found = np.tile(self.quat, (len(share), 1))
        for quat, s in zip(found, share, strict=True):
            mujoco.mju_quatIntegrate(quat, _conjugated(self.quat, self.rotation), float(s))
        return found

    def angles(self, quat: Float[Array, "n 4"], share: Float[Array, " n"]) -> Float[Array, " n"]:
        due = self.orientations(share)
        if self.free_yaw:
            z, wanted = (np.stack([_z_axis(one) for one in each]) for each in (quat, due))
            return np.arctan2(np.linalg.norm(np.cross(z, wanted), axis=1), np.einsum("ni,ni->n", z, wanted))
        return np.array([np.linalg.norm(_rotation_between(a, b)) for a, b in zip(due, quat, strict=True)])

    def shares(
        self, p: Float[Array, "n 3"], quat: Float[Array, "n 4"], weights: tuple[float, float]
    ) -> Float[Array, " n"]:
        """Return the place on the line of least weighted error for each pose, in [0, 1]."""
        by_way, by_turn = (w * v for w, v in zip(weights, (self.translation, self.rotation), strict=True))
        total = float(by_way @ by_way + by_turn @ by_turn)
        if total == 0.0:
            return np.zeros(len(p))
        turned = self._turned(quat)
        return np.clip((weights[0] * (p - self.p) @ by_way + weights[1] * turned @ by_turn) / total, 0.0, 1.0)

    def _turned(self, quat: Float[Array, "n 4"]) -> Float[Array, "n 3"]:
        """Return the rotation vector in W from the first orientation to each; with free yaw, about the line's axis."""
        if not self.free_yaw:
            return np.stack([_rotation_between(self.quat, one) for one in quat])
        angle = float(np.linalg.norm(self.rotation))
        if angle == 0.0:
            return np.zeros((len(quat), 3))
        axis, z = self.rotation / angle, _z_axis(self.quat)
        side = np.cross(axis, z)
        reached = np.stack([_z_axis(one) for one in quat])
        return np.arctan2(reached @ side, reached @ z)[:, None] * axis


def _rotation_between(first: Float[Array, " 4"], last: Float[Array, " 4"]) -> Float[Array, " 3"]:
    """Return the rotation vector in W, at most half a turn [rad]."""
    turn, vector = np.empty(4), np.empty(3)
    mujoco.mju_mulQuat(turn, last, first * [1.0, -1.0, -1.0, -1.0])
    mujoco.mju_quat2Vel(vector, turn, 1.0)
    return vector


def _conjugated(quat: Float[Array, " 4"], vector: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Express a vector of W in the frame of the quaternion, as MuJoCo integrates rotations."""
    own = np.empty(3)
    mujoco.mju_rotVecQuat(own, vector, quat * [1.0, -1.0, -1.0, -1.0])
    return own


def _z_axis(quat: Float[Array, " 4"]) -> Float[Array, " 3"]:
    z = np.empty(3)
    mujoco.mju_rotVecQuat(z, np.array([0.0, 0.0, 1.0]), quat)
    return z


def _check(values: Float[Array, " n"], at: Float[Array, " n"], limit: float, words: str) -> Check:
    worst = int(np.argmax(values))
    bad = np.flatnonzero(values > limit)
    return Check(
        passed=not len(bad),
        worst=float(values[worst]),
        limit=limit,
        first=float(at[bad[0]]) if len(bad) else None,
        detail=f"{words}; worst at {at[worst]:.3g}",
    )
