"""Configurations for many poses at once: a grasp of hundreds that can be reached is found among those that cannot.

Inverse kinematics of one pose takes some milliseconds where all that reaches it collides, more where nothing does.
Here the native core iterates for all poses together, from few seeds each: the start, and the random postures whose tool
is nearest to the pose. What it reaches is a first choice; `ik` looks more closely at a pose, and gives none up so soon.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import exactly_free
from graceful_plan.query.endpoints.pose_solver import PRECISION, within
from graceful_plan.query.endpoints.usable import MOST_GOALS
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

Array = np.ndarray

LEVER = 0.25
"""What a radian counts as distance where poses are sorted by how far they are [m/rad]."""
_POSTURES = 4000
"""Random configurations to begin from; of an arm about a third is free."""
_AT_A_TIME = 64
"""Poses between two looks at the clock."""
_SEEDS = (1, 2, 4)
"""Postures to begin from, in each round of the poses without a usable configuration; the first has the start, too."""
_ITERATIONS, _PATIENCE = 24, 4
"""At most, and those in which a seed has to make progress."""
_OVERLAP = 0.03
"""Depth to which spheres may collide for exact geometry to look at a configuration [m]."""


@dataclass(frozen=True, eq=False)
class Postures:
    """Random configurations that are free, and where the tool is in them.

    | field | meaning                                 | unit     | shape      |
    |-------|-----------------------------------------|----------|------------|
    | q     | configurations                          | rad or m | posture nq |
    | place | position, and rotation in the same unit | m        | posture 12 |
    """

    q: Float[Array, "posture nq"]
    place: Float[Array, "posture 12"]


@per_scene
def postures_of(scene: Scene) -> Postures:
    """Draw configurations of a scene's robot that spheres prove free; the same every time."""
    kernels = compile_scene(scene).kernels
    lower, upper = scene.limits.position.T
    q = np.random.default_rng(0).uniform(lower, upper, (_POSTURES, len(lower)))
    q = q[kernels.free(q)]
    return Postures(q, _places(kernels.tool_pose(q)))


@dataclass(frozen=True, eq=False)
class PosesReached:
    """Configurations that may be used, in the order of the poses.

    | field | meaning                                  | unit     | shape     |
    |-------|------------------------------------------|----------|-----------|
    | q     | configurations                           | rad or m | usable nq |
    | index | which of the poses each of them reaches  |          | usable    |
    """

    q: Float[Array, "usable nq"]
    index: Int[Array, " usable"]


def reach_poses(
    goals: Sequence[PoseGoal],
    scene: Scene,
    start: Float[Array, " nq"],
    *,
    turned: Callable[[Float[Array, "n nq"]], Float[Array, "n nq"]] = lambda q: q,
    cancelled: Callable[[], bool] = lambda: False,
    hurried: Callable[[], bool] = lambda: False,
) -> PosesReached:
    """Find a configuration for each of as many poses as can be, in the order given.

    Args:
        goals: The poses, those that matter most first.
        scene: Robot and surroundings.
        start: What configurations are near to where that costs nothing: the first seed of every pose.
        turned: What is made of configurations before they are looked at, such as joints turned the short way.
        cancelled: Endpoints it early.
        hurried: Endpoints it once there is any.
    """
    poses, known = _Poses(goals, scene), postures_of(scene)
    q, index = np.empty((0, len(start))), np.empty(0, dtype=int)
    left, first = np.arange(len(goals)), 0
    for count in _SEEDS:
        missing = []
        for k in range(0, len(left), _AT_A_TIME):
            if cancelled() or len(index) >= MOST_GOALS or (len(index) and hurried()):
                return _in_order(q, index)
            some = left[k : k + _AT_A_TIME]
            seeds, of = _seeds(poses, some, known, (first, count))
            if not first:
                seeds, of = np.concatenate([np.tile(start, (len(some), 1)), seeds]), np.concatenate([some, of])
            reached, of = poses.reached(seeds, of)
            reached, of = _usable(turned(reached), of, scene, start)
            q, index = np.concatenate([q, reached]), np.concatenate([index, of])
            missing.append(np.setdiff1d(some, of))
        left, first = np.concatenate(missing) if missing else left, first + count
    return _in_order(q, index)


def _in_order(q: Float[Array, "n nq"], index: Int[Array, " n"]) -> PosesReached:
    order = np.argsort(index, kind="stable")
    return PosesReached(q[order][:MOST_GOALS], index[order][:MOST_GOALS])


class _Poses:
    """Iterations towards many poses, each from its own configurations."""

    def __init__(self, goals: Sequence[PoseGoal], scene: Scene) -> None:
        self.kernels = compile_scene(scene).kernels
        self.X_WG = np.stack([goal.X_WT for goal in goals])
        self.free_yaw = np.array([goal.free_yaw for goal in goals])
        tolerance = [(goal.position_tolerance, goal.orientation_tolerance) for goal in goals]
        self.tolerance = PRECISION * np.array(tolerance)

    def reached(self, q: Float[Array, "n nq"], of: Int[Array, " n"]) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
        """Iterate from configurations to the poses with these indices; return what reached its pose, and which."""
        q, missing = self.kernels.reach(q, self.X_WG[of], self.free_yaw[of], iterations=_ITERATIONS, patience=_PATIENCE)
        there = within(missing, *self.tolerance[of].T)
        return q[there], of[there]


def _seeds(
    poses: _Poses, some: Int[Array, " n"], known: Postures, which: tuple[int, int]
) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
    """Return the postures whose tool is nearest to each pose, after as many others, and which pose they are for."""
    first, count = which
    last = min(first + count, len(known.q))
    wanted = _places(poses.X_WG[some])
    away = (known.place**2).sum(axis=1) - 2.0 * wanted @ known.place.T
    free = np.flatnonzero(poses.free_yaw[some])
    if len(free):  # only the axis counts: the last column of the rotation
        axis = np.r_[0:3, 5, 8, 11]
        away[free] = (known.place[:, axis] ** 2).sum(axis=1) - 2.0 * wanted[free][:, axis] @ known.place[:, axis].T
    if first >= last:
        return np.empty((0, known.q.shape[1])), np.empty(0, dtype=int)
    nearest = np.argpartition(away, last - 1, axis=1)[:, :last]
    order = np.argsort(np.take_along_axis(away, nearest, axis=1), axis=1, kind="stable")[:, first:last]
    chosen = np.take_along_axis(nearest, order, axis=1)
    return known.q[chosen.ravel()], np.repeat(some, chosen.shape[1])


def _usable(
    q: Float[Array, "n nq"], of: Int[Array, " n"], scene: Scene, start: Float[Array, " nq"]
) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
    """Return, for each pose that has one, the configuration nearest to the start that is free."""
    if not len(q):
        return q, of
    compiled = compile_scene(scene)
    order = np.argsort(np.linalg.norm(q - start, axis=1), kind="stable")
    q, of = q[order], of[order]
    near = compiled.kernels.free(q, -_OVERLAP)
    q, of = q[near], of[near]
    free = compiled.proof.free(q)
    doubtful = np.flatnonzero(~free & ~np.isin(of, of[free]))
    free[doubtful] = exactly_free(q[doubtful], scene)
    first = _firsts(of, free)
    return q[first], of[first]


def _firsts(of: Int[Array, " n"], good: Bool[Array, " n"]) -> Int[Array, " m"]:
    """Return where each number stands first among those that are good."""
    where = np.flatnonzero(good)
    return where[np.unique(of[where], return_index=True)[1]]


def _places(X: Float[Array, "n 4 4"]) -> Float[Array, "n 12"]:
    """Return positions and rotations as one vector, whose distances are about those of poses with `LEVER` [m]."""
    # The matrices of rotations that are apart by a small angle are apart by the square root of 2 times that angle.
    return np.concatenate([X[:, :3, 3], LEVER / np.sqrt(2.0) * X[:, :3, :3].reshape(-1, 9)], axis=1)
