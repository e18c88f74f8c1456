"""Constants of the spill model: what they are, and how to read them from YAML.

The shipped ones are `spill.yaml`; its head says what they were fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import final

from graceful_plan.costs.models.ranges import check_ranges
from graceful_plan.yaml_file import Block, YamlTable

USES = ("dropped", "held")
"""How contents get out: their container falls and lands; it is jolted or tipped in the gripper."""
_POSITIVE = ("position_spread", "soft_spread")
_STOP = ("deceleration", "amplification", "response", "spread")
"""Constants of stops that are numbers."""


@final
@dataclass(frozen=True, kw_only=True)
class SpillConstants:
    """Constants for one of `USES`; lengths in units of the puddle are shares of its radius if all runs out.

    Raises:
        SettingError: If one is not finite or out of its range.
    """

    position_spread: float
    """s0: standard deviation of where contents land [m]."""
    rim_spread: float
    """cr: the same per radius of the rim."""
    speed_spread: float
    """cv: the same per speed [s]."""
    height_spread: float
    """ch: the same per height of fall [m/m]."""
    carry: float
    """kt: how much later than the container contents are down [s]."""
    margin: float
    """km: how far beside their place contents wet what they fall on [m]."""
    reach: float
    """kr: how far a puddle reaches along each axis [puddle]."""
    run_off: float
    """ko: the same for what runs over an edge [puddle]."""
    edge: float
    """ke: how far from all edges nothing runs over them [puddle]."""
    slosh: float
    """kv: how much of a tilt speed is worth, since what is fast also accelerates [s/m]."""
    soft_speed: float
    """u0: speed of landing from which on contents get out [m/s]; far below 0 if they are out before."""
    soft_spread: float
    """us: how uncertain that is [m/s]."""

    def __post_init__(self) -> None:
        values = {constant.name: getattr(self, constant.name) for constant in fields(self)}
        check_ranges(values, positive=_POSITIVE, not_negative=values.keys() - {"soft_speed"})


@final
@dataclass(frozen=True, kw_only=True)
class StopSettings(YamlTable):
    """How hard the robot stops by itself, and what contents make of it; the shipped ones are `stop.yaml`.

    Raises:
        SettingError: If one is not finite or out of its range.
    """

    shipped_file = Path(__file__).parent / "stop.yaml"
    kind = "stops"
    keys = ("stop", "places")

    deceleration: float
    """kd: of the joint that needs longest, over the greatest acceleration that motions have."""
    amplification: float
    """ka: how much more than the mean deceleration contents feel."""
    response: float
    """tr: time that their surface needs to follow [s]; shorter stops hardly tilt it."""
    spread: float
    """us: how uncertain the logarithm of what the container could hold is."""
    places: SpillConstants
    """Where contents come down that a stop throws out. Speed before it counts for that, not for how full the container
    is."""

    def __post_init__(self) -> None:
        values = {name: getattr(self, name) for name in _STOP}
        check_ranges(values, positive=("deceleration", "response", "spread"), not_negative={"amplification"})

    @classmethod
    def parsed(cls, root: Block) -> StopSettings:
        """Make them of the values in a file."""
        places = SpillConstants(
            **root["places"].numbers_by_name(*(constant.name for constant in fields(SpillConstants)))
        )
        return cls(places=places, **root["stop"].numbers_by_name(*_STOP))

    def widened(self, metres: float) -> StopSettings:
        """Return constants with the place where contents land uncertain by so much more."""
        return replace(self, places=_widened(self.places, metres))


@final
@dataclass(frozen=True, kw_only=True)
class SpillSettings(YamlTable):
    """Constants of the spill model by use, see `USES`."""

    shipped_file = Path(__file__).parent / "spill.yaml"
    kind = "spill models"
    keys = ("provenance", *USES)

    dropped: SpillConstants
    held: SpillConstants

    @classmethod
    def parsed(cls, root: Block) -> SpillSettings:
        """Make them of the values in a file."""
        names = tuple(constant.name for constant in fields(SpillConstants))
        return cls(**{use: SpillConstants(**root[use].numbers_by_name(*names)) for use in USES})

    def widened(self, metres: float) -> SpillSettings:
        """Return constants with the place where contents land uncertain by so much more."""
        return SpillSettings(dropped=_widened(self.dropped, metres), held=_widened(self.held, metres))

    def of(self, use: str) -> SpillConstants:
        """Return the constants of one of `USES`."""
        return getattr(self, use)


def _widened(constants: SpillConstants, metres: float) -> SpillConstants:
    return replace(constants, position_spread=math.hypot(constants.position_spread, metres))
