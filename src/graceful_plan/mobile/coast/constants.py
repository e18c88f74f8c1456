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

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.scene import Scene
from graceful_plan.yaml_file import Block, YamlTable

Array = np.ndarray


WHEELS = ("driven", "released", "locked", "side_locked", "side_dead")
"""What wheels do: all go on as commanded and then stop, all turn freely, all are held; those of one side are held or
turn freely while the other side goes on for the delay and then stops."""
ONE_SIDE = ("side_locked", "side_dead")
_MOMENTS = 4
"""At which is seen where a base is that goes astray."""


@final
@dataclass(frozen=True, kw_only=True)
class Way:
    """A way to come to rest; each deceleration is as likely as each other, and so is each delay.

    Args:
        weight: How often, compared with other ways.
        deceleration: At low speed [m/s^2]; of wheels that are held the friction of tyres, times gravity.
        drag: What is added to it per speed [1/s].
        delay: How long what is driven goes on at full speed before [s].
        wheels: What they do, one of `WHEELS`.
        bend: Curvatures that are added to that of the motion, each as likely as each other [1/m].
        steered: Of one side that fails: whether the other one is steered along the way until the delay is over, by a
            controller that does not know of it, rather than going on at its speed.

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
class Astray:
    """Bases that follow their way as they see it, and are wrong about where they are.

    Args:
        weight: How often, compared with `ways`.
        misread: By how much they misjudge the speed of one side, as a share of it.
        lasts: For how long until somebody notices [s].
        pace: Their mean speed while that lasts, as a share of the greatest.
        spread: Standard deviation of how far aside they are, as a share of it.

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
            if not 0.0 <= value < math.inf:
                raise SettingError(f"astray.{one.name}", value, "a finite number of at least 0")
        if self.pace > 1.0:
            raise SettingError("astray.pace", self.pace, "a number in [0, 1]")

    def places(self, probability: float, base: DiffDrive, position_spread: float) -> Float[Array, "place 4"]:
        """Return where such bases are beside their way, at moments that are evenly spread over while it lasts.

        Args:
            probability: Of such a failure.
            base: Which turns by the difference of its sides.
            position_spread: Standard deviation of where a base is across its way [m].

        Returns:
            For how long [s] times probability, how far to the left [m], angle turned by [rad], standard deviation of
            how far [m].
        """
        way = self.pace * base.v_max * self.lasts * (np.arange(_MOMENTS) + 0.5) / _MOMENTS
        bend = self.misread / (2.0 * base.lever) * np.array([[1.0], [-1.0]])
        aside, turned = (bend * way**2 / 2.0).ravel(), (bend * way).ravel()
        lasts = np.full(len(aside), probability * self.lasts / len(aside))
        return np.column_stack([lasts, aside, turned, np.hypot(position_spread, self.spread * aside)])


@final
@dataclass(frozen=True, kw_only=True)
class CoastSettings(YamlTable):
    """Constants of the coast model.

    Args:
        share: Of failures, those of the base rather than of gripper and arm; all of a robot that has neither are.
        thrown: Of failures of a base without an arm, those that throw off what stands on it.
        harmless: Of failures of the base, those that stop nothing and lead nowhere; the others go one of the ways.
        reference_speed: Speed of a hit that severities are for [m/s].
        position_spread: Standard deviation of where the base is across its way [m].
        drift: How much farther it strays per metre [m/m].
        straightens: Angle by which a skid-steer turns on after its wheels were let go, by its rate of turning squared
            [s^2/rad].
        friction: Coefficient of the tyres where only one side fails that turns freely.
        brakes: Deceleration of the rims of the side that still works, once it is stopped [m/s^2].
        ways: How it comes to rest.
        astray: Those that do not, and are not where they think.

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
    astray: Astray

    def __post_init__(self) -> None:
        for name in ("share", "thrown"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise SettingError(name, getattr(self, name), "a number in [0, 1]")
        if not 0.0 <= self.harmless < 1.0:
            raise SettingError("harmless", self.harmless, "a number in [0, 1)")
        for name in ("reference_speed", "position_spread", "friction", "brakes"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise SettingError(name, getattr(self, name), "a finite number above 0")
        for name in ("drift", "straightens"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise SettingError(name, getattr(self, name), "a finite number of at least 0")
        if not self._total > 0.0:
            raise SettingError("ways", dict(self.ways), "one with a weight above 0 at least")
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
        """Make them of the values in a file."""
        ways, lost = {}, root["astray"]
        lost.only(*(item.name for item in fields(Astray)))
        astray = Astray(**{item.name: lost[item.name].number() for item in fields(Astray)})
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
        numbers = {key: root[key].number() for key in cls.keys if key not in ("ways", "astray")}
        return cls(**numbers, ways=ways, astray=astray)

    def of_base(self, scene: Scene) -> float:
        """Return the share of failures that are the base's: all of them if there is nothing else that may fail."""
        if scene.base is None:
            return 0.0
        return 1.0 if scene.joints == scene.base.joints else self.share

    def of_cargo(self, scene: Scene) -> float:
        """Return the share of failures in which what is carried is let go, or thrown off a base without an arm."""
        if scene.base is None:
            return 1.0
        return self.thrown if scene.joints == scene.base.joints else 1.0 - self.share

    def stops(self, load: float = 1.0) -> Float[Array, "stop 6"]:
        """Return every combination of ways in which both sides do the same.

        Args:
            load: Share of the weight on the driven wheels, which is what held tyres brake with.

        Returns:
            Probability, deceleration [m/s^2], drag [1/s], delay [s], 1 if wheels are let go, curvature added [1/m].
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
        """Return every combination of ways in which one side fails: probability, way, deceleration, delay."""
        return tuple(
            (p * len(way.bend), way, a, delay)
            for way, p in self._each()
            if way.wheels in ONE_SIDE
            for a in way.deceleration
            for delay in way.delay
        )

    def beside(self, base: DiffDrive) -> Float[Array, "place 4"]:
        """Return where a base is that went astray, as `Astray.places` has it."""
        if self.astray.weight == 0.0:
            return np.zeros((0, 4))
        return self.astray.places(self._probability(self.astray.weight), base, self.position_spread)

    def only(self, *names: str) -> CoastSettings:
        """Return settings with these ways alone, which all failures then go."""
        ways = {name: self.ways[name] for name in names}
        return replace(self, harmless=0.0, ways=ways, astray=replace(self.astray, weight=0.0))

    def of_the_moment(self) -> CoastSettings:
        """Return settings for who looks at one moment alone: what leads astray bends off at once, as ways that bend."""
        bent = sum(way.weight for way in self.ways.values() if any(way.bend))
        more = 1.0 + self.astray.weight / bent if bent > 0.0 else 1.0
        ways = {
            name: replace(way, weight=way.weight * (more if any(way.bend) else 1.0)) for name, way in self.ways.items()
        }
        return replace(self, ways=ways, astray=replace(self.astray, weight=0.0))

    @property
    def _total(self) -> float:
        return sum(way.weight for way in self.ways.values()) + self.astray.weight

    def _probability(self, weight: float) -> float:
        return weight / self._total * (1.0 - self.harmless)

    def _each(self) -> list[tuple[Way, float]]:
        """Return ways that happen and the probability of each of their combinations."""
        return [
            (way, self._probability(way.weight) / (len(way.deceleration) * len(way.delay) * len(way.bend)))
            for way in self.ways.values()
            if way.weight > 0.0
        ]
