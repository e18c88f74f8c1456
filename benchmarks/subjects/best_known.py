"""Look for the best motion of every task with every planner, and keep it. Can be interrupted and resumed."""

from __future__ import annotations

from dataclasses import replace

import graceful_plan as gp
from benchmarks import planning, report, suite
from graceful_plan.compare import BestMotion
from graceful_plan.compare.runs.best_motions import Attempt
from graceful_plan.compare.runs.runner import PlannerJob

TITLE = "Best known: the least total cost of every task"
LONG = 60.0
"""Time limit of the default planner's first seed [s]."""
SHORT = 5.0
"""Time limit of all other runs [s]."""
SEEDS = 4
"""Seeds of the default planner."""
MEASURED = f"""\
The default planner for {LONG:g} s with one seed and for {SHORT:g} s with {SEEDS - 1} more, every other planner for
{SHORT:g} s with one seed, unless `--seconds` sets one limit for all; runs that are listed in a file are not repeated.
The best verified motion of each task is in `benchmarks/best_known/` and is judged again, cost and collisions, whenever
it is read. Runs of the planner table that are better replace it too, which is why a run named here may be shorter.
"""


def run(options: suite.Options) -> str:
    """Do what has not been done yet and report what is known."""
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
    return f"{MEASURED}\n{report.table(HEADER, [_row(name, best[name], done[name]) for name in tasks])}"


HEADER = ("task", "J", "motion", "impact", "found by", "runs", "runs without a motion", "second best planner")


def _schedule(tasks: list[str], options: suite.Options) -> list[PlannerJob]:
    """All runs, the most promising first, so that an interrupted search has something for every task."""
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
    told = (
        ""
        if second is None or second.total is None
        else (
            f"{second.planner}, {report.percent(second.total / best.total - 1.0 if best.total else second.total)} above"
        )
    )
    return [name, *costs, found, str(len(runs)), str(failed), told]
