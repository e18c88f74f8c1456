"""How soon the default planner is how close to the best path known, what its parts contribute, and others beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from benchmarks.planning import Job, Record
from benchmarks.subjects.planners import gap, references

TITLE = "The default planner: gap to the best known over time"
OTHERS = ("rrt_star", "informed_rrt_star", "bit_star")
"""Planners of OMPL on the same kernels, for the time to a gap of `CLOSE`."""
CLOSE = 0.05
FASTER = 20.0
WANTED = {(0.3, 50): 0.02, (2.0, 50): 0.005, (1.0, 90): 0.05}
"""Greatest gap by time limit [s] and percentile."""
PARTS = {
    "everything": gp.Auto(),
    "one search": gp.Auto(workers=1),
    "without roadmaps": gp.Auto(search=gp.Anytime(scouts=False)),
    "without descents": gp.Auto(search=gp.Anytime(descents=False)),
}
"""The default planner, and what is left without some of it; roadmaps need descents."""
MEASURED = """\
Calls of `plan(w=1)` with the footprint model, scenes loaded and compiled before, one call at a time. The gap is how
much the total cost lies above the best known: the lesser of `best_known/` and the best of this very run. Every limit is
a call of its own, verification within it. A call that is not SOLVED counts as an infinite gap.
"""


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How many runs of what."""

    seeds: int
    part_seeds: int
    other_seeds: int
    other_limit: float


FULL = Sizes(seeds=10, part_seeds=1, other_seeds=1, other_limit=5.0)
QUICK = Sizes(seeds=1, part_seeds=1, other_seeds=1, other_limit=1.0)


def run(options: suite.Options) -> str:
    """Run the default at every limit, its parts, and the others."""
    sizes = QUICK if options.quick else FULL
    tasks = suite.task_names(options)
    limits = sorted({limit for limit, _ in WANTED})
    own = [
        Job(task=task, seed=seed, time_limit=limit) for limit in limits for seed in range(sizes.seeds) for task in tasks
    ]
    parts = [
        Job(task=task, planner=part, seed=seed, time_limit=1.0)
        for part in PARTS
        for seed in range(sizes.part_seeds)
        for task in tasks
    ]
    others = [
        Job(task=task, planner=planner, seed=seed, time_limit=sizes.other_limit)
        for planner in OTHERS
        for seed in range(sizes.other_seeds)
        for task in tasks
    ]
    records = list(suite.spread(planning.run, own, 1, "default planner"))
    ablation = list(suite.spread(_run_part, parts, 1, "its parts"))
    slow = list(suite.spread(planning.run, others, options.processes, "others"))
    best, doubts = references([*records, *ablation, *slow], tasks, keep=not options.quick)
    return "\n".join(
        [
            MEASURED,
            "".join(f"- {doubt}\n" for doubt in doubts),
            report.targets(_targets(records, slow, best)),
            f"### Gap by task, {sizes.seeds} seeds\n",
            _task_table(records, best, limits),
            f"### What its parts contribute, time_limit=1.0, {sizes.part_seeds} seeds\n",
            _part_table(ablation, best),
            f"### Time to a gap of {report.percent(CLOSE, 0)}, limit {sizes.other_limit:g} s\n",
            _speed_table(records, slow, best),
        ]
    )


def _run_part(job: Job) -> Record:
    found = planning.run(replace(job, planner=PARTS[job.planner]))
    return replace(found, job=job)


def _gaps(records: list[Record], best: dict[str, float], limit: float, task: str | None = None) -> list[float]:
    return [
        gap(r.total, best[r.job.task]) if r.solved else np.inf
        for r in records
        if r.job.time_limit == limit and task in (None, r.job.task)
    ]


def _targets(records: list[Record], others: list[Record], best: dict[str, float]) -> Iterator[report.Target]:
    for (limit, percentile), wanted in WANTED.items():
        measured = float(np.percentile(_gaps(records, best, limit), percentile))
        what = "median" if percentile == 50 else f"{percentile}th percentile of the"
        yield report.Target(
            what=f"{what} gap, time_limit={limit:g}",
            wanted=f"<= {report.percent(wanted)}",
            measured=report.percent(measured),
            met=measured <= wanted,
        )
    solved = sum(r.solved for r in records)
    yield report.Target(
        what="verified", wanted="all", measured=f"{solved} of {len(records)}", met=solved == len(records)
    )
    ratio, bounds = _speed_up(records, others, best)
    yield report.Target(
        what=f"time to a gap of {report.percent(CLOSE, 0)}, best of {', '.join(OTHERS)} / default, median of the tasks",
        wanted=f">= {FASTER:g}",
        measured=f"{'at least ' if bounds else ''}{ratio:.3g} ({bounds} tasks where none of them got there)",
        met=ratio >= FASTER,
    )


def _reached(record: Record, best: float) -> float:
    """When a call had a path within `CLOSE` of the best [s]; infinite if never."""
    times = [at for at, total in record.trace if gap(total, best) <= CLOSE] if record.solved else []
    return min(times, default=np.inf)


def _own_time(records: list[Record], best: float, task: str) -> float:
    """Median over the seeds of the longest calls."""
    longest = max(limit for limit, _ in WANTED)
    return float(np.median([_reached(r, best) for r in records if r.job.task == task and r.job.time_limit == longest]))


def _speed_up(records: list[Record], others: list[Record], best: dict[str, float]) -> tuple[float, int]:
    """Median ratio over the tasks, with the limit in place of times that were never reached, and how many those are."""
    ratios, bounds = [], 0
    for task, least in best.items():
        theirs = min(_reached(r, least) for r in others if r.job.task == task)
        limit = max(r.job.time_limit for r in others)
        bounds += not np.isfinite(theirs)
        ratios.append(min(theirs, limit) / _own_time(records, least, task))
    return float(np.median(ratios)), bounds


def _task_table(records: list[Record], best: dict[str, float], limits: list[float]) -> str:
    rows = []
    for task in best:
        cells = [report.quantity(best[task], digits=5)]
        for limit in limits:
            gaps = _gaps(records, best, limit, task)
            cells.append(f"{report.percent(float(np.median(gaps)))} ({report.percent(max(gaps))})")
        rows.append((task, *cells))
    everything = [
        f"{report.percent(float(np.median(_gaps(records, best, limit))))}, p90 "
        f"{report.percent(float(np.percentile(_gaps(records, best, limit), 90)))}"
        for limit in limits
    ]
    header = ("task", "best known J", *(f"{limit:g} s: median (worst)" for limit in limits))
    return report.table(header, [*rows, ("all", "", *everything)])


def _part_table(records: list[Record], best: dict[str, float]) -> str:
    rows = []
    for part in PARTS:
        mine = [r for r in records if r.job.planner == part]
        gaps = _gaps(mine, best, 1.0)
        at = [
            report.percent(float(np.median([gap(r.total_at(seconds), best[r.job.task]) for r in mine])))
            for seconds in (0.1, 0.3)
        ]
        rows.append((part, *at, report.percent(float(np.median(gaps))), report.percent(float(np.percentile(gaps, 90)))))
    return report.table(("", "median gap at 0.1 s", "at 0.3 s", "in the end", "90th percentile"), rows)


def _speed_table(records: list[Record], others: list[Record], best: dict[str, float]) -> str:
    rows = []
    for task, least in best.items():
        theirs = [
            min(_reached(r, least) for r in others if r.job.task == task and r.job.planner == planner)
            for planner in OTHERS
        ]
        rows.append((task, *(_seconds(value) for value in (_own_time(records, least, task), *theirs))))
    return report.table(("task", "default", *OTHERS), rows)


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if np.isfinite(value) else "never"
