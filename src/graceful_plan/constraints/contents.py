"""Constraint that keeps contents in the carried vessel at rest, in motion and while they slosh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.axes import axis_residual
from graceful_plan.constraints.bounds import frame_in_link
from graceful_plan.constraints.slosh import Slosh
from graceful_plan.constraints.specific_force import SpecificForceCone, SpecificForceConstraint
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import LEVER
from graceful_plan.costs.cost import StateBatch
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.rules.rules import AxisRule, ContentsRule
from graceful_plan.scene.rules.vessel import Vessel, find_vessel
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive_fraction

_AT_REST = 0.9
"""Fraction of `specific_force_angle` that the tilt may use at rest; the rest is left for accelerations."""
_ROOM = 0.01
"""Extra tilt allowed beyond that of a tilted start or goal [rad]."""
_ASTRAY = 0.12
"""Lateral acceleration by tracking error, as a fraction of the axial acceleration of the vessel.
FailBench's controller reaches 0.05 to 0.3 of the peak (ten vessels of the benchmark `constraints`)."""
_LEAST_HEAVE = 0.1
"""Least axial acceleration to allow a vessel, however full, as a fraction of gravity."""
_STEEPEST = float(np.deg2rad(80.0))
"""Upper limit of the brim tilt [rad], whatever the vessel holds: the specific force must have a direction."""


@final
@dataclass(frozen=True)
class KeepContents(SpecificForceConstraint):
    """Keep the contents of the carried vessel from spilling.

    The fill level sets the largest tilt: the angle at which the surface reaches the rim, plus the angle of repose for
    dry contents. At rest the angle is measured from gravity, in motion from the apparent gravity in the vessel: gravity
    minus the acceleration of the contents. The surface lags behind and overshoots (`Slosh`), so a part of the angle is
    reserved for sloshing. If the first mode still reaches the rim, the motion is slowed down until it does not.

    Args:
        share: Fraction of that angle that tilt and acceleration may use, above 0 and at most 1; less where sloshing
            needs the rest. It is raised where start or goal need more.
    """

    share: float = 0.75
    lever: ClassVar[float] = LEVER

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_fraction("share", self.share)

    def rule(self, scene: Scene) -> ContentsRule:
        """Return the rule for a scene; raise if no vessel with contents is carried."""
        return ContentsRule(name=self.name, vessel=_vessel(scene))

    def around(self, q: Float[Array, "n nq"], scene: Scene) -> KeepContents:
        """Return a constraint whose share also admits the given configurations, up to a share of 1."""
        needed = self.needed(q, scene)
        return self if needed <= self.share else KeepContents(needed)

    def needed(self, q: Float[Array, "n nq"], scene: Scene) -> float:
        """Return the share that the tilts of the given configurations need, at most 1."""
        upright = self.upright(scene)
        tilt = float(axis_residual(StateBatch(scene, q), upright).max()) + upright.angle
        return min(1.0, (tilt + _ROOM) / (_AT_REST * min(_vessel(scene).brim_tilt, _STEEPEST)))

    def at_most(self, share: float) -> KeepContents:
        """Return a constraint with this share or the present one, whichever is less."""
        return self if self.share <= share else KeepContents(share)

    def upright(self, scene: Scene) -> AxisRule:
        """Return the tilt limit at rest, which planners enforce in every configuration."""
        x, y, z = _vessel(scene).axis.tolist()
        angle = _AT_REST * self.specific_force_angle(scene)
        return AxisRule(name=self.name, frame="object", axis=(x, y, z), direction=(0.0, 0.0, 1.0), angle=angle)

    def resting(self, scene: Scene) -> tuple[AxisRule, ...]:
        """Return the tilt limit at rest, for the core."""
        return (self.upright(scene),)

    def specific_force_angle(self, scene: Scene) -> float:
        """Return the largest angle between the vessel's axis and the specific force, sloshing excluded [rad]."""
        return self.share * min(_vessel(scene).brim_tilt, _STEEPEST)

    def felt(self, scene: Scene) -> SpecificForceCone:
        """Return the limits on the specific force in the vessel during a motion."""
        vessel, robot = _vessel(scene), compile_scene(scene).robot
        gravity = -float(scene.model.opt.gravity[2])
        X_LO = frame_in_link(scene, robot, "object")
        return SpecificForceCone(
            name=self.name,
            link=robot.tool_link,
            point=X_LO[:3, :3] @ vessel.p_BS + X_LO[:3, 3],
            axis=X_LO[:3, :3] @ vessel.axis,
            angle=self.specific_force_angle(scene),
            gravity=gravity,
            slosh=Slosh.of(vessel, gravity) if vessel.repose == 0.0 else None,
            brim=min(vessel.brim_tilt, _STEEPEST),
            heave=self._heave(vessel),
        )

    def _heave(self, vessel: Vessel) -> float:
        """Return the largest axial deviation from 1 g [g] for which tracking error spills nothing."""
        brim = min(vessel.brim_tilt, _STEEPEST)
        return max(float(np.tan(brim) - np.tan(self.share * brim)) / _ASTRAY, _LEAST_HEAVE)

    def residual(self, batch: StateBatch) -> Float[Array, " n"]:
        """Return the tilt at rest minus its limit [rad]."""
        brim = _AT_REST * min(_vessel(batch.scene).brim_tilt, _STEEPEST)
        return axis_residual(batch, replace(self.upright(batch.scene), angle=brim))

    def told(self, residual: float) -> str:
        """Describe a violation for messages."""
        return f"{self.name}: the vessel is tilted by {np.rad2deg(residual):.1f} degrees more than its fill allows"


def _vessel(scene: Scene) -> Vessel:
    vessel = find_vessel(scene)
    if vessel is None:
        raise SettingError("constraints", "KeepContents()", "KeepContents only where a vessel with contents is carried")
    return vessel
