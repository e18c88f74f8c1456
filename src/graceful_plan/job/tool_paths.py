"""Motions in which the tool turns about a fixed axis or moves along one: a handle on a door, a vessel that pours.

Frames: W world, T tool.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.core.tool_motion import missing_twist, rotation_matrix
from graceful_plan.exceptions import RetimingError
from graceful_plan.job.still_base import arm_alone, base_joints, with_base
from graceful_plan.query.cartesian.following import Follower
from graceful_plan.query.cartesian.straight import ANGLE, DEVIATION
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_CANDIDATES = 16
"""Postures with which a path is followed at once, as in the first round of `plan_cartesian`."""
_BETWEEN = np.array([0.25, 0.5, 0.75])
"""Places between two configurations at which the curve is compared with the path."""


@final
@dataclass(frozen=True, eq=False)
class JointPath:
    """The path of a tool that moves as if a joint fixed it to the world.

    Args:
        X_WT: Pose of the tool in W at the start.
        axis: Unit vector of the joint's axis in W.
        point: Point on the axis of a hinge in W [m]; None for a slide.
        amount: Signed change of the joint's position [rad or m].
    """

    X_WT: Float[Array, "4 4"]
    axis: Float[Array, " xyz"]
    point: Float[Array, " xyz"] | None
    amount: float

    @property
    def goal(self) -> PoseGoal:
        """Pose at the end."""
        return PoseGoal(self.poses(np.ones(1))[0])

    @property
    def length(self) -> float:
        """Distance that the tool's origin travels [m]."""
        if self.point is None:
            return abs(self.amount)
        return abs(self.amount) * float(np.linalg.norm(np.cross(self.axis, self.X_WT[:3, 3] - self.point)))

    @property
    def angle(self) -> float:
        """Angle of the tool's rotation [rad]."""
        return 0.0 if self.point is None else abs(self.amount)

    def poses(self, share: Float[Array, " n"]) -> Float[Array, "n 4 4"]:
        """Return the pose of the tool in W at shares of the path, 0 to 1."""
        X = np.tile(self.X_WT, (len(share), 1, 1))
        way = (self.amount * share)[:, None] * self.axis
        if self.point is None:
            X[:, :3, 3] += way
        else:
            turn = rotation_matrix(way)
            X[:, :3, :3] = turn @ self.X_WT[:3, :3]
            X[:, :3, 3] = turn @ (self.X_WT[:3, 3] - self.point) + self.point
        return X


def along_joint(
    q: Float[Array, " nq"], path: JointPath, scene: Scene, *, speed: float = 1.0, seed: int = 0
) -> Trajectory | str:
    """Move an arm such that its tool follows a path; a base stands still.

    Args:
        q: Configuration at the start of the path.
        path: The path.
        scene: The scene, whose default constraints hold.
        speed: Fraction of the velocity limits to use, as in `plan`.
        seed: Seed of the postures that are tried.

    Returns:
        A trajectory that keeps to the path up to `DEVIATION` and `ANGLE`, at the least number of points in collision by
        the fast checker; or why the arm cannot follow. It is not verified.
    """
    alone = arm_alone(scene, q)
    held = SceneConstraints(alone, default_constraints(alone))
    found = Follower(alone, held.kernels, path, q[base_joints(scene) :]).follow(
        _CANDIDATES, np.random.default_rng(seed)
    )
    if found.why:
        return f"the arm is {found.why}"
    n, points, nq = found.q.shape
    blocked = (~held.kernels.free(found.q.reshape(-1, nq))).reshape(n, points).sum(axis=1)
    travel = np.linalg.norm(np.diff(found.q, axis=1), axis=2).sum(axis=1)
    why = ""
    for k in np.lexsort([travel, blocked]):
        curve = Spline.through(found.q[k])
        u = (np.arange(points - 1)[:, None] + _BETWEEN).ravel()
        off = missing_twist(held.kernels.tool_pose(curve.at(u)), path.poses(u / (points - 1)))
        if (np.linalg.norm(off[:, :3], axis=1) > DEVIATION).any() or (np.linalg.norm(off[:, 3:], axis=1) > ANGLE).any():
            why = "the arm moves too suddenly to keep the tool on its path"
            continue
        try:
            return with_base(held.timed(curve, speed=speed), scene, q)
        except RetimingError as error:
            why = str(error)
    return why
