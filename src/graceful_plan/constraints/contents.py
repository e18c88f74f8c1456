"""Contents stay in the vessel that is carried: at rest, while it is moved, and as they slosh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.constraints.axes import axis_residual
from graceful_plan.constraints.bounds import frame_in_link
from graceful_plan.constraints.felt import FeltCone, FeltConstraint
from graceful_plan.constraints.slosh import Slosh
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError
from graceful_plan.path import is_real
from graceful_plan.scene.rules.rules import AxisRule, ContentsRule
from graceful_plan.scene.rules.vessel import Vessel, find_vessel
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_AT_REST = 0.9
"""Of the angle that what is felt may use, what the vessel may be tilted at rest: the motion needs the others."""
_ROOM = 0.01
"""What a vessel may be tilted further than at a tilted end [rad]."""
_ASTRAY = 0.12
"""Of the acceleration along a vessel's axis, what a robot gives it across: it does not follow to the last bit.
FailBench's own gives between 0.05 and 0.3 of the greatest one (ten vessels of the benchmark `constraints`)."""
_LEAST_HEAVE = 0.1
"""Of gravity, what a vessel may be accelerated along its axis at least, however full it is."""
_STEEPEST = float(np.deg2rad(80.0))
"""Of that angle, whatever the vessel holds: what is felt has to have a direction."""


@final
@dataclass(frozen=True)
class KeepContents(FeltConstraint):
    """What is in the carried vessel stays in it.

    The fill says how far the vessel may be tilted: until the surface reaches the rim; something dry may be tilted
    further by its angle of repose. At rest that is about gravity; in motion about what is felt in the vessel, gravity
    less the acceleration of its contents. The surface lags behind and overshoots (`Slosh`): a part of the angle is left
    to that, and motions whose first mode still reaches the rim are slowed down until it does not.

    Args:
        share: Part of the angle that the fill allows which tilt and acceleration may use, above 0 and at most 1; less
            where sloshing needs the rest. Where start or goal need more, they get more.
    """

    share: float = 0.75
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        if not (is_real(self.share) and 0.0 < self.share <= 1.0):
            raise SettingError("share", self.share, "above 0 and at most 1")

    def rule(self, scene: Scene) -> ContentsRule:
        """Return what has to hold in a scene; raise if nothing is carried in a vessel."""
        return ContentsRule(name=self.name, vessel=_vessel(scene))

    def around(self, q: Float[Array, "n nq"], scene: Scene) -> KeepContents:
        """Return one with room for some configurations, as far as they are allowed: ends that are tilted further."""
        needed = self.needed(q, scene)
        return self if needed <= self.share else KeepContents(needed)

    def needed(self, q: Float[Array, "n nq"], scene: Scene) -> float:
        """Return the share that some configurations need."""
        upright = self.upright(scene)
        tilt = float(axis_residual(StateBatch(scene, q), upright).max()) + upright.angle
        return min(1.0, (tilt + _ROOM) / (_AT_REST * min(_vessel(scene).brim_tilt, _STEEPEST)))

    def at_most(self, share: float) -> KeepContents:
        """Return one that uses no more than some share."""
        return self if self.share <= share else KeepContents(share)

    def upright(self, scene: Scene) -> AxisRule:
        """Return what planners have to hold in every configuration: that the vessel is not tilted too much."""
        x, y, z = _vessel(scene).axis.tolist()
        angle = _AT_REST * self.felt_angle(scene)
        return AxisRule(name=self.name, frame="object", axis=(x, y, z), direction=(0.0, 0.0, 1.0), angle=angle)

    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return the same for the core."""
        return (self.upright(scene),)

    def felt_angle(self, scene: Scene) -> float:
        """Return the largest angle between the vessel's axis and what is felt in it, sloshing aside [rad]."""
        return self.share * min(_vessel(scene).brim_tilt, _STEEPEST)

    def felt(self, scene: Scene) -> FeltCone:
        """Return what has to hold for what is felt in the vessel, in motion."""
        vessel, robot = _vessel(scene), compile_scene(scene).robot
        gravity = -float(scene.model.opt.gravity[2])
        X_LO = frame_in_link(scene, robot, "object")
        return FeltCone(
            name=self.name,
            link=robot.tool_link,
            point=X_LO[:3, :3] @ vessel.p_BS + X_LO[:3, 3],
            axis=X_LO[:3, :3] @ vessel.axis,
            angle=self.felt_angle(scene),
            gravity=gravity,
            slosh=Slosh.of(vessel, gravity) if vessel.repose == 0.0 else None,
            brim=min(vessel.brim_tilt, _STEEPEST),
            heave=self._heave(vessel),
        )

    def _heave(self, vessel: Vessel) -> float:
        """Return what may be felt along the axis beyond gravity, or less, so that what goes astray stays in [g]."""
        brim = min(vessel.brim_tilt, _STEEPEST)
        return max(float(np.tan(brim) - np.tan(self.share * brim)) / _ASTRAY, _LEAST_HEAVE)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return by how much the vessel is tilted too much at rest [rad]."""
        brim = _AT_REST * min(_vessel(batch.scene).brim_tilt, _STEEPEST)
        return axis_residual(batch, replace(self.upright(batch.scene), angle=brim))

    def told(self, residual: float) -> str:
        """Say in words how far outside a state is."""
        return f"{self.name}: the vessel is tilted by {np.rad2deg(residual):.1f} degrees more than its fill allows"


def _vessel(scene: Scene) -> Vessel:
    vessel = find_vessel(scene)
    if vessel is None:
        raise SettingError("constraints", "KeepContents()", "KeepContents only where a vessel with contents is carried")
    return vessel
