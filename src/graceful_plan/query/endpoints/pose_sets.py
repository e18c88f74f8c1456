"""Inverse kinematics for many poses at once, such as hundreds of grasps of which few are reachable.

Inverse kinematics of a single pose takes some milliseconds if all solutions collide, and more if there is none. Here
the native core iterates for all poses together, from few seeds each: the start, and the random postures whose tool is
nearest to the pose. It may miss reachable poses; `ik` searches a single pose more thoroughly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import exactly_free
from graceful_plan.query.endpoints.pose_solver import aims, tolerances, within
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.query.endpoints.usable import MOST_GOALS
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

LEVER = 0.25
"""Weight of rotation in the distance between poses [m/rad]."""
_POSTURES = 4000
"""Number of random configurations; for an arm about a third of them is free."""
_AT_A_TIME = 64
"""Poses between two readings of the clock."""
_SEEDS = (1, 2, 4)
"""Postures that serve as seeds in each round, for poses that are not reached yet; the first round adds the start."""
_ITERATIONS, _PATIENCE = 24, 4
"""Largest number of iterations, and iterations within which a seed has to make progress."""
_OVERLAP = 0.03
"""Penetration of spheres up to which exact geometry checks a configuration [m]."""


@dataclass(frozen=True, eq=False)
class Postures:
    """Random free configurations and the pose of the tool in them.

    | field | meaning                                 | unit     | shape      |
    |-------|-----------------------------------------|----------|------------|
    | q     | configurations                          | rad or m | posture nq |
    | place | position, and rotation in the same unit | m        | posture 12 |
    """

    q: Float[Array, "posture nq"]
    place: Float[Array, "posture 12"]


@per_scene
def postures_of(scene: Scene) -> Postures:
    """Draw configurations of a scene's robot that are free by the sphere model; deterministic."""
    kernels = compile_scene(scene).kernels
    lower, upper = scene.limits.position.T
    q = np.random.default_rng(0).uniform(lower, upper, (_POSTURES, len(lower)))
    q = q[kernels.free(q)]
    return Postures(q, _places(kernels.tool_pose(q)))


@dataclass(frozen=True, eq=False)
class PosesReached:
    """Usable configurations, in the order of the poses.

    | field | meaning                                  | unit     | shape     |
    |-------|------------------------------------------|----------|-----------|
    | q     | configurations                           | rad or m | usable nq |
    | index | index of the pose of each configuration  |          | usable    |
    """

    q: Float[Array, "usable nq"]
    index: Int[Array, " usable"]


def reach_poses(
    goals: Sequence[PoseGoal],
    scene: Scene,
    travel: Travel,
    *,
    turned: Callable[[Float[Array, "n nq"]], Float[Array, "n nq"]] = lambda q: q,
    cancelled: Callable[[], bool] = lambda: False,
    hurried: Callable[[], bool] = lambda: False,
) -> PosesReached:
    """Find one usable configuration for each of as many poses as possible.

    Args:
        goals: The poses, by descending priority.
        scene: Robot and surroundings.
        travel: Cost of moves from the start, which is the first seed of every pose; cheap solutions are preferred.
        turned: Transforms configurations before they are checked, such as `wrapped_near`.
        cancelled: Ends the call early once it returns True.
        hurried: Ends the call once it returns True and a configuration is known.
    """
    start = travel.start
    poses, known = _Poses(goals, scene, travel), postures_of(scene)
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
            reached, of = poses.reached(seeds, of, loose=count == _SEEDS[-1])
            reached, of = _usable(turned(reached), of, scene, travel)
            q, index = np.concatenate([q, reached]), np.concatenate([index, of])
            missing.append(np.setdiff1d(some, of))
        left, first = np.concatenate(missing) if missing else left, first + count
    return _in_order(q, index)


def _in_order(q: Float[Array, "n nq"], index: Int[Array, " n"]) -> PosesReached:
    order = np.argsort(index, kind="stable")
    return PosesReached(q[order][:MOST_GOALS], index[order][:MOST_GOALS])


class _Poses:
    """Iterates towards many poses, with separate seeds for each."""

    def __init__(self, goals: Sequence[PoseGoal], scene: Scene, travel: Travel) -> None:
        self.kernels, self.ease = compile_scene(scene).kernels, travel.ease
        self.X_WG = np.stack([goal.X_WT for goal in goals])
        self.free_yaw = np.array([goal.free_yaw for goal in goals])
        self.tolerance = np.array([tolerances(goal) for goal in goals])

    def reached(
        self, q: Float[Array, "n nq"], of: Int[Array, " n"], *, loose: bool
    ) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
        """Iterate from seeds towards the poses with indices `of`; return converged configurations and their indices.

        If `loose`, fine tolerances are aimed at as sets, too.
        """
        radius, rest = aims(self.tolerance[of], loose=loose)
        q, missing = self.kernels.reach(
            q,
            self.X_WG[of],
            self.free_yaw[of],
            iterations=_ITERATIONS,
            patience=_PATIENCE,
            radius=radius,
            ease=self.ease,
        )
        there = within(missing, *rest.T)
        return q[there], of[there]


def _seeds(
    poses: _Poses, some: Int[Array, " n"], known: Postures, which: tuple[int, int]
) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
    """Return the postures whose tool is nearest to each pose, and the index of that pose.

    Args:
        poses: All poses.
        some: Indices of the poses that need seeds.
        known: Postures to choose from.
        which: Number of nearest postures to skip, and number of postures to return for each pose.
    """
    first, count = which
    last = min(first + count, len(known.q))
    wanted = _places(poses.X_WG[some])
    away = (known.place**2).sum(axis=1) - 2.0 * wanted @ known.place.T
    free = np.flatnonzero(poses.free_yaw[some])
    if len(free):  # with free yaw only the z axis counts: the last column of the rotation
        axis = np.r_[0:3, 5, 8, 11]
        away[free] = (known.place[:, axis] ** 2).sum(axis=1) - 2.0 * wanted[free][:, axis] @ known.place[:, axis].T
    if first >= last:
        return np.empty((0, known.q.shape[1])), np.empty(0, dtype=int)
    nearest = np.argpartition(away, last - 1, axis=1)[:, :last]
    order = np.argsort(np.take_along_axis(away, nearest, axis=1), axis=1, kind="stable")[:, first:last]
    chosen = np.take_along_axis(nearest, order, axis=1)
    return known.q[chosen.ravel()], np.repeat(some, chosen.shape[1])


def _usable(
    q: Float[Array, "n nq"], of: Int[Array, " n"], scene: Scene, travel: Travel
) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
    """Return for each pose the free configuration that is the cheapest to move to, if there is one."""
    if not len(q):
        return q, of
    compiled = compile_scene(scene)
    order = np.argsort(travel.cost(q), kind="stable")
    q, of = q[order], of[order]
    near = compiled.kernels.free(q, -_OVERLAP)
    q, of = q[near], of[near]
    free = compiled.proof.free(q)
    doubtful = np.flatnonzero(~free & ~np.isin(of, of[free]))
    free[doubtful] = exactly_free(q[doubtful], scene)
    first = _firsts(of, free)
    return q[first], of[first]


def _firsts(of: Int[Array, " n"], good: Bool[Array, " n"]) -> Int[Array, " m"]:
    """Return for each number in `of` the index of its first good entry."""
    where = np.flatnonzero(good)
    return where[np.unique(of[where], return_index=True)[1]]


def _places(X: Float[Array, "n 4 4"]) -> Float[Array, "n 12"]:
    """Return poses as vectors whose Euclidean distances approximate distances of poses with weight `LEVER` [m]."""
    # Matrices of rotations that differ by a small angle have a Frobenius distance of sqrt(2) times that angle.
    return np.concatenate([X[:, :3, 3], LEVER / np.sqrt(2.0) * X[:, :3, :3].reshape(-1, 9)], axis=1)
