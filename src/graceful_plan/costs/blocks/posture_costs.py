"""Costs of the robot's posture and of the tool's pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.core import _native
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.blocks.native_cost import NativeCost
from graceful_plan.costs.models.body.tables import body_tables
from graceful_plan.exceptions import SettingError, ShapeError, UnsupportedError
from graceful_plan.path import plain_numbers, real_array
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive, positive_or_none

_TURNS = 6
"""Number of joints that a tool needs for arbitrary translation and rotation."""


@final
@dataclass(frozen=True)
class JointCost(NativeCost):
    """Penalises the distance from a posture: the mean over joints of ((q - centre) / scale)^2.

    By default it keeps joints away from their limits [Liegeois1977]: 0 where all joints are in the middle of their
    ranges, 1 where all are at a limit.

    Args:
        centre: The posture [rad or m], one number per joint; the middle of the ranges by default.
        scale: Offset with a cost of 1 [rad or m], one number or one per joint; half of the ranges by default.

    Raises:
        SettingError: If the posture is not finite, or a scale not a finite number > 0.

    References:
        A. Liegeois, "Automatic supervisory control of the configuration and behavior of multibody mechanisms", IEEE
        Transactions on Systems, Man, and Cybernetics, 1977.
    """

    centre: tuple[float, ...] | None = None
    scale: float | tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        if self.centre is not None:
            object.__setattr__(self, "centre", tuple(real_array("centre", self.centre).tolist()))
            if not np.isfinite(self.centre).all():
                raise SettingError("centre", self.centre, "finite positions, one per joint")
        if self.scale is not None:
            scale = real_array("scale", self.scale)
            object.__setattr__(self, "scale", tuple(scale.tolist()) if scale.ndim else float(scale))
            if not (np.isfinite(scale) & (scale > 0.0)).all():
                raise SettingError("scale", self.scale, "a finite number > 0, or one per joint")

    def kernel(self, scene: Scene) -> ImpactKernel:
        """Return the native kernel of this cost in a scene.

        Raises:
            ShapeError: If posture or scales are not one number per joint.
        """
        lower, upper = scene.limits.position.T
        given = {"JointCost.centre": self.centre, "JointCost.scale": self.scale}
        known = {"JointCost.centre": 0.5 * (lower + upper), "JointCost.scale": 0.5 * (upper - lower)}
        for name, value in given.items():
            if isinstance(value, tuple) and len(value) != len(lower):
                raise ShapeError(name, (len(value),), f"({len(lower)},)")
            if value is not None:
                known[name] = np.broadcast_to(np.asarray(value, dtype=np.float64), lower.shape).copy()
        kernels = compile_scene(scene).kernels
        return ImpactKernel(kernels, _native.JointCost(kernels.core, *known.values()))


@final
@dataclass(frozen=True)
class EnergyCost(NativeCost):
    """Penalises the torques that hold the arm up: the mean over joints of (torque / limit)^2.

    The torques are those of the weight of links and load. Drives lose about the square of their torque as heat, so the
    integral over time is proportional to the energy of a slow motion. The torques of acceleration are not included,
    because a state has no acceleration; see `optimise_trajectory`.

    Args:
        torque: Torques with a cost of 1 [N m or N], one per joint; the limits of the model by default.

    Raises:
        SettingError: If a torque is not a finite number > 0.
    """

    torque: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.torque is not None:
            object.__setattr__(self, "torque", tuple(real_array("torque", self.torque).tolist()))
            if not all(np.isfinite(t) and t > 0.0 for t in self.torque):
                raise SettingError("torque", self.torque, "finite numbers > 0, one per joint")

    def kernel(self, scene: Scene) -> ImpactKernel:
        """Return the native kernel of this cost in a scene.

        Raises:
            ShapeError: If torques are not one number per joint.
            UnsupportedError: If no torques are given, and the model does not limit all of them.
        """
        limit = scene.limits.torque if self.torque is None else np.array(self.torque)
        if len(limit) != len(scene.joints):
            raise ShapeError("EnergyCost.torque", limit.shape, f"({len(scene.joints)},)")
        unlimited = [name for name, value in zip(scene.joints, limit, strict=True) if not np.isfinite(value)]
        if unlimited:
            raise UnsupportedError(
                f"the model has no torque limit of {unlimited[0]!r}: EnergyCost(torque=...) takes them"
            )
        tables, kernels = body_tables(scene), compile_scene(scene).kernels
        columns = [tables.mass[:, None], tables.centre, tables.inertia.reshape(-1, 9)]
        inertia = np.ascontiguousarray(np.concatenate(columns, axis=1))
        limit = np.ascontiguousarray(limit, dtype=np.float64)
        return ImpactKernel(kernels, _native.EnergyCost(kernels.core, inertia, limit))


@final
@dataclass(frozen=True)
class PoseCost(NativeCost):
    r"""Penalises the distance of the tool from a pose, with offset p and angle \theta between the two.

    .. math:: (|p| / D)^2 + 2 (1 - \cos \theta) / A^2

    For small angles, the second part is about (\theta / A)^2.

    Args:
        goal: The pose; its tolerances are ignored. With `free_yaw`, the angle is that between the tools' z axes.
        distance: Offset D with a cost of 1 [m]; None to ignore the position.
        angle: Angle A with a cost of about 1 [rad]; None to ignore the orientation.

    Raises:
        SettingError: If both parts are left out, or one is not a finite number > 0.
    """

    goal: PoseGoal
    distance: float | None = 0.1
    angle: float | None = 0.5

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("distance", "angle"):
            value = getattr(self, name)
            positive_or_none(name, value, "a finite number > 0, or None")
        if self.distance is None and self.angle is None:
            raise SettingError("distance", None, "a number, where the angle is left out too")

    def kernel(self, scene: Scene) -> ImpactKernel:
        """Return the native kernel of this cost in a scene."""
        compiled = compile_scene(scene)
        robot, X_WT = compiled.robot, self.goal.X_WT
        # trace(R_WT^T R) = 1 + 2 cos(angle); for z axes alone, twice their product is 2 cos(angle).
        counts = np.diag([0.0, 0.0, 2.0]) if self.goal.free_yaw else np.eye(3)
        native = _native.PoseCost(
            compiled.kernels.core,
            link=robot.tool_link,
            tool=np.ascontiguousarray(robot.X_LT[:3, 3]),
            position=np.ascontiguousarray(X_WT[:3, 3]),
            turn=np.ascontiguousarray(X_WT[:3, :3] @ counts @ robot.X_LT[:3, :3].T),
            full=float(np.trace(counts)),
            distance=np.inf if self.distance is None else self.distance,
            angle=np.inf if self.angle is None else self.angle,
        )
        return ImpactKernel(compiled.kernels, native)


@final
@dataclass(frozen=True)
class ManipulabilityCost(NativeCost):
    r"""Penalises postures near singularities, where the tool cannot translate or rotate in some direction.

    .. math:: \max(0, 1 - w / w_0)^2, \qquad w = \sqrt{\det J J^T}

    with J the Jacobian of the tool's translation [m] and rotation [rad].

    Args:
        least: Manipulability w_0 from which on the cost is 0, > 0. A Panda at its ready posture has 0.08.

    Raises:
        SettingError: If it is not a finite number > 0.

    References:
        T. Yoshikawa, "Manipulability of robotic mechanisms", IJRR 1985.
    """

    least: float = 0.05

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive("least", self.least)

    def kernel(self, scene: Scene) -> ImpactKernel:
        """Return the native kernel of this cost in a scene.

        Raises:
            UnsupportedError: If fewer than six joints move the tool: it is singular everywhere.
        """
        compiled = compile_scene(scene)
        robot, chain = compiled.robot, _chain(compiled.robot)
        if len(chain) < _TURNS:
            raise UnsupportedError(f"the tool has {len(chain)} joints: with less than {_TURNS} its manipulability is 0")
        native = _native.ManipulabilityCost(
            compiled.kernels.core,
            link=robot.tool_link,
            tool=np.ascontiguousarray(robot.X_LT[:3, 3]),
            chain=np.array(chain, dtype=np.int32),
            least=self.least,
        )
        return ImpactKernel(compiled.kernels, native)


def _chain(robot: RobotArrays) -> list[int]:
    """Return the joints from the base to the tool."""
    found: list[int] = []
    link = robot.tool_link
    while link >= 0:
        found += [int(robot.joint[link])] if robot.joint[link] >= 0 else []
        link = int(robot.parent[link])
    return found[::-1]
