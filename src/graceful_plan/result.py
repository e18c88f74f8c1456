"""What planning returns: statuses, verdicts, cost breakdowns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar

import numpy as np

from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.path import Path
from graceful_plan.timing.trajectory import Trajectory


class PlanStatus(Enum):
    """How planning ended; the value says what to do about it."""

    SOLVED = "A verified trajectory was found."
    INVALID_START = "The start is in collision or outside of the limits; move the robot or fix the scene."
    INVALID_GOAL = "No goal is reachable, free and inside the limits; choose another goal or a looser tolerance."
    TIMEOUT = "The budget ended before a verified trajectory was found; raise the time limit or the iterations."
    INFEASIBLE = "The planner gave up, or there is no path; remove obstacles, choose another goal or another planner."
    CANCELLED = "It was cancelled before a verified trajectory was found; plan again and let it run for longer."
    NONFINITE = "The cost returned a NaN or an infinity; check it with graceful_plan.testing.check_cost."
    RETIMING_FAILED = "A path was found but could not be timed within the limits; relax them or lower the speed."


@dataclass(frozen=True, kw_only=True)
class CostBreakdown:
    """J = motion + w * impact, and where the impact comes from. Pessimistic until computed."""

    motion: float = np.inf
    impact: float = np.inf
    w: float = 1.0
    impact_by_entity: Mapping[str, float] = field(default_factory=dict)
    impact_by_component: Mapping[str, float] = field(default_factory=dict)

    @property
    def total(self) -> float:
        """Motion plus weighted impact."""
        return self.motion + self.w * self.impact if self.w else self.motion


@dataclass(frozen=True, kw_only=True)
class Check:
    """One thing that was verified. Failed until shown otherwise."""

    passed: bool = False
    worst: float = -np.inf
    """The value furthest on the bad side, in the unit that `detail` names."""
    limit: float = 0.0
    first: float | None = None
    """Time [s] (or path length [rad] for a path) of the first violation."""
    detail: str = ""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The independent judge's findings, by name: the motion is verified, its cost only where there is a check "cost".

    `plan` has the cost recomputed for Algorithm 1, `ImpactCost("aabb")`, and for no other model. Whom a base meets who
    moves ("passing_by") rests on a prediction, and people give way: that is a warning, no failure.
    """

    checks: Mapping[str, Check] = field(default_factory=dict)

    WARNS: ClassVar[frozenset[str]] = frozenset({"passing_by"})

    @property
    def passed(self) -> bool:
        """Whether something was checked and nothing failed."""
        return bool(self.checks) and not self.failures

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the checks that did not pass, but for those that warn."""
        return tuple(name for name, check in self.checks.items() if not check.passed and name not in self.WARNS)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Names of the checks that did not pass and warn."""
        return tuple(name for name, check in self.checks.items() if not check.passed and name in self.WARNS)


@dataclass(frozen=True, kw_only=True)
class TracePoint:
    """One improvement: seconds since the call, and the cost of a path as a search charges it, or of a motion."""

    time: float
    total: float
    motion: float
    impact: float


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """What can be promised of a motion; see `certify`. Pessimistic until computed.

    | field          | meaning                                                                | unit         |
    |----------------|------------------------------------------------------------------------|--------------|
    | clearance      | nothing comes closer anywhere, between samples included; proven        | m            |
    | uncertified    | stretches that could not be shown to be free: from and to              | s; path: rad |
    | lower_bound    | no path to a goal is shorter; None if motion is not charged by length  | rad          |
    | gap            | for w = 0: the path may be shortened by at most this, V / bound - 1    |              |
    """

    clearance: float = -np.inf
    uncertified: tuple[tuple[float, float], ...] = ()
    lower_bound: float | None = None
    gap: float | None = None

    @property
    def clear(self) -> bool:
        """Whether the whole motion is proven to be free of collision by the fast checker's spheres."""
        return self.clearance >= 0.0

    @property
    def first_uncertified(self) -> float | None:
        """Where the first stretch begins that could not be shown to be free [s; of a path: rad], if there is one."""
        return self.uncertified[0][0] if self.uncertified else None


@dataclass(frozen=True, kw_only=True)
class PlanResult:
    """The outcome of `plan`."""

    status: PlanStatus
    path: Path | None = None
    """Geometry of the motion: the samples of a smooth one, or the polyline whose corners it cuts."""
    trajectory: Trajectory | None = None
    cost: CostBreakdown = field(default_factory=CostBreakdown)
    """Of the trajectory, as `evaluate` has it; the judge recomputes it only where the verdict has a check "cost"."""
    verdict: Verdict = field(default_factory=Verdict)
    trace: tuple[TracePoint, ...] = ()
    """Improvements of the search, but for those that promised more than the motion has kept, and at last the motion."""
    detail: str = ""
    """What the status means here: the pair in contact and its depth, the joint at its limit..."""
    goal_index: int | None = None
    """Which of several goals was reached."""
    stats: Mapping[str, float] = field(default_factory=dict)
    """Seconds per stage and iterations spent."""

    def unwrap(self) -> Trajectory:
        """Return the trajectory of a solved problem.

        Raises:
            PlanningFailed: With this result, if the status is not SOLVED.
        """
        if self.status is not PlanStatus.SOLVED or self.trajectory is None:
            raise PlanningFailed(self)
        return self.trajectory


class PlanningFailed(GracefulPlanError, RuntimeError):
    """Raised by `PlanResult.unwrap` when there is no trajectory."""

    def __init__(self, result: PlanResult) -> None:
        self.result = result
        super().__init__(
            f"{result.status.name}: {result.status.value}" + (f" ({result.detail})" if result.detail else "")
        )
