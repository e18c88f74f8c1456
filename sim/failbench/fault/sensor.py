"""Faults of position sensors and of the line that commands come in on. Values and their reasons: docs/faults.md.

The servos follow what their sensors say, so what is broken here is the feedback and not the command, except where the
two are the same: a reading that is wrong by a known error acts exactly like a command that is wrong by its opposite.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drives import actuators
from failbench.fault.fault import Fault
from failbench.simulated.plant import Plant
from graceful_plan.exceptions import SettingError

LINES = ("command", "measurement", "both")
ZONES = ("range", "play")

_SAMPLE = 0.01
"""Time between two readings of a noisy sensor [s]."""
_GAP_SPACING = 0.25
"""Mean time from the beginning of one gap of a sensor that drops out to the beginning of the next [s]."""


@dataclass(frozen=True, kw_only=True)
class Noise(Fault):
    """A position sensor is noisy: every reading is off by a normal deviate, and stands until the next one."""

    ramp: float = 0.2

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
    """A position sensor drifts: its error grows at a constant rate, up or down as the seed has it.

    Along the ramp the rate grows from nothing; the error is its integral.
    """

    ramp: float = 0.2

    NAME: ClassVar[str] = "bias_drift"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "rate at which the position reading drifts away [rad/s or m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.02, "moderate": 0.05, "severe": 0.15, "critical": 0.4}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)

    def apply(self, plant: Plant, level: float) -> None:
        """Let the readings drift."""
        if "sign" not in plant.memory:
            plant.memory["sign"] = plant.rng.choice([-1.0, 1.0], len(plant.joints))
        # For how long it would have drifted at its full rate, and when that was found.
        before, found, rate = plant.memory.get("drifted", (0.0, plant.time, level))
        drifted = before + rate * (plant.time - found)
        plant.memory["drifted"] = drifted, plant.time, level
        time = drifted + level * plant.dt * np.arange(len(plant.ahead))
        plant.misread(plant.joints, self.amount * time[:, None] * plant.memory["sign"])


@dataclass(frozen=True, kw_only=True)
class ControlDelay(Fault):
    """Commands arrive late, or what sensors say, or both.

    Args:
        line: What is late: "command", "measurement" (position and speed of the joints, as their servos see them), or
            "both". The gripper's own measurement never is.
    """

    ramp: float = 0.5
    line: str = "command"

    NAME: ClassVar[str] = "control_delay"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "delay of the commands, or of the readings [s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.02, "moderate": 0.05, "severe": 0.1, "critical": 0.2}
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.line not in LINES:
            raise SettingError("line", self.line, f"one of {', '.join(LINES)}")

    @property
    def period(self) -> float | None:
        """Every step if readings are late; commands are known in advance."""
        return None if self.line == "command" else 0.0

    def apply(self, plant: Plant, level: float) -> None:
        """Send what was meant for some steps ago, and read what was true then; a base is told its speeds late."""
        steps = round(level * self.amount / plant.dt)
        if self.line != "measurement":
            struck, wheels = actuators(plant), plant.robot.actuators[plant.wheels]
            plant.lag = steps if np.isin(wheels, struck).any() else 0
            struck = np.setdiff1d(struck, wheels)
            plant.ahead[:, struck] = _late_commands(plant, steps)[:, struck]
        if self.line != "command":
            self._read_late(plant, steps)

    def _read_late(self, plant: Plant, steps: int) -> None:
        seen = plant.memory.setdefault("seen", [])
        seen += [(plant.q, plant.qd)] * (plant.step + 1 - len(seen))
        ago = plant.step - steps
        if ago >= 0 or not len(plant.measured):
            q, qd = seen[max(ago, 0)]
        else:
            q, qd = plant.measured[max(len(plant.measured) - 1 + ago, 0)]
        _stand_still(plant, q[plant.joints], qd[plant.joints])


def _late_commands(plant: Plant, steps: int) -> np.ndarray:
    """Return the commands from now on as they arrive that many steps late; the first stood before the motion began."""
    before = plant.past[len(plant.past) - min(steps, len(plant.past)) :]
    known = np.concatenate([before, plant.healthy])
    at_rest = np.repeat(known[:1], steps - len(before), axis=0)
    return np.concatenate([at_rest, known])[plant.step : len(plant.healthy)]


def _stand_still(plant: Plant, q: np.ndarray, qd: np.ndarray) -> None:
    """Let the servos of the struck joints see these readings until further notice. Needs "actuator_biasprm"."""
    bias, struck = plant["actuator_biasprm"], plant.robot.actuators[plant.joints]
    bias[struck, 0] += bias[struck, 1] * q + bias[struck, 2] * qd
    bias[struck, 1:3] = 0.0


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
        _stand_still(plant, q, qd)


@dataclass(frozen=True, kw_only=True)
class ScaleError(Fault):
    """A sensor is calibrated wrongly: position and speed read too great in proportion, as from a wrong gear ratio."""

    ramp: float = 0.2

    NAME: ClassVar[str] = "scale_error"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "relative error of the reading"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.01, "moderate": 0.02, "severe": 0.05, "critical": 0.1}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)

    def apply(self, plant: Plant, level: float) -> None:
        """Scale the feedback; of wheels what they turn from the onset on, for their encoders only count."""
        bias, struck = plant["actuator_biasprm"], plant.robot.actuators[plant.joints]
        counted = np.isin(plant.joints, plant.wheels)
        before = plant.memory.setdefault("before", np.where(counted, plant.q[plant.joints], 0.0))
        bias[struck, 0] -= level * self.amount * bias[struck, 1] * before
        bias[struck, 1:3] *= 1.0 + level * self.amount


@dataclass(frozen=True, kw_only=True)
class DeadZone(Fault):
    """A sensor does not respond within a range of positions: there its reading stands.

    Args:
        zone: "range": the range lies around where the joint is at the onset; within it, the reading is what it was
            when the joint came in, and outside it is right. "play": the range goes along; the reading stands until the
            joint has moved by its width, and from then on follows that far behind.
    """

    zone: str = "range"

    NAME: ClassVar[str] = "dead_zone"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "width of the zone to either side [rad or m]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.01, "moderate": 0.03, "severe": 0.06, "critical": 0.12}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)
    PERIOD: ClassVar[float | None] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.zone not in ZONES:
            raise SettingError("zone", self.zone, f"one of {', '.join(ZONES)}")

    def apply(self, plant: Plant, level: float) -> None:
        """Let the reading stand, or drag behind the position."""
        q, width = plant.q[plant.joints], level * self.amount
        last = plant.memory.get("reading", q)
        if self.zone == "play":
            reading = np.minimum(np.maximum(last, q - width), q + width)
        else:
            centre = plant.memory.setdefault("centre", q)
            reading = np.where(np.abs(q - centre) > width, q, last)
        plant.memory["reading"] = reading
        bias, struck = plant["actuator_biasprm"], plant.robot.actuators[plant.joints]
        bias[struck, 0] += bias[struck, 1] * (reading - q)
