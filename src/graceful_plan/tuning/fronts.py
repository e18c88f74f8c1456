"""pareto(): the front of motion against impact between two configurations, verified point by point.

Candidates come from minimisations of V + w S for weights up and down, and are refined as a whole, so that the parts of
the front that no weight leads to are found, too (`front_search`, `front_refine`). Every point of the front is timed,
judged and charged anew.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import Objective, SceneObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners import Planner
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.arguments import (
    checked_objective,
    checked_planner,
    checked_seed,
    checked_speed,
    checked_time_limit,
)
from graceful_plan.query.ends import Ends, ways_out
from graceful_plan.query.finish import finish
from graceful_plan.query.goals import Configuration, Goal, resolve_goal, resolve_start
from graceful_plan.query.request import Request
from graceful_plan.result import PlanStatus
from graceful_plan.roadmap import Roadmap
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.tuning.archive import Archive, Candidate
from graceful_plan.tuning.pareto_front import Choice, ChoiceStatus, ParetoFront
from graceful_plan.tuning.points import ParetoPoint, front_of
from graceful_plan.tuning.search import FrontSettings, search_front

__all__ = ["Choice", "ChoiceStatus", "ParetoFront", "ParetoPoint", "Progress", "pareto"]

Array = np.ndarray

_MARGIN = 0.002
"""Clearance to keep [m]."""
_JUDGING = 0.05
"""Seconds that timing and judging a point may take, at first guess."""
_LONGER = 2.5
"""How much longer it takes than for the shortest path."""
_JUDGING_SHARE = 0.35
"""Share of the time limit that is kept for it at most."""
_LATE = 3
"""Candidates that are judged after the time limit if none has passed."""
_NODES = 800
"""Of the roadmap that the search begins with."""
_PER_NODE = 5
"""Iterations that there have to be for each of them."""
MOST_POINTS = 1000


@dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a search for a front has come: seconds since the call, its stage, and the candidates on the front."""

    time: float
    stage: str
    candidates: int


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
    callback: Callable[[Progress], bool | None] | None = None,
) -> ParetoFront:
    """Find the front of motion against impact, to choose a safety weight by what it costs and what it buys.

    Args:
        start: Configuration [rad or m], or the name of a keyframe.
        goal: Configuration, keyframe, several of them, or a `PoseGoal` for the tool.
        scene: Robot, surroundings and what is carried.
        points: Most points of the front; they are picked so that they stand for all that was found.
        planner: Name of a planner or a settings object: minimises V + w S for single weights.
        objective: Motion and impact; its own weight does not matter.
        time_limit: Seconds for the whole call; 10 by default, none if `iterations` is given.
        iterations: Of planner and refinement together; with these alone, the result depends on the seed only.
        seed: Of all random numbers.
        speed: As of `plan`.
        callback: Called now and then; returning True ends the search, what was found is still verified.

    Returns:
        The front; its status is SOLVED if it has a point. Every point passed the independent judge.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside of their range.
    """
    started = time.perf_counter()
    solver, rng = checked_planner(planner), checked_seed(seed)
    limit = checked_time_limit(10.0 if time_limit is None and iterations is None else time_limit, iterations)
    if not (isinstance(points, int | np.integer) and not isinstance(points, bool) and 2 <= points <= MOST_POINTS):
        raise SettingError("points", points, f"a whole number from 2 to {MOST_POINTS}")
    wanted = checked_objective(objective, None, checked_speed(speed))

    def failed(status: PlanStatus, detail: str) -> ParetoFront:
        return ParetoFront(status=status, detail=detail, scene=scene.notes.name)

    resolved_start = resolve_start(start, scene)
    if not len(resolved_start.q):
        return failed(PlanStatus.INVALID_START, resolved_start.detail)
    resolved_goal = resolve_goal(goal, scene, resolved_start.q[0], seed=seed)
    if not len(resolved_goal.q):
        return failed(PlanStatus.INVALID_GOAL, resolved_goal.detail)
    ends = ways_out(resolved_start.q[0], resolved_goal.q, compile_scene(scene), scene, rng)
    if not isinstance(ends, Ends):
        return failed(ends.status, ends.detail)
    tuner = _Tuner(ends, wanted, scene, solver, int(points), goal, speed, Budget(limit, iterations, started=started))
    try:
        return tuner.front(rng, callback)
    except NonFiniteCostError as error:
        return failed(PlanStatus.NONFINITE, str(error))


class _Tuner:
    """One search for a front."""

    def __init__(
        self,
        ends: Ends,
        objective: Objective,
        scene: Scene,
        planner: Planner,
        points: int,
        goal: Goal,
        speed: float,
        budget: Budget,
    ) -> None:
        self.ends, self.objective, self.scene, self.planner = ends, objective, scene, planner
        self.points, self.speed, self.budget = points, speed, budget
        self.pose = goal if isinstance(goal, PoseGoal) else None
        self.archive = Archive()
        self.passed: dict[int, ParetoPoint] = {}
        """Points by the identity of their candidates, which `kept` keeps alive."""
        self.kept: list[Candidate] = []
        self.refused = 0

    def at(self, w: float) -> SceneObjective:
        """The objective with another weight."""
        return self.objective.with_weight(w).bind(self.scene)

    def front(self, rng: np.random.Generator, callback: Callable[[Progress], bool | None] | None) -> ParetoFront:
        """Search, then judge."""
        limit = self.budget.time_limit
        self.budget.time_limit -= min(_JUDGING * self.points, _JUDGING_SHARE * limit)
        margin = min(_MARGIN, 0.5 * self.ends.clearance)
        problem = SceneProblem(
            kernels=self.ends.compiled.kernels,
            start=self.ends.departure.q[-1],
            goals=np.stack([arrival.q[0] for arrival in self.ends.arrivals]),
            margin=margin,
        )

        def certain(q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
            return problem.kernels.edges_free(q0, q1, FINE_STEP, margin)

        settings = FrontSettings(planner=self.planner, capacity=max(8, self.points))
        seeds = self._roadmap(problem, int(rng.integers(2**31)))
        for stage in search_front(problem, self.at, certain, settings, self.budget, rng, self.archive, seeds):
            if not self.passed and len(self.archive) and np.isfinite(limit):
                self.budget.time_limit = limit - self._reserve(limit)
            now = Progress(time=self.budget.elapsed, stage=stage, candidates=len(self.archive))
            if callback is not None and callback(now):
                break
        searched = self.budget.elapsed
        self.budget.time_limit = limit
        found = front_of(self._judged())
        stats = {
            "search_time": searched,
            "total_time": self.budget.elapsed,
            "iterations": float(self.budget.spent),
            "candidates": float(len(self.archive)),
            "refused": float(self.refused),
        }
        status, detail = self._outcome(found)
        return ParetoFront(status=status, points=found, detail=detail, scene=self.scene.notes.name, stats=stats)

    def _reserve(self, limit: float) -> float:
        """Judge the shortest path to see how long that takes here and now; return what to keep for all points [s]."""
        began, shortest = time.perf_counter(), self.archive.candidates[0]
        point = self._point(shortest, self.at(self.objective.w))
        if point is not None:
            self.passed[id(shortest)] = point
            self.kept.append(shortest)
        # Paths around something have more corners to time and more places to look at than the shortest.
        each = max(_JUDGING, _LONGER * (time.perf_counter() - began))
        return min(each * self.points, _JUDGING_SHARE * limit)

    def _roadmap(self, problem: SceneProblem, seed: int) -> Callable[[float], list[Path]] | None:
        """Make what builds a roadmap for these ends and takes its front: paths of many classes, none of them smooth."""
        if self.objective.exposure == "waypoints":
            return None  # edges have no price of their own
        goals = problem.goals

        def paths(seconds: float) -> list[Path]:
            limit = seconds if np.isfinite(seconds) else None
            roadmap = Roadmap.build(
                self.scene,
                objective=self.objective,
                nodes=int(np.clip(self.budget.remaining_iterations / _PER_NODE, 50, _NODES)),
                motions=[(problem.start, goals)],
                seed=seed,
                time_limit=limit,
            )
            front = roadmap.front(problem.start, goals, max_points=self.points)
            return [Path(point.q) for point in front]

        return paths

    def _outcome(self, found: tuple[ParetoPoint, ...]) -> tuple[PlanStatus, str]:
        if found:
            return PlanStatus.SOLVED, ""
        if self.refused:
            return PlanStatus.TIMEOUT, f"the judge refused all {self.refused} paths that it was shown"
        status = PlanStatus.TIMEOUT if self.budget.exhausted else PlanStatus.INFEASIBLE
        return status, f"no path after {self.budget.elapsed:.3f} s"

    def _judged(self) -> list[ParetoPoint]:
        """Time and judge the candidates that stand for all best; others take the place of those that are refused."""
        passed, plain = self.passed, self.at(self.objective.w)
        while True:
            chosen = self.archive.chosen(self.points)
            # From coarse to fine: whenever time is over, what was judged covers the front.
            waiting = [chosen[i] for i in _spread(len(chosen)) if id(chosen[i]) not in passed]
            if not waiting:
                break
            for candidate in waiting:
                if self.budget.elapsed >= self.budget.time_limit and (passed or self.refused >= _LATE):
                    return list(passed.values())
                point = self._point(candidate, plain)
                if point is None:
                    self.archive.drop(candidate)
                    self.refused += 1
                    break
                passed[id(candidate)] = point
                self.kept.append(candidate)
        return [passed[id(candidate)] for candidate in self.archive.chosen(self.points)]

    def _point(self, candidate: Candidate, objective: SceneObjective) -> ParetoPoint | None:
        """Time, judge and charge a candidate; None if the judge refuses it."""
        whole, index = self.ends.joined(Path(candidate.q))
        request = Request(planner=self.planner, objective=objective, pose=self.pose, speed=self.speed)
        done = finish(whole, request, self.ends.in_the_clear(index))
        if done.trajectory is None or not done.verdict.passed:
            return None
        return ParetoPoint(
            path=whole,
            trajectory=done.trajectory,
            cost=done.cost,
            verdict=done.verdict,
            made_by=candidate.made_by,
            made_with=candidate.made_with,
        )


def _spread(n: int) -> list[int]:
    """Order 0 to n - 1: both ends, then the middle, then the middles of the halves, and so on."""
    order, step = [0, n - 1] if n > 1 else list(range(n)), 1
    while len(order) < n:
        step *= 2
        order += [i for i in (round((n - 1) * k / step) for k in range(1, step, 2)) if i not in order]
    return order
