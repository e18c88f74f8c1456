"""Constants of the spill model, and their YAML format.

The shipped values are in `spill.yaml`; its head states the data that they were fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import final

from graceful_plan.path import plain_numbers
from graceful_plan.setting_checks import check_ranges
from graceful_plan.yaml_file import Block, YamlTable

USES = ("dropped", "held")
"""Ways in which contents are lost: the container falls and lands; it is jolted or tipped in the gripper."""
_POSITIVE = ("position_spread", "soft_spread")
_STOP = ("deceleration", "amplification", "response", "spread")
"""Scalar constants of protective stops."""


@final
@dataclass(frozen=True, kw_only=True)
class SpillConstants:
    """Constants for one use (see `USES`); puddle lengths are relative to the radius of a puddle of all contents.

    Raises:
        SettingError: If a constant is not finite or out of its range.
    """

    position_spread: float
    """s0: standard deviation of the landing point of contents [m]."""
    rim_spread: float
    """cr: standard deviation of the landing point per radius of the rim."""
    speed_spread: float
    """cv: standard deviation of the landing point per speed [s]."""
    height_spread: float
    """ch: standard deviation of the landing point per height of fall [m/m]."""
    carry: float
    """kt: time by which contents land later than the container [s]."""
    margin: float
    """km: distance around the landing point within which contents wet a target [m]."""
    reach: float
    """kr: reach of a puddle along each axis [puddle]."""
    run_off: float
    """ko: reach of contents that run over an edge [puddle]."""
    edge: float
    """ke: least distance from all edges at which nothing runs over them [puddle]."""
    slosh: float
    """kv: tilt equivalent of speed, since fast motions also accelerate [s/m]."""
    soft_speed: float
    """u0: landing speed at which contents spill half of the time [m/s]; far below 0 if they have left before."""
    soft_spread: float
    """us: standard deviation of that speed [m/s]."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        values = {constant.name: getattr(self, constant.name) for constant in fields(self)}
        check_ranges(values, positive=_POSITIVE, not_negative=values.keys() - {"soft_speed"})


@final
@dataclass(frozen=True, kw_only=True)
class StopSettings(YamlTable):
    """Constants of the protective stop and its effect on contents; the shipped ones are in `stop.yaml`.

    Raises:
        SettingError: If a constant is not finite or out of its range.
    """

    shipped_file = Path(__file__).parent / "stop.yaml"
    kind = "stops"
    keys = ("stop", "places")

    deceleration: float
    """kd: deceleration of the slowest joint to stop, relative to its acceleration limit in motions."""
    amplification: float
    """ka: ratio of the deceleration that contents feel to the mean deceleration."""
    response: float
    """tr: time that the surface of the contents needs to follow [s]; shorter stops hardly tilt it."""
    spread: float
    """us: standard deviation of the logarithm of the container's capacity."""
    places: SpillConstants
    """Landing point of contents that a stop throws out. Speed before the stop counts for that point, not for the fill
    level."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        values = {name: getattr(self, name) for name in _STOP}
        check_ranges(values, positive=("deceleration", "response", "spread"), not_negative={"amplification"})

    @classmethod
    def parsed(cls, root: Block) -> StopSettings:
        """Construct from the values in a file."""
        places = SpillConstants(
            **root["places"].numbers_by_name(*(constant.name for constant in fields(SpillConstants)))
        )
        return cls(places=places, **root["stop"].numbers_by_name(*_STOP))

    def widened(self, metres: float) -> StopSettings:
        """Return constants with additional uncertainty of the landing point: a standard deviation [m]."""
        return replace(self, places=_widened(self.places, metres))


@final
@dataclass(frozen=True, kw_only=True)
class SpillSettings(YamlTable):
    """Constants of the spill model by use; see `USES`."""

    shipped_file = Path(__file__).parent / "spill.yaml"
    kind = "spill models"
    keys = ("provenance", *USES)

    dropped: SpillConstants
    held: SpillConstants

    @classmethod
    def parsed(cls, root: Block) -> SpillSettings:
        """Construct from the values in a file."""
        names = tuple(constant.name for constant in fields(SpillConstants))
        return cls(**{use: SpillConstants(**root[use].numbers_by_name(*names)) for use in USES})

    def widened(self, metres: float) -> SpillSettings:
        """Return constants with additional uncertainty of the landing point: a standard deviation [m]."""
        return SpillSettings(dropped=_widened(self.dropped, metres), held=_widened(self.held, metres))

    def of(self, use: str) -> SpillConstants:
        """Return the constants of a use; see `USES`."""
        return getattr(self, use)


def _widened(constants: SpillConstants, metres: float) -> SpillConstants:
    return replace(constants, position_spread=math.hypot(constants.position_spread, metres))
