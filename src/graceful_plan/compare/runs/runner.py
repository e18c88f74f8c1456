"""One run of a planner on a problem with a time limit, after loading, imports and compilation."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from graceful_plan.analysis.certified_clearance import certified_clearance
from graceful_plan.compare.problems.analytic import AnalyticProblem, analytic_problems
from graceful_plan.compare.problems.problem_files import ProblemFile, load_problems
from graceful_plan.compare.problems.suite import ProblemSpec
from graceful_plan.compare.runs.measures import exact_clearance, jerk
from graceful_plan.compare.runs.planner_specs import PlannerSpec
from graceful_plan.compare.runs.records import EARLY, RAISED, SOLVED, Run
from graceful_plan.core.compile import compile_scene
from graceful_plan.path import Path
from graceful_plan.plan import plan
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.goals import Goal
from graceful_plan.result import PlanStatus, TracePoint
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.scene.scene import Scene

_SAME = 1e-9
_WORDS = 1000
"""Maximum number of recorded characters of an exception's message."""
_WARM_UP = 0.25
"""Maximum time for imports and compilation before the run, which is not counted [s]."""


@dataclass(frozen=True, kw_only=True)
class PlannerJob:
    """A run to execute.

    Args:
        problem: The problem.
        planner: The planner.
        seed: Seed of the random numbers.
        seconds: Time limit of the call [s].
        w: Safety weight.
        measured: Whether to measure jerk and clearance, which takes longer than many runs.
    """

    problem: ProblemSpec
    planner: PlannerSpec
    seed: int
    seconds: float
    w: float
    measured: bool = True

    @property
    def key(self) -> tuple[str, str, int]:
        """Unique key of the run."""
        return self.problem.name, self.planner.label, self.seed

    def outcome(self, status: str, detail: str = "") -> Run:
        """Return the record of a run that ended without a result."""
        return Run(problem=self.problem.name, planner=self.planner.label, seed=self.seed, status=status, detail=detail)


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneQuery:
    """Start, goal and scene of a planning problem."""

    start: Configuration
    goal: Goal
    scene: Scene


def run(job: PlannerJob) -> Run:
    """Execute a run; exceptions are outcomes."""
    try:
        problem = loaded_problem(job.problem)
        planner = job.planner.make()
        warm_up(job.problem, job.planner, min(job.seconds, _WARM_UP), job.w)
        # Collect the garbage of the previous run outside of this one.
        gc.collect()
        if isinstance(problem, AnalyticProblem):
            return _run_analytic(job, problem, planner)
        return _run_scene(job, problem, planner)
    except Exception as error:
        # The message may contain anything, but has to fit into files and the page.
        words = f"{type(error).__name__}: {error}"[:_WORDS].encode(errors="replace").decode()
        return job.outcome(RAISED, words)


def load(job: PlannerJob) -> None:
    """Load a problem outside of the time of the planner; `run` reports its errors."""
    with suppress(Exception):
        loaded_problem(job.problem)


@lru_cache(maxsize=64)
def loaded_problem(note: ProblemSpec) -> SceneQuery | AnalyticProblem:
    """Load a problem, cached per process.

    Raises:
        GracefulPlanError: If its scene or file is missing or malformed.
    """
    if note.kind == "analytic":
        return analytic_problems()[note.item]
    if note.kind == "file":
        found = _problem_file(note.source)[note.item]
        return SceneQuery(start=found.start, goal=found.goal, scene=found.scene)
    scene = _scene(note.source)
    if note.kind == "task":
        task = scene.tasks[note.item]
        return SceneQuery(start=task.start, goal=task.goal, scene=task.scene)
    start, goal = (end if isinstance(end, str) else np.array(end) for end in (note.start, note.goal))
    return SceneQuery(start=start, goal=goal, scene=scene)  # type: ignore[arg-type]


@lru_cache(maxsize=32)
def _scene(source: str) -> Scene:
    return load_scene(source)


@lru_cache(maxsize=4)
def _problem_file(path: str) -> dict[str, ProblemFile]:
    return {problem.name: problem for problem in load_problems(path)}


@lru_cache(maxsize=1024)
def warm_up(note: ProblemSpec, planner: PlannerSpec, seconds: float = _WARM_UP, w: float = 0.0) -> None:
    """Plan up to a first path, so that measured times exclude imports and the compilation of the scene.

    Args:
        note: The problem.
        planner: The planner.
        seconds: Time limit [s].
        w: Safety weight.
    """
    problem = loaded_problem(note)
    try:
        if isinstance(problem, AnalyticProblem):
            for _ in planner.make().solve(
                problem.problem, problem.objective, Budget(seconds), np.random.default_rng(0)
            ):
                break
        else:
            plan(
                problem.start,
                problem.goal,
                problem.scene,
                w=w,
                planner=planner.make(),
                refine=planner.refine,
                time_limit=seconds,
                stop="first",
            )
    except Exception:
        return  # The run itself reports the error again.


def _run_scene(job: PlannerJob, problem: SceneQuery, planner: Planner) -> Run:
    seen: list[TracePoint] = []
    started = time.perf_counter()
    result = plan(
        problem.start,
        problem.goal,
        problem.scene,
        w=job.w,
        planner=planner,
        refine=job.planner.refine,
        time_limit=job.seconds,
        seed=job.seed,
        callback=seen.append,
    )
    seconds = time.perf_counter() - started
    record = replace(
        job.outcome(result.status.name, result.detail),
        seconds=seconds,
        early=tuple(_best_by(at, seen) for at in EARLY),
        iterations=result.stats.get("iterations", math.nan),
        path_cost=result.stats.get("path_cost", math.nan),
    )
    if result.status is not PlanStatus.SOLVED or result.trajectory is None:
        return record
    trajectory = result.trajectory
    if job.measured:
        peak, rms = jerk(trajectory)
        clearance, own = exact_clearance(trajectory, problem.scene)
        certified = certified_clearance(trajectory, compile_scene(problem.scene).kernels).bound
        wall, cpu = _first_motion(job, problem, planner)
        record = replace(
            record,
            motion_wall=wall,
            motion_cpu=cpu,
            jerk_peak=peak,
            jerk_rms=rms,
            clearance=clearance,
            self_clearance=own,
            certified=certified,
        )
    return replace(
        record,
        first=seen[0].time,
        total=result.cost.total,
        motion=result.cost.motion,
        impact=result.cost.impact,
        duration=trajectory.duration,
        length=trajectory.path.length,
        trace=result.trace,
        path=tuple(map(tuple, trajectory.q.tolist())),
        times=tuple(trajectory.t.tolist()),
        velocities=tuple(map(tuple, trajectory.qd.tolist())),
    )


def _best_by(seconds: float, seen: Sequence[TracePoint]) -> float:
    """Return the motion cost of the path of least total cost at a time; infinite without a path."""
    there = [(point.total, point.motion) for point in seen if point.time <= seconds]
    return min(there, default=(math.inf, math.inf))[1]


def _first_motion(job: PlannerJob, problem: SceneQuery, planner: Planner) -> tuple[float, float]:
    """Return wall and processor seconds of a call that ends with its first path; infinite if it was not solved."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = plan(
        problem.start,
        problem.goal,
        problem.scene,
        w=job.w,
        planner=planner,
        time_limit=job.seconds,
        seed=job.seed,
        refine=job.planner.refine,
        stop="first",
    )
    taken = time.perf_counter() - wall, time.process_time() - cpu
    return taken if result.status is PlanStatus.SOLVED else (math.inf, math.inf)


def _run_analytic(job: PlannerJob, instance: AnalyticProblem, planner: Planner) -> Run:
    """Run a planner on an analytic problem; paths are checked but not timed."""
    objective = replace(instance.objective, w=job.w)
    budget, trace, best = Budget(job.seconds), [], None
    for path in planner.solve(instance.problem, objective, budget, np.random.default_rng(job.seed)):
        at = budget.elapsed
        edges = objective.edges(path.q[:-1], path.q[1:])
        motion, impact = (float(x) for x in edges.sum(axis=0)) if len(edges) else (0.0, 0.0)
        total = motion + job.w * impact
        if not _leads_there(path, instance) or (trace and total >= trace[-1].total):
            continue
        trace.append(TracePoint(time=at, total=total, motion=motion, impact=impact))
        best = path
    seconds, exhausted = budget.elapsed, budget.exhausted
    record = replace(job.outcome(SOLVED), seconds=seconds, iterations=float(budget.spent))
    if best is None:
        return replace(record, status=(PlanStatus.TIMEOUT if exhausted else PlanStatus.INFEASIBLE).name)
    return replace(
        record,
        first=trace[0].time,
        total=trace[-1].total,
        motion=trace[-1].motion,
        impact=trace[-1].impact,
        length=best.length,
        trace=tuple(trace),
        path=tuple(map(tuple, best.q.tolist())),
    )


def _leads_there(path: Path, instance: AnalyticProblem) -> bool:
    problem = instance.problem
    ends = np.abs(path.q[0] - problem.start).max(), np.abs(problem.goals - path.q[-1]).max(axis=1).min()
    return bool(max(ends) <= _SAME and np.all(problem.edges_free(path.q[:-1], path.q[1:])))
