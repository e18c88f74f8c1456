"""Verification of motions: every motion that `plan` returns has passed the independent judge."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.judge.verification import VerificationSettings, verify
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.endpoints.lead_in import LeadIn, RunIn, Takeover
from graceful_plan.query.request import Request
from graceful_plan.result import Verdict
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.timing.trajectory import State


@dataclass(frozen=True, kw_only=True)
class VerifiedMotion:
    """A motion and the judge's verdict on it."""

    motion: Motion
    verdict: Verdict


def judged(motion: Motion, request: Request) -> VerifiedMotion:
    """Verify a motion of a request."""
    pose = request.pose(motion.arrival)
    verdict = verdict_of(
        motion,
        request.objective,
        request.constraints,
        pose,
        request.verification,
        request.lead,
        request.takeover,
        request.run_in,
    )
    return VerifiedMotion(motion=motion, verdict=verdict)


def first_verified(motions: Iterable[Motion], request: Request) -> VerifiedMotion | None:
    """Return the first motion that passes the judge, else the first one with its violations; None without motions."""
    refused: VerifiedMotion | None = None
    for motion in motions:
        found = judged(motion, request)
        if found.verdict.passed:
            return found
        refused = refused or found
    return refused


def verdict_of(
    motion: Motion,
    objective: SceneObjective,
    constraints: SceneConstraints,
    pose: PoseGoal | None = None,
    verification: VerificationSettings | None = None,
    lead: LeadIn | None = None,
    takeover: Takeover | None = None,
    run_in: RunIn | None = None,
) -> Verdict:
    """Verify that a motion goes from the first vertex of its path to the last, or to a pose if one is given.

    Args:
        motion: The motion.
        objective: Objective and scene.
        constraints: Constraints along the motion.
        pose: Pose of the tool at the end; None: the end of the path.
        verification: Resolution of the judge.
        lead: Lead-in of a moving start; None: the motion starts at rest.
        takeover: The motion that the robot leaves at the start; None: it has rested.
        run_in: Run-in of a moving goal; None: the motion ends at rest.
    """
    end = motion.path.q[-1] if run_in is None else State(motion.path.q[-1], run_in.velocity)
    scene, looks = objective.scene, verification or VerificationSettings()
    impact, exposure = objective.objective.impact, objective.objective.exposure
    # The judge can recompute only the published model, over length or time: it has no second implementation of others.
    published = isinstance(impact, ImpactCost) and impact.is_published()
    recomputable = published and not scene.moving and objective.motion_is_length and exposure != "waypoints"
    return verify(
        motion.trajectory,
        scene,
        start=motion.path.q[0] if lead is None else State(motion.path.q[0], lead.velocity),
        before=None if takeover is None else takeover.before,
        goal=end if pose is None else pose,
        cost=motion.cost if recomputable else None,
        components=impact.components if isinstance(impact, ImpactCost) else (),
        exposure=exposure,
        constraints=constraints.constraints,
        step=looks.step,
        clearance=None if looks.everywhere else compile_scene(scene).proof.clearance,
    )
