"""Planning requests of the viewer and their changes by the user. All objects are immutable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from graceful_plan.analysis.checks import clearance
from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import DEFAULT_WEIGHT, Objective
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.plan import plan
from graceful_plan.planners.anytime.auto import Auto
from graceful_plan.query.endpoints.goals import Goal
from graceful_plan.query.endpoints.ik import solve_ik
from graceful_plan.query.preparation import prepared
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.viewer.poses import pose_of
from graceful_plan.viewer.shown import ShownMotion, shown_motion

ORDINARY, CHOSEN = "w = 0", "chosen w"
"""Labels of the two motions."""
TIME_LIMIT, DRIVING_LIMIT = 1.0, 5.0
"""Default time limits for arms and for bases that drive [s]."""
_LONGER = 5.0
"""Factor on the time limit of the second call after a TIMEOUT."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Question:
    """A planning request of the viewer.

    Args:
        scene: Robot, surroundings and carried object.
        start: Start configuration [rad or m].
        goal: Goal, as in `plan`.
        w: Safety weight of the chosen motion; the ordinary one has w = 0.
        impact: Impact cost.
        time_limit: Time limit for each motion [s].
        seed: Seed of the random numbers.
        way: Version number, which increases with every change that affects the ordinary motion.
    """

    scene: Scene
    start: Float[Array, " nq"]
    goal: Goal
    w: float = DEFAULT_WEIGHT
    impact: ImpactCost = ImpactCost()
    time_limit: float = TIME_LIMIT
    seed: int = 0
    way: int = 0

    # --- changes ------------------------------------------------------------------------------------------------------

    def weighted(self, w: float) -> Question:
        """Return the request with another safety weight."""
        return replace(self, w=w)

    def going_to(self, X_W: Float[Array, "4 4"]) -> Question:
        """Return the request with a goal for the tool, or for the base if the robot drives (see `handle_pose`)."""
        goal = _base_pose(X_W) if self.scene.base is not None else PoseGoal(X_W)
        return replace(self, goal=goal, way=self.way + 1)

    def starting_at(self, X_W: Float[Array, "4 4"]) -> Question:
        """Return the request with the start nearest to the present one that has the tool, or the base, at a pose.

        Raises:
            SettingError: If no collision-free configuration reaches the pose, or the base is not free there.
        """
        if self.scene.base is not None:
            pose = _base_pose(X_W)
            q = np.array([pose.x, pose.y, pose.yaw, *self.start[3:]])
            if not self._free(q[None])[0]:
                raise SettingError("start", [round(x, 3) for x in q[:3].tolist()], "a position that is free")
            return replace(self, start=q, way=self.way + 1)
        found = solve_ik(PoseGoal(X_W), self.scene, self.start, free=self._free, count=1, seed=self.seed)
        if not len(found.q):
            problem = "collide" if found.colliding else "are out of reach"
            place = [round(x, 3) for x in X_W[:3, 3].tolist()]
            raise SettingError("start", place, f"a pose that the tool can reach: all configurations {problem}")
        return replace(self, start=found.q[0], way=self.way + 1)

    def with_moved(self, name: str, X_WB: Float[Array, "4 4"]) -> Question:
        """Return the request with an entity moved.

        Raises:
            UnknownNameError: If the entity does not exist.
            SceneError: If it cannot be moved.
        """
        self._check_entity(name)
        return replace(self, scene=self.scene.edit(move={name: X_WB}), way=self.way + 1)

    def with_severity(self, name: str, severity: float) -> Question:
        """Return the request with one severity of an entity for all components.

        Raises:
            UnknownNameError: If the entity does not exist.
            SettingError: If the severity is not a finite number of at least 0.
        """
        self._check_entity(name)
        return replace(self, scene=self.scene.with_severity({name: severity}))

    def _check_entity(self, name: str) -> None:
        if name not in self.scene.entities:
            raise UnknownNameError("entity", name, self.scene.entities)

    def _free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        low, high = self.scene.limits.position.T
        return (np.asarray(clearance(q, self.scene)) > 0.0) & ((q >= low) & (q <= high)).all(axis=1)

    # --- handles ------------------------------------------------------------------------------------------------------

    def handle_pose(self, q: Float[Array, " nq"]) -> Float[Array, "4 4"]:
        """Return the pose in W of the handle for a configuration: that of the tool, or of a base that drives."""
        if self.scene.base is not None:
            yaw = 0.5 * float(q[2])
            return pose_of(np.array([q[0], q[1], 0.0]), np.array([np.cos(yaw), 0.0, 0.0, np.sin(yaw)]))
        site, X_WT = Placement(self.scene).place(q).site(self.scene.tool), np.eye(4)
        X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        return X_WT

    def goal_pose(self) -> Float[Array, "4 4"]:
        """Return the pose of the handle for the goal, the first one of several."""
        goal = self.goal
        if isinstance(goal, PoseGoal):
            return np.array(goal.X_WT)
        if isinstance(goal, BasePose):
            return self.handle_pose(np.array([goal.x, goal.y, goal.yaw or 0.0]))
        if isinstance(goal, str):
            return self.handle_pose(self.scene.keyframes[goal])
        first = np.atleast_2d(np.asarray(goal, dtype=float))[0]
        return self.handle_pose(first)

    def entity_pose(self, name: str) -> Float[Array, "4 4"]:
        """Return the pose of the body of an entity in W."""
        self._check_entity(name)
        body = self.scene.data_at(self.start).body(name)
        return pose_of(body.xpos, body.xquat)

    # --- answer -------------------------------------------------------------------------------------------------------

    def plan(self, w: float, cancelled: Callable[[], bool], known: ShownMotion | None = None) -> PlanResult:
        """Plan one motion; an arm starts from a known one, which a short search might not match.

        Compiling the scene does not count against the time limit, and a busy machine gets a second, longer call.
        """
        objective = Objective(impact=self.impact, w=w)
        prepared(self.scene, objective, None)
        initial = None if known is None or self.scene.base is not None else known.trajectory.path

        def one(seconds: float) -> PlanResult:
            return plan(
                self.start,
                self.goal,
                self.scene,
                planner="auto" if initial is None else Auto(initial=initial),
                objective=objective,
                time_limit=seconds,
                seed=self.seed,
                cancelled=cancelled,
            )

        result = one(self.time_limit)
        return one(_LONGER * self.time_limit) if result.status is PlanStatus.TIMEOUT else result


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class PlanAnswer:
    """The motions found for a request, and a sentence about each."""

    question: Question
    chosen: ShownMotion | None
    ordinary: ShownMotion | None
    said: tuple[str, str]
    """Outcome of planning the chosen and the ordinary motion."""

    @property
    def motions(self) -> tuple[ShownMotion, ...]:
        """Motions that were found, the chosen one first."""
        return tuple(motion for motion in (self.chosen, self.ordinary) if motion is not None)

    def among(self, question: Question) -> PlanAnswer:
        """Return the same motions evaluated in the scene of a new request, until that is answered."""
        chosen, ordinary = (one and _again(one, question) for one in (self.chosen, self.ordinary))
        return replace(self, chosen=chosen, ordinary=ordinary)


def answered(question: Question, known: PlanAnswer | None, cancelled: Callable[[], bool]) -> PlanAnswer:
    """Plan both motions, except for those known from an earlier answer.

    The chosen motion is reused for the identical request, the ordinary one for an equal `way`. For another w, both
    compete with the new motion by J.

    Args:
        question: The request.
        known: An earlier answer.
        cancelled: Whether a newer request has arrived.
    """
    if known is not None and known.ordinary is not None and known.question.way == question.way:
        ordinary, of_ordinary = _again(known.ordinary, question), known.said[1]
    else:
        ordinary, of_ordinary = _shown(ORDINARY, question, question.plan(0.0, cancelled))
    if known is not None and known.question is question and known.chosen is not None:
        return PlanAnswer(question=question, chosen=known.chosen, ordinary=ordinary, said=(known.said[0], of_ordinary))
    if question.w == 0.0 and ordinary is not None:
        chosen = shown_motion(CHOSEN, ordinary.trajectory, question.scene, question.impact, ordinary.cost)
        return PlanAnswer(question=question, chosen=chosen, ordinary=ordinary, said=(of_ordinary, of_ordinary))
    planned, of_chosen = _shown(CHOSEN, question, question.plan(question.w, cancelled, ordinary))
    before = known.chosen if known is not None and known.question.way == question.way else None
    others = [_again(one, question) for one in (before, ordinary) if one is not None]
    chosen = _cheapest([*([] if planned is None else [planned]), *others], question.w)
    if chosen is not None and chosen is not planned:
        chosen = replace(chosen, label=CHOSEN)
        of_chosen = f"{PlanStatus.SOLVED.name}: a motion found before is the best for this w"
    return PlanAnswer(question=question, chosen=chosen, ordinary=ordinary, said=(of_chosen, of_ordinary))


def _cheapest(motions: list[ShownMotion], w: float) -> ShownMotion | None:
    """Return the motion of least J, so that moving w never makes the chosen motion worse by chance."""
    return min(motions, key=lambda motion: motion.cost.motion + w * motion.cost.impact, default=None)


def _shown(label: str, question: Question, result: PlanResult) -> tuple[ShownMotion | None, str]:
    said = f"{result.status.name}: {result.status.value}" + (f" ({result.detail})" if result.detail else "")
    if result.status is not PlanStatus.SOLVED or result.trajectory is None:
        return None, said
    return shown_motion(label, result.trajectory, question.scene, question.impact, result.cost), said


def _again(motion: ShownMotion, question: Question) -> ShownMotion:
    """Return an unchanged motion with its impact in the scene of a new request."""
    if motion.scene is question.scene:
        return motion
    cost = Objective(impact=question.impact, w=0.0).bind(question.scene).breakdown(motion.trajectory)
    return shown_motion(motion.label, motion.trajectory, question.scene, question.impact, cost)


def _base_pose(X_W: Float[Array, "4 4"]) -> BasePose:
    return BasePose(float(X_W[0, 3]), float(X_W[1, 3]), float(np.arctan2(X_W[1, 0], X_W[0, 0])))
