"""Every planner on every bundled task, and the gap of the default planner after one second."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from graceful_plan.compare import Run
from graceful_plan.compare.reports.summary import gap
from graceful_plan.compare.runs.best_motions import StaleBestMotion

TITLE = "Planners: plan(w=1) on every task"
QUESTION = "How does each planner perform on each bundled task?"
HEADLINE = "median gap"
DEPENDS_ON = (*suite.PLANNING, "benchmarks/planning.py", "benchmarks/best_known")
GAP_AT_MOST = 0.05
MEASURED = """\
Whole calls of `plan(w=1)`, with scenes loaded and compiled before. "Gap": relative excess of J over the best-known J of
the task, which is the lesser of `best_known/` and the best of this run. "First": time of the first path of the search.
Runs that are not SOLVED count as infinite, so "none" is a median of mostly unsolved runs. All planners have {limit:g} s
and return their own paths (`refine=False`). The default planner's own calls have `time_limit=1.0`, verification
included.
"""


def run(options: suite.Options) -> str:
    """Run the default planner alone, then all planners; better motions than the best known are stored."""
    seeds = 1
    limit, default_seeds = options.pick((1.0, 2), quick=(0.3, 1), long=(5.0, 10))
    limit = options.seconds or limit
    tasks = suite.task_names(options)
    jobs = [
        planning.job(task, planner, seed=seed, seconds=limit, refine=False)
        for seed in range(seeds)
        for task in tasks
        for planner in gp.PLANNERS
    ]
    default = [planning.job(task, seed=seed) for seed in range(default_seeds) for task in tasks]
    # One process: the default planner gets the whole machine.
    own = planning.runs_once(default, "default planner")
    table = list(planning.runs(jobs, options.processes, "planners"))
    best, doubts = references([(1.0, own), (limit, table)], tasks, keep=not options.quick)
    parts = [
        MEASURED.format(limit=limit),
        "".join(f"- {doubt}\n" for doubt in doubts),
        report.targets(_targets(own, best)),
        f"### The default, time_limit=1.0, {default_seeds} seeds\n",
        _default_table(own, best),
        f"### All planners over all tasks, {seeds} seeds, {limit:g} s, {options.processes} at a time\n",
        _planner_table(table, best),
        "### Median gap, planner by task\n",
        _task_table(table, best),
        "### Solved and median time to first [ms], planner by task\n",
        _first_table(table, tasks),
    ]
    return "\n".join(parts)


def references(
    found: Iterable[tuple[float, Sequence[Run]]], tasks: list[str], *, keep: bool
) -> tuple[dict[str, float], list[str]]:
    """Return the least known total cost of each task, and remarks on missing or refused files.

    Args:
        found: Runs that may be better than the files, with their time limit [s].
        tasks: Names of tasks.
        keep: Whether to store better motions.
    """
    best, doubts, missing = {}, [], []
    for name in tasks:
        task = suite.task(name)
        stored = None
        try:
            stored = planning.BEST.load(name, task)
            missing += [name] if stored is None else []
        except StaleBestMotion as error:
            doubts.append(f"Refused: {error}")
        mine = [(run, seconds) for seconds, runs in found for run in runs if run.problem == name and run.solved]
        least = min(mine, key=lambda one: one[0].total, default=None)
        better = stored if least is None else planning.BEST.offer(task, stored, *least)
        if keep and better is not None and better is not stored:
            planning.BEST.write(better)
        stored = better
        best[name] = np.inf if stored is None else stored.total
    if missing:
        doubts.append(f"No best known before this run, so its own best counts: {', '.join(missing)}")
    return best, doubts


def _targets(own: list[Run], best: dict[str, float]) -> Iterator[report.Target]:
    medians = {task: _median_of(_of(own, task), best) for task in best}
    good = [task for task, value in medians.items() if value <= GAP_AT_MOST]
    worst = max(medians, key=lambda task: medians[task])
    yield report.Target(
        what="median gap of plan(w=1, time_limit=1.0), every task",
        wanted=f"<= {report.percent(GAP_AT_MOST, 0)}",
        measured=f"{len(good)} of {len(medians)} tasks; worst {report.percent(medians[worst])} ({worst})",
        met=len(good) == len(medians),
    )


def _median_of(records: list[Run], best: dict[str, float]) -> float:
    gaps = [gap(r.total, best[r.problem]) if r.solved else np.inf for r in records]
    return float(np.median(gaps)) if gaps else np.nan


def _of(records: list[Run], task: str | None = None, planner: str | None = None) -> list[Run]:
    return [r for r in records if task in (None, r.problem) and planner in (None, r.planner)]


def _default_table(own: list[Run], best: dict[str, float]) -> str:
    rows = []
    for task in best:
        records = _of(own, task)
        gaps = [gap(r.total, best[task]) if r.solved else np.inf for r in records]
        cells = (
            report.quantity(best[task], digits=5),
            report.percent(float(np.median(gaps))),
            report.percent(max(gaps)),
        )
        seconds = f"{max(r.seconds for r in records):.2f}"
        rows.append((task, *cells, _solved(records), _first(records), seconds))
    header = ("task", "best known J", "median gap", "worst gap", "solved", "first [ms]", "longest call [s]")
    return report.table(header, rows)


def _planner_table(records: list[Run], best: dict[str, float]) -> str:
    rows = []
    for planner in gp.PLANNERS:
        mine = _of(records, planner=planner)
        rows.append((planner, _solved(mine), _first(mine), report.percent(_median_of(mine, best))))
    return report.table(("planner", "solved", "first [ms]", "gap"), rows)


def _task_table(records: list[Run], best: dict[str, float]) -> str:
    rows = (
        (task, *(report.percent(_median_of(_of(records, task, planner), best)) for planner in gp.PLANNERS))
        for task in best
    )
    return report.table(("task", *gp.PLANNERS), rows)


def _first_table(records: list[Run], tasks: list[str]) -> str:
    rows = []
    for task in tasks:
        cells = []
        for planner in gp.PLANNERS:
            mine = _of(records, task, planner)
            cells.append(f"{_solved(mine)}, {_first(mine)}")
        rows.append((task, *cells))
    return report.table(("task", *gp.PLANNERS), rows)


def _first(records: list[Run]) -> str:
    """Median time to the first path [ms]."""
    return report.quantity(1e3 * float(np.median([r.first for r in records])))


def _solved(records: list[Run]) -> str:
    """Return the number of solved runs, and the statuses of the others."""
    others = [r.status for r in records if not r.solved]
    named = ", ".join(f"{others.count(status)} {status}" for status in sorted(set(others)))
    return f"{len(records) - len(others)}/{len(records)}" + (f" ({named})" if named else "")
