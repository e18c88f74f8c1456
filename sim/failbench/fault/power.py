"""Faults of the power supply: they strike all drives, the gripper's too. Values and their reasons: docs/faults.md."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from failbench.fault.drives import (
    BRAKE_TORQUE,
    DRIVE,
    FRICTION,
    GRIP,
    add_friction,
    cut_overloaded_weld,
    hold_grip,
    scale_torque,
    weaken,
)
from failbench.fault.fault import Fault
from failbench.simulated.plant import Plant
from graceful_plan.exceptions import SettingError

BRAKES = ("none", "delayed", "immediate")
GRIPS = ("lost", "kept")


@dataclass(frozen=True, kw_only=True)
class BatteryDegradation(Fault):
    """A battery runs down: the torque of all drives sags with time. `ramp` is how long that takes."""

    ramp: float = 1.0

    NAME: ClassVar[str] = "battery_degradation"
    CATEGORY: ClassVar[str] = "power"
    PARAMETER: ClassVar[str] = "torque that is left after the ramp, as a share of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.5, "severe": 0.25, "critical": 0.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Plant, level: float) -> None:
        """Weaken all drives as far as the ramp has come."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class VoltageDrop(Fault):
    """A brown-out: for a short time all drives give a share of their torque, then everything is as before."""

    ramp: float = 0.02
    duration: float | None = 0.2

    NAME: ClassVar[str] = "voltage_drop"
    CATEGORY: ClassVar[str] = "power"
    PARAMETER: ClassVar[str] = "voltage, and with it torque, that is left, as a share of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.7, "severe": 0.4, "critical": 0.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Plant, level: float) -> None:
        """Weaken all drives."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class PowerLoss(Fault):
    """The power fails: no drive gives any torque, until brakes hold the joints, if there are any.

    Args:
        brake: "delayed": spring-closed brakes hold the joints after the time that the degree sets; "immediate": at
            once; "none": never, the arm falls. The degree scales nothing then.
        grip: "lost": the fingers have no force either, as in most grippers; "kept": they are self-locking.
    """

    brake: str = "delayed"
    grip: str = "lost"

    NAME: ClassVar[str] = "power_loss"
    CATEGORY: ClassVar[str] = "power"
    PARAMETER: ClassVar[str] = "time until the brakes hold, if they are delayed [s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.1, "moderate": 0.15, "severe": 0.25, "critical": 0.5}
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)
    FIELDS: ClassVar[tuple[str, ...]] = tuple(dict.fromkeys((*DRIVE, *GRIP, *FRICTION)))
    PERIOD: ClassVar[float | None] = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value, valid in (("brake", self.brake, BRAKES), ("grip", self.grip, GRIPS)):
            if value not in valid:
                raise SettingError(name, value, f"one of {', '.join(valid)}")

    def apply(self, plant: Plant, level: float) -> None:
        """Take the torque away, and close the brakes when it is time."""
        wait = {"none": float("inf"), "delayed": self.amount, "immediate": 0.0}[self.brake]
        if plant.time >= wait - plant.dt / 2.0:
            add_friction(plant, level * BRAKE_TORQUE)
        gripping = {name: plant[name][plant.robot.gripper_actuators] for name in DRIVE}
        scale_torque(plant, 1.0 - level)
        if self.grip == "kept":
            for name, values in gripping.items():
                plant[name][plant.robot.gripper_actuators] = values
            hold_grip(plant)
        cut_overloaded_weld(plant, float(self.grip == "kept" or level < 1.0))
