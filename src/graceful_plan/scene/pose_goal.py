"""Goals given as a tool pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array, plain_numbers
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive

if TYPE_CHECKING:
    from typing import Self


_ROOT_STEPS = 40
"""Steps of the fixed-point iteration, each of which at least halves the error."""


@dataclass(frozen=True, eq=False)
class PoseGoal:
    """A goal pose of the tool, with tolerances.

    The goal is the set of poses within the tolerances. Tolerances up to 5 mm and 0.05 rad are for errors: `plan` aims
    at the pose itself, and uses them where it cannot be reached exactly. Greater ones are room: `plan` ends at a pose
    of the set that is cheap to reach. An arm with less than six joints needs such room, or `free_yaw`.

    Args:
        X_WT: Pose of the tool in W, homogeneous.
        position_tolerance: Largest distance of the tool's origin from the goal [m], > 0.
        orientation_tolerance: Largest angle between the goal's and the reached orientation [rad], > 0; from pi on, any
            orientation will do.
        free_yaw: Whether the rotation about the tool's own z axis is free, so that only the axis counts.

    Raises:
        ShapeError: If `X_WT` is not a 4 x 4 matrix.
        SettingError: If it is not a rigid pose, or a tolerance is not above 0.
    """

    X_WT: Float[Array, "4 4"]
    position_tolerance: float = 0.001
    orientation_tolerance: float = 0.01
    free_yaw: bool = False

    def __post_init__(self) -> None:
        plain_numbers(self)
        X = finite_array("X_WT", self.X_WT, ndim=2)
        if X.shape != (4, 4):
            raise ShapeError("X_WT", X.shape, "(4, 4)")
        R = X[:3, :3]
        rigid = np.allclose(R @ R.T, np.eye(3), atol=1e-6) and np.linalg.det(R) > 0.0
        if not rigid or not np.allclose(X[3], [0.0, 0.0, 0.0, 1.0], atol=1e-9):
            raise SettingError("X_WT", X.tolist(), "a rotation and a translation, last row 0 0 0 1")
        for name in ("position_tolerance", "orientation_tolerance"):
            positive(name, getattr(self, name))
        X = X.copy()
        X.flags.writeable = False
        object.__setattr__(self, "X_WT", X)

    @classmethod
    def at(
        cls,
        position: ArrayLike,
        quaternion: ArrayLike | None = None,
        *,
        position_tolerance: float = 0.001,
        orientation_tolerance: float = 0.01,
        free_yaw: bool = False,
    ) -> Self:
        """Create a goal from a position [m] and a quaternion wxyz, which is normalised; None means no rotation.

        Raises:
            SettingError: If the quaternion is zero.
        """
        given = [1.0, 0.0, 0.0, 0.0] if quaternion is None else quaternion
        w, x, y, z = q = finite_array("quaternion", given, ndim=1, last=4)
        norm = float(q @ q)
        if norm < 1e-12:
            raise SettingError("quaternion", q.tolist(), "a quaternion wxyz other than zero")
        v = np.array([x, y, z])
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        X_WT = np.eye(4)
        X_WT[:3, :3] = ((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * cross) / norm
        X_WT[:3, 3] = finite_array("position", position, ndim=1, last=3)
        return cls(X_WT, position_tolerance, orientation_tolerance, free_yaw)

    @classmethod
    def from_tool(
        cls,
        q: ArrayLike,
        scene: Scene,
        *,
        translation: ArrayLike | None = None,
        rotation: ArrayLike | None = None,
        frame: str = "world",
        position_tolerance: float = 0.001,
        orientation_tolerance: float = 0.01,
        free_yaw: bool = False,
    ) -> Self:
        """Create a goal relative to the tool's pose in a configuration.

        Args:
            q: The configuration [rad or m].
            scene: Robot and tool.
            translation: Translation of the tool's origin [m]; none by default.
            rotation: Rotation about the tool's origin, as a rotation vector [rad]; none by default.
            frame: "world" or "tool": the axes in which translation and rotation are expressed.
            position_tolerance: As in `PoseGoal`.
            orientation_tolerance: As in `PoseGoal`.
            free_yaw: As in `PoseGoal`.

        Raises:
            ShapeError: If the configuration does not match the scene's joints, or a vector does not have length 3.
            SettingError: If there is no such frame.
        """
        if frame not in ("world", "tool"):
            raise SettingError("frame", frame, "'world' or 'tool'")
        site = Placement(scene).place(finite_array("q", q, ndim=1, last=len(scene.joints))).site(scene.tool)
        R_WT, turn, quat = site.xmat.reshape(3, 3), np.empty(9), np.array([1.0, 0.0, 0.0, 0.0])
        none = [0.0, 0.0, 0.0]
        p = finite_array("translation", none if translation is None else translation, ndim=1, last=3)
        vector = finite_array("rotation", none if rotation is None else rotation, ndim=1, last=3)
        mujoco.mju_quatIntegrate(quat, vector, 1.0)
        mujoco.mju_quat2Mat(turn, quat)
        R = turn.reshape(3, 3)
        X_WT = np.eye(4)
        X_WT[:3, :3] = R @ R_WT if frame == "world" else R_WT @ R
        X_WT[:3, 3] = site.xpos + (p if frame == "world" else R_WT @ p)
        return cls(X_WT, position_tolerance, orientation_tolerance, free_yaw)

    def region(self, half_size: ArrayLike | None = None, turns: ArrayLike | None = None, count: int = 64) -> list[Self]:
        """Return goals sampled in a region around this one, to be passed to `plan` together; this goal is the first.

        They cover offsets and rotations evenly and independently of each other. Only these samples are goals, not the
        poses between them. `plan` tries the nearest first.

        Args:
            half_size: Largest offset of the tool along the goal's axes [m], half the size of a box; 0 by default.
            turns: Largest rotation about each of the tool's axes, first x, then y, then z [rad]; 0 by default, at most
                pi, which leaves that rotation free.
            count: Number of goals.

        Raises:
            ShapeError: If `half_size` or `turns` does not have length 3.
            SettingError: If a value is negative, a turn is beyond pi, or `count` is below 1.
        """
        given = {"half_size": half_size, "turns": turns}
        room = np.concatenate(
            [np.zeros(3) if x is None else finite_array(name, x, ndim=1, last=3) for name, x in given.items()]
        )
        if (room < 0.0).any() or (room[3:] > np.pi).any():
            raise SettingError("region", room.tolist(), "half sizes >= 0 and turns from 0 to pi")
        if count < 1:
            raise SettingError("count", count, "at least 1")
        wide = np.flatnonzero(room > 0.0)
        # Roberts' R sequence: its steps are powers of 1 / root, with root^(d + 1) = root + 1.
        root = 2.0
        for _ in range(_ROOT_STEPS):
            root = (1.0 + root) ** (1.0 / (len(wide) + 1.0))
        share = np.arange(count)[:, None] * root ** -(1.0 + np.arange(len(wide))) % 1.0
        off = np.zeros((count, 6))
        off[:, wide] = room[wide] * (2.0 * np.where(share < 0.5, share, share - 1.0))  # the first is 0
        return [self._moved(row) for row in off]

    def _moved(self, off: Float[Array, " 6"]) -> Self:
        """Return this goal moved along its own axes, then rotated about x, y, z of the tool [m and rad]."""
        X, turn = self.X_WT.copy(), np.empty(9)
        X[:3, 3] += X[:3, :3] @ off[:3]
        for axis, angle in zip(np.eye(3), off[3:], strict=True):
            quat = np.empty(4)
            mujoco.mju_axisAngle2Quat(quat, axis, angle)
            mujoco.mju_quat2Mat(turn, quat)
            X[:3, :3] = X[:3, :3] @ turn.reshape(3, 3)
        return replace(self, X_WT=X)


def pose_error(goal: PoseGoal, X_WT: Float[Array, "4 4"]) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between a reached pose and a goal; with free yaw, the angle of the z axes."""
    distance = float(np.linalg.norm(X_WT[:3, 3] - goal.X_WT[:3, 3]))
    if goal.free_yaw:
        a, b = X_WT[:3, 2], goal.X_WT[:3, 2]
        return distance, float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
    R = goal.X_WT[:3, :3].T @ X_WT[:3, :3]
    skew = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return distance, float(np.arctan2(np.linalg.norm(skew), 0.5 * (np.trace(R) - 1.0)))
