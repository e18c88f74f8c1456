"""Faults of the gripper. Values and their reasons: docs/faults.md."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drives import GRIP, cut_overloaded_weld, hold_grip
from failbench.fault.fault import Fault
from failbench.simulated.simulation import Simulation


@dataclass(frozen=True, kw_only=True)
class GripperFailure(Fault):
    """The gripper opens fully. A weld that models the grasp is cut at once."""

    NAME: ClassVar[str] = "gripper_failure"
    CATEGORY: ClassVar[str] = "end_effector"
    PARAMETER: ClassVar[str] = "time the gripper takes to open [s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.8, "moderate": 0.4, "severe": 0.1, "critical": 0.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("gripper",)
    STRIKES: ClassVar[tuple[str, ...]] = ("gripper",)

    def apply(self, plant: Simulation, level: float) -> None:
        """Open the gripper gradually."""
        time = plant.dt * np.arange(plant.step, len(plant.command))
        opened = np.minimum(1.0, time / self.amount) if self.amount else np.ones_like(time)
        _open(plant, level * opened[:, None])
        plant.cut_weld()


@dataclass(frozen=True, kw_only=True)
class WeakGrip(Fault):
    """The gripper presses less: the object slips once friction no longer carries its weight."""

    ramp: float = 0.3

    NAME: ClassVar[str] = "weak_grip"
    CATEGORY: ClassVar[str] = "end_effector"
    PARAMETER: ClassVar[str] = "remaining grip force, as a fraction of the healthy one"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.3, "moderate": 0.1, "severe": 0.02, "critical": 0.005}
    TARGETS: ClassVar[tuple[str, ...]] = ("gripper",)
    STRIKES: ClassVar[tuple[str, ...]] = ("gripper",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_forcerange", *GRIP)

    def apply(self, plant: Simulation, level: float) -> None:
        """Reduce the force limit of the fingers."""
        plant["actuator_forcerange"][plant.robot.gripper_actuators] *= 1.0 + level * (self.amount - 1.0)
        cut_overloaded_weld(plant)


@dataclass(frozen=True, kw_only=True)
class StuckGripper(Fault):
    """The gripper sticks open and loses the object, or sticks closed and ignores the command to release it.

    Args:
        closed: Whether the gripper stays as it is at the onset and ignores commands; the degree then has no effect.
            Otherwise it springs open by the amount of the degree. A weld that models the grasp is cut if fingers at
            that opening would no longer touch the object.
    """

    closed: bool = False

    NAME: ClassVar[str] = "stuck_gripper"
    CATEGORY: ClassVar[str] = "end_effector"
    PARAMETER: ClassVar[str] = "opening at which it sticks, as a fraction of the widest opening"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.25, "moderate": 0.5, "severe": 0.8, "critical": 1.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("gripper",)
    STRIKES: ClassVar[tuple[str, ...]] = ("gripper",)

    def apply(self, plant: Simulation, level: float) -> None:
        """Hold the gripper at the opening where it sticks."""
        if self.closed:
            hold_grip(plant)
            return
        opening = level * self.amount
        _open(plant, opening)
        if opening >= plant.robot.grip_clear:
            plant.cut_weld()


def _open(plant: Simulation, share: np.ndarray | float) -> None:
    """Open the gripper by a fraction of the widest opening: one value for all further steps, or one for each."""
    grippers = plant.robot.gripper_actuators
    plant.ahead[:, grippers] += share * (plant.robot.grip_open - plant.ahead[:, grippers])
