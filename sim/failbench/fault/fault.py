"""The contract of a fault: a small frozen object that says what breaks, how badly, and for how long."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from failbench.basics.onset import Onset, Uniform
from failbench.simulated.plant import Plant
from graceful_plan.exceptions import SettingError

DEGREES = ("minor", "moderate", "severe", "critical")

CATEGORIES = ("actuator", "sensor", "end_effector", "power")
REACTION = "reaction"
"""Category of what the robot does on purpose: nothing is broken."""
SURROUNDINGS = "surroundings"
"""Category of what happens around a robot."""

_PARTS = {"gripper": ("gripper",), "robot": ("joints", "gripper")}
"""The parts that a target stands for, if not joints alone."""


@dataclass(frozen=True, kw_only=True)
class Fault(ABC):
    """Something that breaks in the robot at some moment of a motion.

    A fault of your own is a frozen dataclass that inherits from this, sets the class data below and has `apply`;
    `failbench.testing.check_fault` says what is wrong with it. Pass the object; nothing has to be registered.

    Args:
        degree: "minor", "moderate", "severe" or "critical"; what it scales is the class's `PARAMETER`.
        ramp: Time over which the effect grows from nothing to its full strength [s]; 0 is at once.
        duration: Time from the onset after which everything is as before [s]; None for good.
        targets: Names of the joints that are struck, "any" for one drawn at random, "all" joints, "gripper", or "robot"
            for joints and gripper. Empty: the class's `TARGETS`.
        when: When it begins.
        rates: How often each joint has this fault, from the base to the tool; "any" draws in proportion. Only ratios
            matter. Empty: all alike.
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
    """What the degree scales, in words, with its unit."""
    AMOUNTS: ClassVar[Mapping[str, float]]
    """The parameter's value by degree."""
    TARGETS: ClassVar[tuple[str, ...]] = ("any",)
    """What is struck unless the user says otherwise."""
    STRIKES: ClassVar[tuple[str, ...]] = ("joints", "gripper")
    """Which parts of a robot can have this fault at all."""
    FIELDS: ClassVar[tuple[str, ...]] = ()
    """Fields of the MuJoCo model that `apply` writes."""
    PERIOD: ClassVar[float | None] = None
    """Time between calls of `apply` while the fault lasts [s]: 0 for every step; None if once is enough."""

    def __post_init__(self) -> None:
        if self.degree not in DEGREES:
            raise SettingError("degree", self.degree, f"one of {', '.join(DEGREES)}")
        if not (math.isfinite(self.ramp) and self.ramp >= 0.0):
            raise SettingError("ramp", self.ramp, "a finite time >= 0 s")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0.0):
            raise SettingError("duration", self.duration, "a finite time > 0 s, or None for good")
        if not isinstance(self.when, Onset):
            raise SettingError("when", self.when, "AtTime, AtFraction or Uniform")
        if not isinstance(self.targets, tuple | list):
            raise SettingError("targets", self.targets, "a tuple of names")
        object.__setattr__(self, "targets", tuple(self.targets))
        self._check_rates()
        parts = {part for target in self.targets for part in _PARTS.get(target, ("joints",))}
        if parts and parts.isdisjoint(self.STRIKES):
            able = " or ".join({"joints": "a joint", "gripper": "the gripper"}[part] for part in self.STRIKES)
            raise SettingError("targets", self.targets, f"{able} among them: nothing else can have a {self.NAME}")

    def _check_rates(self) -> None:
        if not isinstance(self.rates, tuple | list):
            raise SettingError("rates", self.rates, "a tuple of numbers, one for each joint")
        rates = tuple(float(rate) for rate in self.rates)
        if rates and not (all(0.0 <= rate < math.inf for rate in rates) and 0.0 < sum(rates) < math.inf):
            raise SettingError("rates", rates, "finite numbers of at least 0, one of them positive")
        object.__setattr__(self, "rates", rates)

    @property
    def period(self) -> float | None:
        """Time between calls of `apply` with these settings [s]: `PERIOD`, unless settings decide."""
        return self.PERIOD

    @property
    def amount(self) -> float:
        """The parameter's value at this degree."""
        return self.AMOUNTS[self.degree]

    @abstractmethod
    def apply(self, plant: Plant, level: float) -> None:
        """Break the robot.

        Called at the onset, along the ramp, and every `PERIOD` while the fault lasts. Before each call the model's
        fields and the commands to come are as in a healthy robot again, so effects never add up by being repeated. All
        that is random comes from `plant.rng`; what has to be remembered from call to call goes into `plant.memory`.

        Args:
            plant: The one simulated robot that breaks.
            level: How far the ramp has come, in (0, 1]; 1 is the full strength of the degree.
        """
