"""Search for the best motion of every task with every planner and store it in best_known/; resumes if interrupted.

python benchmarks/find_best_known.py [--processes N] [--seconds S]
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import graceful_plan as gp  # noqa: E402 - the import path is set above
from benchmarks import planning, report, suite  # noqa: E402
from graceful_plan.compare import BestMotion  # noqa: E402
from graceful_plan.compare.runs.best_motions import Attempt  # noqa: E402
from graceful_plan.compare.runs.runner import PlannerJob  # noqa: E402

LONG = 60.0
"""Time limit of the first seed of the default planner [s]."""
SHORT = 5.0
"""Time limit of all other runs [s]."""
SEEDS = 4
"""Seeds of the default planner."""


def run(options: suite.Options) -> str:
    """Do the runs that are left, and return a table of the best-known motions."""
    tasks = suite.task_names(options)
    best = {name: planning.BEST.renewed(name, suite.task(name)) for name in tasks}
    done: dict[str, list[Attempt]] = {name: list(entry.runs) if entry else [] for name, entry in best.items()}
    jobs = {job.key: job for job in _schedule(tasks, options) if not _was_done(job, done[job.problem.name])}
    for run in planning.runs([*jobs.values()], options.processes, "best known"):
        name, seconds = run.problem, jobs[run.key].seconds
        total = run.total if run.solved else None
        done[name].append(Attempt(planner=run.planner, seed=run.seed, seconds=seconds, total=total))
        better = planning.BEST.offer(suite.task(name), best[name], run, seconds)
        best[name] = None if better is None else replace(better, runs=tuple(done[name]))
        if better is not None and not options.quick:
            planning.BEST.write(replace(better, runs=tuple(done[name])))
    return report.table(HEADER, [_row(name, best[name], done[name]) for name in tasks])


HEADER = ("task", "J", "motion", "impact", "found by", "runs", "runs without a motion", "second best planner")


def _schedule(tasks: list[str], options: suite.Options) -> list[PlannerJob]:
    """Return all runs, the most promising first, so an interrupted search covers every task."""
    long = options.seconds or (0.5 if options.quick else LONG)
    short = options.seconds or (0.5 if options.quick else SHORT)
    others = [planner for planner in gp.PLANNERS if planner != "auto"]
    seeds = (("auto", seed, short) for seed in range(1, SEEDS))
    plans = [("auto", 0, long), *seeds, *((planner, 0, short) for planner in others)]
    return [
        planning.job(task, planner, seed=seed, seconds=seconds) for planner, seed, seconds in plans for task in tasks
    ]


def _was_done(job: PlannerJob, runs: list[Attempt]) -> bool:
    label, seed = job.planner.label, job.seed
    return any(run.planner == label and run.seed == seed and run.seconds >= job.seconds for run in runs)


def _row(name: str, best: BestMotion | None, runs: list[Attempt]) -> list[str]:
    failed = sum(run.total is None for run in runs)
    if best is None:
        return [name, "none", "", "", "", str(len(runs)), str(failed), ""]
    found = f"{best.planner}, seed {best.seed}, {best.seconds:g} s"
    costs = [report.quantity(value, digits=5) for value in (best.total, best.motion, best.impact)]
    others = [run for run in runs if run.planner != best.planner and run.total is not None]
    second = min(others, key=lambda run: run.total or 0.0, default=None)
    runner_up = (
        ""
        if second is None or second.total is None
        else (
            f"{second.planner}, {report.percent(second.total / best.total - 1.0 if best.total else second.total)} above"
        )
    )
    return [name, *costs, found, str(len(runs)), str(failed), runner_up]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=max(1, (os.cpu_count() or 1)), help="default: one per core")
    parser.add_argument("--seconds", type=float, help=f"time limit of every run (default: {LONG:g} and {SHORT:g})")
    arguments = parser.parse_args()
    print(run(suite.Options(processes=arguments.processes, seconds=arguments.seconds)))
