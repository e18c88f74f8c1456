"""The start of a real robot: a little outside of a limit or in a grazing contact, or several turns away.

Robots report positions some milliradians beyond a limit, or stop in a contact with a surface. The motion then begins
with a short first piece, from rest to rest, that leads back to where planning is possible. Hinges without limits are
planned within a turn; whole turns of the start are added to the motion again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import RetimingError
from graceful_plan.judge.exact import state_contacts
from graceful_plan.judge.verification import GRAZING_SHARE, VerificationSettings, verify
from graceful_plan.path import Path
from graceful_plan.query.base_planning import base_planning
from graceful_plan.query.endpoints.escape import ascend
from graceful_plan.query.endpoints.lead_in import Takeover
from graceful_plan.query.endpoints.usable import CLAMPED
from graceful_plan.query.request import Request
from graceful_plan.query.via.legs import one_after_the_other
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import State, Trajectory

START_TOLERANCE = 0.005
"""Default for the largest distance outside of a limit that a start may have [rad or m]: resolution and backlash of
encoders, and the deviation of a controller that holds its position."""
_INWARDS = 2e-5
"""Distance inside of a limit where the first piece ends [rad or m]: timing merges points that are nearer than 1e-5."""
_ATTEMPTS = 4
"""Number of attempts to leave a grazing contact."""


@dataclass(frozen=True, eq=False)
class RealStart:
    """Where planning begins, and what to add to the motion found."""

    q: Float[Array, " nq"]
    """Start for planning."""
    turns: Float[Array, " nq"]
    """Whole turns between it and the given start [rad]; 0 for most joints."""
    first: Trajectory | None = None
    """Motion from the given start, less these turns, to the start for planning; None if they are the same."""
    tolerance: float = 0.0
    note: str = ""
    takeover: Takeover | None = None
    """The motion that the robot leaves, less these turns; None if it is not known."""
    passes: bool = False
    """Whether `first` is the stop of a moving base, at whose end the motion need not rest."""

    def completed(self, result: PlanResult, request: Request) -> PlanResult:
        """Return the result, and its candidates, with the first piece and the whole turns."""
        found = [self._completed(candidate, request) for candidate in result.candidates]
        solved = tuple(candidate for candidate in found if candidate.status is PlanStatus.SOLVED)
        return self._completed(replace(result, candidates=solved), request)

    def _completed(self, result: PlanResult, request: Request) -> PlanResult:
        if result.trajectory is None or result.path is None:
            return result
        if self.first is not None:
            result = self._with_first(result, request)
        if not self.turns.any() or result.trajectory is None or result.path is None:
            return result
        motion = result.trajectory
        turned = Trajectory(motion.t, motion.q + self.turns, motion.qd, motion.qdd, motion.joints)
        return replace(result, path=Path(result.path.q + self.turns), trajectory=turned)

    def _with_first(self, result: PlanResult, request: Request) -> PlanResult:
        assert self.first is not None and result.trajectory is not None and result.path is not None
        whole = one_after_the_other([self.first, result.trajectory])
        if self.passes and (driving := base_planning(request.objective.scene)) is not None:
            for motion in driving.passing(self.first, result.trajectory, whole, request):
                found = self._judged(motion, motion.path, result, request)
                if found.status is PlanStatus.SOLVED and not found.verdict.warnings:
                    return found
        path = Path(np.concatenate([self.first.q[:1], result.path.q])).without_duplicates()
        return self._judged(whole, path, result, request)

    def _judged(self, whole: Trajectory, path: Path, result: PlanResult, request: Request) -> PlanResult:
        assert self.first is not None
        scene, looks = request.objective.scene, request.verification or VerificationSettings()
        verdict = verify(
            whole,
            scene,
            start=State(self.first.q[0], self.first.qd[0]),
            before=None if self.takeover is None else self.takeover.before,
            goal=None if request.run_in is None else State(whole.q[-1], request.run_in.velocity),
            constraints=request.constraints.constraints,
            step=looks.step,
            clearance=None if looks.everywhere else compile_scene(scene).proof.clearance,
            start_tolerance=self.tolerance,
        )
        checks = {**result.verdict.checks, **verdict.checks}
        detail = "; ".join(part for part in (self.note, result.detail) if part)
        if not verdict.passed:
            told = "; ".join(f"{name}: {verdict.checks[name].detail}" for name in verdict.failures)
            return PlanResult(status=PlanStatus.INVALID_START, detail=f"{detail}; {told}", verdict=verdict)
        cost = request.objective.breakdown(whole)
        return replace(
            result, path=path, trajectory=whole, cost=cost, verdict=replace(verdict, checks=checks), detail=detail
        )


def without_turns(q: Float[Array, " nq"], scene: Scene) -> tuple[Float[Array, " nq"], Float[Array, " nq"]]:
    """Return a configuration with hinges without limits within a turn, and the whole turns that are missing [rad]."""
    turns = np.where(scene.endless, 2.0 * np.pi * np.round(q / (2.0 * np.pi)), 0.0)
    return q - turns, turns


def real_start(q: Float[Array, " nq"], constraints: SceneConstraints, tolerance: float, speed: float) -> RealStart:
    """Return where to begin planning from a given start.

    A start that is farther outside, or whose first piece the judge refuses, is returned as it is.

    Args:
        q: The given start.
        constraints: Constraints and scene.
        tolerance: Largest distance outside of a limit [rad or m]; `GRAZING_SHARE` of it is the largest depth of a
            contact [m].
        speed: Fraction of the velocity limits to use.
    """
    scene = constraints.scene
    q, turns = without_turns(q, scene)
    as_given = RealStart(q, turns)
    lower, upper = scene.limits.position.T
    excess = np.maximum(lower - q, q - upper)
    outside = excess > CLAMPED
    if excess.max() > tolerance or (scene.base is not None and outside[: len(scene.base.joints)].any()):
        return as_given
    inside = np.where(outside, np.clip(q, lower + _INWARDS, upper - _INWARDS), np.clip(q, lower, upper))
    notes = []
    if outside.any():
        names = ", ".join(repr(scene.joints[k]) for k in np.flatnonzero(outside))
        notes.append(f"start: {names} up to {excess.max():.3g} rad or m beyond a limit; moved inside first")
    contacts = state_contacts(inside, scene)
    ends = [inside]
    if contacts and contacts[0].depth <= GRAZING_SHARE * tolerance:
        nudges = np.random.default_rng(0).normal(size=(_ATTEMPTS, len(q))) * 0.01 * np.arange(_ATTEMPTS)[:, None]
        ends = [end for nudge in nudges if (end := ascend(inside + nudge, constraints)) is not None]
        deepest = contacts[0]
        notes.append(f"start: {deepest.first} is {1e3 * deepest.depth:.3g} mm in {deepest.second}; moved out first")
    if not notes:
        return as_given
    held = constraints.around(inside[None])
    for end in ends:
        via = Path(np.stack([q, inside, end])).without_duplicates()
        try:
            first = held.retimed(via, deviation=0.0, speed=speed)
        except RetimingError:
            continue
        verdict = verify(first, scene, start=q, constraints=held.constraints, start_tolerance=tolerance)
        if verdict.passed:
            return RealStart(end, turns, first, tolerance, "; ".join(notes))
    return as_given
