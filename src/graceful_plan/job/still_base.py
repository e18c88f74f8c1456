"""Motions of the arm of a mobile robot while its base stands still: an approach, a lift, a path of a handle.

They are planned in a scene in which only the joints of the arm are planned; returned motions have the base at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.costs.objective import Objective, evaluate
from graceful_plan.judge.exact import exactly_free
from graceful_plan.path import Path
from graceful_plan.query.cartesian.straight import plan_cartesian
from graceful_plan.query.endpoints.base_goals import base_goals
from graceful_plan.query.endpoints.ik import FreeTest, solve_ik
from graceful_plan.query.endpoints.pose_solver import PoseSolver
from graceful_plan.query.endpoints.usable import free_of_collision
from graceful_plan.result import PlanResult
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_RAISED = 0.1
"""Height above a pose at which the place of the base is sought [m]: beyond contact in the model of spheres."""
_SEEDS, _SPREAD, _ITERATIONS = 16, 0.3, 40
"""Arm configurations from which a pose is sought with the base at rest, their spread [rad or m], and iterations."""
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
    within: Callable[[], Scene] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Float[Array, "n nq"]:
    """Return configurations free of collision that bring the tool to a pose, the nearest first; possibly none.

    A base stays where it is if the arm reaches the pose from there. Otherwise it goes to places from which the arm
    reaches a pose above this one.

    Args:
        goal: The pose.
        scene: Scene with the robot.
        near: Configuration near which others are sought.
        count: Number of configurations that is enough.
        seed: Seed of the random numbers.
        within: Returns another scene with the same robot in which the configurations have to be free. It is made only
            for poses within reach, and not compiled for an arm without a base.
        cancelled: Polled during the search.
    """

    def free(q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        return free_of_collision(q, scene) if within is None else exactly_free(q, within())

    if base_joints(scene) == 0:
        return solve_ik(goal, scene, near, free=free, count=count, rounds=2, seed=seed).q
    if len(found := _by_arm(goal, scene, near, free, count, seed)):
        return found
    inside = scene if within is None else within()
    bases = base_goals(inside)
    assert bases is not None
    above = goal.X_WT.copy()
    above[2, 3] += _RAISED
    untouched = partial(free_of_collision, scene=inside)
    raised = replace(goal, X_WT=above)
    places = bases.reaching(raised, inside, near, free=untouched, seed=seed, cancelled=cancelled).q
    arms = (row for q in places for row in _by_arm(goal, scene, q, free, 1, seed))
    return np.array(list(islice(arms, count))).reshape(-1, len(near))


def is_reached_from(
    q: Float[Array, " nq"], goal: PoseGoal, scene: Scene, within: Callable[[], Scene], *, seed: int
) -> bool:
    """Tell whether the arm reaches a pose from a configuration near it; for the arguments see `reached_poses`."""
    found, _ = PoseSolver(goal, scene).search(q[None], _ITERATIONS, slice(0, base_joints(scene)))
    if len(found) and exactly_free(found, within())[0]:
        return True
    return len(reached_poses(goal, scene, q, count=1, seed=seed, within=within)) > 0


def _by_arm(
    goal: PoseGoal, scene: Scene, near: Float[Array, " nq"], free: FreeTest, count: int, seed: int
) -> Float[Array, "n nq"]:
    """Return configurations with the base as in one, the nearest to it first."""
    n, rng = base_joints(scene), np.random.default_rng(seed)
    seeds = np.tile(near, (_SEEDS, 1))
    seeds[1:, n:] += rng.normal(0.0, _SPREAD, (_SEEDS - 1, len(near) - n))
    lower, upper = scene.limits.position.T
    found, _ = PoseSolver(goal, scene).search(np.clip(seeds, lower, upper), _ITERATIONS, slice(0, n))
    found = found[np.argsort(np.linalg.norm(found - near, axis=1), kind="stable")]
    usable = (row for row in found if free(row[None])[0])
    return np.array(list(islice(usable, count))).reshape(-1, len(near))


def with_base(motion: Trajectory, scene: Scene, q: Float[Array, " nq"]) -> Trajectory:
    """Return a motion of the arm as a motion of the whole robot, whose base stands where it is in a configuration."""
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
