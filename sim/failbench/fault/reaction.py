"""Deliberate reactions of a robot that has to stop. Values and their reasons: docs/faults.md."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drives import BRAKE_TORQUE, DRIVE, FRICTION, add_friction, scale_torque
from failbench.fault.fault import REACTION, Fault
from failbench.simulated.simulation import Simulation
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.setting_checks import positive

STOPS = (0, 1)
"""Supported stop categories of IEC 60204-1."""


@dataclass(frozen=True, kw_only=True)
class ProtectiveStop(Fault):
    """The robot stops because of a near person, a contact force or a pressed button. Nothing is broken.

    The gripper keeps holding. The robot does not resume the motion.

    Args:
        category: Stop category of IEC 60204-1. With 1, all joints brake under power and stay on the motion's path. The
            joint that needs longest decelerates at the rate of the degree. The servos then hold the joints, as closed
            brakes would. With 0, the power is cut and the brakes close at once, each joint on its own. The degree then
            has no effect.
        prepared: Time between the beginnings of stops that are planned ahead along the motion and keep contents and
            grasp, see `graceful_plan.plan_stops` [s]. The robot follows the one with the earliest end instead of
            braking; degree and ramp then have no effect. None: it brakes. For category 1 only.
    """

    category: int = 1
    prepared: float | None = None

    NAME: ClassVar[str] = "protective_stop"
    CATEGORY: ClassVar[str] = REACTION
    PARAMETER: ClassVar[str] = "deceleration of the joints, as a multiple of the motions' acceleration limit"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.25, "moderate": 0.5, "severe": 1.0, "critical": 2.0}
    TARGETS: ClassVar[tuple[str, ...]] = ("all",)
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = tuple(dict.fromkeys((*DRIVE, *FRICTION)))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.category not in STOPS:
            raise SettingError("category", self.category, f"one of {', '.join(map(str, STOPS))}")
        if self.prepared is None:
            return
        positive("prepared", self.prepared, "a finite time > 0 s, or None")
        if self.category == 0:
            raise SettingError("prepared", self.prepared, "None with category 0: brakes follow no path")

    def apply(self, plant: Simulation, level: float) -> None:
        """Brake by the chosen stop category."""
        if self.category == 0:
            add_friction(plant, level * BRAKE_TORQUE)
            scale_torque(plant, 1.0 - level)
            return
        if any(wheel in plant.joints for side in plant.robot.together for wheel in side):
            raise UnsupportedError(
                "a driving base cannot brake along its path here: use category 0, or strike joints of its arm"
            )
        if self.prepared is not None:
            time = plant.dt * np.arange(plant.step, plant.step + len(plant.ahead))
            plant.ahead[:, plant.robot.actuators[plant.joints]] = plant.stopped(self.prepared, time)[:, plant.joints]
            return
        time, pace, change = self._pace(plant, level)
        plant.ahead[:, plant.robot.actuators[plant.joints]] = plant.paced(time, pace, change)[:, plant.joints]

    def _pace(self, plant: Simulation, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the braked motion from the next step on: its clock since the onset [s], pace, and pace rate [1/s]."""
        began, clock, rate, slowing = plant.memory.get("braking", (plant.step, 0.0, 1.0, 0.0))
        clock, rate, _ = _braked(clock, rate, slowing, plant.dt * np.array([plant.step - began]))
        # From the joint speeds at the onset, and in proportion to one another: they stay on the path.
        speed = plant.memory.setdefault("speed", np.abs(plant.qd))
        longest = float(np.max(speed / plant.robot.acceleration)) / (level * self.amount)
        slowing = 1.0 / max(longest, plant.dt)
        plant.memory["braking"] = plant.step, float(clock[0]), float(rate[0]), slowing
        ahead = plant.dt * np.arange(len(plant.ahead))
        return _braked(float(clock[0]), float(rate[0]), slowing, ahead)


def _braked(clock: float, rate: float, slowing: float, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return clock [s], pace and pace rate [1/s] at times [s] after the clock was `clock` and the pace `rate`."""
    braking = np.minimum(time, rate / slowing) if slowing > 0.0 else time
    pace = rate - slowing * braking
    return clock + braking * (rate + pace) / 2.0, pace, np.where(braking == time, -slowing, 0.0)
