"""What stands loose on what is carried neither slides nor tips: a cake on a tray, a cup on a saucer.

What it feels, its acceleration less gravity, stays within an angle of the axis that points up from what it stands on:
the angle of friction, and the one at which it tips over the rim of its base. That holds at rest, as a tilt, and in
motion. Its own turning is left out, and so is whatever stands on top of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.axes import axis_residual, standing_axis
from graceful_plan.constraints.bounds import frame_in_link
from graceful_plan.constraints.felt import FeltCone, FeltConstraint
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.path import is_real
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.rules import AxisRule, StandsRule
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_AT_REST = 0.9
"""Of the angle, what the tilt may use at rest: the motion needs the others."""
_KEPT = 8
"""Such constraints of a scene whose rules are kept."""


@final
@dataclass(frozen=True)
class KeepStanding(FeltConstraint):
    """What stands loose on what is carried neither slides nor tips.

    Args:
        load: Name of the geom of the carried object that stands for it. Bundled scenes make it a part of what it
            stands on, since it is to stay there.
        height: Of its centre of mass above what it stands on [m]; by default half the geom's height.
        support: Radius of its base about the centre of mass [m]; by default half the geom's least width.
        friction: Coefficient between it and what it stands on; by default that of the geom.
        share: Part of the angle that the motion may use, above 0 and at most 1: nothing else is held back for errors
            of the controller.
    """

    load: str
    height: float | None = None
    support: float | None = None
    friction: float | None = None
    share: float = 0.9
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        for name in ("height", "support", "friction"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise SettingError(name, value, "a finite number above 0")
        if not (is_real(self.share) and 0.0 < self.share <= 1.0):
            raise SettingError("share", self.share, "above 0 and at most 1")

    def rule(self, scene: Scene) -> StandsRule:
        """Return what has to hold in a scene.

        Raises:
            SettingError: If nothing is carried in it.
            UnknownNameError: If what is carried has no such geom.
        """
        return _rule(scene, self)

    def felt_angle(self, scene: Scene) -> float:
        """Return the largest angle between its axis and what it feels [rad]."""
        rule = self.rule(scene)
        return self.share * float(np.arctan(min(rule.friction, rule.support)))

    def felt(self, scene: Scene) -> FeltCone:
        """Return what has to hold for what is felt at its centre of mass."""
        rule, robot = self.rule(scene), compile_scene(scene).robot
        X_LO = frame_in_link(scene, robot, "object")
        return FeltCone(
            name=self.name,
            link=robot.tool_link,
            point=X_LO[:3, :3] @ rule.point + X_LO[:3, 3],
            axis=X_LO[:3, :3] @ rule.axis,
            angle=self.felt_angle(scene),
            gravity=-float(scene.model.opt.gravity[2]),
            slosh=None,
            brim=None,
        )

    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return what has to hold in every configuration: that it is not tilted too much."""
        return (self._upright(scene),)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return by how much it is tilted too much at rest [rad]."""
        return axis_residual(batch, self._upright(batch.scene))

    def told(self, residual: float) -> str:
        """Say in words how far outside a state is."""
        return f"{self.name}: {self.load!r} is tilted by {np.rad2deg(residual):.1f} degrees more than it stands"

    def _upright(self, scene: Scene) -> AxisRule:
        return AxisRule(
            name=self.name,
            frame="object",
            axis=self.rule(scene).axis,
            direction=(0.0, 0.0, 1.0),
            angle=_AT_REST * self.felt_angle(scene),
        )


@per_layout(most=_KEPT)
def _rule(scene: Scene, keep: KeepStanding) -> StandsRule:
    geom = _geom(scene, keep.load)
    axis = np.array(standing_axis(scene))
    R_OG = np.zeros(9)
    mujoco.mju_quat2Mat(R_OG, scene.model.geom_quat[geom])
    R_OG = R_OG.reshape(3, 3)
    box = scene.model.geom_aabb[geom]
    # Boxes in the geom's axes: what stands upright is half as high as the one along the vertical.
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
