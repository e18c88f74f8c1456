"""The motions of a task for the bound of prevention, as they are stored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

import graceful_plan as gp
from benchmarks.prevention.runs import NONE

Array = np.ndarray
SECONDS = 1.0
SPEED, OTHER_SPEEDS = 0.5, (0.35, 0.65)
"""Fractions of the velocity limits."""
PRIORS: Mapping[str, gp.ImpactCost] = MappingProxyType(
    {
        "default": gp.ImpactCost(),
        "service": gp.ImpactCost(model=gp.FailureMixture(faults="service_robot")),
        "arm": gp.ImpactCost(model=gp.FailureMixture(faults="arm")),
    }
)
WEIGHTS = (0.3, 1.0, 3.0)
SEEDS, PLANNERS = (1, 2), ("rrt_star", "prm_star")
DISTINCT, MOST = 4, 44
"""Candidates of each call with w > 0, and motions of a task; first motions of calls come before further candidates."""
TASKS = (
    "bedside/bring_pills",
    "desk/bring_coffee",
    "workbench/bring_chisel",
    "tabletop_l3/corner_to_blue",
    "bathroom/rinse_mug",
    "dining_table/serve_cake",
    "lab_bench/move_plate",
    "kitchen_counter/move_oil",
    "play_table/pass_ball",
    "tabletop/green_to_blue",
    "reading_corner/move_candlestick",
    "desk/return_stapler",
    "breakfast_bar/pass_milk",
    "dining_table/move_bottle",
)
"""Half of them unseen, in the order of a run that time may end early."""
SIZES = {"drops": (40, 96), "mixed": (38, 76)}
"""Failures of every motion that choose, and of the judged motions that judge."""
LONG_SIZES = {"drops": (400, 400), "mixed": (228, 228)}


@dataclass(frozen=True, kw_only=True)
class BoundJob:
    """A task, and the numbers of failures of each kind: to choose, and to judge."""

    task: str
    sizes: Mapping[str, tuple[int, int]]


@dataclass(frozen=True, kw_only=True)
class Modelled:
    """A motion as the planner's model sees it.

    Args:
        motion: Motion cost V.
        impact: Time integral of the impact along the motion, by prior; the predicted harm per executed task without the
            rate of failures.
        height: Mean height of the carried object, or of the tool [m].
        aside: Greatest horizontal distance of the object from the default motion's object at equal shares of the
            duration [m].
        end: Distance of the last configuration from that of the default motion [rad].
    """

    motion: float
    impact: Mapping[str, float]
    height: float
    aside: float
    end: float

    def cost(self, prior: str, w: float) -> float:
        """Return J with a prior."""
        return self.motion + w * self.impact[prior]


@dataclass(frozen=True, kw_only=True)
class Bound:
    """The motions of a task.

    Args:
        task: "scene/task".
        duration: Duration by motion [s].
        modelled: The model's view, by motion.
        first: Harm per failure on the failures that choose, by kind of failures, then by motion.
        second: Harm per failure on the failures that judge, for the named motions and for those that were chosen.
        others: The part of `second` that is not the loss of the carried object.
        best: The chosen motion, by kind.
        best_at_speed: The chosen motion among those at `SPEED`, by kind.
    """

    task: str
    duration: Mapping[str, float]
    modelled: Mapping[str, Modelled]
    first: Mapping[str, Mapping[str, float]]
    second: Mapping[str, Mapping[str, float]]
    others: Mapping[str, Mapping[str, float]]
    best: Mapping[str, str]
    best_at_speed: Mapping[str, str]

    def less(self, kind: str, name: str, *, others: bool = False) -> float:
        """Return the relative reduction of harm per executed task against w = 0, on the failures that judge."""
        return 1.0 - self.per_task(kind, name, others=others) / self.per_task(kind, NONE, others=others)

    def less_first(self, kind: str, name: str) -> float:
        """Return the same on the failures that choose, for a motion that was chosen without them."""
        a, b = (self.first[kind][which] * self.duration[which] for which in (name, NONE))
        return 1.0 - a / b

    def least(self, prior: str, w: float) -> str:
        """Return the motion at `SPEED` of least J; with an infinite weight, of least predicted harm per task."""
        if math.isinf(w):
            return min(self._at_speed, key=lambda name: self.modelled[name].impact[prior])
        return min(self._at_speed, key=lambda name: self.modelled[name].cost(prior, w))

    @property
    def _at_speed(self) -> list[str]:
        return [name for name in self.duration if at_speed(name)]

    def per_task(self, kind: str, name: str, *, others: bool = False) -> float:
        """Return the harm per executed task, without the rate of failures."""
        return (self.others if others else self.second)[kind][name] * self.duration[name]


def name_of(prior: str, w: float) -> str:
    """Return the label of a motion."""
    return f"{prior}, w = {w:g}"


def at_speed(name: str) -> bool:
    """Return whether a motion is planned at `SPEED`."""
    return "speed" not in name


NAMED = (
    NONE,
    *(name_of(prior, WEIGHTS[0]) for prior in PRIORS),
    *(name_of("default", w) for w in WEIGHTS[1:]),
    name_of("service", WEIGHTS[2]),
)
"""Motions that are always judged."""
DEFAULT = name_of("default", WEIGHTS[0])
