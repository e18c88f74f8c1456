"""Constants of the drop model: what they are, and how to read them from YAML.

The shipped ones are `drop.yaml`; its head says what they were fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import final

from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES
from graceful_plan.costs.models.ranges import check_ranges
from graceful_plan.exceptions import SettingError
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
    """Constants for one class of objects; lengths that scale with the object are in units of its `size`.

    Raises:
        SettingError: If one is not finite or out of its range.
    """

    delay: float
    """How long the gripper carries on after it lets go [s]."""
    velocity_spread: float
    """sv: standard deviation of the release velocity [m/s]."""
    height_spread: float
    """ch: spread on the ground per height of fall [m/m]."""
    carry_spread: float
    """cv: spread on the ground per speed [s]."""
    side_spread: float
    """cl: spread of where it comes to rest [size]."""
    side_reach: float
    """kl: how far it reaches beside the place where it comes down [size]; negative if it stays in its shadow."""
    side_height: float
    """sh: how sharply it passes under things [m]."""
    catch: float
    """P that a wide top under its path ends a fall."""
    leave_tilt: float
    """gti: how much a tilt at release helps it leave its support."""
    position_spread: float
    """s0: standard deviation of the place of release [m]."""
    size_spread: float
    """ct: spread of a fall [size]."""
    tumble_reach: float
    """kb: how far it reaches around its centre while it tumbles [size]."""
    catch_margin: float
    """kc: how far inside of a top (if negative) its centre has to be to end a fall [size]."""
    leave: float
    """g0: how readily it leaves a support whose edge is under its centre."""
    leave_offset: float
    """gd: how much a support beside its centre helps."""
    leave_narrow: float
    """gt: how much a narrow support helps."""
    leave_speed: float
    """gv: how much speed helps [s/m]."""
    drift: float
    """How far it moves off its support [size]."""
    carry: float
    """ks: how far it moves on per speed while it falls off [s]."""
    slide: float
    """ksl: how far it moves on per speed where it comes down [s]."""
    topple_reach: float
    """tk: how much farther it reaches to the side if it does not stay where it comes down [size]."""

    def __post_init__(self) -> None:
        values = {constant.name: getattr(self, constant.name) for constant in fields(self)}
        check_ranges(values, positive=_POSITIVE, not_negative=_NOT_NEGATIVE)
        if not 0.0 <= self.catch <= 1.0:
            raise SettingError("catch", self.catch, "a probability")


@final
@dataclass(frozen=True, kw_only=True)
class DropSettings(YamlTable):
    """Constants of the drop model by class of the carried object, see `drop_tables.SHAPE_CLASSES`."""

    shipped_file = Path(__file__).parent / "drop.yaml"
    kind = "drop models"
    keys = ("provenance", "shared", "classes")

    box: DropConstants
    cylinder: DropConstants
    plate: DropConstants
    ball: DropConstants

    @classmethod
    def parsed(cls, root: Block) -> DropSettings:
        """Make them of the values in a file."""
        shared, classes = root["shared"].numbers_by_name(*SHARED), root["classes"]
        classes.only(*SHAPE_CLASSES)
        own = tuple(constant.name for constant in fields(DropConstants) if constant.name not in SHARED)
        return cls(**{name: DropConstants(**shared, **classes[name].numbers_by_name(*own)) for name in SHAPE_CLASSES})

    def widened(self, metres: float) -> DropSettings:
        """Return constants with the place of release uncertain by so much more: a footprint with softer edges."""
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
