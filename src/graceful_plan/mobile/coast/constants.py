"""Constants of the coast model, read from YAML."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import fraction, not_negative, positive
from graceful_plan.yaml_file import Block, YamlTable

WHEELS = ("driven", "released", "locked", "side_locked", "side_dead")
"""Wheel behaviours after a failure: all go on as commanded and then stop; all turn freely; all are locked; those of one
side are locked or turn freely, while the other side goes on for the delay and then stops."""
ONE_SIDE = ("side_locked", "side_dead")
_MOMENTS = 4
"""Number of moments of an unnoticed failure at which a drifting base, or one that cannot turn, is evaluated."""


@final
@dataclass(frozen=True, kw_only=True)
class Way:
    """A stopping mode of a failed base. Its decelerations are equally likely, and so are its delays and its curvatures.

    Args:
        weight: Relative frequency among the modes.
        deceleration: Deceleration at low speed [m/s^2]; for locked wheels, the friction of the tyres times gravity.
        drag: Additional deceleration per speed [1/s].
        delay: Time for which driven wheels go on at full speed before they stop [s].
        wheels: Behaviour of the wheels, from `WHEELS`.
        bend: Curvatures added to that of the motion [1/m].
        steered: For one-sided failures: whether a controller unaware of the failure steers the working side along the
            path until the delay is over. Otherwise that side keeps its speed.

    Raises:
        SettingError: If a number is out of its range.
    """

    weight: float
    deceleration: tuple[float, ...]
    drag: float
    delay: tuple[float, ...]
    wheels: str = "driven"
    bend: tuple[float, ...] = (0.0,)
    steered: bool = False

    def __post_init__(self) -> None:
        if self.wheels not in WHEELS:
            raise SettingError("way.wheels", self.wheels, f"one of {', '.join(WHEELS)}")
        if not isinstance(self.steered, bool):
            raise SettingError("way.steered", self.steered, "True or False")
        if self.steered and self.wheels not in ONE_SIDE:
            raise SettingError("way.steered", self.steered, f"False unless wheels are one of {', '.join(ONE_SIDE)}")
        if not self.bend or not all(abs(b) < math.inf for b in self.bend):
            raise SettingError("way.bend", self.bend, "finite numbers")
        for name, least in (("weight", 0.0), ("drag", 0.0)):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= least):
                raise SettingError(f"way.{name}", value, f"a finite number >= {least:g}")
        if not self.deceleration or not all(0.0 < a < math.inf for a in self.deceleration):
            raise SettingError("way.deceleration", self.deceleration, "finite numbers above 0")
        if not self.delay or not all(0.0 <= t < math.inf for t in self.delay):
            raise SettingError("way.delay", self.delay, "finite numbers of at least 0")


@final
@dataclass(frozen=True, kw_only=True)
class OdometryDrift:
    """Drifting bases: they follow their path with a proportional odometry error.

    Args:
        weight: Relative frequency, compared with the weights of `ways`.
        misread: Relative error of the measured speed of one side.
        lasts: Time until the drift is detected [s].
        pace: Mean speed during the drift, as a share of the greatest speed.
        spread: Standard deviation of the lateral offset, as a share of the offset.

    Raises:
        SettingError: If a number is out of its range.
    """

    weight: float
    misread: float
    lasts: float
    pace: float
    spread: float

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            not_negative(f"astray.{one.name}", value)
        if self.pace > 1.0:
            raise SettingError("astray.pace", self.pace, "a number in [0, 1]")

    def places(self, probability: float, base: DiffDrive, position_spread: float) -> Float[Array, "place 4"]:
        """Return the offsets of drifting bases from their path, at moments spread evenly over the drift.

        Args:
            probability: Probability of this failure.
            base: Parameters of the base.
            position_spread: Standard deviation of the lateral position of a healthy base [m].

        Returns:
            Duration times probability [s], offset to the left [m], heading error [rad], standard deviation of the
            offset [m].
        """
        way = self.pace * base.v_max * self.lasts * (np.arange(_MOMENTS) + 0.5) / _MOMENTS
        bend = self.misread / (2.0 * base.lever) * np.array([[1.0], [-1.0]])
        aside, turned = (bend * way**2 / 2.0).ravel(), (bend * way).ravel()
        lasts = np.full(len(aside), probability * self.lasts / len(aside))
        return np.column_stack([lasts, aside, turned, np.hypot(position_spread, self.spread * aside)])


@final
@dataclass(frozen=True, kw_only=True)
class WeakDrives:
    """Bases whose drives have too little torque to turn: they go straight on where their path turns.

    A skid-steer needs torque to turn, because its wheels slide sideways; on a straight path it does not notice that its
    drives have become weak. When it leaves its path, any part of the time until the detection may be left.

    Args:
        weight: Relative frequency, compared with the weights of `ways`.
        lasts: Time until the weakness is detected and the base is stopped [s].
        turn: Angle of turns in which such a base leaves its path once [rad].
        deceleration: Deceleration from then on [m/s^2].

    Raises:
        SettingError: If a number is out of its range.
    """

    weight: float
    lasts: float
    turn: float
    deceleration: float

    def __post_init__(self) -> None:
        for name in ("weight", "lasts"):
            not_negative(f"weak.{name}", getattr(self, name))
        for name in ("turn", "deceleration"):
            positive(f"weak.{name}", getattr(self, name))

    def stops(self, probability: float) -> Float[Array, "stop 3"]:
        """Return the stops of bases that leave their path: probability [1/rad], deceleration [m/s^2], time left [s].

        Args:
            probability: Probability of this failure.
        """
        left = self.lasts * (np.arange(_MOMENTS) + 0.5) / _MOMENTS
        each = np.full(_MOMENTS, probability * self.lasts / self.turn / _MOMENTS)
        return np.column_stack([each, np.full(_MOMENTS, self.deceleration), left])


@final
@dataclass(frozen=True, kw_only=True)
class CoastSettings(YamlTable):
    """Constants of the coast model.

    Args:
        share: Share of failures that are base failures rather than failures of gripper or arm. It is 1 for a robot with
            neither.
        thrown: Share of failures of a base without an arm that throw off its load.
        harmless: Share of base failures that neither stop nor divert the base. The others are distributed over `ways`,
            `astray` and `weak`.
        reference_speed: Impact speed for which severities are specified [m/s].
        position_spread: Standard deviation of the lateral position of the base [m].
        drift: Growth of that deviation per distance [m/m].
        straightens: Angle by which a skid-steer still turns after its wheels are released, over its turning rate
            squared [s^2/rad].
        friction: Friction coefficient of the tyres when the wheels of one side turn freely.
        brakes: Deceleration of the rims of the working side after the delay [m/s^2].
        ways: Stopping modes by name.
        astray: Drifting bases, which do not stop at the failure.
        weak: Bases that can no longer turn.

    Raises:
        SettingError: If a number is out of its range.
    """

    shipped_file = Path(__file__).with_name("coast.yaml")
    kind = "coast settings"
    keys = (
        "share",
        "thrown",
        "harmless",
        "reference_speed",
        "position_spread",
        "drift",
        "straightens",
        "friction",
        "brakes",
        "ways",
        "astray",
        "weak",
    )

    share: float
    thrown: float
    harmless: float
    reference_speed: float
    position_spread: float
    drift: float
    straightens: float
    friction: float
    brakes: float
    ways: Mapping[str, Way]
    astray: OdometryDrift
    weak: WeakDrives

    def __post_init__(self) -> None:
        for name in ("share", "thrown"):
            fraction(name, getattr(self, name))
        if not 0.0 <= self.harmless < 1.0:
            raise SettingError("harmless", self.harmless, "a number in [0, 1)")
        for name in ("reference_speed", "position_spread", "friction", "brakes"):
            positive(name, getattr(self, name))
        for name in ("drift", "straightens"):
            not_negative(name, getattr(self, name))
        if not self._total > 0.0:
            raise SettingError("ways", dict(self.ways), "at least one with a weight above 0")
        object.__setattr__(self, "ways", MappingProxyType(dict(self.ways)))

    def __hash__(self) -> int:
        numbers = tuple(getattr(self, key) for key in self.keys if key != "ways")
        return hash((numbers, tuple(self.ways.items())))

    def __reduce__(self) -> tuple[Callable[[], CoastSettings], tuple[()]]:
        # Read-only mappings cannot be pickled.
        given = {key: getattr(self, key) for key in self.keys} | {"ways": dict(self.ways)}
        return partial(CoastSettings, **given), ()

    @classmethod
    def parsed(cls, root: Block) -> CoastSettings:
        """Build the settings from a parsed file."""
        ways, lost, weak = {}, root["astray"], root["weak"]
        lost.only(*(item.name for item in fields(OdometryDrift)))
        astray = OdometryDrift(**{item.name: lost[item.name].number() for item in fields(OdometryDrift)})
        weak.only(*(item.name for item in fields(WeakDrives)))
        tired = WeakDrives(
            weight=weak["weight"].number(),
            lasts=weak["lasts"].number(),
            turn=weak["turn"].number(),
            deceleration=weak["deceleration"].number(),
        )
        for name, block in root["ways"].items():
            block.only(*(item.name for item in fields(Way)))
            bend, steered = block.get("bend"), block.get("steered")
            ways[name] = Way(
                weight=block["weight"].number(),
                deceleration=block["deceleration"].numbers(),
                drag=block["drag"].number(),
                delay=block["delay"].numbers(),
                wheels=block["wheels"].string(),
                bend=(0.0,) if bend is None else bend.numbers(),
                steered=False if steered is None else steered.flag(),
            )
        numbers = {key: root[key].number() for key in cls.keys if key not in ("ways", "astray", "weak")}
        return cls(**numbers, ways=ways, astray=astray, weak=tired)

    def of_base(self, scene: Scene) -> float:
        """Return the share of failures that are base failures; 1 if the robot has no other part that can fail."""
        if scene.base is None:
            return 0.0
        return 1.0 if scene.joints == scene.base.joints else self.share

    def of_cargo(self, scene: Scene) -> float:
        """Return the share of failures that release the carried object, or throw it off a base without an arm."""
        if scene.base is None:
            return 1.0
        return self.thrown if scene.joints == scene.base.joints else 1.0 - self.share

    def stops(self, load: float = 1.0) -> Float[Array, "stop 6"]:
        """Return all combinations of parameters for stopping modes that act on both sides alike.

        Args:
            load: Share of the weight on the driven wheels; it scales the braking of locked wheels.

        Returns:
            Probability, deceleration [m/s^2], drag [1/s], delay [s], 1 if wheels are released, added curvature [1/m].
        """
        rows = [
            (p, a * (load if way.wheels == "locked" else 1.0), way.drag, delay, float(way.wheels == "released"), bend)
            for way, p in self._each()
            if way.wheels not in ONE_SIDE
            for a in way.deceleration
            for delay in way.delay
            for bend in way.bend
        ]
        return np.array(rows).reshape(-1, 6)

    def one_sided(self) -> tuple[tuple[float, Way, float, float], ...]:
        """Return all combinations of parameters for one-sided failures: probability, mode, deceleration, delay."""
        return tuple(
            (p * len(way.bend), way, a, delay)
            for way, p in self._each()
            if way.wheels in ONE_SIDE
            for a in way.deceleration
            for delay in way.delay
        )

    def beside(self, base: DiffDrive) -> Float[Array, "place 4"]:
        """Return the offsets of drifting bases from their path, as `OdometryDrift.places` defines them."""
        if self.astray.weight == 0.0:
            return np.zeros((0, 4))
        return self.astray.places(self._probability(self.astray.weight), base, self.position_spread)

    def unable_to_turn(self) -> Float[Array, "stop 3"]:
        """Return the stops of bases that can no longer turn, as `WeakDrives.stops` defines them."""
        if self.weak.weight == 0.0:
            return np.zeros((0, 3))
        return self.weak.stops(self._probability(self.weak.weight))

    def only(self, *names: str) -> CoastSettings:
        """Return settings in which these modes alone account for all failures."""
        ways = {name: self.ways[name] for name in names}
        none = replace(self.astray, weight=0.0), replace(self.weak, weight=0.0)
        return replace(self, harmless=0.0, ways=ways, astray=none[0], weak=none[1])

    def without_drift(self) -> CoastSettings:
        """Return settings for evaluating single states: drift counts as modes with added curvature."""
        bent = sum(way.weight for way in self.ways.values() if any(way.bend))
        more = 1.0 + self.astray.weight / bent if bent > 0.0 else 1.0
        ways = {
            name: replace(way, weight=way.weight * (more if any(way.bend) else 1.0)) for name, way in self.ways.items()
        }
        return replace(self, ways=ways, astray=replace(self.astray, weight=0.0))

    @property
    def _total(self) -> float:
        return sum(way.weight for way in self.ways.values()) + self.astray.weight + self.weak.weight

    def _probability(self, weight: float) -> float:
        return weight / self._total * (1.0 - self.harmless)

    def _each(self) -> list[tuple[Way, float]]:
        """Return the modes with non-zero weight, each with the probability of one combination."""
        return [
            (way, self._probability(way.weight) / (len(way.deceleration) * len(way.delay) * len(way.bend)))
            for way in self.ways.values()
            if way.weight > 0.0
        ]
