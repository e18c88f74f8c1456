"""How soon the default planner is how close to the best path known, what its parts contribute, and others beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from benchmarks.subjects.planners import references
from graceful_plan.compare import Run
from graceful_plan.compare.reports.summary import gap
from graceful_plan.compare.runs.planner_notes import PlannerNote
from graceful_plan.compare.runs.runner import PlannerJob

TITLE = "The default planner: gap to the best known over time"
OTHERS = ("rrt_star", "informed_rrt_star", "bit_star")
"""Planners of OMPL on the same kernels, for the time to a gap of `CLOSE`."""
CLOSE = 0.05
FASTER = 20.0
WANTED = {(0.3, 50): 0.02, (2.0, 50): 0.005, (1.0, 90): 0.05}
"""Greatest gap by time limit [s] and percentile."""
PARTS = (
    PlannerNote(label="everything", name="auto"),
    PlannerNote(label="one search", name="auto", settings=(("workers", 1),)),
    PlannerNote(label="without roadmaps", name="auto", settings=(("search", gp.Anytime(scouts=False)),)),
    PlannerNote(label="without descents", name="auto", settings=(("search", gp.Anytime(descents=False)),)),
)
"""The default planner, and what is left without some of it; roadmaps need descents."""
MEASURED = """\
Calls of `plan(w=1)` with the footprint model, scenes loaded and compiled before, one call at a time. The gap is how
much the total cost lies above the best known: the lesser of `best_known/` and the best of this very run. Every limit is
a call of its own, verification within it. A call that is not SOLVED counts as an infinite gap.
"""


Runs = Mapping[float, list[Run]]
"""By time limit [s]."""


def run(options: suite.Options) -> str:
    """Run the default at every limit, its parts, and the others."""
    seeds, other_limit = options.pick((10, 5.0), quick=(1, 1.0))
    tasks = suite.task_names(options)
    limits = sorted({limit for limit, _ in WANTED})
    own = [planning.job(task, seed=seed, seconds=limit) for limit in limits for seed in range(seeds) for task in tasks]
    parts = [planning.job(task, part) for part in PARTS for task in tasks]
    others = [planning.job(task, planner, seconds=other_limit) for planner in OTHERS for task in tasks]
    records = _by_limit(own)
    ablation = list(planning.runs(parts, 1, "its parts"))
    slow = list(planning.runs(others, options.processes, "others"))
    found = [*records.items(), (1.0, ablation), (other_limit, slow)]
    best, doubts = references(found, tasks, keep=not options.quick)
    return "\n".join(
        [
            MEASURED,
            "".join(f"- {doubt}\n" for doubt in doubts),
            report.targets(_targets(records, slow, best, other_limit)),
            f"### Gap by task, {seeds} seeds\n",
            _task_table(records, best),
            "### What its parts contribute, time_limit=1.0, 1 seed\n",
            _part_table(ablation, best),
            f"### Time to a gap of {report.percent(CLOSE, 0)}, limit {other_limit:g} s\n",
            _speed_table(records, slow, best),
        ]
    )


def _by_limit(jobs: list[PlannerJob]) -> Runs:
    """Run the default planner; jobs of all limits take part in one row, so that progress is told of all."""
    done = zip(jobs, planning.runs(jobs, 1, "default planner"), strict=True)  # one process keeps the order
    found: dict[float, list[Run]] = {}
    for job, run in done:
        found.setdefault(job.seconds, []).append(run)
    return found


def _gaps(runs: list[Run], best: dict[str, float], task: str | None = None) -> list[float]:
    return [gap(r.total, best[r.problem]) if r.solved else np.inf for r in runs if task in (None, r.problem)]


def _targets(records: Runs, others: list[Run], best: dict[str, float], other_limit: float) -> Iterator[report.Target]:
    for (limit, percentile), wanted in WANTED.items():
        measured = float(np.percentile(_gaps(records[limit], best), percentile))
        what = "median" if percentile == 50 else f"{percentile}th percentile of the"
        yield report.Target(
            what=f"{what} gap, time_limit={limit:g}",
            wanted=f"<= {report.percent(wanted)}",
            measured=report.percent(measured),
            met=measured <= wanted,
        )
    solved = [r.solved for runs in records.values() for r in runs]
    yield report.Target(what="verified", wanted="all", measured=f"{sum(solved)} of {len(solved)}", met=all(solved))
    ratio, bounds = _speed_up(records, others, best, other_limit)
    yield report.Target(
        what=f"time to a gap of {report.percent(CLOSE, 0)}, best of {', '.join(OTHERS)} / default, median of the tasks",
        wanted=f">= {FASTER:g}",
        measured=f"{'at least ' if bounds else ''}{ratio:.3g} ({bounds} tasks where none of them got there)",
        met=ratio >= FASTER,
    )


def _reached(run: Run, best: float) -> float:
    """When a call had a path within `CLOSE` of the best [s]; infinite if never."""
    times = [point.time for point in run.trace if gap(point.total, best) <= CLOSE] if run.solved else []
    return min(times, default=np.inf)


def _own_time(records: Runs, best: float, task: str) -> float:
    """Median over the seeds of the longest calls."""
    return float(np.median([_reached(r, best) for r in records[max(records)] if r.problem == task]))


def _speed_up(records: Runs, others: list[Run], best: dict[str, float], limit: float) -> tuple[float, int]:
    """Median ratio over the tasks, with the limit in place of times that were never reached, and how many those are."""
    ratios, bounds = [], 0
    for task, least in best.items():
        theirs = min(_reached(r, least) for r in others if r.problem == task)
        bounds += not np.isfinite(theirs)
        ratios.append(min(theirs, limit) / _own_time(records, least, task))
    return float(np.median(ratios)), bounds


def _task_table(records: Runs, best: dict[str, float]) -> str:
    rows = []
    for task in best:
        cells = [report.quantity(best[task], digits=5)]
        for runs in records.values():
            gaps = _gaps(runs, best, task)
            cells.append(f"{report.percent(float(np.median(gaps)))} ({report.percent(max(gaps))})")
        rows.append((task, *cells))
    everything = [
        f"{report.percent(float(np.median(_gaps(runs, best))))}, p90 "
        f"{report.percent(float(np.percentile(_gaps(runs, best), 90)))}"
        for runs in records.values()
    ]
    header = ("task", "best known J", *(f"{limit:g} s: median (worst)" for limit in records))
    return report.table(header, [*rows, ("all", "", *everything)])


def _part_table(records: list[Run], best: dict[str, float]) -> str:
    rows = []
    for part in PARTS:
        mine = [r for r in records if r.planner == part.label]
        gaps = _gaps(mine, best)
        at = [
            report.percent(float(np.median([gap(r.total_at(seconds), best[r.problem]) for r in mine])))
            for seconds in (0.1, 0.3)
        ]
        rows.append(
            (part.label, *at, report.percent(float(np.median(gaps))), report.percent(float(np.percentile(gaps, 90))))
        )
    return report.table(("", "median gap at 0.1 s", "at 0.3 s", "in the end", "90th percentile"), rows)


def _speed_table(records: Runs, others: list[Run], best: dict[str, float]) -> str:
    rows = []
    for task, least in best.items():
        theirs = [
            min(_reached(r, least) for r in others if r.problem == task and r.planner == planner) for planner in OTHERS
        ]
        rows.append((task, *(_seconds(value) for value in (_own_time(records, least, task), *theirs))))
    return report.table(("task", "default", *OTHERS), rows)


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if np.isfinite(value) else "never"
