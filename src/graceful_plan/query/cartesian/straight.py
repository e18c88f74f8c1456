"""Straight motions of the tool: approach, retreat, pour.

The line is followed by differential inverse kinematics, in several ways at once where the arm has joints to spare. A
spline goes through the configurations of each, with more of them until the tool stays near the line in between; the
motions are timed and compared by J, and the judge looks at the best first.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from graceful_plan.array_types import Float
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
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

DEVIATION = 1e-3
"""Distance of the tool from its line by default [m]."""
ANGLE = float(np.deg2rad(0.5))
"""Angle to the orientation on the line by default [rad]."""
_ROUNDS = ((16, 1), (48, 1), (16, 4))
"""Candidates, and what divides their steps: further rounds are run while none before has succeeded. Of 299 lines of the
benchmark `straight_tool` that end at a possible pose, 244 are solved without the second round and 245 with it."""
_MOST_JUDGED = 4
"""Motions of a round that are timed and compared."""
_USED = 0.5
"""Share of the bounds that the curve may use up: the rest is for the cubics of the trajectory between its samples."""
_BETWEEN = np.array([0.25, 0.5, 0.75])
"""Where between two configurations the curve is looked at."""
_MOST_POINTS = 513
_HALF_TURN = np.pi - 0.05
"""Turns of more than this [rad] have no axis that is clearly the shortest way."""


def straight_motion(
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
    """Move the tool along a straight line to a pose, turning evenly on the way, without a stop.

    What the arm does with joints to spare is chosen by J; the line itself is not, and nothing is planned around
    obstacles: where the arm cannot follow, the result says where and why.

    Args:
        start: Configuration [rad or m], or the name of a keyframe; the line begins where its tool is.
        goal: Pose of the tool at the end. With free yaw its z axis goes the shortest way and nothing else turns.
        scene: Robot, surroundings and what is carried.
        w: Safety weight; see `plan`.
        deviation: Largest distance of the tool's origin from the line [m], at every time of the motion.
        angle: Largest angle to the orientation that is due there [rad]; of the z axis, with free yaw.
        objective: What to minimise where there is a choice; see `plan`.
        constraints: What has to hold on the way; see `plan`. Who pours asks for none: `[]`.
        speed: In (0, 1]: fraction of the velocity limits to use.
        seed: Of all random numbers; the result depends on nothing else.

    Returns:
        The result, SOLVED only if the independent judge passed the motion, its checks "deviation" and "orientation"
        included. INFEASIBLE if the arm cannot follow, or hits something; INVALID_GOAL if it cannot be at the goal at
        all. The detail then names the place on the line.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names, settings outside of their range.
    """
    started = time.perf_counter()
    if not isinstance(goal, PoseGoal):
        raise SettingError("goal", goal, "a PoseGoal: straight motions go from the tool's pose to another")
    bounds = _positive("deviation", deviation), _positive("angle", angle)
    share, rng = checked_speed(speed), checked_seed(seed)
    bound = checked_objective(objective, w).bind(scene, search_paces(share))
    held = SceneConstraints(scene, default_constraints(scene) if constraints is None else constraints)
    starts = constrained("start", resolve_start(start, scene), held)
    if not len(starts.q):
        return PlanResult(status=PlanStatus.INVALID_START, detail=starts.detail)
    line = ToolLine(bound.kernels.tool_pose(starts.q[0]), goal)
    if line.angle > _HALF_TURN:
        detail = f"the tool would turn by {np.rad2deg(line.angle):.1f} degrees, about an axis that is not clear"
        return PlanResult(status=PlanStatus.INFEASIBLE, detail=f"{detail}; ask for two motions")
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


def _positive(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating) or not 0.0 < value < np.inf:
        raise SettingError(name, value, "a finite number > 0")
    return float(value)


@dataclass(eq=False)
class _Objections:
    """Why motions were given up, and how far along the line each came."""

    told: list[tuple[float, str, Verdict]] = field(default_factory=list)

    def add(self, share: float, why: str, verdict: Verdict | None = None) -> None:
        self.told.append((share, why, verdict or Verdict()))

    @property
    def farthest(self) -> tuple[float, str, Verdict]:
        return max(self.told, key=lambda one: one[0])


@dataclass(frozen=True, eq=False)
class _Query:
    """One straight motion: what is asked, and how it is answered."""

    objective: SceneObjective
    held: SceneConstraints
    follower: Follower
    bounds: tuple[float, float]
    """Of distance [m] and angle [rad]."""
    speed: float

    @property
    def line(self) -> ToolLine:
        return self.follower.line

    def answer(self, rng: np.random.Generator) -> PlanResult:
        """Follow the line by more and more candidates until the judge passes one."""
        if self.line.is_still:
            rest, none = self.follower.start[None], np.zeros((1, len(self.follower.start)))
            still = Trajectory(np.zeros(1), rest, none, none, self.follower.scene.joints)
            return self._judged([self._charged(still)], _Objections())
        objections, unhappy = _Objections(), ""
        gone_all_the_way = False
        for n, finer in _ROUNDS:
            if finer > 1 and gone_all_the_way:  # the judge refused that, and smaller steps would lead to the same
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
        """Return those that collide least by the fast checker, the cheapest first."""
        n, points, nq = q.shape
        edges = self.objective.edges(q[:, :-1].reshape(-1, nq), q[:, 1:].reshape(-1, nq))
        totals = (edges[:, 0] + self.objective.w * edges[:, 1]).reshape(n, points - 1).sum(axis=1)
        blocked = (~self.held.kernels.free(q.reshape(-1, nq))).reshape(n, points).sum(axis=1)
        return q[np.lexsort([totals, blocked])[:_MOST_JUDGED]]

    def _curve(self, q: Float[Array, "point nq"], objections: _Objections) -> Spline | None:
        """Return a spline through configurations on the line, with twice as many until the tool is near it between."""
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
        """Return the first motion that the judge passes."""
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
        """Return where on the line the judge first objects, and to what."""
        checks = [(name, verdict.checks[name]) for name in verdict.failures]
        first = min((check.first for _, check in checks if check.first is not None), default=trajectory.t[-1])
        X_WT = self.objective.kernels.tool_pose(trajectory.at(np.array(first)).q)
        return self.line.share_of(X_WT), "; ".join(f"{name}: {check.detail}" for name, check in checks)
