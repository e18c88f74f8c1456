"""Faults of the joints' drives and bearings. Values and their reasons: docs/faults.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drives import DRIVE, FRICTION, GRIP, add_friction, cut_overloaded_weld, scale_response, weaken
from failbench.fault.fault import Fault
from failbench.simulated.simulation import Simulation
from graceful_plan.exceptions import SettingError

_SEIZED = 100.0
"""Inertia of a seized joint [kg m^2 or kg]: with the lock alone it would tremble while other joints brake."""


@dataclass(frozen=True, kw_only=True)
class CompleteShutdown(Fault):
    """A drive loses all torque: the joint swings freely, against only the resistance of the dead motor."""

    NAME: ClassVar[str] = "complete_shutdown"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "viscous resistance of the dead motor [N m s/rad]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 40.0, "moderate": 10.0, "severe": 2.0, "critical": 0.0}
    FIELDS: ClassVar[tuple[str, ...]] = ("dof_damping", *DRIVE, *GRIP)

    def apply(self, plant: Simulation, level: float) -> None:
        """Remove the drive's torque and add the motor's viscous resistance."""
        scale_response(plant, 1.0 - level)
        cut_overloaded_weld(plant, 1.0 - level)
        plant["dof_damping"][plant.robot.dofs[plant.joints]] += level * self.amount


@dataclass(frozen=True, kw_only=True)
class LooseJoint(Fault):
    """A transmission comes loose: the joint gets little of the motor's stiffness and damping, so it sags and sways.

    The gears also have backlash: a motor that reverses has to cross the gap before the joint moves.

    Args:
        backlash: Width of the gap [rad or m], half of it on either side. None takes the value of the degree,
            `BACKLASH`.
    """

    ramp: float = 0.2
    backlash: float | None = None

    NAME: ClassVar[str] = "loose_joint"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "remaining stiffness, as a fraction of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.3, "moderate": 0.1, "severe": 0.03, "critical": 0.01}
    BACKLASH: ClassVar[Mapping[str, float]] = {"minor": 0.005, "moderate": 0.01, "severe": 0.02, "critical": 0.04}
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)
    PERIOD: ClassVar[float | None] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.backlash is not None and not (math.isfinite(self.backlash) and self.backlash >= 0.0):
            raise SettingError(
                "backlash", self.backlash, "a finite width >= 0 rad, or None for the value of the degree"
            )

    @property
    def gap(self) -> float:
        """Width of the gap between the gears [rad or m]."""
        return self.BACKLASH[self.degree] if self.backlash is None else self.backlash

    @property
    def period(self) -> float | None:
        """Every step with a gap, to track on which side of it the gears are; once without a gap."""
        return self.PERIOD if self.gap else None

    def apply(self, plant: Simulation, level: float) -> None:
        """Weaken the coupling of motor and joint, and transmit no torque while the gears are within the gap."""
        share = 1.0 + level * (self.amount - 1.0)
        scale_response(plant, share)
        cut_overloaded_weld(plant, share)
        if self.gap and len(plant.ahead):
            robot, bias, joints = plant.robot, plant["actuator_biasprm"], plant.joints
            struck, half = robot.actuators[joints], level * self.gap / 2.0
            # Angle by which the servo would twist a shaft without a gap: its torque over its stiffness.
            asked = robot.gain[joints] * plant.ahead[0, struck] - robot.kd[joints] * plant.qd[joints]
            twist = asked / robot.kp[joints] - plant.q[joints]
            bias[struck, 0] += bias[struck, 1] * half * np.sign(twist)
            within = struck[np.abs(twist) <= half]
            plant["actuator_gainprm"][within] = bias[within] = 0.0


@dataclass(frozen=True, kw_only=True)
class LimitedRange(Fault):
    """A joint is obstructed: it moves freely around its position at the onset, up to a hard stop on either side."""

    NAME: ClassVar[str] = "limited_range"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "remaining range of motion in each direction [rad or m]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.2, "moderate": 0.1, "severe": 0.05, "critical": 0.01}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("jnt_range", "jnt_limited", "jnt_solref")

    def apply(self, plant: Simulation, level: float) -> None:
        """Put stops around the position at the onset; they close in along the ramp."""
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
    """A drive has lost part of its strength: commanded torque and torque limit are both scaled down."""

    ramp: float = 0.2

    NAME: ClassVar[str] = "partial_degradation"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "remaining torque, as a fraction of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.5, "severe": 0.25, "critical": 0.1}
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Simulation, level: float) -> None:
        """Weaken the drive."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class GradualDegradation(Fault):
    """A drive loses strength gradually, over the time `ramp`, for example because it overheats."""

    ramp: float = 0.5

    NAME: ClassVar[str] = "gradual_degradation"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "remaining torque after the ramp, as a fraction of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.6, "moderate": 0.3, "severe": 0.1, "critical": 0.0}
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Simulation, level: float) -> None:
        """Weaken the drive in proportion to the progress of the ramp."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class StuckPosition(Fault):
    """A joint seizes: friction grows until it equals the motor's torque limit, then the joint is locked."""

    NAME: ClassVar[str] = "stuck_position"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "time from the first friction to standstill [s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.4, "moderate": 0.2, "severe": 0.1, "critical": 0.0}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("eq_data", "dof_armature", *FRICTION)
    PERIOD: ClassVar[float | None] = 0.02

    def apply(self, plant: Simulation, level: float) -> None:
        """Add growing friction, then lock the joint at its current position."""
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
    """A bearing runs dry: it adds dry friction, and viscous friction of the same torque at 1 rad/s."""

    ramp: float = 0.2

    NAME: ClassVar[str] = "increased_friction"
    CATEGORY: ClassVar[str] = "actuator"
    PARAMETER: ClassVar[str] = "dry friction, as a fraction of the joint's torque limit"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.1, "moderate": 0.3, "severe": 0.6, "critical": 0.9}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("dof_damping", *FRICTION)

    def apply(self, plant: Simulation, level: float) -> None:
        """Add dry and viscous friction."""
        torque = add_friction(plant, level * self.amount)
        plant["dof_damping"][plant.robot.dofs[plant.joints]] += torque
