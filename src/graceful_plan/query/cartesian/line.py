"""Geometry of a straight motion of the tool from one pose to another."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.tool_motion import matrix_vector, missing_twist, rotation_matrix
from graceful_plan.scene.pose_goal import PoseGoal

_STILL = 1e-9
"""Distance [m] and angle [rad] below which the line is a single pose."""


@dataclass(frozen=True, eq=False)
class ToolLine:
    """A straight line of the tool's origin at constant speed, with a rotation about one axis at constant rate (slerp).

    Args:
        X_WT: Pose of the tool in W at the start.
        goal: Pose at the end; with free yaw only its z axis counts, which turns the shortest way.
    """

    X_WT: Float[Array, "4 4"]
    goal: PoseGoal

    @cached_property
    def translation(self) -> Float[Array, " 3"]:
        """Vector from the first to the last position of the tool's origin in W [m]."""
        return self.goal.X_WT[:3, 3] - self.X_WT[:3, 3]

    @cached_property
    def rotation(self) -> Float[Array, " 3"]:
        """Rotation vector in W from the first to the last orientation [rad]."""
        return missing_twist(self.X_WT[None], self.goal.X_WT[None], free_yaw=self.goal.free_yaw)[0, 3:]

    @property
    def length(self) -> float:
        """Distance that the tool's origin travels [m]."""
        return float(np.linalg.norm(self.translation))

    @property
    def angle(self) -> float:
        """Angle of the tool's rotation [rad]."""
        return float(np.linalg.norm(self.rotation))

    @property
    def is_still(self) -> bool:
        """Whether the line is a single pose."""
        return self.length <= _STILL and self.angle <= _STILL

    def poses(self, share: Float[Array, " n"]) -> Float[Array, "n 4 4"]:
        """Return the pose of the tool in W at shares of the line, 0 to 1."""
        X = np.tile(np.eye(4), (len(share), 1, 1))
        X[:, :3, :3] = rotation_matrix(share[:, None] * self.rotation) @ self.X_WT[:3, :3]
        X[:, :3, 3] = self.X_WT[:3, 3] + share[:, None] * self.translation
        return X

    def errors(self, X_WT: Float[Array, "n 4 4"], share: Float[Array, " n"]) -> Float[Array, "n 2"]:
        """Return distances of poses from the line [m], and angles to the orientations at these shares of it [rad]."""
        missing = missing_twist(X_WT, self.poses(share), free_yaw=self.goal.free_yaw)
        off = missing[:, :3]
        if self.length > _STILL:
            along = self.translation / self.length
            off = off - (off @ along)[:, None] * along
        return np.stack([np.linalg.norm(off, axis=1), np.linalg.norm(missing[:, 3:], axis=1)], axis=1)

    def share_of(self, X_WT: Float[Array, "4 4"]) -> float:
        """Return the share of the line, 0 to 1, that is nearest to a pose."""
        if self.length > _STILL:
            share = (X_WT[:3, 3] - self.X_WT[:3, 3]) @ self.translation / self.length**2
        elif self.angle > _STILL:
            turned = matrix_vector((X_WT[:3, :3] @ self.X_WT[:3, :3].T)[None])[0]
            share = turned @ self.rotation / self.angle**2
        else:
            share = 0.0
        return float(np.clip(share, 0.0, 1.0))

    def place(self, share: float) -> str:
        """Return a description of a share of the line for messages."""
        if self.length > _STILL:
            return f"{share * self.length:.3f} m of {self.length:.3f} m"
        return f"{np.rad2deg(share * self.angle):.1f} of {np.rad2deg(self.angle):.1f} degrees"
