"""Constraint that a loose load on the carried object neither slides nor tips: a cake on a tray, a cup on a saucer.

The specific force of the load (acceleration minus gravity) stays within an angle of the upward normal of its support.
The angle is the lesser of the friction angle and the angle at which the load tips over the rim of its base. It limits
the tilt at rest and the accelerations in motion. The load's rotational inertia is neglected, as is anything on top of
the load.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.axes import axis_residual, standing_axis
from graceful_plan.constraints.bounds import frame_in_link
from graceful_plan.constraints.specific_force import SpecificForceCone, SpecificForceConstraint
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.rules import AxisRule, StandsRule
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive_fraction, positive_or_none

_AT_REST = 0.9
"""Fraction of the angle that the tilt may use at rest; the rest is left for accelerations."""
_KEPT = 8
"""Constraints per scene whose rules are cached."""


@final
@dataclass(frozen=True)
class KeepStanding(SpecificForceConstraint):
    """Keep a loose load on the carried object from sliding and tipping.

    Args:
        load: Name of the load's geom in the carried object. Bundled scenes fix it to its support, since it is to stay
            there.
        height: Height of the load's centre of mass above its support [m]; by default half the geom's height.
        support: Radius of the load's base about its centre of mass [m]; by default half the geom's least width.
        friction: Coefficient between load and support; by default that of the geom.
        share: Fraction of the angle that the motion may use, above 0 and at most 1. It is the only reserve for errors
            of the controller.
    """

    load: str
    height: float | None = None
    support: float | None = None
    friction: float | None = None
    share: float = 0.9
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("height", "support", "friction"):
            value = getattr(self, name)
            positive_or_none(name, value)
        positive_fraction("share", self.share)

    def rule(self, scene: Scene) -> StandsRule:
        """Return the rule for a scene.

        Raises:
            SettingError: If nothing is carried in the scene.
            UnknownNameError: If the carried object has no such geom.
        """
        return _rule(scene, self)

    def specific_force_angle(self, scene: Scene) -> float:
        """Return the largest angle between the support's normal and the load's specific force [rad]."""
        rule = self.rule(scene)
        return self.share * float(np.arctan(min(rule.friction, rule.support)))

    def felt(self, scene: Scene) -> SpecificForceCone:
        """Return the limits of the specific force at the load's centre of mass."""
        rule, robot = self.rule(scene), compile_scene(scene).robot
        X_LO = frame_in_link(scene, robot, "object")
        return SpecificForceCone(
            name=self.name,
            link=robot.tool_link,
            point=X_LO[:3, :3] @ rule.point + X_LO[:3, 3],
            axis=X_LO[:3, :3] @ rule.axis,
            angle=self.specific_force_angle(scene),
            gravity=-float(scene.model.opt.gravity[2]),
            slosh=None,
            brim=None,
        )

    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return the tilt limit at rest, for every configuration."""
        return (self._upright(scene),)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the tilt at rest minus its limit [rad]."""
        return axis_residual(batch, self._upright(batch.scene))

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        return f"{self.name}: {self.load!r} is tilted by {np.rad2deg(residual):.1f} degrees more than is stable"

    def _upright(self, scene: Scene) -> AxisRule:
        return AxisRule(
            name=self.name,
            frame="object",
            axis=self.rule(scene).axis,
            direction=(0.0, 0.0, 1.0),
            angle=_AT_REST * self.specific_force_angle(scene),
        )


@per_layout(most=_KEPT)
def _rule(scene: Scene, keep: KeepStanding) -> StandsRule:
    geom = _geom(scene, keep.load)
    axis = np.array(standing_axis(scene))
    R_OG = np.zeros(9)
    mujoco.mju_quat2Mat(R_OG, scene.model.geom_quat[geom])
    R_OG = R_OG.reshape(3, 3)
    box = scene.model.geom_aabb[geom]
    # The box is aligned with the geom; an upright load is half as high as the half size nearest the vertical.
    upward = np.abs(R_OG.T @ axis)
    k = int(np.argmax(upward))
    half = float(box[3 + k])
    height = half if keep.height is None else keep.height
    support = float(np.delete(box[3:], k).min()) if keep.support is None else keep.support
    friction = float(scene.model.geom_friction[geom, 0]) if keep.friction is None else keep.friction
    bottom = scene.model.geom_pos[geom] + R_OG @ box[:3] - half * axis
    x, y, z = (bottom + height * axis).tolist()
    up_x, up_y, up_z = axis.tolist()
    return StandsRule(
        name=keep.name,
        point=(x, y, z),
        axis=(up_x, up_y, up_z),
        friction=friction,
        support=support / height,
    )


def _geom(scene: Scene, load: str) -> int:
    if scene.carried is None:
        raise SettingError("constraints", "KeepStanding()", "KeepStanding only where something is carried")
    mine = scene.components["carried"].geoms
    names = {scene.model.geom(g).name: int(g) for g in mine if scene.model.geom(g).name}
    if load not in names:
        raise UnknownNameError(f"geom of {scene.carried.body!r}", load, names)
    return names[load]
