"""Conversion of the user's starts and goals to configurations that a planner can use.

Misuse (wrong shape, NaN, unknown name) raises. A configuration outside the limits or in collision is a result with a
message.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.query.endpoints.base_goals import base_goals
from graceful_plan.query.endpoints.configurations import (
    Configuration,
    configurations_of,
    goal_labels,
    named_configuration,
    nearest_turns,
    wrapped_near,
)
from graceful_plan.query.endpoints.ik import solve_ik
from graceful_plan.query.endpoints.pose_sets import LEVER, reach_poses
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.query.endpoints.usable import Resolved, collision, free_of_collision, usable
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

Goal = Configuration | PoseGoal | BasePose | Sequence[Configuration | PoseGoal | BasePose]

_ENOUGH, _OF_EACH = 8, 2
"""Number of configurations that are enough for several poses solved one by one, and for each of them. More than
`_ENOUGH` poses are first solved together."""


def start_configuration(start: Configuration, scene: Scene) -> Float[Array, " nq"]:
    """Return a start as numbers.

    Raises:
        ShapeError: If it does not fit the scene's joints.
        NonFiniteError: If it contains a NaN or an infinity.
        UnknownNameError: If the keyframe does not exist.
    """
    if isinstance(start, str):
        return named_configuration(start, scene)
    return finite_array("start", start, ndim=1, last=len(scene.joints))


def resolve_start(start: Configuration, scene: Scene) -> Resolved:
    """Convert a start to one usable configuration, or none; errors as in `start_configuration`."""
    q = start_configuration(start, scene)
    return usable(["start"], q[None], scene, Travel(q))


def resolve_goal(
    goal: Goal,
    scene: Scene,
    start: ArrayLike,
    *,
    objective: SceneObjective | None = None,
    seed: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
    hurried: Callable[[], bool] = lambda: False,
) -> Resolved:
    """Convert a goal to usable configurations, in the order given; those of one pose are sorted by motion cost.

    Configurations are checked in the order of the cost of a straight move from the start, until `MOST_GOALS` are
    usable. Inverse kinematics of several poses begins with the pose nearest to the tool and ends once there are enough
    configurations. Many poses of an arm without a base are first solved together (see `pose_sets`).

    Args:
        goal: A configuration, a keyframe by name, a pose of tool or base, or several of these.
        scene: The scene.
        start: Start of the motion; poses are solved near it.
        objective: Objective whose motion cost counts; by default the joint-space length does.
        seed: Seed of the random numbers of inverse kinematics.
        cancelled: Ends the call early once it returns True, with the configurations checked by then.
        hurried: Ends the call once it returns True and a usable configuration is known.

    Raises:
        ShapeError: If the goal does not fit the scene's joints.
        NonFiniteError: If it contains a NaN or an infinity.
        UnknownNameError: If the keyframe does not exist.
    """
    travel = Travel(np.asarray(start, dtype=float), objective)
    if isinstance(goal, PoseGoal):
        return _pose(goal, scene, travel, seed, cancelled)
    if isinstance(goal, BasePose):
        return _standing(goal, scene, travel.start)
    several = _poses_among(goal)
    if several:
        return _several(several, scene, travel, seed, cancelled, hurried)
    q = configurations_of(cast("Configuration | Sequence[Configuration]", goal), scene)
    near = wrapped_near(q, travel.start, scene)
    return usable(goal_labels(len(q)), near, scene, travel, cancelled=cancelled, hurried=hurried)


def has_poses(goal: Goal) -> bool:
    """Return whether a goal is a pose, or contains one."""
    return isinstance(goal, PoseGoal) or bool(_poses_among(goal))


def _poses_among(goal: Goal) -> Sequence[Configuration | PoseGoal | BasePose]:
    """Return the goals of a sequence that contains a pose; empty for any other goal."""
    if isinstance(goal, Sequence) and any(isinstance(one, PoseGoal | BasePose) for one in goal):
        return cast("Sequence[Configuration | PoseGoal | BasePose]", goal)
    return ()


def poses_of(goal: Goal, index: Sequence[int]) -> tuple[PoseGoal | None, ...]:
    """Return the pose goals with these indices; None for each goal that is a configuration."""
    if isinstance(goal, PoseGoal):
        return (goal,) * len(index)
    several = _poses_among(goal)
    chosen = [several[k] if several else None for k in index]
    return tuple(one if isinstance(one, PoseGoal) else None for one in chosen)


def _several(
    goals: Sequence[Configuration | PoseGoal | BasePose],
    scene: Scene,
    travel: Travel,
    seed: int,
    cancelled: Callable[[], bool],
    hurried: Callable[[], bool],
) -> Resolved:
    """Resolve configurations, then many poses together, then single poses from the nearest on until there are enough.

    If solving many poses together has reached some of them, only these are solved one by one.
    """
    given = [k for k, one in enumerate(goals) if not isinstance(one, PoseGoal | BasePose)]
    left = _from_the_nearest_on(goals, scene, travel.start)
    first = _given(goals, given, scene, travel, cancelled, hurried)
    over = (lambda: cancelled() or hurried()) if first.index else cancelled
    together = _together(goals, left, scene, travel, over, hurried)
    if together.index:
        reached = set(together.index)
        left = [k for k in left if k in reached or not isinstance(goals[k], PoseGoal)]
    found, count = [first, together], len(first.index)
    for k in left:
        one = goals[k]
        if isinstance(one, PoseGoal):
            if count >= _ENOUGH or cancelled() or (together.index and hurried()):
                break
            own = _pose(one, scene, travel, seed, cancelled, count=_OF_EACH, rounds=1)
        else:
            own = _standing(cast("BasePose", one), scene, travel.start)
        notes, problems = (tuple(t.replace("goal", f"goal {k}", 1) for t in some) for some in (own.notes, own.problems))
        found.append(Resolved(own.q, (k,) * len(own.index), notes, problems))
        count += len(own.index)
    return Resolved(
        np.concatenate([one.q for one in found]),
        tuple(k for one in found for k in one.index),
        tuple(text for one in found for text in one.notes),
        tuple(text for one in found for text in one.problems),
    )


def _together(
    goals: Sequence[Configuration | PoseGoal | BasePose],
    order: list[int],
    scene: Scene,
    travel: Travel,
    cancelled: Callable[[], bool],
    hurried: Callable[[], bool],
) -> Resolved:
    """Solve many poses of an arm without a base together: at most one configuration for each, in the order given."""
    poses = {k: one for k in order if isinstance(one := goals[k], PoseGoal)}
    if len(poses) <= _ENOUGH or scene.base is not None:
        return Resolved(np.empty((0, len(travel.start))), ())

    def turned(q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        return nearest_turns(q, travel.start, scene)

    found = reach_poses(list(poses.values()), scene, travel, turned=turned, cancelled=cancelled, hurried=hurried)
    which = list(poses)
    return Resolved(found.q, tuple(which[i] for i in found.index))


def _given(
    goals: Sequence[Configuration | PoseGoal | BasePose],
    given: list[int],
    scene: Scene,
    travel: Travel,
    cancelled: Callable[[], bool],
    hurried: Callable[[], bool],
) -> Resolved:
    """Resolve the goals that are configurations."""
    if not given:
        return Resolved(np.zeros((0, len(scene.joints))), ())
    rows = [configurations_of(cast("Configuration", goals[k]), scene) for k in given]
    of = np.repeat(given, [len(row) for row in rows])
    q = wrapped_near(np.concatenate(rows), travel.start, scene)
    found = usable([f"goal {k}" for k in of], q, scene, travel, cancelled=cancelled, hurried=hurried)
    return Resolved(found.q, tuple(int(of[i]) for i in found.index), found.notes, found.problems)


def _from_the_nearest_on(
    goals: Sequence[Configuration | PoseGoal | BasePose], scene: Scene, start: Float[Array, " nq"]
) -> list[int]:
    """Return the indices of pose goals: poses of the base first, then poses of the tool by their distance from it."""
    X_WT = compile_scene(scene).kernels.tool_pose(start)
    away = {
        k: float(np.dot(pose_error(one, X_WT), (1.0, LEVER))) if isinstance(one, PoseGoal) else -1.0
        for k, one in enumerate(goals)
        if isinstance(one, PoseGoal | BasePose)
    }
    return sorted(away, key=away.__getitem__)


def _standing(goal: BasePose, scene: Scene, start: Float[Array, " nq"]) -> Resolved:
    """Resolve a pose of the base.

    Raises:
        SettingError: If the robot has no mobile base.
    """
    bases = base_goals(scene)
    if bases is None:
        raise SettingError("goal", goal, "a goal of the arm: this robot has no DiffDrive")
    return bases.standing(goal, scene, start)


def _pose(
    goal: PoseGoal,
    scene: Scene,
    travel: Travel,
    seed: int,
    cancelled: Callable[[], bool],
    **effort: int,
) -> Resolved:
    blocked: list[Array] = []

    def free(q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        ok = free_of_collision(q, scene)
        blocked.extend(q[~ok])
        return ok

    bases = base_goals(scene)
    if bases is not None and scene.base is not None and len(scene.joints) > len(scene.base.joints):
        found = bases.reaching(goal, scene, travel.start, free=free, seed=seed, cancelled=cancelled)
        if len(found.q):
            return Resolved(found.q, (0,) * len(found.q))
    found = solve_ik(goal, scene, travel.start, travel=travel, free=free, seed=seed, cancelled=cancelled, **effort)
    if len(found.q):
        return Resolved(found.q, (0,) * len(found.q))
    if blocked:
        told = collision("one", blocked[0], scene)
        problem = f"goal: all {len(blocked)} configurations found for the pose collide; {told}"
    else:
        missing = f"{1e3 * found.position_error:.3g} mm and {found.orientation_error:.3g} rad"
        problem = f"goal: no configuration within the limits reaches the pose; the nearest found misses it by {missing}"
    return Resolved(found.q, (), (), (problem,))
