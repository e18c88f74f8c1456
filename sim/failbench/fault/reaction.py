"""What the robot does on purpose when it must not go on. Values and their reasons: docs/faults.md."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drives import BRAKE_TORQUE, DRIVE, FRICTION, add_friction, scale_torque
from failbench.fault.fault import REACTION, Fault
from failbench.simulated.plant import Plant
from graceful_plan.exceptions import SettingError, UnsupportedError

STOPS = (0, 1)
"""Stop categories of IEC 60204-1 that are known."""


@dataclass(frozen=True, kw_only=True)
class ProtectiveStop(Fault):
    """The robot stops: a person comes near, a force is felt, somebody presses the button. Nothing is broken.

    The gripper goes on holding. The stop is over when nothing moves any more, and nobody lets the robot go on.

    Args:
        category: As in IEC 60204-1. 1: all joints brake together along the motion's path, under power, as hard as the
            degree says for the one that needs longest. Then servos hold, as brakes would that close now. 0: the power
            goes and the brakes close at once, each joint on its own. The degree scales nothing then.
    """

    category: int = 1

    NAME: ClassVar[str] = "protective_stop"
    CATEGORY: ClassVar[str] = REACTION
    PARAMETER: ClassVar[str] = "deceleration of the joints, over the greatest acceleration that motions have"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.25, "moderate": 0.5, "severe": 1.0, "critical": 2.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("all",)
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = tuple(dict.fromkeys((*DRIVE, *FRICTION)))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.category not in STOPS:
            raise SettingError("category", self.category, f"one of {', '.join(map(str, STOPS))}")

    def apply(self, plant: Plant, level: float) -> None:
        """Brake."""
        if self.category == 0:
            add_friction(plant, level * BRAKE_TORQUE)
            scale_torque(plant, 1.0 - level)
            return
        if any(wheel in plant.joints for side in plant.robot.together for wheel in side):
            raise UnsupportedError(
                "a base that drives cannot brake along its way here: use category 0, or strike joints of its arm"
            )
        time, pace, change = self._pace(plant, level)
        plant.ahead[:, plant.robot.actuators[plant.joints]] = plant.paced(time, pace, change)[:, plant.joints]

    def _pace(self, plant: Plant, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return how the motion goes on from the next step: time on its clock since the onset [s], pace, its change."""
        began, clock, rate, slowing = plant.memory.get("braking", (plant.step, 0.0, 1.0, 0.0))
        clock, rate, _ = _braked(clock, rate, slowing, plant.dt * np.array([plant.step - began]))
        # Of the joints' speed at the onset: they slow down in proportion to one another, as a path wants it.
        speed = plant.memory.setdefault("speed", np.abs(plant.qd))
        longest = float(np.max(speed / plant.robot.acceleration)) / (level * self.amount)
        slowing = 1.0 / max(longest, plant.dt)
        plant.memory["braking"] = plant.step, float(clock[0]), float(rate[0]), slowing
        ahead = plant.dt * np.arange(len(plant.ahead))
        return _braked(float(clock[0]), float(rate[0]), slowing, ahead)


def _braked(clock: float, rate: float, slowing: float, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return clock [s], pace and its change [1/s] at times after both were `clock` and `rate` [s]."""
    braking = np.minimum(time, rate / slowing) if slowing > 0.0 else time
    pace = rate - slowing * braking
    return clock + braking * (rate + pace) / 2.0, pace, np.where(braking == time, -slowing, 0.0)
