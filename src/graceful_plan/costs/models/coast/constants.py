"""Constants of the coast model, read from YAML."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError
from graceful_plan.yaml_file import Block, YamlTable

Array = np.ndarray


@final
@dataclass(frozen=True, kw_only=True)
class Way:
    """A way to come to rest; each deceleration is as likely as each other, and so is each delay.

    Args:
        weight: How often, compared with other ways.
        deceleration: At low speed [m/s^2].
        drag: What is added to it per speed [1/s].
        delay: How long the base goes on at full speed before [s].
        released: Whether the wheels turn freely: a skid-steer then goes straight on.

    Raises:
        SettingError: If a number is out of its range.
    """

    weight: float
    deceleration: tuple[float, ...]
    drag: float
    delay: tuple[float, ...]
    released: bool = False

    def __post_init__(self) -> None:
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
class CoastSettings(YamlTable):
    """Constants of the coast model.

    Args:
        share: Of failures, those of the base rather than of what it carries.
        reference_speed: Speed of a hit that severities are for [m/s].
        position_spread: Standard deviation of where the base is across its way [m].
        drift: How much farther it strays per metre [m/m].
        straightens: Angle by which a skid-steer turns on after its wheels were let go, by its rate of turning squared
            [s^2/rad].
        ways: How it comes to rest.

    Raises:
        SettingError: If a number is out of its range.
    """

    shipped_file = Path(__file__).with_name("coast.yaml")
    kind = "coast settings"
    keys = ("share", "reference_speed", "position_spread", "drift", "straightens", "ways")

    share: float
    reference_speed: float
    position_spread: float
    drift: float
    straightens: float
    ways: Mapping[str, Way]

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise SettingError("share", self.share, "a number in [0, 1]")
        for name in ("reference_speed", "position_spread"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise SettingError(name, getattr(self, name), "a finite number above 0")
        for name in ("drift", "straightens"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise SettingError(name, getattr(self, name), "a finite number of at least 0")
        if not sum(way.weight for way in self.ways.values()) > 0.0:
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
        ways = {}
        for name, block in root["ways"].items():
            block.only("weight", "released", "deceleration", "drag", "delay")
            ways[name] = Way(
                weight=block["weight"].number(),
                deceleration=block["deceleration"].numbers(),
                drag=block["drag"].number(),
                delay=block["delay"].numbers(),
                released=_flag(block["released"]),
            )
        return cls(**{key: root[key].number() for key in cls.keys if key != "ways"}, ways=ways)

    @property
    def stops(self) -> Float[Array, "stop 5"]:
        """Every combination: probability, deceleration [m/s^2], drag [1/s], delay [s], and 1 if wheels are let go."""
        total = sum(way.weight for way in self.ways.values())
        return np.array(
            [
                (way.weight / total / (len(way.deceleration) * len(way.delay)), a, way.drag, delay, float(way.released))
                for way in self.ways.values()
                if way.weight > 0.0
                for a in way.deceleration
                for delay in way.delay
            ]
        )


def _flag(block: Block) -> bool:
    if block.value not in ("true", "false"):
        raise block.error(f"{block.name} is neither true nor false")
    return block.value == "true"
