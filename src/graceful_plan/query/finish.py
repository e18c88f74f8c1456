"""From motions to a verified one: the judge looks at one after the other, the best first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.judge.verification import Verification, verify
from graceful_plan.query.motions import Motion
from graceful_plan.query.request import Request
from graceful_plan.result import Verdict
from graceful_plan.scene.pose_goal import PoseGoal


@dataclass(frozen=True, kw_only=True)
class Judged:
    """A motion and what the judge says of it."""

    motion: Motion
    verdict: Verdict


def first_verified(motions: Iterable[Motion], request: Request) -> Judged | None:
    """Return the first motion that the judge passes, better without a warning; else the first with his objections.

    None if there are no motions, or there was no time to judge one.
    """
    warned, refused, clock = None, None, request.clock
    for motion in motions:
        if not (clock.has_room("judging") if warned or refused else clock.may_do("judging")):
            break
        with clock.measured("judging"):
            pose, looks = request.pose(motion.arrival), request.verification
            verdict = verdict_of(motion, request.objective, request.constraints, pose, looks)
        judged = Judged(motion=motion, verdict=verdict)
        if judged.verdict.passed and not judged.verdict.warnings:
            return judged
        if judged.verdict.passed:
            warned = warned or judged
        else:
            refused = refused or judged
    return warned or refused


def verdict_of(
    motion: Motion,
    objective: SceneObjective,
    constraints: SceneConstraints,
    pose: PoseGoal | None = None,
    verification: Verification | None = None,
) -> Verdict:
    """Return what the judge says of a motion: from the first to the last vertex of its path, or to a pose."""
    scene, looks = objective.scene, verification or Verification()
    impact, exposure = objective.objective.impact, objective.objective.exposure
    # The judge knows how to recompute the published model over length or time; other costs it takes as they are.
    published = isinstance(impact, ImpactCost) and impact.is_published()
    recomputable = published and not scene.moving and objective.motion_is_length and exposure != "waypoints"
    return verify(
        motion.trajectory,
        scene,
        start=motion.path.q[0],
        goal=motion.path.q[-1] if pose is None else pose,
        cost=motion.cost if recomputable else None,
        components=impact.components if isinstance(impact, ImpactCost) else (),
        exposure=exposure,
        constraints=constraints.constraints,
        step=looks.step,
        clearance=None if looks.everywhere else compile_scene(scene).proof.clearance,
    )
