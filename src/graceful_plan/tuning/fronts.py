"""pareto(): the front of motion against impact between two configurations, with every point verified.

Paths come from minimisations of V + w S over sweeps of the weight (`search`). From these paths, smooth motions descend
along J with their own timing, at weights all along the front (`motion_front`). If the objective has no descent, as for
user-defined costs, the paths themselves are refined as a whole (`refine`) and timed with rounded corners. Every point
is checked by the judge, and its cost is that of the timed motion (`judging`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, is_whole
from graceful_plan.planners import Planner
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.arguments import (
    check_no_base,
    checked_objective,
    checked_planner,
    checked_seed,
    checked_speed,
    checked_time_limit,
)
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.endpoints import Endpoints, find_endpoints
from graceful_plan.query.endpoints.goals import Goal, poses_of
from graceful_plan.query.request import Request
from graceful_plan.result import PlanStatus
from graceful_plan.roadmap import Roadmap
from graceful_plan.scene.scene import Scene
from graceful_plan.tuning.archive import Archive, Candidate
from graceful_plan.tuning.front_problem import FrontProblem, Seeds
from graceful_plan.tuning.judging import LONGER, MOTION_LONGER, FrontQuery, Judging
from graceful_plan.tuning.motion_front import FrontMotion, MotionFront
from graceful_plan.tuning.pareto_front import Choice, ChoiceStatus, ParetoFront
from graceful_plan.tuning.points import ParetoPoint, front_of
from graceful_plan.tuning.search import FrontSettings, search_front

__all__ = ["Choice", "ChoiceStatus", "FrontProgress", "ParetoFront", "ParetoPoint", "pareto"]


_MARGIN = 0.002
"""Clearance to keep [m]."""
_NODES = 800
"""Nodes of the initial roadmap."""
_PER_NODE = 5
"""Iterations of the budget per node of the roadmap."""
_SEARCHING = 0.35
"""Fraction of the time for paths if motions descend from them; one half is no better."""
_WEIGHTS, _SWEEP = 4, 0.45
"""Number of weights in a sweep for such paths, and the sweep's fraction of their time."""
MOST_POINTS = 1000


@final
@dataclass(frozen=True, kw_only=True)
class FrontProgress:
    """Progress of a front search: time since the call [s], stage, and number of candidates on the front."""

    time: float
    stage: str
    candidates: int


Tell = Callable[[FrontProgress], bool | None]
"""Progress callback; returning True ends the search."""


def pareto(
    start: Configuration,
    goal: Goal,
    scene: Scene,
    *,
    points: int = 30,
    planner: str | Planner = "auto",
    objective: Objective | None = None,
    time_limit: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
    speed: float = 1.0,
    constraints: Iterable[Constraint] | None = None,
    callback: Tell | None = None,
) -> ParetoFront:
    """Compute the front of motion against impact, for an informed choice of the safety weight.

    Args:
        start: Configuration [rad or m], or the name of a keyframe.
        goal: Configuration, keyframe, `PoseGoal` for the tool, or several of these.
        scene: Robot, surroundings and carried object.
        points: Largest number of points; they are selected to represent all candidates found.
        planner: Name of a planner, or its settings object; it minimises V + w S at single weights.
        objective: Motion and impact; its own weight is ignored.
        time_limit: Time limit of the whole call [s]; 10 by default, none if `iterations` is given.
        iterations: Iterations of planner and refinement together. If no time limit is given, the result depends only
            on the seed.
        seed: Seed of all random numbers.
        speed: As in `plan`.
        constraints: As in `plan`: by default `default_constraints` of the scene; an empty list for none.
        callback: Called with the progress; returning True ends the search. Candidates found so far are still verified.

    Returns:
        The front; its status is SOLVED if it has a point. Every point passed the independent judge.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside their range.
    """
    started = time.perf_counter()
    check_no_base(scene, "pareto()")
    solver, rng = checked_planner(planner), checked_seed(seed)
    limit = checked_time_limit(10.0 if time_limit is None and iterations is None else time_limit, iterations)
    if not (is_whole(points) and 2 <= points <= MOST_POINTS):
        raise SettingError("points", points, f"a whole number from 2 to {MOST_POINTS}")
    wanted = checked_objective(objective, None)

    def failed(status: PlanStatus, detail: str) -> ParetoFront:
        return ParetoFront(status=status, detail=detail, scene=scene.notes.name)

    held = SceneConstraints(scene, default_constraints(scene) if constraints is None else constraints)
    bound = wanted.bind(scene, search_paces(checked_speed(speed)))
    ends = find_endpoints(start, goal, held, rng, objective=bound, seed=seed)
    if not isinstance(ends, Endpoints):
        return failed(ends.status, ends.detail)
    request = Request(
        planner=solver,
        objective=bound,
        constraints=ends.constraints,
        poses=poses_of(goal, ends.goal_index),
        speed=checked_speed(speed),
    )
    query = FrontQuery(ends=ends, request=request)
    try:
        return _Tuner(query, int(points), Budget(limit, iterations, started=started)).front(rng, callback)
    except NonFiniteCostError as error:
        return failed(PlanStatus.NONFINITE, str(error))


@final
class _Tuner:
    """State of one front search."""

    def __init__(self, query: FrontQuery, points: int, budget: Budget) -> None:
        self.query, self.points, self.budget = query, points, budget
        ends = query.ends
        self.problem = SceneProblem(
            kernels=ends.constraints.kernels,
            constraints=ends.constraints,
            start=ends.departure.q[-1],
            goals=np.stack([arrival.q[0] for arrival in ends.arrivals]),
            margin=min(_MARGIN, 0.5 * ends.clearance),
        )
        self.paths: Archive[Candidate] = Archive()
        self.motions: Archive[FrontMotion] = Archive()
        self.path_judging = Judging(self.paths, query.point_along, points, LONGER)
        self.motion_judging = Judging(self.motions, query.point_of, points, MOTION_LONGER)

    def front(self, rng: np.random.Generator, callback: Tell | None) -> ParetoFront:
        """Search for paths, descend from them to smooth motions if the objective allows it, then judge."""
        stopped = self._search(rng, callback)
        searched = self.budget.elapsed
        points = self._descend(rng, None if stopped else callback, stopped) if self.query.descends else []
        found = front_of(points or self.path_judging.front(self.budget))
        stats = {
            "search_time": searched,
            "total_time": self.budget.elapsed,
            "iterations": float(self.budget.spent),
            "candidates": float(len(self.paths)),
            "refused": float(self.refused),
        }
        status, detail = self._outcome(found)
        name = self.query.request.objective.scene.notes.name
        return ParetoFront(status=status, points=found, detail=detail, scene=name, stats=stats)

    @property
    def refused(self) -> int:
        """Number of paths and motions that the judge rejected."""
        return self.path_judging.refused + self.motion_judging.refused

    def _search(self, rng: np.random.Generator, callback: Tell | None) -> bool:
        """Fill the archive of paths; return whether the callback ended the search."""
        settings = FrontSettings(planner=self.query.request.planner, capacity=max(8, self.points))
        if self.query.descends:  # motions are refined instead
            settings = replace(settings, weights=_WEIGHTS, sweep=_SWEEP, refines=False)
        sought = self._sought(int(rng.integers(2**31)))
        share = _SEARCHING if self.query.descends else 1.0
        reserve = self.path_judging.reserve(self.budget.time_limit)
        with self.budget.share(share * (self.budget.remaining_seconds - reserve)) as part:
            for stage in search_front(sought, settings, self.paths, part, rng):
                if not self.query.descends:
                    self._keep_time_for(self.path_judging, part)
                if callback is not None and callback(self._progress(stage, len(self.paths))):
                    return True
        return False

    def _descend(self, rng: np.random.Generator, callback: Tell | None, stopped: bool) -> list[ParetoPoint]:
        """Fill the archive of motions, and judge them."""
        descents = MotionFront(self.query, self.problem, self.motions, self.points)
        reserve = self.motion_judging.reserve(self.budget.time_limit)
        with self.budget.share(self.budget.remaining_seconds - reserve) as part:
            for stage in descents.fill(self.paths, part, rng, gaps=not stopped):
                self._keep_time_for(self.motion_judging, part)
                if callback is not None and callback(self._progress(stage, len(self.motions))):
                    break
        return self.motion_judging.front(self.budget)

    def _keep_time_for(self, judging: Judging[Any], part: Budget) -> None:
        """Shorten a part of the budget such that all points can be judged, once the time per point is measured."""
        if np.isfinite(self.budget.time_limit) and judging.time_first():
            part.time_limit = self.budget.time_limit - judging.reserve(self.budget.time_limit)

    def _progress(self, stage: str, candidates: int) -> FrontProgress:
        return FrontProgress(time=self.budget.elapsed, stage=stage, candidates=candidates)

    def _sought(self, seed: int) -> FrontProblem:
        problem = self.problem

        def certain(q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
            return problem.kernels.edges_free(q0, q1, FINE_STEP, problem.margin)

        seeds = self._roadmap(problem, seed)
        return FrontProblem(problem=problem, objective_at=self.query.at, certain=certain, seeds=seeds)

    def _roadmap(self, problem: SceneProblem, seed: int) -> Seeds | None:
        """Return a function that builds a roadmap and takes its front: paths of many homotopy classes, not smooth."""
        objective = self.query.request.objective.objective
        if objective.exposure == "waypoints":
            return None  # edges alone have no cost
        goals = problem.goals

        def paths(budget: Budget) -> list[Path]:
            seconds = budget.remaining_seconds
            roadmap = Roadmap.build(
                self.query.request.objective.scene,
                objective=objective,
                nodes=int(np.clip(budget.remaining_iterations / _PER_NODE, 50, _NODES)),
                motions=[(problem.start, goals)],
                constraints=self.query.request.constraints.constraints,
                seed=seed,
                time_limit=seconds if np.isfinite(seconds) else None,
            )
            front = roadmap.front(problem.start, goals, max_points=self.points)
            return [Path(point.q) for point in front]

        return paths

    def _outcome(self, found: tuple[ParetoPoint, ...]) -> tuple[PlanStatus, str]:
        if found:
            return PlanStatus.SOLVED, ""
        if self.refused:
            return PlanStatus.TIMEOUT, f"the judge rejected all {self.refused} paths"
        return PlanStatus.TIMEOUT, f"no path after {self.budget.elapsed:.3f} s"
