"""Faults of the power supply, which strike all drives including the gripper's. For the values see docs/faults.md."""

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
from failbench.simulated.simulation import Simulation
from graceful_plan.exceptions import SettingError

BRAKES = ("none", "delayed", "immediate")
GRIPS = ("lost", "kept")


@dataclass(frozen=True, kw_only=True)
class BatteryDegradation(Fault):
    """A battery runs down: the torque of all drives decreases over the time `ramp`."""

    ramp: float = 1.0

    NAME: ClassVar[str] = "battery_degradation"
    CATEGORY: ClassVar[str] = "power"
    PARAMETER: ClassVar[str] = "remaining torque after the ramp, as a fraction of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.5, "severe": 0.25, "critical": 0.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Simulation, level: float) -> None:
        """Weaken all drives in proportion to the progress of the ramp."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class VoltageDrop(Fault):
    """A brown-out: for a short time all drives give a fraction of their torque, then they recover fully."""

    ramp: float = 0.02
    duration: float | None = 0.2

    NAME: ClassVar[str] = "voltage_drop"
    CATEGORY: ClassVar[str] = "power"
    PARAMETER: ClassVar[str] = "remaining voltage, and with it torque, as a fraction of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.7, "severe": 0.4, "critical": 0.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)
    FIELDS: ClassVar[tuple[str, ...]] = (*DRIVE, *GRIP)

    def apply(self, plant: Simulation, level: float) -> None:
        """Weaken all drives."""
        weaken(plant, 1.0 + level * (self.amount - 1.0))


@dataclass(frozen=True, kw_only=True)
class PowerLoss(Fault):
    """The power fails: no drive gives torque, and the joints move freely until brakes, if any, hold them.

    Args:
        brake: "delayed": spring-closed brakes hold the joints after the time set by the degree. "immediate": they hold
            at once. "none": they never do, and the arm falls. The degree has an effect with "delayed" only.
        grip: "lost": the fingers lose their force as well, as in most grippers. "kept": they are self-locking.
    """

    brake: str = "delayed"
    grip: str = "lost"

    NAME: ClassVar[str] = "power_loss"
    CATEGORY: ClassVar[str] = "power"
    PARAMETER: ClassVar[str] = "delay until the brakes hold, if brake is delayed [s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.1, "moderate": 0.15, "severe": 0.25, "critical": 0.5}
    TARGETS: ClassVar[tuple[str, ...]] = ("robot",)
    FIELDS: ClassVar[tuple[str, ...]] = tuple(dict.fromkeys((*DRIVE, *GRIP, *FRICTION)))
    PERIOD: ClassVar[float | None] = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value, valid in (("brake", self.brake, BRAKES), ("grip", self.grip, GRIPS)):
            if value not in valid:
                raise SettingError(name, value, f"one of {', '.join(valid)}")

    def apply(self, plant: Simulation, level: float) -> None:
        """Remove the torque, and close the brakes once their delay has passed."""
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
