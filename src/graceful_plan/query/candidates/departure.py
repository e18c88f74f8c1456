"""Choice of path and departure time among moving entities.

A search has no times, so it ignores moving entities. Local moves then improve its best path by a J in which each
entity may be anywhere along its predicted path. Paths of both stages are timed with several departure times, and the
pair of path and departure time with the least J is selected. Other paths and departure times are not considered.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import StateBatch, checked_state
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.costs.static_objective import static_objective
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.shortcut import Shortcut
from graceful_plan.query.candidates.search import ALL, Search, is_solution, search, subsampled
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory

WAIT_STEP = 0.25
"""Step between candidate departure times [s]; larger if there would be more than `MOST_WAITS` steps."""
MOST_WAITS = 16
WORTH = 0.01
"""Share of J by which a longer wait has to be better than a shorter one."""
_PIECES = 60  # samples of the coarse trajectory that waits are compared on
_STILL = 0.6
"""Share of the budget for the search without moving entities."""


def waits(max_wait: float) -> Float[Array, " wait"]:
    """Return the waiting times to try [s], from 0."""
    count = int(np.clip(np.ceil(max_wait / WAIT_STEP), 0, MOST_WAITS))
    return np.linspace(0.0, max_wait, count + 1)


def with_best_departure(
    trajectory: Trajectory, objective: SceneObjective, max_wait: float = 0.0
) -> tuple[Trajectory, CostBreakdown]:
    """Return a trajectory with the best wait at its start, and its cost.

    Args:
        trajectory: Trajectory without a wait.
        objective: Objective in a scene with moving entities.
        max_wait: Longest wait [s].
    """
    wait = _best_wait(trajectory, objective, max_wait)[0] if max_wait > 0.0 else 0.0
    delayed = trajectory.delayed(wait)
    return delayed, objective.breakdown(delayed)


def _best_wait(trajectory: Trajectory, objective: SceneObjective, max_wait: float) -> tuple[float, float]:
    """Return the best wait [s], and w S with this wait; the motion cost does not depend on the wait."""
    tried = waits(max_wait)
    trajectory = trajectory.sample(max(trajectory.duration / _PIECES, 1e-3))
    samples, impact, w = objective.cost_samples(trajectory), objective.objective.impact, objective.w
    assert samples.batch.time is not None
    totals = [
        w * float(samples.weight @ checked_state(impact, samples.batch.at(samples.batch.time + t))) for t in tried
    ]
    if objective.objective.exposure == "time" and len(tried) > 1:  # failures during the wait
        start = np.repeat(trajectory.q[:1], len(tried), axis=0)
        rest = checked_state(impact, StateBatch(objective.scene, start, time=trajectory.t[0] + tried))
        totals = totals + w * np.append(0.0, np.cumsum(0.5 * (rest[1:] + rest[:-1]) * np.diff(tried)))
    totals = np.array(totals)
    chosen = int(np.argmax(totals <= totals.min() + WORTH * (trajectory.path.length + totals.min())))
    return float(tried[chosen]), float(totals[chosen])


def search_with_moving_entities(
    request: Request, problem: SceneProblem, ends: Endpoints, budget: Budget, rng: np.random.Generator
) -> Search:
    """Search without moving entities, improve the best path by J with them, and order the paths by their timed J.

    The best path is the last one. The trace is that of the search without moving entities.
    """
    planner, objective = request.planner, request.objective
    still, among_still = without_moving(request, problem)
    with budget.share(_STILL * budget.remaining_seconds, _STILL * budget.remaining_iterations) as part:
        found = search(planner, among_still, still, part, rng, kept=ALL)
    paths = list(found.paths)
    if paths and objective.w > 0.0:
        better = Shortcut().improve(paths[-1], InterruptibleProblem(problem, objective, budget), budget, rng)
        paths += [path for path in better if is_solution(path, problem)]
    choice = _Choice(ends, objective, request.speed, request.max_wait)
    deadline = -np.inf if budget.cancelled() else budget.started + budget.time_limit
    found.paths = choice.ordered(paths, len(found.paths) - 1, deadline)
    return found


def without_moving(request: Request, problem: SceneProblem) -> tuple[SceneObjective, SceneProblem]:
    """Return objective and problem in the scene without its moving entities, since a search has no times."""
    still = static_objective(request.objective)
    held = request.constraints.on(still.scene)
    return still, replace(problem, kernels=held.kernels, constraints=held)


def at_time(scene: Scene, seconds: float) -> Scene:
    """Return a scene on the clock of a motion that starts at a time [s]: predictions are shifted to earlier times."""
    if not scene.moving or seconds == 0.0:
        return scene
    return scene.with_moving(*(entity.later(-seconds) for entity in scene.moving.values()))


@dataclass(frozen=True)
class _Choice:
    """Compares paths by J at their best departure time, on a coarse trajectory."""

    ends: Endpoints
    objective: SceneObjective
    speed: float
    max_wait: float

    def ordered(self, paths: Sequence[Path], still: int, deadline: float) -> list[Path]:
        """Return a subsample of the paths by descending J, the best at the end; fewer of them if time is short.

        Args:
            paths: Paths in the order in which they were found.
            still: Index of the best path without moving entities.
            deadline: Clock reading after which only two paths are evaluated [s].
        """
        order = subsampled(len(paths))
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
