"""Faults of position sensors and of the command line. Values and their reasons: docs/faults.md.

The servos follow their sensors, so these faults change the feedback. Where a known reading error is equivalent to the
opposite error of the command, the command is changed instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from failbench.fault.drives import actuators
from failbench.fault.fault import Fault
from failbench.simulated.simulation import Simulation
from graceful_plan.exceptions import SettingError

LINES = ("command", "measurement", "both")
ZONES = ("range", "play")

_SAMPLE = 0.01
"""Time between readings of a noisy sensor [s]."""
_GAP_SPACING = 0.25
"""Mean time between the beginnings of two gaps of a sensor with dropouts [s]."""


@dataclass(frozen=True, kw_only=True)
class Noise(Fault):
    """A position sensor is noisy: each reading has a normally distributed error and is held until the next reading."""

    ramp: float = 0.2

    NAME: ClassVar[str] = "noise"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "standard deviation of the position reading [rad or m]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.005, "moderate": 0.02, "severe": 0.05, "critical": 0.1}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)

    def apply(self, plant: Simulation, level: float) -> None:
        """Add noise to the readings."""
        if "deviates" not in plant.memory:
            held = max(1, round(_SAMPLE / plant.dt))
            readings = plant.rng.standard_normal((-(-len(plant.command) // held), len(plant.joints)))
            plant.memory["deviates"] = np.repeat(readings, held, axis=0)[: len(plant.command)]
        plant.misread(plant.joints, level * self.amount * plant.memory["deviates"][plant.step :])


@dataclass(frozen=True, kw_only=True)
class BiasDrift(Fault):
    """A position sensor drifts: its error grows at a constant rate, with a random sign drawn from the seed.

    Along the ramp the rate grows from zero; the error is the integral of the rate.
    """

    ramp: float = 0.2

    NAME: ClassVar[str] = "bias_drift"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "drift rate of the position reading [rad/s or m/s]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.02, "moderate": 0.05, "severe": 0.15, "critical": 0.4}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)

    def apply(self, plant: Simulation, level: float) -> None:
        """Add the drift to the readings."""
        if "sign" not in plant.memory:
            plant.memory["sign"] = plant.rng.choice([-1.0, 1.0], len(plant.joints))
        # Equivalent drift time at full rate, the time when it was computed, and the rate since then.
        before, found, rate = plant.memory.get("drifted", (0.0, plant.time, level))
        drifted = before + rate * (plant.time - found)
        plant.memory["drifted"] = drifted, plant.time, level
        time = drifted + level * plant.dt * np.arange(len(plant.ahead))
        plant.misread(plant.joints, self.amount * time[:, None] * plant.memory["sign"])


@dataclass(frozen=True, kw_only=True)
class ControlDelay(Fault):
    """Commands arrive late, or sensor readings, or both.

    Args:
        line: The delayed line: "command", "measurement" (joint position and speed as the servos see them), or "both".
            The gripper's measurement is never delayed.
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
        """Every step if readings are delayed; once for commands, which are known in advance."""
        return None if self.line == "command" else 0.0

    def apply(self, plant: Simulation, level: float) -> None:
        """Delay commands and readings by the same number of steps; for a base, its commanded speeds."""
        steps = round(level * self.amount / plant.dt)
        if self.line != "measurement":
            struck, wheels = actuators(plant), plant.robot.actuators[plant.wheels]
            plant.lag = steps if np.isin(wheels, struck).any() else 0
            struck = np.setdiff1d(struck, wheels)
            plant.ahead[:, struck] = _late_commands(plant, steps)[:, struck]
        if self.line != "command":
            self._read_late(plant, steps)

    def _read_late(self, plant: Simulation, steps: int) -> None:
        seen = plant.memory.setdefault("seen", [])
        seen += [(plant.q, plant.qd)] * (plant.step + 1 - len(seen))
        ago = plant.step - steps
        if ago >= 0 or not len(plant.measured):
            q, qd = seen[max(ago, 0)]
        else:
            q, qd = plant.measured[max(len(plant.measured) - 1 + ago, 0)]
        _stand_still(plant, q[plant.joints], qd[plant.joints])


def _late_commands(plant: Simulation, steps: int) -> np.ndarray:
    """Return the commands from now on, delayed by `steps`; the first command is taken to hold before the motion."""
    before = plant.past[len(plant.past) - min(steps, len(plant.past)) :]
    known = np.concatenate([before, plant.healthy])
    at_rest = np.repeat(known[:1], steps - len(before), axis=0)
    return np.concatenate([at_rest, known])[plant.step : len(plant.healthy)]


def _stand_still(plant: Simulation, q: np.ndarray, qd: np.ndarray) -> None:
    """Give the servos of the struck joints these constant readings. Needs "actuator_biasprm"."""
    bias, struck = plant["actuator_biasprm"], plant.robot.actuators[plant.joints]
    bias[struck, 0] += bias[struck, 1] * q + bias[struck, 2] * qd
    bias[struck, 1:3] = 0.0


@dataclass(frozen=True, kw_only=True)
class Dropout(Fault):
    """A sensor drops out repeatedly: during a gap, position and speed keep their last reading."""

    NAME: ClassVar[str] = "dropout"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = (
        "length of a gap [s]; gaps begin at random, 0.25 s apart on average, the first at the onset"
    )
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.02, "moderate": 0.04, "severe": 0.08, "critical": 0.16}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)
    PERIOD: ClassVar[float | None] = 0.01

    def apply(self, plant: Simulation, level: float) -> None:
        """Freeze the readings during gaps."""
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
    """A sensor has a wrong scale: it reads position and speed too large by a factor, as with a wrong gear ratio."""

    ramp: float = 0.2

    NAME: ClassVar[str] = "scale_error"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "relative error of the reading"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.01, "moderate": 0.02, "severe": 0.05, "critical": 0.1}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)

    def apply(self, plant: Simulation, level: float) -> None:
        """Scale the feedback; encoders of wheels count increments, so only rotation since the onset is scaled."""
        bias, struck = plant["actuator_biasprm"], plant.robot.actuators[plant.joints]
        counted = np.isin(plant.joints, plant.wheels)
        before = plant.memory.setdefault("before", np.where(counted, plant.q[plant.joints], 0.0))
        bias[struck, 0] -= level * self.amount * bias[struck, 1] * before
        bias[struck, 1:3] *= 1.0 + level * self.amount


@dataclass(frozen=True, kw_only=True)
class DeadZone(Fault):
    """A sensor does not respond within a range of positions: its reading is frozen there.

    Args:
        zone: "range": the zone is fixed around the position at the onset. Within it, the reading is the one from the
            entry into the zone; outside it, the reading is right. "play": the zone moves along, like backlash: the
            reading is constant until the joint has moved by the width of the zone, then lags by that width.
    """

    zone: str = "range"

    NAME: ClassVar[str] = "dead_zone"
    CATEGORY: ClassVar[str] = "sensor"
    PARAMETER: ClassVar[str] = "width of the zone on either side [rad or m]"
    AMOUNTS: ClassVar[Mapping[str, float]] = {"minor": 0.01, "moderate": 0.03, "severe": 0.06, "critical": 0.12}
    STRIKES: ClassVar[tuple[str, ...]] = ("joints",)
    FIELDS: ClassVar[tuple[str, ...]] = ("actuator_biasprm",)
    PERIOD: ClassVar[float | None] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.zone not in ZONES:
            raise SettingError("zone", self.zone, f"one of {', '.join(ZONES)}")

    def apply(self, plant: Simulation, level: float) -> None:
        """Freeze the reading, or let it lag behind the position."""
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
