"""Base class of faults: a small frozen object that states which part fails, how badly, and for how long."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from failbench.basics.onset import Onset, Uniform
from failbench.simulated.simulation import Simulation
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.setting_checks import not_negative, positive_or_none

DEGREES = ("minor", "moderate", "severe", "critical")

CATEGORIES = ("actuator", "sensor", "end_effector", "power")
REACTION = "reaction"
"""Category of deliberate reactions of a robot in which nothing is broken."""
SURROUNDINGS = "surroundings"
"""Category of events around the robot."""

_PARTS = {"gripper": ("gripper",), "robot": ("joints", "gripper")}
"""Parts that a target stands for, if not only joints."""


@dataclass(frozen=True, kw_only=True)
class Fault(ABC):
    """A failure of a robot part at some time during a motion.

    To add a fault, write a frozen dataclass that inherits from this class, sets the class data below and implements
    `apply`. `failbench.testing.check_fault` reports mistakes in it. Pass the object; no registration is needed.

    Args:
        degree: "minor", "moderate", "severe" or "critical": sets the value of the class's `PARAMETER`.
        ramp: Time over which the effect grows from nothing to its full strength [s]; 0 is at once.
        duration: Time from the onset after which the effect is undone [s]; None if it is permanent.
        targets: Names of the struck joints, "any" for a random joint, "all" for all joints, "gripper", or "robot" for
            joints and gripper. Empty: the class's `TARGETS`.
        when: Onset of the fault.
        rates: Relative frequency of this fault for each joint, from the base to the tool: "any" draws in proportion.
            Empty: all joints are equally likely.
    """

    degree: str = "severe"
    ramp: float = 0.0
    duration: float | None = None
    targets: tuple[str, ...] = ()
    when: Onset = Uniform()
    rates: tuple[float, ...] = ()

    NAME: ClassVar[str]
    """The fault's name, e.g. "loose_joint"."""
    CATEGORY: ClassVar[str]
    """One of "actuator", "sensor", "end_effector", "power", "reaction" and "surroundings"."""
    PARAMETER: ClassVar[str]
    """Meaning of the parameter that the degree sets, with its unit."""
    AMOUNTS: ClassVar[Mapping[str, float]]
    """The parameter's value by degree."""
    TARGETS: ClassVar[tuple[str, ...]] = ("any",)
    """Default targets."""
    STRIKES: ClassVar[tuple[str, ...]] = ("joints", "gripper")
    """Parts of a robot that can have this fault: "joints", "gripper"."""
    FIELDS: ClassVar[tuple[str, ...]] = ()
    """Fields of the MuJoCo model that `apply` writes."""
    PERIOD: ClassVar[float | None] = None
    """Time between calls of `apply` while the fault lasts [s]: 0 for every step; None for a single call."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        if self.degree not in DEGREES:
            raise SettingError("degree", self.degree, f"one of {', '.join(DEGREES)}")
        not_negative("ramp", self.ramp, "a finite time >= 0 s")
        positive_or_none("duration", self.duration, "a finite time > 0 s, or None if permanent")
        if not isinstance(self.when, Onset):
            raise SettingError("when", self.when, "AtTime, AtFraction or Uniform")
        if not isinstance(self.targets, tuple | list):
            raise SettingError("targets", self.targets, "a tuple of names")
        object.__setattr__(self, "targets", tuple(self.targets))
        self._check_rates()
        parts = {part for target in self.targets for part in _PARTS.get(target, ("joints",))}
        if parts and parts.isdisjoint(self.STRIKES):
            able = " or ".join({"joints": "a joint", "gripper": "the gripper"}[part] for part in self.STRIKES)
            raise SettingError("targets", self.targets, f"to include {able}: no other part can have a {self.NAME}")

    def _check_rates(self) -> None:
        if not isinstance(self.rates, tuple | list):
            raise SettingError("rates", self.rates, "a tuple of numbers, one for each joint")
        rates = tuple(float(rate) for rate in self.rates)
        if rates and not (all(0.0 <= rate < math.inf for rate in rates) and 0.0 < sum(rates) < math.inf):
            raise SettingError("rates", rates, "finite numbers of at least 0, one of them positive")
        object.__setattr__(self, "rates", rates)

    @property
    def period(self) -> float | None:
        """Time between calls of `apply` with these settings [s] (default: `PERIOD`)."""
        return self.PERIOD

    @property
    def amount(self) -> float:
        """The parameter's value at this degree."""
        return self.AMOUNTS[self.degree]

    @abstractmethod
    def apply(self, plant: Simulation, level: float) -> None:
        """Apply the fault to a simulated robot.

        Called at the onset, along the ramp, and every `PERIOD` while the fault lasts. Before each call the model fields
        and the future commands are reset to those of a healthy robot, so effects do not add up over calls. Draw all
        random numbers from `plant.rng`, and keep state between calls in `plant.memory`.

        Args:
            plant: The simulated robot.
            level: Progress of the ramp, in (0, 1]; 1 is the full strength of the degree.
        """
