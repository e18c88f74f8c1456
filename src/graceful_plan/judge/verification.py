"""The judge, an independent checker: is a motion free of collision, within limits, and from start to goal?

Its only inputs are arrays and a scene. Geometry is MuJoCo's own (`exact`), optionally also python-fcl's. The cost of a
motion is verified for Algorithm 1 only, by a slow implementation that shares no code with the kernels
(`reference_cost`); no other model, including the default one, has a second implementation here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.judge.drive_checks import drive_checks
from graceful_plan.judge.exact import Judge, Touch, motion_violations
from graceful_plan.judge.limit_checks import LIMIT_TOLERANCE, dynamics_checks, position_check
from graceful_plan.judge.motion_samples import ClearanceBound, MotionSamples, joint_travel, motion_samples, reach
from graceful_plan.judge.passing_by import passing_check
from graceful_plan.judge.preparation import own_placement
from graceful_plan.judge.reference_cost import reference_cost
from graceful_plan.judge.rule_checks import rule_checks
from graceful_plan.judge.second_opinion import opinion_of_fcl
from graceful_plan.judge.torque_check import torque_check
from graceful_plan.path import Path, finite_array, is_real, plain_numbers
from graceful_plan.result import Check, CostBreakdown, Verdict
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.rules.rules import Ruled, default_rules
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.setting_checks import not_negative
from graceful_plan.timing.trajectory import State, Trajectory

STEP = 0.002
"""Default for the largest displacement of any point between two collision checks [m]."""
MOST_SAMPLES = 300_000
"""Largest number of configurations of one verdict: half a minute of exact geometry, and a few hundred metres."""
_OVERRATED, _SECONDS_EACH = 3.0, 0.004
"""Typical ratio of the reach of a joint to its levers; time between two samples for constraints [s]."""
GRAZING_SHARE = 0.1
"""Largest depth of a contact at the start of a motion, as a share of the tolerance of the start [m per rad or m]."""
COST_TOLERANCE = 0.01
"""Relative tolerance; two integrations of a discontinuous impact differ by less at the steps in use."""


@final
@dataclass(frozen=True, kw_only=True)
class VerificationSettings:
    """Settings of the checks that `plan` runs on motions.

    | field      | meaning                                                                    | unit |
    |------------|----------------------------------------------------------------------------|------|
    | step       | largest displacement of any point between two collision checks             | m    |
    | everywhere | exact geometry at every sample, even where spheres prove that it is free   |      |
    """

    step: float = STEP
    everywhere: bool = False

    def __post_init__(self) -> None:
        plain_numbers(self)
        _check_step(self.step)


def _check_step(step: float) -> None:
    if not (is_real(step) and np.isfinite(step) and step > 0.0):
        raise SettingError("step", step, "a finite distance > 0 m")


def verify(
    motion: Path | Trajectory,
    scene: Scene,
    *,
    start: ArrayLike | State | None = None,
    goal: ArrayLike | PoseGoal | State | None = None,
    cost: CostBreakdown | None = None,
    cost_path: Path | None = None,
    components: Sequence[str] = ("carried", "contents"),
    exposure: str = "time",
    constraints: Iterable[Ruled] | None = None,
    step: float = STEP,
    clearance: ClearanceBound | None = None,
    second_opinion: bool = False,
    start_tolerance: float = 0.0,
    before: Trajectory | None = None,
) -> Verdict:
    """Check a path or a trajectory.

    Args:
        motion: The motion to check.
        scene: The scene.
        start: Required start: a configuration, or the state of a robot that moves, whose velocity the motion has to
            continue; None to skip the check. Without a state, the motion has to start at rest.
        goal: Required end: a configuration, several alternatives, a pose, or a state, with whose velocity the motion
            has to end; None to skip the check. Without a state, the motion has to end at rest.
        cost: Claimed cost by Algorithm 1, `ImpactCost("box_overlap")`, to be recomputed; None to skip the check.
            Do not pass the cost of any other model: it would be compared with Algorithm 1 all the same.
        cost_path: The path of the claimed cost, if it is not the motion itself.
        components: Components whose impact is in that cost.
        exposure: Integration variable of the impact in that cost.
        constraints: Constraints along the motion; by default, contents have to stay in a carried vessel.
        step: No point of the robot moves farther than this between two collision checks [m].
        clearance: Lower bound that proves configurations free, such as `compile_scene(scene).kernels.clearance`. Exact
            geometry then checks only configurations that it does not prove free, and a few others. Default: all.
        second_opinion: Whether python-fcl also checks for collisions, every 10 steps.
        start_tolerance: Distance outside of its limits at which a joint may start [rad or m], if it moves no farther
            out. `GRAZING_SHARE` of it is the depth of a contact in which the motion may start [m], if it gets no
            deeper until it ends for good.
        before: Motion up to the start of a trajectory, on the same clock. A liquid swings by it; by default it is calm
            at the start.

    Returns:
        Checks by name: "collision", "position_limits"; for a trajectory "velocity_limits", "acceleration_limits",
        "consistency", "rest", "torque" if the scene limits the torque of a joint, and "passing_by" with moving
        entities, of which the last two only warn; "contents" if they have to stay in a vessel, and one for each other
        constraint, such as "upright"; for bases "rolling" and "drive_limits"; and "start", "goal", "cost",
        "second_opinion" if requested. Without "cost", the verdict does not cover the cost of the motion.

    Raises:
        ShapeError: If motion, start or goal do not fit the scene's joints.
        SettingError: If there is no such exposure, or the step is not a positive distance.
    """
    checked_scene(scene)
    if not isinstance(motion, Path | Trajectory):
        raise SettingError("motion", motion, "a Path or a Trajectory")
    nq = len(scene.joints)
    if motion.q.shape[1] != nq:
        raise ShapeError("motion", motion.q.shape, f"(n, {nq})")
    _check_step(step)
    not_negative("start_tolerance", start_tolerance)
    start_tolerance = float(start_tolerance)
    q_start, leaving = _start(start, nq)
    arriving = finite_array("goal.qd", goal.qd, ndim=1, last=nq) if isinstance(goal, State) else np.zeros(nq)
    rules = default_rules(scene) if constraints is None else [asked.rule(scene) for asked in constraints]
    too_long = _too_long(motion, scene, step)
    if too_long:
        at = motion.t if isinstance(motion, Trajectory) else np.append(0.0, np.cumsum(motion.segment_lengths))
        samples = MotionSamples.of(motion.q, at)
        checks = {"collision": too_long, "position_limits": position_check(samples, motion, scene, start_tolerance)}
    else:
        violations, samples = motion_violations(motion, scene, step, clearance)
        checks = {
            "collision": _collision(_without_left(violations, GRAZING_SHARE * start_tolerance), samples, scene),
            "position_limits": position_check(samples, motion, scene, start_tolerance),
            **rule_checks(motion, scene, rules, before if _continues(motion, start) else None),
        }
    if isinstance(motion, Trajectory):
        checks |= dynamics_checks(motion, scene, leaving, arriving)
        if np.isfinite(scene.limits.torque).any():
            checks["torque"] = torque_check(motion, scene)
    if scene.base is not None:
        checks |= drive_checks(motion, scene.base)
    if scene.moving and isinstance(motion, Trajectory) and not too_long:
        checks["passing_by"] = passing_check(motion, scene)
    end = motion.t[[0, -1]] if isinstance(motion, Trajectory) else (0.0, float(np.sum(motion.segment_lengths)))
    if q_start is not None:
        checks["start"] = _end_point(motion.q[0], q_start[None], float(end[0]))
    if isinstance(goal, PoseGoal):
        checks["goal"] = _pose(goal, motion.q[-1], scene, float(end[1]))
    elif goal is not None:
        q_goal = goal.q if isinstance(goal, State) else goal
        goals = np.atleast_2d(finite_array("goal", q_goal, last=nq))
        if not len(goals):
            raise ShapeError("goal", goals.shape, f"({nq},) or (n >= 1, {nq})")
        checks["goal"] = _end_point(motion.q[-1], goals, float(end[1]), scene.endless)
    if too_long:
        return Verdict(checks=checks)
    if cost is not None:
        checks["cost"] = _cost(cost, motion if cost_path is None else cost_path, scene, components, exposure)
    if second_opinion:
        checks["second_opinion"] = opinion_of_fcl(motion_samples(motion, scene, 10.0 * step), scene)
    return Verdict(checks=checks)


def _start(start: ArrayLike | State | None, nq: int) -> tuple[Float[Array, " nq"] | None, Float[Array, " nq"]]:
    """Return the required start configuration, if there is one, and the required velocity."""
    if isinstance(start, State):
        q = finite_array("start.q", start.q, ndim=1, last=nq)
        return q, finite_array("start.qd", start.qd, ndim=1, last=nq)
    return None if start is None else finite_array("start", start, ndim=1, last=nq), np.zeros(nq)


def _continues(motion: Path | Trajectory, start: ArrayLike | State | None) -> bool:
    """Return whether a motion continues a state, if one is required; otherwise its verdict fails anyway."""
    if not isinstance(start, State) or not isinstance(motion, Trajectory):
        return True
    steps = np.abs(motion.q[0] - start.q), np.abs(motion.qd[0] - start.qd)
    return bool(max(step.max() for step in steps) <= LIMIT_TOLERANCE)


def _too_long(motion: Path | Trajectory, scene: Scene, step: float) -> Check | None:
    """Return a failed check if the number of configurations to check exceeds `MOST_SAMPLES`, else None."""
    if len(motion) == 1:
        return None
    # No point moves farther than this. A closer bound needs the levers, which requires samples itself.
    samples = float((joint_travel(motion) @ reach(scene)).sum()) / step / _OVERRATED + len(motion)
    seconds = motion.duration if isinstance(motion, Trajectory) else 0.0
    most = max(samples, seconds / _SECONDS_EACH)
    if most <= MOST_SAMPLES:
        return None
    told = f"not checked: about {most:.3g} configurations, at most {MOST_SAMPLES} are allowed: check it in parts"
    return Check(passed=False, worst=-np.inf, detail=told)


def _collision(violations: list[Touch], samples: MotionSamples, scene: Scene) -> Check:
    judge = Judge(scene)
    if not violations:
        proved = int(samples.proved.sum())
        told = f"{len(samples.q)} configurations, {f'{proved} of them proved by spheres, ' if proved else ''}"
        return Check(passed=True, worst=np.inf, detail=f"{told}signed distance [m]")
    worst = min(violations, key=lambda t: t.distance)
    first = min(violations, key=lambda t: (t.sample, t.distance))
    contact, deepest = judge.named(first), judge.named(worst)
    return Check(
        worst=worst.distance,
        first=float(samples.at[first.sample]),
        detail=f"{contact.first} is {1e3 * contact.depth:.3g} mm in {contact.obstacle}; "
        f"worst [m]: {deepest.first} in {deepest.obstacle}",
    )


def _without_left(violations: list[Touch], deepest: float) -> list[Touch]:
    """Return the collisions without contacts at the start, up to a depth [m], that the motion leaves."""
    left: list[Touch] = []
    for pair in {(touch.first, touch.second) for touch in violations if touch.sample == 0}:
        mine = [touch for touch in violations if (touch.first, touch.second) == pair]
        begun = max(-touch.distance for touch in mine if touch.sample == 0)
        unbroken = {touch.sample for touch in mine} == set(range(mine[-1].sample + 1))
        if begun <= deepest and unbroken and all(-touch.distance <= begun + LIMIT_TOLERANCE for touch in mine):
            left += mine
    return [touch for touch in violations if touch not in left]


def _end_point(
    q: Float[Array, " nq"], wanted: Float[Array, "end nq"], at: float, endless: Bool[Array, " nq"] | None = None
) -> Check:
    """Check that a configuration equals one of several; whole turns of endless joints make no difference."""
    away = wanted - q
    if endless is not None:
        away = np.where(endless, np.remainder(away + np.pi, 2.0 * np.pi) - np.pi, away)
    error = float(np.abs(away).max(axis=1).min())
    passed = error <= LIMIT_TOLERANCE
    detail = "largest joint error [rad or m]"
    return Check(passed=passed, worst=error, limit=LIMIT_TOLERANCE, first=None if passed else float(at), detail=detail)


def _pose(goal: PoseGoal, q: Float[Array, " nq"], scene: Scene, at: float) -> Check:
    X_WT = np.eye(4)
    site = own_placement(scene).place(q).site(scene.tool)
    X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    position, orientation = pose_error(goal, X_WT)
    worst = max(position / goal.position_tolerance, orientation / goal.orientation_tolerance)
    passed = worst <= 1.0 + LIMIT_TOLERANCE
    detail = f"of the tolerance: {1e3 * position:.3g} mm, {orientation:.3g} rad"
    return Check(passed=passed, worst=worst, limit=1.0 + LIMIT_TOLERANCE, first=None if passed else at, detail=detail)


def _cost(
    cost: CostBreakdown, motion: Path | Trajectory, scene: Scene, components: Sequence[str], exposure: str
) -> Check:
    own = reference_cost(motion, scene, w=cost.w, components=components, exposure=exposure)
    # At least 1, since a small weight would hardly check the impact, which is reported, too.
    w = max(cost.w, 1.0)
    expected, claimed = own.motion + w * own.impact, cost.motion + w * cost.impact
    parts = max(abs(sum(x.values()) - cost.impact) for x in (cost.impact_by_entity, cost.impact_by_component))
    error = (abs(claimed - expected) + parts) / max(expected, 1e-6)
    own_parts, claimed_parts = f"{own.motion:.6g} + w {own.impact:.6g}", f"{cost.motion:.6g} + w {cost.impact:.6g}"
    detail = f"relative error of motion + w impact by Algorithm 1: claimed {claimed_parts}, recomputed {own_parts}"
    return Check(passed=bool(error <= COST_TOLERANCE), worst=float(error), limit=COST_TOLERANCE, detail=detail)
