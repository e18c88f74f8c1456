"""Statistics of calls of `plan` by kind of problem: refusals, times to path and motion, lateness, lengths."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from graceful_plan.compare.runs.comparison import Comparison
from graceful_plan.compare.runs.records import Run
from graceful_plan.result import PlanStatus

ALL = "all"
_REFUSED = (PlanStatus.INVALID_START.name, PlanStatus.INVALID_GOAL.name)
_NO_CALL = "analytic"
"""Kind of the analytic problems, which are solved without a call of `plan`."""


@dataclass(frozen=True, kw_only=True)
class CallSummary:
    """Statistics of a planner's calls on one kind of problem; medians take the worse of two middle values.

    | field       | meaning                                                                              |
    |-------------|--------------------------------------------------------------------------------------|
    | group       | kind of problem; `ALL` for all together                                              |
    | planner     | label of the planner                                                                 |
    | runs        | number of calls                                                                      |
    | solved      | number of calls with a verified motion                                               |
    | refused     | number of calls with an invalid start or goal                                        |
    | search      | median time until the first path [s]                                                 |
    | motion_wall | median time of a call that ends with its first path, to its verified motion [s]      |
    | motion_cpu  | the same in processor time [s]                                                       |
    | slow        | the same in processor time, 95th percentile [s]                                      |
    | over        | 99th percentile of how long after its time limit a call returned [s]; negative: before |
    | most_over   | the longest [s]                                                                      |
    | early       | median motion cost of the best path by the times `EARLY`; infinite: none             |
    """

    group: str
    planner: str
    runs: int
    solved: int
    refused: int
    search: float
    motion_wall: float
    motion_cpu: float
    slow: float
    over: float
    most_over: float
    early: tuple[float, ...]


def call_summaries(comparison: Comparison) -> tuple[CallSummary, ...]:
    """Summarise calls by kind of problem and planner, then all kinds together."""
    kinds = [kind for kind in dict.fromkeys(comparison.groups.values()) if kind != _NO_CALL]
    rows = [row for kind in kinds for row in _of_kind(comparison, kind, (kind,))]
    return (*rows, *_of_kind(comparison, ALL, kinds)) if len(kinds) > 1 else tuple(rows)


def _of_kind(comparison: Comparison, name: str, kinds: Sequence[str]) -> Iterator[CallSummary]:
    for planner in comparison.planners:
        runs = [run for run in comparison.of(planner=planner) if comparison.groups.get(run.problem) in kinds]
        if runs:
            yield _summary(name, planner, runs, comparison)


def _summary(group: str, planner: str, runs: Sequence[Run], comparison: Comparison) -> CallSummary:
    over = [run.seconds - comparison.seconds for run in runs if math.isfinite(run.seconds)]
    motions = [run.motion_cpu for run in runs if not math.isnan(run.motion_cpu)]
    walls = [run.motion_wall for run in runs if not math.isnan(run.motion_wall)]
    return CallSummary(
        group=group,
        planner=planner,
        runs=len(runs),
        solved=sum(run.solved for run in runs),
        refused=sum(run.status in _REFUSED for run in runs),
        search=_share([run.first if run.solved else math.inf for run in runs], 0.5),
        motion_wall=_share(walls, 0.5),
        motion_cpu=_share(motions, 0.5),
        slow=_share(motions, 0.95),
        over=_share(over, 0.99),
        most_over=max(over, default=math.nan),
        early=tuple(_share(column, 0.5) for column in zip(*(run.early for run in runs if run.early), strict=True)),
    )


def _share(values: Sequence[float], share: float) -> float:
    """Return a quantile without interpolation, the upper of two values, so that infinity remains; NaN if empty."""
    return sorted(values)[math.ceil(share * (len(values) - 1) - 1e-9)] if len(values) else math.nan
