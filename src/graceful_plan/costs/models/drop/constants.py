"""Constants of the drop model, and their YAML format.

The shipped values are in `drop.yaml`; its head states the data that they were fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import final

from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES
from graceful_plan.path import plain_numbers
from graceful_plan.setting_checks import check_ranges, fraction
from graceful_plan.yaml_file import Block, YamlTable

SHARED = (
    "delay",
    "velocity_spread",
    "height_spread",
    "carry_spread",
    "side_spread",
    "side_reach",
    "side_height",
    "catch",
    "leave_tilt",
)
"""Constants that all classes share in the YAML file."""
_POSITIVE = ("position_spread", "velocity_spread", "side_height")
_NOT_NEGATIVE = ("delay", "height_spread", "carry_spread", "side_spread", "size_spread")


@final
@dataclass(frozen=True, kw_only=True)
class DropConstants:
    """Constants for one class of objects; some lengths are in units of the object's `size`.

    Raises:
        SettingError: If a constant is not finite or out of its range.
    """

    delay: float
    """Time that the gripper still carries the object along after it starts to let go [s]."""
    velocity_spread: float
    """sv: standard deviation of the release velocity [m/s]."""
    height_spread: float
    """ch: standard deviation of the landing point per height of fall [m/m]."""
    carry_spread: float
    """cv: standard deviation of the landing point per speed [s]."""
    side_spread: float
    """cl: standard deviation of the resting place [size]."""
    side_reach: float
    """kl: lateral reach around the landing place [size]; negative if it stays within the object's outline."""
    side_height: float
    """sh: smoothing width of the height below which the object passes under a target [m]."""
    catch: float
    """P that a wide top below its path ends a fall."""
    leave_tilt: float
    """gti: effect of a tilt at release on leaving the support."""
    position_spread: float
    """s0: standard deviation of the release position [m]."""
    size_spread: float
    """ct: standard deviation of a fall from a support [size]."""
    tumble_reach: float
    """kb: reach around the centre while tumbling [size]."""
    catch_margin: float
    """kc: margin by which a top is widened (or narrowed, if negative) for ending a fall [size]."""
    leave: float
    """g0: tendency to leave a support whose edge is below the centre of mass."""
    leave_offset: float
    """gd: effect of a lateral offset between support and centre of mass on leaving."""
    leave_narrow: float
    """gt: effect of a narrow support on leaving."""
    leave_speed: float
    """gv: effect of horizontal speed on leaving [s/m]."""
    drift: float
    """Distance by which the object moves off its support [size]."""
    carry: float
    """ks: further displacement per speed while falling off a support [s]."""
    slide: float
    """ksl: further displacement per speed after landing [s]."""
    topple_reach: float
    """tk: additional lateral reach if the object does not stay where it lands [size]."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        values = {constant.name: getattr(self, constant.name) for constant in fields(self)}
        check_ranges(values, positive=_POSITIVE, not_negative=_NOT_NEGATIVE)
        fraction("catch", self.catch, "a probability")


@final
@dataclass(frozen=True, kw_only=True)
class DropSettings(YamlTable):
    """Constants of the drop model by class of the carried object; see `SHAPE_CLASSES`."""

    shipped_file = Path(__file__).parent / "drop.yaml"
    kind = "drop models"
    keys = ("provenance", "shared", "classes")

    box: DropConstants
    cylinder: DropConstants
    plate: DropConstants
    ball: DropConstants

    @classmethod
    def parsed(cls, root: Block) -> DropSettings:
        """Construct from the values in a file."""
        shared, classes = root["shared"].numbers_by_name(*SHARED), root["classes"]
        classes.only(*SHAPE_CLASSES)
        own = tuple(constant.name for constant in fields(DropConstants) if constant.name not in SHARED)
        return cls(**{name: DropConstants(**shared, **classes[name].numbers_by_name(*own)) for name in SHAPE_CLASSES})

    def widened(self, metres: float) -> DropSettings:
        """Return constants with additional uncertainty of the release position: a standard deviation [m]."""
        every = {name: getattr(self, name) for name in SHAPE_CLASSES}
        return DropSettings(
            **{
                name: replace(own, position_spread=math.hypot(own.position_spread, metres))
                for name, own in every.items()
            }
        )

    def of(self, shape_class: int) -> DropConstants:
        """Return the constants of a class, given as index into `SHAPE_CLASSES`."""
        return getattr(self, SHAPE_CLASSES[shape_class])
