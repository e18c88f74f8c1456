"""Results of `plan_job`: steps with their motions, cost and lower bound, and comparisons with other orders."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from graceful_plan.exceptions import GracefulPlanError, SettingError
from graceful_plan.job.motions import JobMotion
from graceful_plan.job.rejected import Rejected, change
from graceful_plan.result import CostBreakdown, TracePoint

_STAY = ("pick", "wait", "open", "close", "pour")
"""Kinds of steps that put no object down elsewhere."""


class JobStatus(Enum):
    """Outcome of `plan_job`; each value is a sentence with a remedy."""

    SOLVED = "A sequence that meets all goals was found."
    INFEASIBLE = "No sequence of the allowed actions meets all goals; allow more actions, grasps or placements."
    TIMEOUT = "No sequence was found in time; raise the time limit or the iterations."
    CANCELLED = "Planning was cancelled before a sequence was found."


class JobFailed(GracefulPlanError, RuntimeError):
    """Raised by `JobResult.unwrap` when there is no sequence."""

    def __init__(self, result: JobResult) -> None:
        self.result = result
        super().__init__(f"{result.status.name}: {result.status.value} {result.detail}".strip())


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """A step of a job.

    Its kind is "pick", "place", "clear", "close_lid", "load", "carry" (a tray), "wait", "open", "close", "pour" or that
    of an own action.

    | field  | meaning                                                   |
    |--------|-----------------------------------------------------------|
    | kind   | kind of action                                            |
    | name   | the object                                                |
    | pieces | motions with their scenes, one after the other            |
    | cost   | their total cost                                          |
    """

    kind: str
    name: str
    pieces: tuple[JobMotion, ...]
    cost: CostBreakdown

    @property
    def duration(self) -> float:
        """Time that the step takes [s]."""
        return sum(piece.trajectory.duration for piece in self.pieces)

    def __str__(self) -> str:
        worst = max(self.cost.impact_by_entity.items(), key=lambda item: item[1], default=("", 0.0))
        harm = f", most to {worst[0]}" if worst[1] > 0.0 else ""
        return (
            f"{self.kind} {self.name}: {self.duration:.1f} s, cost {self.cost.total:.3g} "
            f"(motion {self.cost.motion:.3g} rad, impact {self.cost.impact:.3g}{harm})"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class JobResult:
    """Result of `plan_job`. Without a solution it has no steps, and its cost is infinite.

    `lower_bound` bounds the cost of every sequence over the same grasps, placements and configurations. It counts the
    straight motions at both ends of each transport with their harm, and straight lines in joint space between them;
    with moving entities and with actions of one's own, only the lines.

    `stats` are the seconds spent on grasps, "stances" (configurations and straight motions), "checks" (verifying and
    pricing straight motions), "plan", which are the calls of `plan`, and "search", which is the rest of "total_time",
    and the number of planned "actions".
    """

    status: JobStatus
    steps: tuple[Step, ...] = ()
    cost: CostBreakdown = field(default_factory=CostBreakdown)
    lower_bound: float = 0.0
    exhaustive: bool = False
    """Whether all sequences over the choices at hand were compared."""
    detail: str = ""
    """Why there is no solution; of a solved job, the things so close that a healthy arm may touch them."""
    trace: tuple[TracePoint, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    """Other orders and actions that the search rejected, and why: the complete ones first, the cheapest first."""
    stats: Mapping[str, float] = field(default_factory=dict)
    again: Callable[..., JobResult] | None = field(default=None, repr=False)
    """Plans the same job once more with other limits and in a given order; see `why`."""

    @property
    def gap(self) -> float:
        """Largest share by which a sequence over the same choices may be cheaper; infinite without a solution."""
        return 1.0 - self.lower_bound / self.cost.total if self.steps else float("inf")

    @property
    def order(self) -> tuple[str, ...]:
        """Names of the objects in the order in which they are put down."""
        return tuple(step.name for step in self.steps if step.kind not in _STAY)

    @property
    def duration(self) -> float:
        """Time that the whole job takes [s]."""
        return sum((step.duration for step in self.steps), 0.0)

    def unwrap(self) -> tuple[Step, ...]:
        """Return the steps of a solved job.

        Raises:
            JobFailed: If the status is not SOLVED.
        """
        if self.status is not JobStatus.SOLVED:
            raise JobFailed(self)
        return self.steps

    def why(
        self, *, order: Sequence[str], time_limit: float | None = None, iterations: int | None = None
    ) -> OrderComparison:
        """Plan the job with its goals met in another order, and compare.

        Args:
            order: Names of goal objects; other goals may be met at any time.
            time_limit: As in `plan_job`; 5 s by default.
            iterations: As in `plan_job`.

        Raises:
            SettingError: If this result comes from no call of `plan_job`.
            UnknownNameError: If a name is no goal of the job.
        """
        if self.again is None:
            raise SettingError("result", self, "a result of plan_job")
        limit = 5.0 if time_limit is None and iterations is None else time_limit
        other = self.again(limit, iterations, None, tuple(order))
        return OrderComparison(chosen=self, other=other, order=tuple(order))

    def __str__(self) -> str:
        if self.status is not JobStatus.SOLVED:
            return f"{self.status.name}: {self.status.value} {self.detail}".strip()
        gap = "compared with all sequences" if self.exhaustive else f"at least {self.lower_bound:.3g} is needed"
        head = f"cost {self.cost.total:.3g} ({gap}), {self.duration:.1f} s"
        detail = [f"  {self.detail}"] if self.detail else []
        return "\n".join([head, *(f"  {step}" for step in self.steps), *detail, *self._times()])

    def _times(self) -> list[str]:
        """Return a line with the shares of the planning time."""
        total = self.stats.get("total_time", 0.0)
        if not total > 0.0:
            return []
        parts = ("grasps", "stances", "checks", "plan", "search")
        told = ", ".join(f"{part} {100.0 * self.stats[part] / total:.0f} %" for part in parts)
        return [f"  planned in {total:.1f} s: {told}"]


@dataclass(frozen=True, kw_only=True, eq=False)
class OrderComparison:
    """A job with its goals met in another order, beside the sequence that was chosen."""

    chosen: JobResult
    other: JobResult
    order: tuple[str, ...]

    @property
    def difference(self) -> float:
        """How much more the other order costs; infinite if it was not found to be possible."""
        return self.other.cost.total - self.chosen.cost.total

    def __str__(self) -> str:
        asked = ", ".join(self.order)
        if self.other.status is not JobStatus.SOLVED:
            return f"order {asked}: {self.other}"
        return (
            f"order {asked}: cost {self.other.cost.total:.3g} instead of {self.chosen.cost.total:.3g}; "
            f"{change(self.other.cost, self.chosen.cost)}"
        )
