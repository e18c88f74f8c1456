"""Results of planning: statuses, verdicts and cost breakdowns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar

import numpy as np

from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.path import Path
from graceful_plan.timing.prepared_stops import PreparedStops
from graceful_plan.timing.trajectory import Trajectory

_WORST = 4
"""Number of entities that a printed result names, the most harmed first."""


class PlanStatus(Enum):
    """Outcome of planning; each value is a sentence with a remedy."""

    SOLVED = "A verified trajectory was found."
    INVALID_START = "The start is in collision or outside the limits; move the robot or fix the scene."
    INVALID_GOAL = "No goal is reachable, free and inside the limits; choose another goal or a looser tolerance."
    TIMEOUT = "No verified trajectory was found; raise the time limit or the iterations, or choose another planner."
    INFEASIBLE = "There is no such motion; remove obstacles, choose another goal or another kind of motion."
    CANCELLED = "Planning was cancelled before a verified trajectory was found; plan again and let it run longer."
    NONFINITE = "The cost returned a NaN or an infinity; check it with graceful_plan.testing.check_cost."
    RETIMING_FAILED = "A path was found but could not be timed within the limits; relax them or lower the speed."


@dataclass(frozen=True, kw_only=True)
class CostBreakdown:
    """Total cost J = motion + w * impact, and the impact by entity and component. Infinite by default.

    | field               | meaning                                                                | unit         |
    |---------------------|------------------------------------------------------------------------|--------------|
    | motion              | V: joint-space length, or the objective's motion cost                  | rad          |
    | impact              | integral over time of the severity expected if the robot failed then   | severity s   |
    | w                   | the safety weight of the call                                          | rad/(severity s) |
    | impact_by_entity    | by entity; other costs in a sum with `ImpactCost` by their class       | severity s   |
    | impact_by_component | by component of the robot: "body", "carried", "contents"               | severity s   |
    | exposure            | variable of the integral; "length" gives severity rad, "waypoints" severity | |
    """

    motion: float = np.inf
    impact: float = np.inf
    w: float = 1.0
    impact_by_entity: Mapping[str, float] = field(default_factory=dict)
    impact_by_component: Mapping[str, float] = field(default_factory=dict)
    exposure: str = field(default="time", compare=False)

    @property
    def impact_unit(self) -> str:
        """Unit of the impact."""
        return {"time": "severity s", "length": "severity rad"}.get(self.exposure, "severity")

    @property
    def total(self) -> float:
        """Motion plus weighted impact."""
        return self.motion + self.w * self.impact if self.w else self.motion


@dataclass(frozen=True, kw_only=True)
class Check:
    """Outcome of one check of the judge. Failed by default."""

    passed: bool = False
    worst: float = -np.inf
    """Worst value along the motion, in the unit that `detail` names."""
    limit: float = 0.0
    first: float | None = None
    """Time of the first violation [s]; for a path, the path length there [rad]."""
    detail: str = ""

    def __str__(self) -> str:
        """Say first whether the check passed."""
        since = "" if self.first is None else f" from {self.first:.4g} on"
        return f"{'passed' if self.passed else f'failed{since}'}: {self.detail}"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Checks of the independent judge, by name.

    The motion is always verified, its cost only if there is a check "cost": `plan` has it recomputed for Algorithm 1,
    `ImpactCost("box_overlap")`, and for no other model. The check "passing_by" of a robot that comes near
    moving entities only warns: it relies on a prediction, and people give way. So does "torque": masses of models are
    often rough. The constraint `TorqueWithin` adds a check that fails. "stops" of `plan(stoppable=True)` warns, too.
    """

    checks: Mapping[str, Check] = field(default_factory=dict)

    WARNS: ClassVar[frozenset[str]] = frozenset({"passing_by", "stops", "torque"})

    @property
    def passed(self) -> bool:
        """Whether there are checks and none of them failed."""
        return bool(self.checks) and not self.failures

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the checks that did not pass, without those in `WARNS`."""
        return tuple(name for name, check in self.checks.items() if not check.passed and name not in self.WARNS)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Names of the checks in `WARNS` that did not pass."""
        return tuple(name for name, check in self.checks.items() if not check.passed and name in self.WARNS)


@dataclass(frozen=True, kw_only=True)
class TracePoint:
    """An improvement: its time in the call, and the estimated cost of a path or the cost of a timed motion.

    Times count as the time limit does: from the start of the call, by default without compiling the scene [s].
    """

    time: float
    total: float
    motion: float
    impact: float


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Proven bounds on a motion; see `certify`. Pessimistic by default.

    | field          | meaning                                                                | unit         |
    |----------------|------------------------------------------------------------------------|--------------|
    | clearance      | proven lower bound of the clearance, also between samples              | m            |
    | uncertified    | start and end of stretches that are not proven to be free              | s; path: rad |
    | lower_bound    | lower bound of the length to a goal; None if motion cost is not length | rad          |
    | gap            | for w = 0: upper bound of the possible saving, V / lower_bound - 1     |              |
    """

    clearance: float = -np.inf
    uncertified: tuple[tuple[float, float], ...] = ()
    lower_bound: float | None = None
    gap: float | None = None

    @property
    def clear(self) -> bool:
        """Whether the fast checker's spheres prove the whole motion to be free of collision."""
        return self.clearance >= 0.0

    @property
    def first_uncertified(self) -> float | None:
        """Start of the first stretch that is not proven to be free [s; for a path: rad]; None if there is none."""
        return self.uncertified[0][0] if self.uncertified else None


@dataclass(frozen=True, kw_only=True)
class PlanResult:
    """The outcome of `plan`."""

    status: PlanStatus
    path: Path | None = None
    """Geometry: samples of a smooth motion, or the polyline whose corners the motion rounds."""
    trajectory: Trajectory | None = None
    cost: CostBreakdown = field(default_factory=CostBreakdown)
    """Cost of the trajectory, as of `evaluate`; the judge recomputes it only if the verdict has a check "cost"."""
    verdict: Verdict = field(default_factory=Verdict)
    trace: tuple[TracePoint, ...] = ()
    """Improvements during the call, the returned motion last; paths estimated at less than its cost are left out."""
    detail: str = ""
    """Details of the status, e.g. the pair in contact and its depth, or the joint at its limit."""
    goal_index: int | None = None
    """Index of the goal that is reached, among several."""
    candidates: tuple[PlanResult, ...] = ()
    """Distinct verified motions that the call has found: this one first, then by cost; empty unless `plan` was asked
    for several."""
    stats: Mapping[str, float] = field(default_factory=dict)
    """Statistics of the call, such as seconds per stage and iterations."""
    stops: PreparedStops | None = None
    """Stops along the trajectory, with `plan(stoppable=True)`."""

    def __str__(self) -> str:
        """Describe the outcome in a few lines."""
        lines = [f"{self.status.name}: {self.status.value}", *([self.detail] if self.detail else [])]
        if self.trajectory is not None:
            goal = "" if self.goal_index is None else f", goal {self.goal_index}"
            lines.append(f"motion: {self.trajectory.duration:.3g} s, {len(self.trajectory)} samples{goal}")
            cost = self.cost
            parts = f"motion {cost.motion:.4g} rad + w {cost.w:g} x impact {cost.impact:.4g} {cost.impact_unit}"
            lines.append(f"J = {cost.total:.4g} rad = {parts}")
            if self.trajectory.duration > 0.0 and np.isfinite(cost.impact) and cost.exposure == "time":
                mean = cost.impact / self.trajectory.duration
                lines.append(f"a failure at a random moment does harm of severity {mean:.3g} on average")
            worst = sorted(cost.impact_by_entity.items(), key=lambda item: -item[1])[:_WORST]
            if harmed := [f"{name} {value:.3g}" for name, value in worst if value > 0.0]:
                lines.append(f"impact by entity [{cost.impact_unit}]: {', '.join(harmed)}")
        if self.candidates:
            costs = ", ".join(f"{candidate.cost.total:.4g}" for candidate in self.candidates)
            lines.append(f"{len(self.candidates)} distinct motions, J = {costs} rad")
        for name in (*self.verdict.failures, *self.verdict.warnings):
            word = "failed" if name in self.verdict.failures else "warning"
            lines.append(f"{word}: {name}: {self.verdict.checks[name].detail}")
        if self.verdict.passed:
            lines.append(f"checks passed: {', '.join(name for name, c in self.verdict.checks.items() if c.passed)}")
        if "total_time" in self.stats:
            first = f", first motion after {self.trace[0].time:.3g} s" if self.trace else ""
            lines.append(f"call: {self.stats['total_time']:.3g} s{first}")
        return "\n".join(lines)

    def unwrap(self) -> Trajectory:
        """Return the trajectory of a solved problem.

        Raises:
            PlanningFailed: If the status is not SOLVED; it carries this result.
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
