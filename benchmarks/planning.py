"""One call of `plan` on a task, as a record that can cross processes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache

import numpy as np

import graceful_plan as gp
from benchmarks.suite import task
from graceful_plan.compare.problems.analytic import disc
from graceful_plan.planners.planner import Budget

W = 1.0
"""Safety weight of every benchmark that does not say otherwise."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """What to plan."""

    task: str
    planner: str | gp.Planner = "auto"
    seed: int = 0
    w: float = W
    time_limit: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Record:
    """What came of it. The totals of the trace include the ways out of tight starts and goals."""

    job: Job
    status: str
    detail: str = ""
    seconds: float = np.inf
    """Of the whole call."""
    total: float = np.inf
    path: np.ndarray | None = None
    trace: tuple[tuple[float, float], ...] = ()
    """Seconds since the call and total cost, at each improvement."""

    @property
    def solved(self) -> bool:
        """Whether a verified trajectory was returned."""
        return self.status == "SOLVED"

    @property
    def first(self) -> float:
        """When the first path was there [s]; infinite if the call was not solved."""
        return self.trace[0][0] if self.solved and self.trace else np.inf

    def total_at(self, seconds: float) -> float:
        """Total cost of the best path so far; infinite if there was none or the call was not solved in the end."""
        reached = [total for at, total in self.trace if at <= seconds]
        return min(reached, default=np.inf) if self.solved else np.inf


def run(job: Job) -> Record:
    """Plan, in a scene that is loaded and compiled; whatever is raised is an outcome."""
    try:
        return _run(job)
    except Exception as error:
        return Record(job=job, status="RAISED", detail=f"{type(error).__name__}: {error}")


@cache
def warm_task(name: str) -> None:
    """Load and compile what a task needs, once per process, so that it is in no figure."""
    instance = task(name)
    gp.plan(instance.start, instance.goal, instance.scene, w=0.0, time_limit=2.0, callback=lambda point: True)


@cache
def warm_planner(name: str) -> None:
    """Let a planner import what it needs, once per process."""
    trivial = disc()
    budget = Budget(2.0, iterations=200)
    for _ in gp.PLANNERS[name]().solve(trivial.problem, trivial.objective, budget, np.random.default_rng(0)):
        pass


def _run(job: Job) -> Record:
    instance = task(job.task)
    warm_task(job.task)
    if isinstance(job.planner, str):
        warm_planner(job.planner)
    started = time.perf_counter()
    result = gp.plan(
        instance.start,
        instance.goal,
        instance.scene,
        w=job.w,
        planner=job.planner,
        time_limit=job.time_limit,
        seed=job.seed,
    )
    seconds = time.perf_counter() - started
    if result.path is None:
        return Record(job=job, status=result.status.name, detail=result.detail, seconds=seconds)
    # The search knows nothing of the ways out of tight places at both ends; what they cost is the same all along.
    ends = result.cost.total - result.trace[-1].total if result.trace else 0.0
    return Record(
        job=job,
        status=result.status.name,
        detail=result.detail,
        seconds=seconds,
        total=result.cost.total,
        path=np.array(result.path.q),
        trace=tuple((point.time, point.total + ends) for point in result.trace),
    )
