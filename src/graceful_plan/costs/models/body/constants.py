"""Constants of the body model, and their YAML format.

The shipped values are in `body.yaml`; its head states the data that they were fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import final

from graceful_plan.costs.models.body.tables import ROWS
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers
from graceful_plan.setting_checks import check_ranges, finite, not_negative, positive
from graceful_plan.yaml_file import Block, YamlTable

GENERATORS = ("collapse", "joint", "stuck", "stray")
"""Kinds of arm failure, in this order: no joint has power; one has none; one is frozen; the arm leaves its path."""
MOTION = (
    "brake_time",
    "brake_stop",
    "resistance",
    "step",
    "steps",
    "carry_on",
)
"""Constants of the arm's motion; the others are margins."""
_POSITIVE = ("step",)
_ROUNDING = 1e-9
_BETA = math.sqrt(3.0) / math.pi  # scale of a logistic distribution with standard deviation 1
_NOT_NEGATIVE = ("brake_time", "brake_stop", "resistance", "carry_on")


@final
@dataclass(frozen=True, kw_only=True)
class Margin:
    """Map from distance to probability: 1/(1 + exp((d - offset)/spread)).

    Raises:
        SettingError: If the offset is not finite or the spread is not positive.
    """

    offset: float
    """Distance at which the probability of a hit is 1/2 [m]."""
    spread: float
    """Scale of the logistic distribution around `offset` [m]."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        finite("offset", self.offset)
        positive("spread", self.spread)


@final
@dataclass(frozen=True, kw_only=True)
class Margins:
    """Margins of the arm and of the carried object, and the effect of earlier contacts.

    Raises:
        SettingError: If a constant is not finite or the gain is negative.
    """

    body: Margin
    carried: Margin
    stop_gain: float
    """Distance added per depth of penetration at earlier configurations [m/m]."""
    stop_tolerance: float
    """Depth from which penetration counts [m]."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        not_negative("stop_gain", self.stop_gain)
        if not math.isfinite(self.stop_tolerance) or self.stop_tolerance < 0.0:
            raise SettingError("stop_tolerance", self.stop_tolerance, "at least 0")


@final
@dataclass(frozen=True, kw_only=True)
class BodySettings(YamlTable):
    """Constants of the body model.

    Raises:
        SettingError: If a constant is not finite or out of its range.
    """

    shipped_file = Path(__file__).parent / "body.yaml"
    kind = "body models"
    keys = ("provenance", "motion", "margins")

    brake_time: float
    """Time after which brakes hold all joints when the power fails [s]; without brakes, how long the arm falls."""
    brake_stop: float
    """tb: joints move on by tb times their velocity while the brakes engage [s]."""
    resistance: float
    """Viscous resistance of a dead motor, in addition to that of the joint [N m s/rad]."""
    step: float
    """h: time between two evaluated configurations [s]."""
    steps: int
    """K: number of evaluated configurations if the motion ahead is unknown."""
    carry_on: float
    """T: working joints move on by T times their velocity if the motion ahead is unknown [s]."""
    collapse: Margins
    joint: Margins
    stuck: Margins
    stray: Margins

    def __post_init__(self) -> None:
        plain_numbers(self)
        values = {name: getattr(self, name) for name in MOTION}
        check_ranges(values, positive=_POSITIVE, not_negative=_NOT_NEGATIVE)
        if not (self.steps == int(self.steps) and 0 <= self.steps <= 64):
            raise SettingError("steps", self.steps, "a whole number, at most 64")

    @classmethod
    def parsed(cls, root: Block) -> BodySettings:
        """Construct from the values in a file."""
        motion, margins = root["motion"], root["margins"]
        motion.only(*MOTION)
        margins.only(*GENERATORS)
        return cls(
            brake_time=motion["brake_time"].number(),
            brake_stop=motion["brake_stop"].number(),
            resistance=motion["resistance"].number(),
            step=motion["step"].number(),
            steps=_whole(motion["steps"]),
            carry_on=motion["carry_on"].number(),
            collapse=_margins(margins["collapse"]),
            joint=_margins(margins["joint"]),
            stuck=_margins(margins["stuck"]),
            stray=_margins(margins["stray"]),
        )

    def margin(self, generator: str, row: str) -> Margin:
        """Return the margin of one generator for "body" or "carried"."""
        return getattr(getattr(self, generator), row)

    def within(self, seconds: float) -> BodySettings:
        """Return constants for failures that last this long [s], until the arm is stopped.

        The evaluated configurations of joints that fall, stick or stray end then; brakes close at the latest then.
        """
        steps = min(self.steps, max(1, math.ceil(seconds / self.step - _ROUNDING)))
        return replace(
            self,
            brake_time=min(self.brake_time, seconds),
            step=min(self.step, seconds / steps),
            steps=steps,
            carry_on=min(self.carry_on, seconds),
        )

    def widened(self, metres: float) -> BodySettings:
        """Return constants whose distances are uncertain by an additional standard deviation [m]."""
        wide: dict[str, Margins] = {}
        for name in GENERATORS:
            own: Margins = getattr(self, name)
            wide[name] = replace(own, body=_widened(own.body, metres), carried=_widened(own.carried, metres))
        return replace(self, collapse=wide["collapse"], joint=wide["joint"], stuck=wide["stuck"], stray=wide["stray"])


def _widened(margin: Margin, metres: float) -> Margin:
    return replace(margin, spread=math.hypot(margin.spread, _BETA * metres))


def _margins(block: Block) -> Margins:
    block.only(*ROWS, "stop_gain", "stop_tolerance")
    return Margins(
        body=_margin(block["body"]),
        carried=_margin(block["carried"]),
        stop_gain=block["stop_gain"].number(),
        stop_tolerance=block["stop_tolerance"].number(),
    )


def _whole(block: Block) -> int:
    number = block.number()
    if number != int(number):
        raise block.error("a whole number is needed")
    return int(number)


def _margin(block: Block) -> Margin:
    return Margin(**block.numbers_by_name(*(constant.name for constant in fields(Margin))))
