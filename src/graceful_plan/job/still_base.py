"""Motions of the arm of a mobile robot while its base stands still: an approach, a lift, a path of a handle.

They are planned in a scene in which only the joints of the arm are planned, and returned with those of the base at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.path import Path
from graceful_plan.query.cartesian.straight import plan_cartesian
from graceful_plan.query.endpoints.base_goals import base_goals
from graceful_plan.query.endpoints.ik import solve_ik
from graceful_plan.query.endpoints.usable import free_of_collision
from graceful_plan.result import PlanResult
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_RAISED = 0.1
"""Height above a pose at which the place of the base is sought [m]: nearer to a table, the fast checker sees contact."""
_KEPT = 16
"""Scenes with the base at one place that are cached per scene."""


def base_joints(scene: Scene) -> int:
    """Return the number of planned joints that belong to the base."""
    return 0 if scene.base is None else len(scene.base.joints)


def arm_alone(scene: Scene, q: Float[Array, " nq"]) -> Scene:
    """Return the scene of the arm with the base fixed where it is in a configuration; the same scene without a base."""
    n = base_joints(scene)
    return scene if n == 0 else _fixed(scene, tuple(q[:n].tolist()))


@per_scene(most=_KEPT)
def _fixed(scene: Scene, base: tuple[float, ...]) -> Scene:
    n, notes = len(base), scene.notes
    state = {**notes.state, **{joint: (x,) for joint, x in zip(scene.joints[:n], base, strict=True)}}
    return Scene.assemble(
        scene.posed, replace(notes, joints=scene.joints[n:], base=None, keyframes={}, states={}, tasks={}, state=state)
    )


def reached_poses(
    goal: PoseGoal,
    scene: Scene,
    near: Float[Array, " nq"],
    *,
    count: int,
    seed: int,
    cancelled: Callable[[], bool] = lambda: False,
) -> Float[Array, "n nq"]:
    """Return configurations free of collision that bring the tool to a pose, the nearest first; possibly none.

    A base stays where it is if the arm reaches the pose from there. Otherwise it goes to places from which the arm
    reaches a pose above this one.
    """
    n = base_joints(scene)

    def by_arm(q: Float[Array, " nq"]) -> Float[Array, "n nq"]:
        alone = arm_alone(scene, q)
        free = partial(free_of_collision, scene=alone)
        found = solve_ik(goal, alone, q[n:], free=free, count=count, rounds=2, seed=seed).q
        return np.hstack([np.tile(q[:n], (len(found), 1)), found])

    bases = base_goals(scene)
    found = by_arm(near)
    if bases is None or len(found):
        return found
    above = goal.X_WT.copy()
    above[2, 3] += _RAISED
    free = partial(free_of_collision, scene=scene)
    places = bases.reaching(replace(goal, X_WT=above), scene, near, free=free, seed=seed, cancelled=cancelled).q
    return np.concatenate([found, *(by_arm(q)[:1] for q in places)])[:count]


def with_base(motion: Trajectory, scene: Scene, q: Float[Array, " nq"]) -> Trajectory:
    """Return a motion of the arm as one of the whole robot, whose base stands where it is in a configuration."""
    n = base_joints(scene)
    if n == 0:
        return motion
    still, none = np.tile(q[:n], (len(motion.t), 1)), np.zeros((len(motion.t), n))
    return Trajectory(
        motion.t,
        np.hstack([still, motion.q]),
        np.hstack([none, motion.qd]),
        np.hstack([none, motion.qdd]),
        scene.joints,
    )


def straight_arm_motion(
    q: Float[Array, " nq"], goal: PoseGoal, scene: Scene, *, objective: Objective, speed: float
) -> PlanResult:
    """Move the tool straight to a pose as `plan_cartesian` does, with the base at rest."""
    n = base_joints(scene)
    result = plan_cartesian(q[n:], goal, arm_alone(scene, q), objective=objective, speed=speed)
    if n == 0 or result.trajectory is None:
        return result
    whole = with_base(result.trajectory, scene, q)
    return replace(result, trajectory=whole, path=Path(whole.q), cost=evaluate(whole, scene, objective))
