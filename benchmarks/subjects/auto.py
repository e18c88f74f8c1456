"""Gap of the default planner to the best-known cost over time, contribution of its parts, and other planners."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from benchmarks.subjects.planners import references
from graceful_plan.compare import Run
from graceful_plan.compare.reports.summary import gap
from graceful_plan.compare.runs.planner_specs import PlannerSpec
from graceful_plan.compare.runs.runner import PlannerJob

TITLE = "The default planner: gap to the best known over time"
QUESTION = "How close to the best-known cost is the default planner over time, and how much do its parts contribute?"
HEADLINE = "median gap, time_limit=0.3"
DEPENDS_ON = (*suite.PLANNING, "benchmarks/planning.py", "benchmarks/best_known")
OTHERS, LONG_OTHERS = ("rrt_star", "bit_star"), ("rrt_star", "informed_rrt_star", "bit_star")
"""Planners to compare with, on the same kernels and with more time, in normal and long runs; at w = 1, the informed
`rrt_star` finds the motions of the other."""
OTHERS_WITHIN, OTHERS_TASKS = 0.3, 20
"""Target for the first of them: gap, and number of tasks with at most this gap."""
WANTED = {(0.3, 50): 0.02, (2.0, 50): 0.005, (1.0, 90): 0.05}
"""Largest gap by time limit [s] and percentile."""
PARTS = (
    PlannerSpec(label="everything", name="auto", refine=True),
    PlannerSpec(label="one search", name="auto", refine=True, settings=(("workers", 1),)),
    PlannerSpec(label="without roadmaps", name="auto", refine=True, settings=(("search", gp.Anytime(scouts=False)),)),
    PlannerSpec(label="without descents", name="auto", refine=True, settings=(("search", gp.Anytime(descents=False)),)),
)
"""The default planner with all parts, and without some; roadmaps need descents."""
MEASURED = """\
Calls of `plan(w=1)` with the footprint model, one at a time, with scenes loaded and compiled before. "Gap": relative
excess of the total cost over the best known, which is the lesser of `best_known/` and the best of this run. Every time
limit is a separate call that includes verification. A call that is not SOLVED counts as an infinite gap. Calls of 1 s
that `planners` has made in the same process are not repeated.
"""


Runs = Mapping[float, list[Run]]
"""By time limit [s]."""


def run(options: suite.Options) -> str:
    """Run the default planner at every limit, its parts, and the other planners."""
    seeds, other_limit = options.pick((2, 5.0), quick=(1, 1.0), long=(4, 5.0))
    tasks = suite.task_names(options)
    limits = sorted({limit for limit, _ in WANTED})
    own = [planning.job(task, seed=seed, seconds=limit) for limit in limits for seed in range(seeds) for task in tasks]
    whole, *parts = PARTS
    fewer = [planning.job(task, part) for part in parts for task in tasks]
    planners = options.pick(OTHERS, quick=OTHERS, long=LONG_OTHERS)
    others = [planning.job(task, planner, seconds=other_limit, refine=False) for planner in planners for task in tasks]
    records = _by_limit(own)
    ablation = [replace(run, planner=whole.label) for run in records[1.0] if run.seed == 0]
    ablation += planning.runs(fewer, 1, "its parts")
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
            f"### Gap of the default after {min(limits):g} s and of others after {other_limit:g} s\n",
            _other_table(records, slow, best),
        ]
    )


def _by_limit(jobs: list[PlannerJob]) -> Runs:
    """Run the default planner on all jobs, and group the runs by time limit."""
    done = zip(jobs, planning.runs_once(jobs, "default planner"), strict=True)
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
    planners = _planners(others)
    first = planners[0]
    near = [gap for gap in (_least(others, best, task, (first,)) for task in best) if gap <= OTHERS_WITHIN]
    yield report.Target(
        what=f"tasks on which {first} is within {report.percent(OTHERS_WITHIN, 0)} after {other_limit:g} s",
        wanted=f">= {OTHERS_TASKS} of 27",
        measured=f"{len(near)} of {len(best)}",
        met=len(near) >= OTHERS_TASKS if len(best) >= OTHERS_TASKS else None,
    )
    soon = min(records)
    closer = [task for task in best if _own(records, best, task) < _least(others, best, task, planners)]
    yield report.Target(
        what=f"tasks on which {soon:g} s come closer than {other_limit:g} s of the best of {', '.join(planners)}",
        wanted="more than half",
        measured=f"{len(closer)} of {len(best)}",
        met=2 * len(closer) > len(best),
    )


def _own(records: Runs, best: dict[str, float], task: str) -> float:
    """Median gap of the shortest calls over the seeds."""
    return float(np.median(_gaps(records[min(records)], best, task)))


def _planners(others: list[Run]) -> tuple[str, ...]:
    """Names of the other planners, in the order of their runs."""
    return tuple(dict.fromkeys(run.planner for run in others))


def _least(others: list[Run], best: dict[str, float], task: str, planners: Sequence[str]) -> float:
    """Least gap of some planners on a task."""
    return min(_gaps([run for run in others if run.planner in planners], best, task))


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
        rows.append(
            (part.label, report.percent(float(np.median(gaps))), report.percent(float(np.percentile(gaps, 90))))
        )
    return report.table(("", "median gap", "90th percentile"), rows)


def _other_table(records: Runs, others: list[Run], best: dict[str, float]) -> str:
    rows, planners = [], _planners(others)
    for task in best:
        gaps = (_own(records, best, task), *(_least(others, best, task, (planner,)) for planner in planners))
        rows.append((task, *(report.percent(value) for value in gaps)))
    return report.table(("task", "default", *planners), rows)
