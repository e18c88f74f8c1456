"""When to go and which way, if somebody moves: candidates of a search are timed, and the best by its times is taken.

A search knows no times. So it looks for paths as if nobody moved, and from the best of these local moves look for paths
of less J where moving entities are anywhere along their predicted paths. What was found by both is timed, each with
several times of departure, and the path and departure of least J at these times are taken: what lies between these, or
beyond, is not considered.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.cost import StateBatch, checked_state
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.costs.still import still_objective
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.questions import Questions
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.shortcut import Shortcut
from graceful_plan.query.candidates.search import ALL, Search, is_solution, search, thinned
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import CostBreakdown
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

WAIT_STEP = 0.25
"""Times of departure that are tried are so far apart [s], or farther if that would be more than `MOST_WAITS`."""
MOST_WAITS = 16
WORTH = 0.01
"""A wait has to lower J by more than this share of it for all that a shorter one does."""
_PIECES = 60  # of a coarse trajectory
_STILL = 0.6
"""Share of the budget for the search as if nobody moved."""


def waits(max_wait: float) -> Float[Array, " wait"]:
    """Return the waiting times to try [s], from 0."""
    count = int(np.clip(np.ceil(max_wait / WAIT_STEP), 0, MOST_WAITS))
    return np.linspace(0.0, max_wait, count + 1)


def best_departure(
    trajectory: Trajectory, objective: SceneObjective, max_wait: float = 0.0
) -> tuple[Trajectory, CostBreakdown]:
    """Return a trajectory with the wait at its start that pays, and its cost at its times.

    Args:
        trajectory: Without a wait.
        objective: In a scene where something moves.
        max_wait: Longest wait [s].
    """
    wait = _best_wait(trajectory, objective, max_wait)[0] if max_wait > 0.0 else 0.0
    delayed = trajectory.delayed(wait)
    return delayed, objective.breakdown(delayed)


def _best_wait(trajectory: Trajectory, objective: SceneObjective, max_wait: float) -> tuple[float, float]:
    """Return the wait that pays [s], and J after it but for the motion, which no wait changes."""
    tried = waits(max_wait)
    trajectory = trajectory.sample(max(trajectory.duration / _PIECES, 1e-3))
    charged, impact, w = objective.charged_states(trajectory), objective.objective.impact, objective.w
    assert charged.batch.time is not None
    totals = [
        w * float(charged.weight @ checked_state(impact, charged.batch.at(charged.batch.time + t))) for t in tried
    ]
    if objective.objective.exposure == "time" and len(tried) > 1:  # failures while it waits
        start = np.repeat(trajectory.q[:1], len(tried), axis=0)
        rest = checked_state(impact, StateBatch(objective.scene, start, time=trajectory.t[0] + tried))
        totals = totals + w * np.append(0.0, np.cumsum(0.5 * (rest[1:] + rest[:-1]) * np.diff(tried)))
    totals = np.array(totals)
    chosen = int(np.argmax(totals <= totals.min() + WORTH * (trajectory.path.length + totals.min())))
    return float(tried[chosen]), float(totals[chosen])


def search_among_moving(
    request: Request, problem: SceneProblem, ends: Endpoints, budget: Budget, rng: np.random.Generator
) -> Search:
    """Search as if nobody moved, improve what was found by J among moving entities, and order by J at its times.

    The trace is of the search as if nobody moved. The best path is at the end.
    """
    planner, objective = request.planner, request.objective
    still, among_still = without_moving(request, problem)
    with budget.share(_STILL * budget.remaining_seconds, _STILL * budget.remaining_iterations) as part:
        found = search(planner, among_still, still, part, rng, kept=ALL)
    paths = list(found.paths)
    if paths and objective.w > 0.0:
        better = Shortcut().improve(paths[-1], Questions(problem, objective, budget), budget, rng)
        paths += [path for path in better if is_solution(path, problem)]
    choice = _Choice(ends, objective, request.speed, request.max_wait)
    deadline = -np.inf if budget.cancelled() else budget.started + budget.time_limit
    found.paths = choice.ordered(paths, len(found.paths) - 1, deadline)
    return found


def without_moving(request: Request, problem: SceneProblem) -> tuple[SceneObjective, SceneProblem]:
    """Return objective and problem of a search in the scene without moving entities: a search knows no times."""
    still = still_objective(request.objective)
    held = request.constraints.on(still.scene)
    return still, replace(problem, kernels=held.kernels, constraints=held)


@dataclass(frozen=True)
class _Choice:
    """By what paths are compared: J at the departure that pays, on a coarse trajectory."""

    ends: Endpoints
    objective: SceneObjective
    speed: float
    max_wait: float

    def ordered(self, paths: Sequence[Path], still: int, deadline: float) -> list[Path]:
        """Return some improvements in the order of J, the best at the end; not all of them if time is short.

        Args:
            paths: In the order in which they were found.
            still: Index of the best as if nobody moved.
            deadline: Clock reading after which no more are looked at [s].
        """
        order = thinned(len(paths))
        if order:
            order.insert(1, still)
        totals: dict[int, float] = {}
        for index in dict.fromkeys(order):
            if len(totals) < 2 or time.perf_counter() < deadline:
                totals[index] = self._total(paths[index])
        return [paths[index] for index in sorted(totals, key=lambda index: -totals[index])]

    def _total(self, path: Path) -> float:
        whole, scene = self.ends.joined(path)[0], self.objective.scene
        try:
            timed = retime(whole, scene.limits, scene.joints, speed=self.speed)
        except RetimingError:
            return np.inf
        motion = float(self.objective.edges(whole.q[:-1], whole.q[1:])[:, 0].sum())
        return motion + _best_wait(timed, self.objective, self.max_wait)[1]
