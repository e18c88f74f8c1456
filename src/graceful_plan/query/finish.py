"""From a path to a verified trajectory: time it, judge it, and cut corners less where the judge objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import RetimingError
from graceful_plan.judge.verification import verify
from graceful_plan.path import Path
from graceful_plan.query.arguments import FAILURE_AWARE, checked_speed
from graceful_plan.query.departure import best_departure
from graceful_plan.result import CostBreakdown, Verdict
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory

DEVIATIONS = (0.1, 0.03, 0.01, 0.0)
"""How far the motion may cut the path's corners [rad], from swift to exact; 0 stops at every corner."""


@dataclass(frozen=True, kw_only=True)
class Finished:
    """A timed path and what the judge says of it."""

    trajectory: Trajectory | None
    cost: CostBreakdown
    verdict: Verdict
    problem: str = ""
    """Why there is no trajectory."""


def finish(
    path: Path,
    scene: Scene,
    objective: SceneObjective,
    goal: PoseGoal | None = None,
    speed: float | str = 1.0,
    in_the_clear: bool = True,
    max_wait: float = 0.0,
) -> Finished:
    """Time and judge a path.

    Args:
        path: What a planner found, with ways out at both ends.
        scene: The scene.
        objective: What it was planned for.
        goal: The pose to be reached, if that was the goal.
        speed: In (0, 1]: fraction of the velocity limits to use; or "failure_aware".
        in_the_clear: Whether the fast checker calls the whole path free, so that it can tell which corners not to cut.
        max_wait: Longest wait at the start if something moves [s].
    """
    cost = objective.breakdown(path)
    verdict, problem, trajectory = Verdict(), "", None
    for deviation in DEVIATIONS:
        try:
            timed = retime(path, scene.limits, scene.joints, deviation=deviation, speed=checked_speed(speed))
        except RetimingError as error:
            problem = str(error)
            continue
        if in_the_clear and deviation > 0.0 and not _keeps_clear(timed, objective):
            continue
        if speed == FAILURE_AWARE:  # the same curve, so what was timed before can be timed now
            # Without those who move: where they are depends on the times that are to be found.
            still = SceneObjective(objective.objective, scene.without_moving()) if scene.moving else objective
            timed = retime(path, scene.limits, scene.joints, deviation=deviation, impact=still.states, w=objective.w)
        trajectory = timed
        if scene.moving:
            trajectory, cost = best_departure(timed, objective, max_wait)
        elif objective.objective.exposure == "time":
            cost = objective.breakdown(trajectory)
        verdict = _judge(trajectory, path, scene, objective, cost, goal)
        if verdict.passed or "collision" not in verdict.failures:
            break
    return Finished(trajectory=trajectory, cost=cost, verdict=verdict, problem=problem)


def _keeps_clear(trajectory: Trajectory, objective: SceneObjective) -> bool:
    samples = trajectory.sample(max(trajectory.duration / 1000.0, 1e-3)).q
    return bool(np.all(objective.kernels.free(samples)))


def _judge(
    trajectory: Trajectory,
    path: Path,
    scene: Scene,
    objective: SceneObjective,
    cost: CostBreakdown,
    goal: PoseGoal | None,
) -> Verdict:
    impact = objective.objective.impact
    # The judge knows how to recompute the published model over the joint length; other costs it takes as they are.
    still = not scene.moving and objective.kernel is not None
    recomputable = still and isinstance(impact, ImpactCost) and impact.is_published()
    return verify(
        trajectory,
        scene,
        start=path.q[0],
        goal=path.q[-1] if goal is None else goal,
        cost=cost if recomputable else None,
        cost_path=path if recomputable else None,
        components=impact.components if isinstance(impact, ImpactCost) else (),
    )
