"""Faults of position sensors and of the line that commands come in on. Values and their reasons: docs/faults.md.

The servos follow what their sensors say, so what is broken here is the feedback and not the command, except where the
two are the same: a reading that is wrong by a known error acts exactly like a command that is wrong by its opposite.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drive import actuators
from failbench.fault.fault import Fault
from failbench.simulated.plant import Plant

_SAMPLE = 0.01
"""Time between two readings of a noisy sensor [s]."""
_GAP_SPACING = 0.25
"""Mean time from the beginning of one gap of a sensor that drops out to the beginning of the next [s]."""


@dataclass(frozen=True, kw_only=True)
class Noise(Fault):
    """A position sensor is noisy: every reading is off by a normal deviate, and stands until the next one."""

    NAME: ClassVar[str] = "noise"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "standard deviation of the position reading [rad or m]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.005, "moderate": 0.02, "severe": 0.05, "critical": 0.1}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)

    def apply(self, plant: Plant, level: float) -> None:
        """Let the readings scatter."""
        if "deviates" not in plant.memory:
            held = max(1, round(_SAMPLE / plant.dt))
            readings = plant.rng.standard_normal((-(-len(plant.command) // held), len(plant.joints)))
            plant.memory["deviates"] = np.repeat(readings, held, axis=0)[: len(plant.command)]
        plant.misread(plant.joints, level * self.amount * plant.memory["deviates"][plant.step :])


@dataclass(frozen=True, kw_only=True)
class BiasDrift(Fault):
    """A position sensor drifts: its error grows at a constant rate, up or down as the seed has it."""

    NAME: ClassVar[str] = "bias_drift"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "rate at which the position reading drifts away [rad/s or m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.02, "moderate": 0.05, "severe": 0.15, "critical": 0.4}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)

    def apply(self, plant: Plant, level: float) -> None:
        """Let the readings drift."""
        if "sign" not in plant.memory:
            plant.memory["sign"] = plant.rng.choice([-1.0, 1.0], len(plant.joints))
        time = plant.dt * np.arange(plant.step, len(plant.command))
        plant.misread(plant.joints, level * self.amount * time[:, None] * plant.memory["sign"])


@dataclass(frozen=True, kw_only=True)
class ControlDelay(Fault):
    """Commands arrive late."""

    NAME: ClassVar[str] = "control_delay"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "delay of the commands [s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.02, "moderate": 0.05, "severe": 0.1, "critical": 0.2}

    def apply(self, plant: Plant, level: float) -> None:
        """Send what was meant for some steps ago."""
        plant.lag = steps = round(level * self.amount / plant.dt)
        before = plant.past[len(plant.past) - min(steps, len(plant.past)) :]
        known = np.concatenate([before, plant.healthy])
        at_rest = np.repeat(known[:1], steps - len(before), axis=0)  # nothing was commanded before the motion began
        late = np.concatenate([at_rest, known])[plant.step : len(plant.healthy)]
        struck = actuators(plant)
        plant.ahead[:, struck] = late[:, struck]


@dataclass(frozen=True, kw_only=True)
class Dropout(Fault):
    """A sensor drops out time and again: during a gap the last reading of position and speed stands."""

    NAME: ClassVar[str] = "dropout"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = (
        "length of a gap [s]; gaps begin at random, 0.25 s apart in the mean, the first at the onset"
    )
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.02, "moderate": 0.04, "severe": 0.08, "critical": 0.16}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)
    PERIOD: ClassVar[float | None] = 0.01

    def apply(self, plant: Plant, level: float) -> None:
        """Keep the readings from the controller while there is a gap."""
        if "begins" not in plant.memory:
            plant.memory["begins"] = plant.rng.random(len(plant.command)) < plant.dt / _GAP_SPACING
            plant.memory["begins"][0] = True
        length = round(level * self.amount / plant.dt)
        if not plant.memory["begins"][max(0, plant.step - length + 1) : plant.step + 1].any():
            plant.memory.pop("reading", None)
            return
        q, qd = plant.memory.setdefault("reading", (plant.q[plant.joints], plant.qd[plant.joints]))
        bias = plant["actuator_biasprm"]
        struck = plant.robot.actuators[plant.joints]
        bias[struck, 0] += bias[struck, 1] * q + bias[struck, 2] * qd
        bias[struck, 1:3] = 0.0


@dataclass(frozen=True, kw_only=True)
class ScaleError(Fault):
    """A sensor is calibrated wrongly: position and speed read too great in proportion, as from a wrong gear ratio."""

    NAME: ClassVar[str] = "scale_error"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "relative error of the reading"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.01, "moderate": 0.02, "severe": 0.05, "critical": 0.1}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)

    def apply(self, plant: Plant, level: float) -> None:
        """Scale the feedback; of wheels what they turn from the onset on, for their encoders only count."""
        bias, struck = plant["actuator_biasprm"], plant.robot.actuators[plant.joints]
        counted = np.isin(plant.joints, [wheel for side in plant.robot.together for wheel in side])
        before = plant.memory.setdefault("before", np.where(counted, plant.q[plant.joints], 0.0))
        bias[struck, 0] -= level * self.amount * bias[struck, 1] * before
        bias[struck, 1:3] *= 1.0 + level * self.amount


@dataclass(frozen=True, kw_only=True)
class DeadZone(Fault):
    """A sensor does not see small motions: its position reading stands until the joint has moved by the zone's width.

    From then on it follows that far behind. So the controller is blind to errors smaller than the width.
    """

    NAME: ClassVar[str] = "dead_zone"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "width of the zone [rad or m]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.01, "moderate": 0.03, "severe": 0.06, "critical": 0.12}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)
    PERIOD: ClassVar[float | None] = 0.0

    def apply(self, plant: Plant, level: float) -> None:
        """Let the reading drag behind the position."""
        q, width = plant.q[plant.joints], level * self.amount
        reading = np.minimum(np.maximum(plant.memory.get("reading", q), q - width), q + width)
        plant.memory["reading"] = reading
        bias, struck = plant["actuator_biasprm"], plant.robot.actuators[plant.joints]
        bias[struck, 0] += bias[struck, 1] * (reading - q)
