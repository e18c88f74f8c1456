"""Starts and goals as users give them -> configurations that a planner may use, or the reasons why not.

Misuse (wrong shape, NaN, a name that does not exist) raises; a configuration that is out of limits or in collision is
an outcome, told in words.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError
from graceful_plan.path import finite_array
from graceful_plan.query.endpoints.base_goals import base_goals
from graceful_plan.query.endpoints.configurations import (
    Configuration,
    configurations_of,
    goal_words,
    named_configuration,
    the_short_way,
)
from graceful_plan.query.endpoints.ik import solve_ik
from graceful_plan.query.endpoints.pose_sets import LEVER, reach_poses
from graceful_plan.query.endpoints.usable import Resolved, collision, free_of_collision, usable
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

Array = np.ndarray
Goal = Configuration | PoseGoal | BasePose | Sequence[Configuration | PoseGoal | BasePose]

_ENOUGH, _OF_EACH = 8, 2
"""Configurations that are enough for several poses that are looked at one by one, and for one of them. Of more poses
than that, all are looked at together first."""


def resolve_start(start: Configuration, scene: Scene) -> Resolved:
    """Turn a start into one usable configuration, or none.

    Raises:
        ShapeError: If it does not fit the scene's joints.
        NonFiniteError: If it holds a NaN or an infinity.
        UnknownNameError: If there is no keyframe of that name.
    """
    q = (
        named_configuration(start, scene)
        if isinstance(start, str)
        else finite_array("start", start, ndim=1, last=len(scene.joints))
    )
    return usable(["start"], q[None], scene, q)


def resolve_goal(
    goal: Goal,
    scene: Scene,
    start: ArrayLike,
    *,
    seed: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
    hurried: Callable[[], bool] = lambda: False,
) -> Resolved:
    """Turn a goal into usable configurations, in the order given; of a pose, those nearest to the start first.

    Many configurations are looked at from the nearest on, and no further than for `MOST_GOALS` that are usable. Of
    several poses, inverse kinematics begins with those nearest to where the tool is, and stops once there are enough
    configurations for them. More poses than that are first reached together, by arms without a base (see `pose_sets`).

    Args:
        goal: A configuration, a keyframe by name, a pose of tool or base, or several of these.
        scene: Where.
        start: Where the motion begins; poses are solved near to it.
        seed: Of the random numbers of inverse kinematics.
        cancelled: Endpoints it early: what was looked at by then is what there is to choose from.
        hurried: Whether a configuration that is usable by now will do.

    Raises:
        ShapeError: If it does not fit the scene's joints.
        NonFiniteError: If it holds a NaN or an infinity.
        UnknownNameError: If there is no keyframe of that name.
    """
    if isinstance(goal, PoseGoal):
        return _pose(goal, scene, start, seed, cancelled)
    if isinstance(goal, BasePose):
        return _standing(goal, scene, np.asarray(start, dtype=float))
    several = _poses_among(goal)
    if several:
        return _several(several, scene, np.asarray(start, dtype=float), seed, cancelled, hurried)
    q = configurations_of(cast("Configuration | Sequence[Configuration]", goal), scene)
    begin = np.asarray(start, dtype=float)
    return usable(
        goal_words(len(q)), the_short_way(q, begin, scene), scene, begin, cancelled=cancelled, hurried=hurried
    )


def has_poses(goal: Goal) -> bool:
    """Whether a goal is a pose, or one of several is."""
    return isinstance(goal, PoseGoal) or bool(_poses_among(goal))


def _poses_among(goal: Goal) -> Sequence[Configuration | PoseGoal | BasePose]:
    """Return several goals if one of them is a pose; else nothing."""
    if isinstance(goal, Sequence) and any(isinstance(one, PoseGoal | BasePose) for one in goal):
        return cast("Sequence[Configuration | PoseGoal | BasePose]", goal)
    return ()


def poses_of(goal: Goal, index: Sequence[int]) -> tuple[PoseGoal | None, ...]:
    """Return the poses that goals with some indices are; None for those that are configurations."""
    if isinstance(goal, PoseGoal):
        return (goal,) * len(index)
    several = _poses_among(goal)
    chosen = [several[k] if several else None for k in index]
    return tuple(one if isinstance(one, PoseGoal) else None for one in chosen)


def _several(
    goals: Sequence[Configuration | PoseGoal | BasePose],
    scene: Scene,
    start: Float[Array, " nq"],
    seed: int,
    cancelled: Callable[[], bool],
    hurried: Callable[[], bool],
) -> Resolved:
    """Resolve configurations, then many poses together, then poses one by one from the nearest on until it is enough.

    Of many poses only those are looked at one by one that were reached together, if any was.
    """
    given = [k for k, one in enumerate(goals) if not isinstance(one, PoseGoal | BasePose)]
    left = _from_the_nearest_on(goals, scene, start)
    first = _given(goals, given, scene, start, cancelled, hurried)
    over = (lambda: cancelled() or hurried()) if first.index else cancelled
    together = _together(goals, left, scene, start, over, hurried)
    if together.index:
        reached = set(together.index)
        left = [k for k in left if k in reached or not isinstance(goals[k], PoseGoal)]
    found, count = [first, together], len(first.index)
    for k in left:
        one = goals[k]
        if isinstance(one, PoseGoal):
            if count >= _ENOUGH or cancelled() or (together.index and hurried()):
                break
            own = _pose(one, scene, start, seed, cancelled, count=_OF_EACH, rounds=1)
        else:
            own = _standing(cast("BasePose", one), scene, start)
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
    start: Float[Array, " nq"],
    cancelled: Callable[[], bool],
    hurried: Callable[[], bool],
) -> Resolved:
    """Reach many poses together, by arms alone: one configuration for each pose that has one, in the order given."""
    poses = {k: one for k in order if isinstance(one := goals[k], PoseGoal)}
    if len(poses) <= _ENOUGH or scene.base is not None:
        return Resolved(np.empty((0, len(start))), ())

    def turned(q: Float[Array, "n nq"]) -> Float[Array, "n nq"]:
        return the_short_way(q, start, scene)

    found = reach_poses(list(poses.values()), scene, start, turned=turned, cancelled=cancelled, hurried=hurried)
    which = list(poses)
    return Resolved(found.q, tuple(which[i] for i in found.index))


def _given(
    goals: Sequence[Configuration | PoseGoal | BasePose],
    given: list[int],
    scene: Scene,
    start: Float[Array, " nq"],
    cancelled: Callable[[], bool],
    hurried: Callable[[], bool],
) -> Resolved:
    """Resolve those of several goals that are configurations."""
    if not given:
        return Resolved(np.zeros((0, len(scene.joints))), ())
    rows = [configurations_of(cast("Configuration", goals[k]), scene) for k in given]
    of = np.repeat(given, [len(row) for row in rows])
    q = the_short_way(np.concatenate(rows), start, scene)
    found = usable([f"goal {k}" for k in of], q, scene, start, cancelled=cancelled, hurried=hurried)
    return Resolved(found.q, tuple(int(of[i]) for i in found.index), found.notes, found.problems)


def _from_the_nearest_on(
    goals: Sequence[Configuration | PoseGoal | BasePose], scene: Scene, start: Float[Array, " nq"]
) -> list[int]:
    """Return which of several goals are poses: those of the base, then those of the tool by how far it is from them."""
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
        SettingError: If the robot has no base that drives.
    """
    bases = base_goals(scene)
    if bases is None:
        raise SettingError("goal", goal, "a goal of the arm: this robot has no DiffDrive")
    return bases.standing(goal, scene, start)


def _pose(
    goal: PoseGoal,
    scene: Scene,
    start: ArrayLike,
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
        begin = np.asarray(start, dtype=float)
        found = bases.reaching(goal, scene, begin, free=free, seed=seed, cancelled=cancelled)
        if len(found.q):
            return Resolved(found.q, (0,) * len(found.q))
    found = solve_ik(goal, scene, start, free=free, seed=seed, cancelled=cancelled, **effort)
    if len(found.q):
        return Resolved(found.q, (0,) * len(found.q))
    if blocked:
        told = collision("one", blocked[0], scene)
        problem = f"goal: all {len(blocked)} configurations found for the pose collide; {told}"
    else:
        missing = f"{1e3 * found.position_error:.3g} mm and {found.orientation_error:.3g} rad"
        problem = f"goal: no configuration within the limits reaches the pose; the nearest found misses it by {missing}"
    return Resolved(found.q, (), (), (problem,))
