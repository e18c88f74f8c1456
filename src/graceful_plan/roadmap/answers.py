"""Results of roadmap queries."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown, PlanStatus


class QueryStatus(Enum):
    """Outcome of a roadmap query; each value is a sentence with a remedy."""

    FOUND = "A path of the roadmap, free at a fine step; it is not timed, and the judge has not verified it."
    INVALID_START = PlanStatus.INVALID_START.value
    INVALID_GOAL = PlanStatus.INVALID_GOAL.value
    NOT_CONNECTED = "The roadmap has no path from start to goal; build it with more nodes, or plan without it."


@dataclass(frozen=True, kw_only=True)
class QueryResult:
    """Result of one query."""

    status: QueryStatus
    path: Path | None = None
    cost: CostBreakdown = field(default_factory=CostBreakdown)
    """Cost of the path, as of `evaluate`. The search compares edges with coarser samples, at speeds of real motions."""
    goal_index: int | None = None
    """Index of the goal that is reached, among several."""
    detail: str = ""
    """Details of the status, e.g. the pair in contact and its depth, or the joint at its limit."""


@dataclass(frozen=True, eq=False)
class FrontPath:
    """One path of a Pareto front: vertices and costs."""

    q: Float[Array, "n nq"]
    """Vertices [rad or m], from the start to a goal."""
    motion: float
    """Motion cost V."""
    impact: float
    """Impact S."""
