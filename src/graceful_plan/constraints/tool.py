"""Constraints on the tool's position and speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.path import finite_array, plain_numbers
from graceful_plan.scene.rules.rules import BoxRule, SpeedRule, Vector
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive


@final
@dataclass(frozen=True)
class ToolWithin(Constraint):
    """The tool's origin stays inside a box.

    Args:
        lower: Lower corner of the box [m].
        upper: Upper corner [m].
        frame: X_WB, pose of the box's axes in W [m]; W itself by default.
    """

    lower: Vector
    upper: Vector
    frame: ArrayLike | None = None

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            object.__setattr__(self, name, _corner(name, getattr(self, name)))
        if not np.all(np.array(self.lower) < np.array(self.upper)):
            raise SettingError("upper", self.upper, f"above lower, {self.lower}, in each coordinate")
        X_WB = np.eye(4) if self.frame is None else finite_array("frame", self.frame, ndim=2, last=4)
        if X_WB.shape != (4, 4) or not np.allclose(X_WB[:3, :3] @ X_WB[:3, :3].T, np.eye(3), atol=1e-6):
            raise SettingError("frame", self.frame, "a pose [4, 4] with a rotation")
        object.__setattr__(self, "frame", tuple(map(tuple, X_WB.tolist())))

    def rule(self, scene: Scene) -> BoxRule:
        """Return the rule for a scene."""
        del scene
        return BoxRule(name=self.name, X_WB=np.array(self.frame), lower=self.lower, upper=self.upper)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the distance of the tool outside the box along the worst coordinate [m]."""
        X_WB = np.array(self.frame)
        at = (batch.tool_poses[:, :3, 3] - X_WB[:3, 3]) @ X_WB[:3, :3]
        return np.maximum(np.array(self.lower) - at, at - np.array(self.upper)).max(axis=1)

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        return f"{self.name}: the tool is {1e3 * residual:.3g} mm outside of its box"


@final
@dataclass(frozen=True)
class ToolSpeed(Constraint):
    """Limit the speed of the tool's origin, everywhere or only near an entity.

    It restricts timing only: every configuration satisfies it.

    Args:
        limit: Largest speed of the tool's origin [m/s], above 0.
        near: Entity near which the limit applies; everywhere by default.
        within: Distance of robot and carried object from that entity up to which the limit applies [m].
    """

    limit: float
    near: str | None = None
    within: float = 0.3

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("limit", "within"):
            value = getattr(self, name)
            positive(name, value)

    def rule(self, scene: Scene) -> SpeedRule:
        """Return the rule for a scene; raise if the scene has no such entity."""
        if self.near is not None and self.near not in scene.entities:
            raise UnknownNameError("entity", self.near, scene.entities)
        return SpeedRule(name=self.name, limit=self.limit, near=self.near, within=self.within)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return a negative constant: a robot at rest satisfies the limit everywhere."""
        return np.full(len(batch), -self.limit)


def _corner(name: str, value: Vector) -> Vector:
    x, y, z = finite_array(name, np.asarray(value, dtype=object), ndim=1, last=3).tolist()
    return x, y, z
