"""Constraints that keep an axis within an angle of a direction, for level trays and cameras on a target."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real, plain_numbers, real_array
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.rules import AxisRule, Vector, checked_frame
from graceful_plan.scene.scene import Scene


@final
@dataclass(frozen=True)
class AxisWithin(Constraint):
    """An axis of the tool or of the carried object stays within an angle of a direction in W.

    Args:
        axis: Axis in the frame; any length above 0.
        direction: Direction in W; any length above 0.
        angle: Largest angle between them [rad], above 0 and at most pi.
        frame: "tool" or "object". The default is the carried object, or the tool if nothing is carried.
    """

    axis: Vector
    direction: Vector
    angle: float
    frame: str | None = None
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("axis", "direction"):
            object.__setattr__(self, name, _unit(name, getattr(self, name)))
        _check_angle("angle", self.angle)

    def rule(self, scene: Scene) -> AxisRule:
        """Return the rule for a scene; raise if the scene has no such frame."""
        frame = checked_frame(scene, self.frame)
        return AxisRule(name=self.name, frame=frame, axis=self.axis, direction=self.direction, angle=self.angle)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the angle minus its limit [rad]."""
        return axis_residual(batch, self.rule(batch.scene))

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        return told_angle(self.name, residual, self.angle)


@final
@dataclass(frozen=True)
class Upright(Constraint):
    """Limit the tilt of the carried object away from its initial upright pose.

    The axis is the one that is vertical in the object's initial pose. If nothing is carried, it is the tool's -z axis,
    which points from the fingers back to the wrist, so that the gripper points down.

    Args:
        max_tilt: Largest angle between that axis and the vertical [rad].
    """

    max_tilt: float = float(np.deg2rad(15.0))
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        plain_numbers(self)
        _check_angle("max_tilt", self.max_tilt)

    def rule(self, scene: Scene) -> AxisRule:
        """Return the rule for a scene."""
        return AxisRule(
            name=self.name,
            frame=checked_frame(scene, None),
            axis=standing_axis(scene),
            direction=(0.0, 0.0, 1.0),
            angle=self.max_tilt,
        )

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the tilt minus its limit [rad]."""
        return axis_residual(batch, self.rule(batch.scene))

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        return told_angle(self.name, residual, self.max_tilt)


def axis_residual(batch: StateBatch, rule: AxisRule) -> Float[Array, " n"]:
    """Return the angle between axis and direction minus the rule's limit [rad]."""
    poses = batch.object_poses if rule.frame == "object" else batch.tool_poses
    axis = poses[:, :3, :3] @ np.array(rule.axis)
    across = np.linalg.norm(np.cross(axis, rule.direction), axis=1)
    return np.arctan2(across, axis @ np.array(rule.direction)) - rule.angle


def told_angle(name: str, residual: float, angle: float) -> str:
    """Describe a violated tilt limit."""
    tilt, allowed = np.rad2deg([residual + angle, angle])
    return f"{name}: {tilt:.1f} degrees, {np.rad2deg(residual):.1f} more than the {allowed:.1f} allowed"


@per_layout
def standing_axis(scene: Scene) -> Vector:
    """Return the carried object's axis that is vertical in the initial scene; the tool's -z if nothing is carried."""
    if scene.carried is None:
        return 0.0, 0.0, -1.0
    data = mujoco.MjData(scene.model)
    mujoco.mj_kinematics(scene.model, data)
    return _vector(data.xmat[scene.model.body(scene.carried.body).id].reshape(3, 3)[2])


def _check_angle(name: str, angle: float) -> None:
    if not (is_real(angle) and 0.0 < angle <= np.pi):
        raise SettingError(name, angle, "an angle above 0 and at most pi rad")


def _unit(name: str, value: Vector) -> Vector:
    array = real_array(name, value)
    length = float(np.linalg.norm(array)) if array.shape == (3,) else 0.0
    if not (np.isfinite(length) and length > 0.0):
        raise SettingError(name, value, "three finite numbers, not all 0")
    return _vector(array / length)


def _vector(array: Float[Array, " xyz"]) -> Vector:
    x, y, z = array.tolist()
    return x, y, z
