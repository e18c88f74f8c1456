"""Motions through intermediate poses: planned leg by leg, then joined into one motion without stops.

Each leg is planned from rest to rest. A smooth curve through points on all legs, including the intermediate ones, then
passes them at speed. With a smaller spacing of these points, the curve stays closer to the legs but turns more sharply
between them. Curves of several spacings are compared by J. If the judge passes none of them, the legs are executed one
after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import RetimingError
from graceful_plan.judge.passing import passing
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget
from graceful_plan.query.candidates.departure import at_time
from graceful_plan.query.candidates.motions import Motion, with_cost
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.goals import Goal, poses_of
from graceful_plan.query.request import Request
from graceful_plan.query.verification import verdict_of
from graceful_plan.query.via.stages import Stages, find_stages
from graceful_plan.result import CostBreakdown, PlanResult, PlanStatus, TracePoint, Verdict
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.trajectory import Trajectory

_SPACINGS = (0.8, 0.4, 0.2, 0.1, 0.05)
"""Spacings of points of a curve, along the legs [rad]."""
_FEWEST = 2
"""Least number of pieces of a leg."""
_LOOKED_AT = 0.02
"""Spacing of configurations that the fast checker tests on a curve [rad]."""
_MOST_JUDGED = 4
"""Largest number of curves that the judge verifies."""
_JOINING = 0.2
"""Share of the time budget that is reserved for joining the legs and verifying the result."""
_LEAST = 0.2
"""Share of the legs' time that is divided evenly; the rest is divided by their lengths."""


@runtime_checkable
class Leg(Protocol):
    """Plans one leg, as `plan` does."""

    def __call__(
        self, start: Float[Array, " nq"], goal: Goal, *, scene: Scene, time_limit: float | None, iterations: int | None
    ) -> PlanResult:
        """Plan from a configuration to a goal, in a scene on the leg's own clock, within a budget."""
        ...


def plan_through(
    stops: tuple[Configuration, Sequence[Float[Array, " nq"] | PoseGoal], Goal],
    leg: Leg,
    request: Request,
    budget: Budget,
    seed: int = 0,
) -> PlanResult:
    """Plan a motion from a start through intermediate poses to a goal.

    Args:
        stops: The start, the intermediate stops (see `checked_via`), and the goal.
        leg: Plans from one stop to the next.
        request: The request for the whole motion.
        budget: Budget of the call.
        seed: Seed of the random numbers of inverse kinematics.
    """
    stages = find_stages(*stops, request.objective, seed)
    if isinstance(stages, PlanResult):
        return stages
    legs = _legs(stages, leg, request.objective.scene, budget)
    if isinstance(legs, PlanResult):
        result = legs
    else:
        asked = replace(request, poses=poses_of(stages.goal, (legs[-1].goal_index or 0,)))
        result = _Joining(stages, asked, budget).joined(legs)
    detail = "; ".join([*stages.notes, *([result.detail] if result.detail else [])])
    return replace(result, detail=detail, stats={**result.stats, "total_time": budget.elapsed})


def _legs(stages: Stages, leg: Leg, scene: Scene, budget: Budget) -> list[PlanResult] | PlanResult:
    """Return a motion for each leg, or a result that names the leg that failed.

    A leg meets moving entities where they are once the legs before it, from rest to rest, have ended.
    """
    legs: list[PlanResult] = []
    begins = 0.0
    chosen = stages.chosen()
    lengths = np.array([np.linalg.norm(b - a) for a, b in pairwise(chosen)])
    shares = _LEAST / len(lengths) + (1.0 - _LEAST) * lengths / max(lengths.sum(), 1e-12)
    shares = shares / shares.sum()
    seconds = (1.0 - _JOINING) * budget.remaining_seconds
    at = chosen[0]
    for k, share in enumerate(shares):
        last = k == len(shares) - 1
        limits = {
            "time_limit": None if np.isinf(seconds) else share * seconds,
            "iterations": None if budget.iterations is None else max(1, int(share * budget.iterations)),
            "scene": at_time(scene, begins),
        }
        result = leg(at, stages.goal if last else chosen[k + 1], **limits)
        others = stages.usable[k + 1]
        if result.status is not PlanStatus.SOLVED and not last and len(others) > 1 and not budget.cancelled():
            result = leg(at, others, **limits)
        if result.trajectory is None:
            return _not_solved(result, k, len(shares))
        legs.append(result)
        at, begins = result.trajectory.q[-1], begins + result.trajectory.duration
    return legs


def _not_solved(result: PlanResult, k: int, count: int) -> PlanResult:
    ends = ("the start" if k == 0 else f"via {k - 1}", "the goal" if k == count - 1 else f"via {k}")
    # The start of a later leg is not the start that the user gave.
    status = PlanStatus.INVALID_GOAL if k and result.status is PlanStatus.INVALID_START else result.status
    detail = f"from {ends[0]} to {ends[1]}: {result.detail or result.status.value}"
    return PlanResult(status=status, detail=detail, verdict=result.verdict, stats=result.stats)


@dataclass(frozen=True, eq=False)
class _Joining:
    """Joins legs into one motion."""

    stages: Stages
    request: Request
    budget: Budget

    def joined(self, legs: Sequence[PlanResult]) -> PlanResult:
        """Return the cheapest curve that the judge passes; if there is none, the legs one after the other."""
        trajectories = [leg.unwrap() for leg in legs]
        clear, others, why = [], [], ""
        held = self.request.constraints
        for spacing in _SPACINGS:
            curve = _through([trajectory.path for trajectory in trajectories], spacing)
            if curve is None:
                continue
            try:
                motion = self._costed(held.timed(curve, speed=self.request.speed))
            except RetimingError as error:
                why = str(error)
                continue
            (clear if self._is_clear(curve) else others).append(motion)
        # Where the fast checker finds no curve free, those with the smallest spacing are the most likely to be free.
        smooth = [*sorted(clear, key=lambda motion: motion.ranking), *reversed(others)][:_MOST_JUDGED]
        stopping = self._costed(one_after_the_other(trajectories))
        refused: Verdict | None = None
        for motion in (*smooth, stopping):
            verdict = self._verdict(motion)
            if verdict.passed:
                note = "" if motion is not stopping else f"it stops at each pose on the way{f' ({why})' if why else ''}"
                return self._solved(motion, verdict, legs, note)
            refused = refused or verdict
        verdict = refused or Verdict()
        told = "; ".join(f"{name}: {verdict.checks[name].detail}" for name in verdict.failures)
        detail = f"the judge refused the motion as a whole: {told}"
        return PlanResult(status=PlanStatus.TIMEOUT, detail=detail, verdict=verdict)

    def _costed(self, trajectory: Trajectory) -> Motion:
        bare = Motion(path=trajectory.path, trajectory=trajectory, cost=CostBreakdown(), arrival=0, ranking=np.inf)
        return with_cost(bare, self.request)

    def _is_clear(self, curve: Spline) -> bool:
        n = 2 + int(Path(curve.controls).length / _LOOKED_AT)
        q, scene = curve.at(np.linspace(0.0, curve.spans, n)), self.request.objective.scene
        lower, upper = scene.limits.position.T
        return bool(((q >= lower) & (q <= upper)).all() and self.request.constraints.kernels.free(q).all())

    def _verdict(self, motion: Motion) -> Verdict:
        asked, scene = self.request, self.request.objective.scene
        verdict = verdict_of(motion, asked.objective, asked.constraints, asked.pose(0), asked.verification)
        checks = dict(verdict.checks)
        checks["via"], _ = passing(motion.trajectory, self.stages.wanted, scene)
        return Verdict(checks=checks)

    def _solved(self, motion: Motion, verdict: Verdict, legs: Sequence[PlanResult], note: str) -> PlanResult:
        cost = motion.cost
        point = TracePoint(time=self.budget.elapsed, total=cost.total, motion=cost.motion, impact=cost.impact)
        if self.request.callback is not None:
            self.request.callback(point)
        iterations = sum(leg.stats.get("iterations", 0.0) for leg in legs)
        return PlanResult(
            status=PlanStatus.SOLVED,
            path=motion.path,
            trajectory=motion.trajectory,
            cost=cost,
            verdict=verdict,
            trace=(point,),
            detail=note,
            goal_index=legs[-1].goal_index,
            stats={"iterations": iterations},
        )


def _through(legs: Sequence[Path], spacing: float) -> Spline | None:
    """Return a curve through points on the legs, including their ends; None if there are fewer than four points."""
    points = [legs[0].q[:1]]
    for leg in legs:
        if leg.length > 0.0:
            done = np.concatenate([[0.0], np.cumsum(leg.segment_lengths)])
            n = max(_FEWEST, int(np.ceil(leg.length / spacing)))
            at = np.linspace(0.0, done[-1], n + 1)[1:]
            inner = np.stack([np.interp(at[:-1], done, column) for column in leg.q.T], axis=1)
            points += [inner, leg.q[-1:]]
    q = np.concatenate(points)
    return Spline.through(q) if len(q) >= 4 else None


def one_after_the_other(trajectories: Sequence[Trajectory]) -> Trajectory:
    """Concatenate trajectories; each ends at rest where the next one begins."""
    whole = trajectories[0]
    for after in trajectories[1:]:
        if len(after) == 1:
            continue
        t = np.concatenate([whole.t[:-1], whole.t[-1] + after.t - after.t[0]])
        q, qd, qdd = (np.concatenate([getattr(whole, x)[:-1], getattr(after, x)]) for x in ("q", "qd", "qdd"))
        whole = Trajectory(t, q, qd, qdd, whole.joints)
    return whole
