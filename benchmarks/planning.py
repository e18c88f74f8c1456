"""Runs of `plan` on the tasks of bundled scenes, recorded by `graceful_plan.compare`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks import suite
from graceful_plan.compare import BestMotions, Run
from graceful_plan.compare.problems.suite import ProblemSpec
from graceful_plan.compare.runs import workers
from graceful_plan.compare.runs.planner_specs import PlannerSpec
from graceful_plan.compare.runs.runner import PlannerJob, warm_up

W = 1.0
"""Safety weight of `planners`, `auto` and `best_known/`."""
BEST = BestMotions(Path(__file__).parent / "best_known", W)
"""Best-known motion of every task."""


def job(
    task: str,
    planner: str | PlannerSpec = "auto",
    *,
    seed: int = 0,
    w: float = W,
    seconds: float = 1.0,
    refine: bool = True,
) -> PlannerJob:
    """Return the run of a planner on a task, "scene/task"; jerk and clearance are not measured."""
    note = PlannerSpec(label=planner, name=planner, refine=refine) if isinstance(planner, str) else planner
    return PlannerJob(problem=problem(task), planner=note, seed=seed, seconds=seconds, w=w, measured=False)


def problem(task: str) -> ProblemSpec:
    """Return the origin of a task."""
    scene, name = task.split("/")
    return ProblemSpec(name=task, kind="task", source=scene, item=name)


def runs(jobs: Sequence[PlannerJob], processes: int, label: str) -> Iterator[Run]:
    """Do runs and yield them as they finish; one process means this process."""
    return suite.with_progress(workers.done(jobs, processes if processes > 1 else 0), len(jobs), label)


_DONE: dict[PlannerJob, Run] = {}
"""Runs of this process that several subjects report."""


def runs_once(jobs: Sequence[PlannerJob], label: str) -> list[Run]:
    """Do runs in this process, except those that an earlier call has done, and return all in order."""
    left = [job for job in jobs if job not in _DONE]
    _DONE.update(zip(left, runs(left, 1, label), strict=True))  # in order, in one process
    return [_DONE[job] for job in jobs]


def warm(planner: str, task: str | None = None) -> None:
    """Run a planner once per process, to import and compile its code: on a task, or on a planar problem."""
    disc = ProblemSpec(name="analytic/disc", kind="analytic", item="disc")
    warm_up(disc if task is None else problem(task), PlannerSpec(label=planner, name=planner))
