"""Summary of a comparison: gaps to the best-known cost, over time and at the end, by planner and problem."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.compare.reports.calls import CallSummary, call_summaries
from graceful_plan.compare.reports.statistics import Paired, compare_all
from graceful_plan.compare.runs.comparison import Comparison
from graceful_plan.compare.runs.records import Run

Array = np.ndarray

CHECKPOINTS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
"""Times of tabulated gaps [s], up to the time limit."""
LATE = (1.1, 0.1)
"""A call is late if it exceeds its limit by this factor and by this many seconds."""
GRID = 120
"""Number of points of curves over time."""


@dataclass(frozen=True, kw_only=True)
class PlannerSummary:
    """Results of a planner. Medians over its runs take the worse of two middle values, so that failures show.

    | field     | meaning                                                                                 |
    |-----------|-----------------------------------------------------------------------------------------|
    | planner   | label                                                                                   |
    | runs      | number of runs                                                                          |
    | solved    | number of runs with a verified result                                                   |
    | outcomes  | number of runs by status                                                                |
    | first     | median time to the first path [s]; unsolved runs count as infinite                      |
    | seconds   | median time of the whole call, until the verified result [s]                            |
    | slowest   | longest call [s]                                                                        |
    | late      | number of late calls, see `LATE`                                                        |
    | gap       | median gap of the result to the best known                                              |
    | gap_at    | median gap of the best path at a time, by seconds                                       |
    | motion    | median over problems of the motion cost over the best known total                       |
    | impact    | median over problems of the weighted impact over the best known total                   |
    | jerk_peak | median of the peak waypoint jerk of solved runs [rad/s^3]                               |
    | jerk_rms  | median of its root mean square [rad/s^3]                                                |
    | duration  | median duration of the trajectories of solved runs [s]                                  |
    | clearance | median clearance of solved runs [m]                                                     |
    | closest   | least clearance of all solved runs [m]                                                  |
    """

    planner: str
    runs: int
    solved: int
    outcomes: Mapping[str, int]
    first: float
    seconds: float
    slowest: float
    late: int
    gap: float
    gap_at: Mapping[str, float]
    motion: float
    impact: float
    jerk_peak: float
    jerk_rms: float
    duration: float
    clearance: float
    closest: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Summary:
    """Statistics for a report.

    Args:
        comparison: The comparison.
        best: Best-known total cost of each problem; infinite if it was never solved.
        planners: Results by planner, in the order of the comparison.
        pairs: Every pair of planners, pairs with the reference first.
        calls: Statistics of calls by kind of problem.
    """

    comparison: Comparison
    best: Mapping[str, float]
    planners: tuple[PlannerSummary, ...]
    pairs: tuple[Paired, ...]
    calls: tuple[CallSummary, ...] = ()

    def to_document(self) -> dict[str, Any]:
        """Return the summary as a dictionary for JSON."""
        comparison = self.comparison
        return {
            "schema": "graceful_plan.bench.summary",
            "version": 1,
            "suite": comparison.suite,
            "seconds": comparison.seconds,
            "w": comparison.w,
            "seeds": list(comparison.seeds),
            "machine": dict(comparison.machine),
            "runs": len(comparison.runs),
            "expected": comparison.expected,
            "best_known": dict(self.best),
            "planners": [asdict(planner) for planner in self.planners],
            "pairs": [asdict(pair) for pair in self.pairs],
            "calls": [asdict(row) for row in self.calls],
        }


def summarise(comparison: Comparison) -> Summary:
    """Compute gaps and statistics of all finished runs."""
    best = best_known(comparison)
    return Summary(
        comparison=comparison,
        best=best,
        planners=tuple(_of_planner(comparison, planner, best) for planner in comparison.planners),
        pairs=compare_all(comparison.planners, problem_costs(comparison)),
        calls=call_summaries(comparison),
    )


def best_known(comparison: Comparison) -> dict[str, float]:
    """Return the best-known total cost of each problem, from all runs and from earlier knowledge."""
    return {
        problem: min(
            [
                comparison.known.get(problem, math.inf),
                *(run.total for run in comparison.of(problem=problem) if run.solved),
            ]
        )
        for problem in comparison.problems
    }


def gap(total: float, best: float) -> float:
    """Compute the relative excess of a total over the best-known one (absolute if that is 0); may be infinite."""
    return float(_gaps(np.array([total]), best)[0])


def gaps_at(runs: Sequence[Run], best: Mapping[str, float], times: Sequence[float]) -> Float[Array, "time run"]:
    """Return the gap of every run's best path at each time."""
    found = [_gaps(run.totals_at(times), best[run.problem]) for run in runs]
    return np.array(found).reshape(len(runs), len(times)).T


def _gaps(totals: Float[Array, " n"], best: float) -> Float[Array, " n"]:
    if not math.isfinite(best):
        return np.full(len(totals), np.inf)
    return totals / best - 1.0 if best > 0.0 else totals


def time_grid(comparison: Comparison) -> Float[Array, " time"]:
    """Return times for curves [s], log-spaced from the first path of any run to the limit."""
    firsts = [run.first for run in comparison.runs if 0.0 < run.first < comparison.seconds]
    begin = max(1e-4, min([*firsts, 0.1 * comparison.seconds]))
    return np.geomspace(begin, comparison.seconds, GRID)


def gap_curve(
    comparison: Comparison, planner: str, best: Mapping[str, float], times: Float[Array, " time"]
) -> Float[Array, "quartile time"]:
    """Return the lower quartile, median and upper quartile of the gaps of a planner's runs over time."""
    runs = comparison.of(planner=planner)
    if not runs:
        return np.full((3, len(times)), np.inf)
    gaps = gaps_at(runs, best, times.tolist())
    return np.array([quantile(gaps, share) for share in (0.25, 0.5, 0.75)])


def solved_curve(comparison: Comparison, planner: str, times: Float[Array, " time"]) -> Float[Array, " time"]:
    """Return the share of a planner's runs with a path at each time and a verified result at the end."""
    runs = comparison.of(planner=planner)
    first = np.array([run.first if run.solved else np.inf for run in runs])
    return (first[None] <= times[:, None]).mean(axis=1) if runs else np.zeros(len(times))


def quantile(values: Float[Array, "n m"], share: float) -> Float[Array, " n"]:
    """Compute quantiles of rows without interpolation, the upper of two values, so that infinity remains."""
    ordered = np.sort(values, axis=1)
    return ordered[:, math.ceil(share * (ordered.shape[1] - 1) - 1e-9)]


def median(values: Sequence[float]) -> float:
    """Compute the median as the greater of two middle values; NaN if empty."""
    return float(quantile(np.array([values], dtype=float), 0.5)[0]) if len(values) else math.nan


def problem_costs(comparison: Comparison) -> Float[Array, "planner problem"]:
    """Return the median over seeds of the total cost; infinite if most seeds are unsolved or missing."""
    return np.array(
        [
            [
                median([run.total if run.solved else math.inf for run in runs]) if runs else math.inf
                for problem in comparison.problems
                for runs in [comparison.of(planner=planner, problem=problem)]
            ]
            for planner in comparison.planners
        ]
    ).reshape(len(comparison.planners), len(comparison.problems))


def shares(comparison: Comparison, best: Mapping[str, float], planner: str) -> Float[Array, "problem 2"]:
    """Return motion and weighted impact over the best-known total of solved problems, as medians over solved seeds."""
    found = []
    for problem in comparison.problems:
        runs = [run for run in comparison.of(planner=planner, problem=problem) if run.solved]
        if runs and 0.0 < best[problem] < math.inf:
            middle = sorted(runs, key=lambda run: run.total)[len(runs) // 2]
            found.append((middle.motion / best[problem], comparison.w * middle.impact / best[problem]))
    return np.array(found).reshape(-1, 2)


def _of_planner(comparison: Comparison, planner: str, best: Mapping[str, float]) -> PlannerSummary:
    runs = comparison.of(planner=planner)
    solved = [run for run in runs if run.solved]
    motion, impact = (median(column.tolist()) for column in shares(comparison, best, planner).T)
    clearances = _finite(run.clearance for run in solved)
    seconds = _finite(run.seconds for run in runs)
    at = [time for time in CHECKPOINTS if time < comparison.seconds]
    return PlannerSummary(
        planner=planner,
        runs=len(runs),
        solved=len(solved),
        outcomes=dict(Counter(run.status for run in runs)),
        first=median([run.first if run.solved else math.inf for run in runs]),
        seconds=median(seconds),
        slowest=max(seconds, default=math.nan),
        late=sum(value > LATE[0] * comparison.seconds + LATE[1] for value in seconds),
        gap=median([gap(run.total if run.solved else math.inf, best[run.problem]) for run in runs]),
        gap_at={f"{time:g}": median(gaps.tolist()) for time, gaps in zip(at, gaps_at(runs, best, at), strict=True)},
        motion=motion,
        impact=impact,
        jerk_peak=median(_finite(run.jerk_peak for run in solved)),
        jerk_rms=median(_finite(run.jerk_rms for run in solved)),
        duration=median(_finite(run.duration for run in solved)),
        clearance=median(clearances),
        closest=min(clearances, default=math.nan),
    )


def _finite(values: Any) -> list[float]:
    return [value for value in values if math.isfinite(value)]
