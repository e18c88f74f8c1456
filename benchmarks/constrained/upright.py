"""Planning with the carried object or the gripper upright: bundled tasks and problems of the MotionBenchMaker type."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

import graceful_plan as gp
from benchmarks import motion_problems, suite
from benchmarks.constrained.projected import connect, ompl_connect
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.endpoints.endpoints import find_endpoints

UPRIGHT = gp.Upright(float(np.deg2rad(15.0)))
SEED = 14
"""Seed of the problems."""
KINDS = tuple(motion_problems.KINDS)
SIZES, LONG_SIZES = (8, 4), (16, 10)
"""Problems made per kind, and problems with upright ends used per kind, in normal and long runs."""
PROJECTION, REJECTION, OMPL = "projection", "rejection", "OMPL"
SECONDS = 1.0
"""Time limit of a plan and of a search."""
SOON = 0.5
"""Time at which the gap is measured [s]."""


@dataclass(frozen=True, kw_only=True)
class UprightJob:
    """A problem to examine.

    Args:
        name: "scene/task" or "kind/number".
        seeds: Number of seeds of the short runs.
        long: Duration of a long run [s].
        long_seeds: Number of long runs.
    """

    name: str
    seeds: int
    long: float
    long_seeds: int


@dataclass(frozen=True, kw_only=True)
class UprightFigures:
    """Result for a problem; infinite without a path.

    Args:
        name: Name of the problem.
        objection: Reason why start and goal cannot be upright or connected; otherwise "".
        statuses: Status of every seed within `SECONDS`.
        details: Messages of unsolved runs.
        first: Time to the first path of every seed [s], by method.
        soon: J of every seed after `SOON`.
        long: J of every long run.
    """

    name: str
    objection: str = ""
    statuses: tuple[str, ...] = ()
    details: tuple[str, ...] = ()
    first: dict[str, tuple[float, ...]]
    soon: tuple[float, ...] = ()
    long: tuple[float, ...] = ()

    @property
    def best(self) -> float:
        """Least J of all runs."""
        return min([*self.soon, *self.long], default=np.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """Scene, start and goal of a problem."""

    scene: gp.Scene
    start: np.ndarray
    goal: np.ndarray


def question(name: str) -> Question:
    """Return a task or a problem by its name."""
    kind, item = name.split("/")
    if kind not in KINDS:
        task = suite.task(name)
        return Question(scene=task.scene, start=task.start, goal=task.goal)
    problem = _made(kind, int(item) + 1)[int(item)]
    return Question(scene=problem.scene, start=problem.start, goal=problem.goals)


@cache
def _made(kind: str, count: int) -> Sequence[motion_problems.ProblemFile]:
    return motion_problems.make(kind, count, SEED)


def names(options: suite.Options) -> dict[str, list[str]]:
    """Return the problems to examine, by group: "tasks", and each kind of problems with upright ends.

    Kinds that reach from the front never end with the gripper upright, so they are left out.
    """
    made, kept = options.pick(SIZES, quick=(2, 1), long=LONG_SIZES)
    found = {"tasks": suite.task_names(options)}
    for kind in ("box", "table_pick"):
        asked = [Question(scene=p.scene, start=p.start, goal=p.goals) for p in _made(kind, made)]
        upright = [k for k, one in enumerate(asked) if not objection(one)]
        found[kind] = [f"{kind}/{k}" for k in upright[:kept]]
    return {group: suite.chosen(all_of, options.tasks) for group, all_of in found.items()}


def objection(asked: Question) -> str:
    """Return the reason why start and goal cannot be upright or connected; otherwise ""."""
    held = SceneConstraints(asked.scene, [UPRIGHT])
    at_start = [f"start: {reason}" for reason in held.objections(asked.start)]
    at_goals = [held.objections(q) for q in np.atleast_2d(asked.goal)]
    return "; ".join([*at_start, *([f"goal: {at_goals[0][0]}"] if all(at_goals) else [])])


def examine(job: UprightJob) -> UprightFigures:
    """Examine one problem, with a compiled scene and after a warm-up."""
    asked = question(job.name)
    held = SceneConstraints(asked.scene, [UPRIGHT])
    lacking = objection(asked)
    ends = None if lacking else find_endpoints(asked.start, asked.goal, held, np.random.default_rng(0))
    if ends is None or isinstance(ends, gp.PlanResult):
        reason = lacking if ends is None else f"{ends.status.name}: {ends.detail}"
        return UprightFigures(name=job.name, objection=reason, first={})
    problem = SceneProblem(
        kernels=held.kernels,
        start=ends.departure.q[-1],
        goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
        margin=min(0.002, 0.5 * ends.clearance),
        constraints=held,
    )
    plans = [_planned(asked, SECONDS, seed, stop="first") for seed in range(job.seeds)]  # only their status counts
    bad = [plan for plan in plans if plan.status is not gp.PlanStatus.SOLVED]
    return UprightFigures(
        name=job.name,
        statuses=tuple(plan.status.name for plan in plans),
        details=tuple(plan.detail for plan in bad),
        first=first_paths(problem, asked.scene, job.seeds),
        soon=tuple(_total(_planned(asked, SOON, seed)) for seed in range(job.seeds)),
        long=tuple(_total(_planned(asked, job.long, seed)) for seed in range(100, 100 + job.long_seeds)),
    )


def first_paths(problem: SceneProblem, scene: gp.Scene, seeds: int) -> dict[str, tuple[float, ...]]:
    """Return the time to the first path of every seed [s], by method."""
    objective = gp.Objective(w=0.0).bind(scene)

    def search(method: str, seed: int) -> float:
        if method == OMPL:
            return ompl_connect(problem, UPRIGHT.rule(scene), scene, seed, SECONDS)
        return connect(problem, objective, seed, SECONDS, projects=method == PROJECTION)

    methods = (PROJECTION, REJECTION, OMPL)
    return {method: tuple(search(method, seed) for seed in (0, *range(seeds)))[1:] for method in methods}


def _planned(asked: Question, seconds: float, seed: int, *, stop: Literal["first"] | None = None) -> gp.PlanResult:
    return gp.plan(
        asked.start, asked.goal, asked.scene, constraints=[UPRIGHT], time_limit=seconds, seed=seed, stop=stop
    )


def _total(result: gp.PlanResult) -> float:
    return result.cost.total if result.status is gp.PlanStatus.SOLVED and result.cost is not None else np.inf
