"""Constants of the body model: what they are, and how to read them from YAML.

The shipped ones are `body.yaml`; its head says what they were fitted to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import final

from graceful_plan.costs.models.body.tables import ROWS
from graceful_plan.costs.models.ranges import check_ranges
from graceful_plan.exceptions import SettingError
from graceful_plan.yaml_file import Block, YamlTable

GENERATORS = ("collapse", "joint", "stuck", "stray")
"""What may happen to the arm, in this order: no joint has power; one has none; one is frozen; it goes astray."""
MOTION = (
    "brake_time",
    "brake_stop",
    "resistance",
    "step",
    "steps",
    "carry_on",
)
"""Constants of how the arm moves; the others are margins."""
_POSITIVE = ("step",)
_BETA = math.sqrt(3.0) / math.pi  # scale of a logistic distribution with standard deviation 1
_NOT_NEGATIVE = ("brake_time", "brake_stop", "resistance", "carry_on")


@final
@dataclass(frozen=True, kw_only=True)
class Margin:
    """How a distance becomes a probability: 1/(1 + exp((d - offset)/spread)).

    Raises:
        SettingError: If the offset is not finite or the spread is not positive.
    """

    offset: float
    """Distance at which a hit is as likely as not [m]."""
    spread: float
    """Scale of the logistic distribution around it [m]."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.offset):
            raise SettingError("offset", self.offset, "a finite number")
        if not 0.0 < self.spread < math.inf:
            raise SettingError("spread", self.spread, "a positive number")


@final
@dataclass(frozen=True, kw_only=True)
class Margins:
    """Margins of the arm itself and of what it holds, and how far things that are met stop it.

    Raises:
        SettingError: If a constant is not finite or the gain is negative.
    """

    body: Margin
    carried: Margin
    stop_gain: float
    """How much farther things become per depth in something that was met before."""
    stop_tolerance: float
    """Depth from which it counts [m]."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.stop_gain < math.inf:
            raise SettingError("stop_gain", self.stop_gain, "at least 0")
        if not math.isfinite(self.stop_tolerance) or self.stop_tolerance < 0.0:
            raise SettingError("stop_tolerance", self.stop_tolerance, "at least 0")


@final
@dataclass(frozen=True, kw_only=True)
class BodySettings(YamlTable):
    """Constants of the body model.

    Raises:
        SettingError: If one is not finite or out of its range.
    """

    shipped_file = Path(__file__).parent / "body.yaml"
    kind = "body models"
    keys = ("provenance", "motion", "margins")

    brake_time: float
    """Time after which brakes hold all joints when the power fails [s]; how long the arm falls if there are none."""
    brake_stop: float
    """tb: joints move on by tb times their velocity while the brakes bite [s]."""
    resistance: float
    """Viscous resistance of a dead motor, besides that of the joint [N m s/rad]."""
    step: float
    """h: time between two configurations that are looked at [s]."""
    steps: int
    """K: how many of them there are where the motion to come is not known."""
    carry_on: float
    """T: joints that work go on for T times their velocity, where the motion to come is not known [s]."""
    collapse: Margins
    joint: Margins
    stuck: Margins
    stray: Margins

    def __post_init__(self) -> None:
        values = {name: getattr(self, name) for name in MOTION}
        check_ranges(values, positive=_POSITIVE, not_negative=_NOT_NEGATIVE)
        if not (self.steps == int(self.steps) and 0 <= self.steps <= 64):
            raise SettingError("steps", self.steps, "a whole number, at most 64")

    @classmethod
    def parsed(cls, root: Block) -> BodySettings:
        """Make them of the values in a file."""
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

    def widened(self, metres: float) -> BodySettings:
        """Return constants with distances uncertain by so much more (a standard deviation)."""
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
