"""From a path to a verified trajectory: time it, judge it, and cut corners less where the judge objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import RetimingError
from graceful_plan.judge.verification import verify
from graceful_plan.path import Path
from graceful_plan.query.departure import best_departure
from graceful_plan.query.request import Request
from graceful_plan.result import CostBreakdown, Verdict
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


def finish(path: Path, request: Request, in_the_clear: bool = True) -> Finished:
    """Time and judge a path.

    Args:
        path: What a planner found, with ways out at both ends.
        request: What it was planned for.
        in_the_clear: Whether the fast checker calls the whole path free, so that it can tell which corners not to cut.
    """
    objective, scene = request.objective, request.objective.scene
    cost = objective.breakdown(path)
    verdict, problem, trajectory = Verdict(), "", None
    for deviation in DEVIATIONS:
        try:
            timed = retime(path, scene.limits, scene.joints, deviation=deviation, speed=request.speed)
        except RetimingError as error:
            problem = str(error)
            continue
        if in_the_clear and deviation > 0.0 and not _keeps_clear(timed, objective):
            continue
        trajectory = timed
        if scene.moving:
            trajectory, cost = best_departure(timed, objective, request.max_wait)
        elif objective.objective.exposure == "time":
            cost = objective.breakdown(trajectory)
        verdict = _judge(trajectory, path, cost, request)
        if verdict.passed or "collision" not in verdict.failures:
            break
    return Finished(trajectory=trajectory, cost=cost, verdict=verdict, problem=problem)


def _keeps_clear(trajectory: Trajectory, objective: SceneObjective) -> bool:
    samples = trajectory.sample(max(trajectory.duration / 1000.0, 1e-3)).q
    return bool(np.all(objective.kernels.free(samples)))


def _judge(trajectory: Trajectory, path: Path, cost: CostBreakdown, request: Request) -> Verdict:
    objective, scene = request.objective, request.objective.scene
    impact = objective.objective.impact
    # The judge knows how to recompute the published model over the joint length; other costs it takes as they are.
    still = not scene.moving and objective.kernel is not None
    recomputable = still and isinstance(impact, ImpactCost) and impact.is_published()
    return verify(
        trajectory,
        scene,
        start=path.q[0],
        goal=path.q[-1] if request.pose is None else request.pose,
        cost=cost if recomputable else None,
        cost_path=path if recomputable else None,
        components=impact.components if isinstance(impact, ImpactCost) else (),
    )
