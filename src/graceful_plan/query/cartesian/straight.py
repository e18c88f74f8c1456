"""Straight motions of the tool: approach, retreat, pour.

Differential inverse kinematics follows the line, with several candidates if the arm is redundant. A spline interpolates
the configurations of each candidate; configurations are added until the tool stays near the line between them, too.
The motions are timed and compared by J, and the judge verifies the best one first.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.costs.cost import NonFiniteCostError
from graceful_plan.costs.objective import Objective, SceneObjective, search_paces
from graceful_plan.exceptions import RetimingError, SettingError
from graceful_plan.judge.straightness import straightness
from graceful_plan.planners.motion_descent import time_price
from graceful_plan.query.arguments import checked_objective, checked_seed, checked_speed
from graceful_plan.query.candidates.motions import Motion
from graceful_plan.query.cartesian.following import Follower
from graceful_plan.query.cartesian.line import ToolLine
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.endpoints import constrained
from graceful_plan.query.endpoints.goals import resolve_goal, resolve_start
from graceful_plan.query.verification import verdict_of
from graceful_plan.result import PlanResult, PlanStatus, Verdict
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.setting_checks import positive
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.trajectory import Trajectory

DEVIATION = 1e-3
"""Default bound of the tool's distance from its line [m]."""
ANGLE = float(np.deg2rad(0.5))
"""Default bound of the angle to the orientation on the line [rad]."""
_ROUNDS = ((16, 1), (48, 1), (16, 4))
"""Candidates and divisor of their steps in each round; the next round is run if the previous one has failed.

Of 299 lines of benchmarks/straight_tool (commit cbf77b38) that end at a possible pose, 244 are solved without the
second round and 245 with it."""
_MOST_JUDGED = 4
"""Motions of a round that are timed and compared."""
_USED = 0.5
"""Share of the bounds that the curve may use; the rest is for the cubics of the trajectory between its samples."""
_BETWEEN = np.array([0.25, 0.5, 0.75])
"""Places between two configurations at which the curve is checked."""
_MOST_POINTS = 513
_HALF_TURN = np.pi - 0.05
"""Largest rotation [rad]; beyond, the axis of the shortest rotation is ambiguous."""


def plan_cartesian(
    start: Configuration,
    goal: PoseGoal,
    scene: Scene,
    w: float | None = None,
    *,
    deviation: float = DEVIATION,
    angle: float = ANGLE,
    objective: Objective | None = None,
    constraints: Iterable[Constraint] | None = None,
    speed: float = 1.0,
    seed: int = 0,
) -> PlanResult:
    """Move the tool along a straight line to a pose without a stop, while it rotates about one axis.

    The objective J selects among the ways in which a redundant arm can follow. The line itself is fixed: it does not
    avoid obstacles. Where the arm cannot follow, the result says where and why.

    Args:
        start: Configuration [rad or m], or the name of a keyframe; the line begins where its tool is.
        goal: Pose of the tool at the end. With free yaw its z axis turns the shortest way, and the tool does not rotate
            about it.
        scene: Robot, surroundings and carried object.
        w: Safety weight; see `plan`.
        deviation: Largest distance of the tool's origin from the line [m], over the whole motion.
        angle: Largest angle to the orientation on the line [rad]; of the z axis, with free yaw.
        objective: Objective that selects among candidates; see `plan`.
        constraints: Constraints along the motion; see `plan`. Pass `[]` to pour.
        speed: Fraction of the velocity limits to use, in (0, 1].
        seed: Seed of all random numbers; a call with the same arguments returns the same result.

    Returns:
        The result; SOLVED only if the motion passed the independent judge, including its checks "deviation" and
        "orientation". INFEASIBLE if the arm cannot follow or collides; INVALID_GOAL if no usable configuration reaches
        the goal. The detail then names the place on the line.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside their range.
    """
    started = time.perf_counter()
    if not isinstance(goal, PoseGoal):
        raise SettingError("goal", goal, "a PoseGoal: straight motions go from the tool's pose to another")
    bounds = positive("deviation", deviation), positive("angle", angle)
    share, rng = checked_speed(speed), checked_seed(seed)
    bound = checked_objective(objective, w).bind(scene, search_paces(share))
    held = SceneConstraints(scene, default_constraints(scene) if constraints is None else constraints)
    starts = constrained("start", resolve_start(start, scene), held)
    if not len(starts.q):
        return PlanResult(status=PlanStatus.INVALID_START, detail=starts.detail)
    line = ToolLine(bound.kernels.tool_pose(starts.q[0]), goal)
    if line.angle > _HALF_TURN:
        detail = f"the tool would turn by {np.rad2deg(line.angle):.1f} degrees, about an ambiguous axis"
        return PlanResult(status=PlanStatus.INFEASIBLE, detail=f"{detail}; plan two motions instead")
    query = _Query(bound, held, Follower(scene, held.kernels, line, starts.q[0]), bounds, share)
    try:
        result = query.answer(rng)
    except NonFiniteCostError as error:
        return PlanResult(status=PlanStatus.NONFINITE, detail=str(error))
    if result.status is PlanStatus.INFEASIBLE and not len(
        (ends := constrained("goal", resolve_goal(goal, scene, starts.q[0], seed=seed), held)).q
    ):
        result = replace(result, status=PlanStatus.INVALID_GOAL, detail=f"{result.detail}; {ends.detail}")
    detail = "; ".join([*starts.notes, *([result.detail] if result.detail else [])])
    return replace(result, detail=detail, stats={"total_time": time.perf_counter() - started})


@dataclass(eq=False)
class _Objections:
    """Reasons why candidates failed, each with the share of the line where that was."""

    told: list[tuple[float, str, Verdict]] = field(default_factory=list)

    def add(self, share: float, why: str, verdict: Verdict | None = None) -> None:
        self.told.append((share, why, verdict or Verdict()))

    @property
    def farthest(self) -> tuple[float, str, Verdict]:
        return max(self.told, key=lambda one: one[0])


@dataclass(frozen=True, eq=False)
class _Query:
    """A query for one straight motion."""

    objective: SceneObjective
    held: SceneConstraints
    follower: Follower[ToolLine]
    bounds: tuple[float, float]
    """Bounds of distance [m] and angle [rad]."""
    speed: float

    @property
    def line(self) -> ToolLine:
        return self.follower.line

    def answer(self, rng: np.random.Generator) -> PlanResult:
        """Follow the line, with more candidates or finer steps in each round, until the judge passes a motion."""
        if self.line.is_still:
            rest, none = self.follower.start[None], np.zeros((1, len(self.follower.start)))
            still = Trajectory(np.zeros(1), rest, none, none, self.follower.scene.joints)
            return self._judged([self._charged(still)], _Objections())
        objections, unhappy = _Objections(), ""
        gone_all_the_way = False
        for n, finer in _ROUNDS:
            if finer > 1 and gone_all_the_way:  # the judge refused these motions; finer steps would give the same ones
                break
            found = self.follower.follow(n, rng, finer)
            if found.why:
                objections.add(found.share, f"the arm is {found.why}")
                continue
            motions: list[Motion] = []
            for candidate in self._promising(found.q):
                curve = self._curve(candidate, objections)
                try:
                    motions += [] if curve is None else [self._timed(curve)]
                except RetimingError as error:
                    unhappy = str(error)
            result = self._judged(sorted(motions, key=lambda motion: motion.ranking), objections)
            if result.status is PlanStatus.SOLVED:
                return result
            gone_all_the_way |= bool(motions)
        share, why, verdict = objections.farthest if objections.told else (0.0, unhappy, Verdict())
        status = PlanStatus.INFEASIBLE if objections.told else PlanStatus.RETIMING_FAILED
        return PlanResult(status=status, detail=f"at {self.line.place(share)} of the line: {why}", verdict=verdict)

    def _promising(self, q: Float[Array, "n point nq"]) -> Float[Array, "most point nq"]:
        """Return the best candidates by number of colliding points of the fast checker, then by cost."""
        n, points, nq = q.shape
        edges = self.objective.edges(q[:, :-1].reshape(-1, nq), q[:, 1:].reshape(-1, nq))
        totals = (edges[:, 0] + self.objective.w * edges[:, 1]).reshape(n, points - 1).sum(axis=1)
        blocked = (~self.held.kernels.free(q.reshape(-1, nq))).reshape(n, points).sum(axis=1)
        return q[np.lexsort([totals, blocked])[:_MOST_JUDGED]]

    def _curve(self, q: Float[Array, "point nq"], objections: _Objections) -> Spline | None:
        """Return a spline through configurations on the line.

        The number of configurations is doubled until the tool stays near the line between them, too. If that fails, the
        reason is added to `objections` and None is returned.
        """
        while True:
            curve, spans = Spline.through(q), len(q) - 1
            u = (np.arange(spans)[:, None] + _BETWEEN).ravel()
            between = curve.at(u)
            errors = self.line.errors(self.objective.kernels.tool_pose(between), u / spans) / self.bounds
            lower, upper = self.follower.scene.limits.position.T
            outside = (between < lower).any(axis=1) | (between > upper).any(axis=1)
            bad = np.flatnonzero((errors.max(axis=1) > _USED) | outside)
            if not len(bad):
                return curve
            middle = np.arange(spans) + 0.5
            moved = None if 2 * spans >= _MOST_POINTS else self.follower.onto_line(curve.at(middle), middle / spans)
            if moved is None:
                objections.add(
                    float(u[bad[0]]) / spans, "the arm moves too suddenly to keep the tool within its bounds"
                )
                return None
            q = np.insert(q, np.arange(1, len(q)), moved, axis=0)

    def _timed(self, curve: Spline) -> Motion:
        return self._charged(self.held.timed(curve, speed=self.speed))

    def _charged(self, trajectory: Trajectory) -> Motion:
        cost = self.objective.breakdown(trajectory)
        ranking = cost.total + time_price(careful=self.held.level) * trajectory.duration
        return Motion(path=trajectory.path, trajectory=trajectory, cost=cost, arrival=0, ranking=ranking)

    def _judged(self, motions: Sequence[Motion], objections: _Objections) -> PlanResult:
        """Return the first motion that the judge passes; INFEASIBLE if there is none."""
        scene, goal = self.follower.scene, self.line.goal
        for motion in motions:
            straight = straightness(motion.trajectory, goal, scene, deviation=self.bounds[0], angle=self.bounds[1])
            verdict = Verdict(
                checks={
                    **verdict_of(motion, self.objective, self.held, goal).checks,
                    **straight,
                }
            )
            if verdict.passed:
                found = (motion.path, motion.trajectory, motion.cost)
                return PlanResult(
                    status=PlanStatus.SOLVED, path=found[0], trajectory=found[1], cost=found[2], verdict=verdict
                )
            objections.add(*self._objection(motion.trajectory, verdict), verdict)
        return PlanResult(status=PlanStatus.INFEASIBLE)

    def _objection(self, trajectory: Trajectory, verdict: Verdict) -> tuple[float, str]:
        """Return the share of the line at the first violation, and a description of all violations."""
        checks = [(name, verdict.checks[name]) for name in verdict.failures]
        first = min((check.first for _, check in checks if check.first is not None), default=trajectory.t[-1])
        X_WT = self.objective.kernels.tool_pose(trajectory.at(np.array(first)).q)
        return self.line.share_of(X_WT), "; ".join(f"{name}: {check.detail}" for name, check in checks)
