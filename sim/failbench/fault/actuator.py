"""Faults of the joints' drives and bearings. Values and their reasons: docs/faults.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drives import DRIVE, FRICTION, GRIP, add_friction, cut_overloaded_weld, scale_response, weaken
from failbench.fault.fault import Fault
from failbench.simulated.plant import Plant
from graceful_plan.exceptions import SettingError

_SEIZED = 100.0
"""Inertia of a seized joint [kg m^2 or kg]: the lock alone would let it tremble when the other joints brake."""


@dataclass(frozen=True, kw_only=True)
class CompleteShutdown(Fault):
    """A drive gives no torque any more: the joint swings freely but for the resistance of the dead motor."""

    NAME: ClassVar[str] = "complete_shutdown"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "viscous resistance of the dead motor [N m s/rad]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 40.0, "moderate": 10.0, "severe": 2.0, "critical": 0.0}
    FIELDS: ClassVar[tuple[str, ...]] = ("dof_damping", *DRIVE, *GRIP)

    def apply(self, plant: Plant, level: float) -> None:
        """Take the torque away."""
        scale_response(plant, 1.0 - level)
        cut_overloaded_weld(plant, 1.0 - level)
        plant["dof_damping"][plant.robot.dofs[plant.joints]] += level * self.amount


@dataclass(frozen=True, kw_only=True)
class LooseJoint(Fault):
    """A transmission comes loose: little of the motor's stiffness and damping reaches the joint; it sags and sways.

    Its gears have backlash, too: a motor that turns back has to cross the gap before the joint feels anything.

    Args:
        backlash: Width of the gap [rad or m], half of it on either side; None for what the degree says, `BACKLASH`.
    """

    ramp: float = 0.2
    backlash: float | None = None

    NAME: ClassVar[str] = "loose_joint"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "stiffness that is left, as a share of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.3, "moderate": 0.1, "severe": 0.03, "critical": 0.01}
    BACKLASH: ClassVar[Mapping[str, float]] = {"minor": 0.005, "moderate": 0.01, "severe": 0.02, "critical": 0.04}
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)
    PERIOD: ClassVar[float | None] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.backlash is not None and not (math.isfinite(self.backlash) and self.backlash >= 0.0):
            raise SettingError("backlash", self.backlash, "a finite width >= 0 rad, or None for that of the degree")

    @property
    def gap(self) -> float:
        """Width of the gap between the gears [rad or m]."""
        return self.BACKLASH[self.degree] if self.backlash is None else self.backlash

    @property
    def period(self) -> float | None:
        """Every step, to see on which side of the gap the gears are; without a gap once is enough."""
        return self.PERIOD if self.gap else None

    def apply(self, plant: Plant, level: float) -> None:
        """Weaken the coupling of motor and joint, and let it pass nothing while the gears are within the gap."""
        share = 1.0 + level * (self.amount - 1.0)
        scale_response(plant, share)
        cut_overloaded_weld(plant, share)
        if self.gap and len(plant.ahead):
            robot, bias, joints = plant.robot, plant["actuator_biasprm"], plant.joints
            struck, half = robot.actuators[joints], level * self.gap / 2.0
            # By how much the servo would twist a shaft without a gap: its torque over its stiffness.
            asked = robot.gain[joints] * plant.ahead[0, struck] - robot.kd[joints] * plant.qd[joints]
            twist = asked / robot.kp[joints] - plant.q[joints]
            bias[struck, 0] += bias[struck, 1] * half * np.sign(twist)
            within = struck[np.abs(twist) <= half]
            plant["actuator_gainprm"][within] = bias[within] = 0.0


@dataclass(frozen=True, kw_only=True)
class LimitedRange(Fault):
    """Something is in the way of a joint: it moves freely around where it is, then meets a hard stop on either side."""

    NAME: ClassVar[str] = "limited_range"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "motion that is left in each direction [rad or m]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.2, "moderate": 0.1, "severe": 0.05, "critical": 0.01}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("jnt_range", "jnt_limited", "jnt_solref")

    def apply(self, plant: Plant, level: float) -> None:
        """Put stops around the position of the onset; along a ramp they close in."""
        centre = plant.memory.setdefault("centre", plant.q[plant.joints])
        joints = plant.robot.joint_ids[plant.joints]
        limited = plant["jnt_limited"][joints].astype(bool)[:, None]
        healthy = np.where(limited, plant["jnt_range"][joints], [-np.inf, np.inf])
        plant["jnt_range"][joints, 0] = np.maximum(healthy[:, 0], centre - self.amount / level)
        plant["jnt_range"][joints, 1] = np.minimum(healthy[:, 1], centre + self.amount / level)
        plant["jnt_limited"][joints] = 1
        plant["jnt_solref"][joints] = [2.0 * plant.dt, 1.0]  # as hard as the time step allows


@dataclass(frozen=True, kw_only=True)
class PartialDegradation(Fault):
    """A drive has lost part of its strength: a share of the torque that is asked for, and of its greatest torque."""

    ramp: float = 0.2

    NAME: ClassVar[str] = "partial_degradation"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "torque that is left, as a share of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.5, "severe": 0.25, "critical": 0.1}
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Plant, level: float) -> None:
        """Weaken the drive."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class GradualDegradation(Fault):
    """A drive loses strength little by little, as one that overheats does. `ramp` is how long that takes."""

    ramp: float = 0.5

    NAME: ClassVar[str] = "gradual_degradation"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "torque that is left after the ramp, as a share of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.6, "moderate": 0.3, "severe": 0.1, "critical": 0.0}
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Plant, level: float) -> None:
        """Weaken the drive as far as the ramp has come."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class StuckPosition(Fault):
    """A joint seizes: friction grows until it is as strong as the motor, and from then on nothing moves the joint."""

    NAME: ClassVar[str] = "stuck_position"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "time from the first rubbing to the standstill [s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.4, "moderate": 0.2, "severe": 0.1, "critical": 0.0}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("eq_data", "dof_armature", *FRICTION)
    PERIOD: ClassVar[float | None] = 0.02

    def apply(self, plant: Plant, level: float) -> None:
        """Let the joint rub, then lock it where it is."""
        seized = level * min(1.0, plant.time / self.amount) if self.amount else level
        if seized < 1.0:
            add_friction(plant, seized)
            return
        plant["dof_armature"][plant.robot.dofs[plant.joints]] += _SEIZED
        stuck_at = plant.memory.setdefault("position", plant.q[plant.joints])
        for joint, position in zip(plant.joints, stuck_at, strict=True):
            plant.lock(int(joint), float(position))


@dataclass(frozen=True, kw_only=True)
class IncreasedFriction(Fault):
    """A bearing runs dry: dry friction, and at 1 rad/s as much viscous friction again."""

    ramp: float = 0.2

    NAME: ClassVar[str] = "increased_friction"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "dry friction, as a share of the joint's greatest torque"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.1, "moderate": 0.3, "severe": 0.6, "critical": 0.9}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("dof_damping", *FRICTION)

    def apply(self, plant: Plant, level: float) -> None:
        """Add friction."""
        torque = add_friction(plant, level * self.amount)
        plant["dof_damping"][plant.robot.dofs[plant.joints]] += torque
