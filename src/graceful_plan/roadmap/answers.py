"""What a roadmap answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown, PlanStatus

Array = np.ndarray


class QueryStatus(Enum):
    """How a question to a roadmap ended; the value says what to do about it."""

    FOUND = "A path of the roadmap, free at a fine step; not timed, and the judge has not seen it."
    INVALID_START = PlanStatus.INVALID_START.value
    INVALID_GOAL = PlanStatus.INVALID_GOAL.value
    NOT_CONNECTED = "The roadmap has no path from start to goal; build it with more nodes, or plan without it."


@dataclass(frozen=True, kw_only=True)
class QueryResult:
    """The answer to one question."""

    status: QueryStatus
    path: Path | None = None
    cost: CostBreakdown = field(default_factory=CostBreakdown)
    """What the path costs, as `evaluate` has it; edges were compared by coarser samples, at the paces of motions."""
    goal_index: int | None = None
    """Which of several goals was reached."""
    detail: str = ""
    """What the status means here: the pair in contact and its depth, the joint at its limit..."""


@dataclass(frozen=True, eq=False)
class FrontPath:
    """One path of a front: its vertices, and what it costs."""

    q: Float[Array, "n nq"]
    """Vertices [rad or m], from the start to a goal."""
    motion: float
    """V."""
    impact: float
    """S."""
