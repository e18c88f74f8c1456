"""Base placement and inverse kinematics: configurations of a base with an arm that bring the tool to a pose.

A base can stand anywhere at any heading, so the arm only has to provide the height and tilt of the tool. For each
robot, random arm postures are stored with their tool poses in the frame of the base. Those with about the wanted height
and tilt determine the base pose in closed form. The nearest collision-free ones are refined to the exact pose by damped
least squares in all joints. Configurations with the base at its place, or turned there, are tried first.

N. Vahrenkamp, T. Asfour, R. Dillmann, "Robot placement based on reachability inversion", ICRA 2013.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.compile import compile_scene
from graceful_plan.query.endpoints.base_goals import BaseGoals
from graceful_plan.query.endpoints.configurations import goal_labels, wrapped_near
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE
from graceful_plan.query.endpoints.ik import FreeTest, IKResult
from graceful_plan.query.endpoints.pose_solver import PoseSolver
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.query.endpoints.usable import Resolved, usable
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

BASE = 3
"""Number of joints of the base, before those of the arm."""
_SAMPLES, _AT_A_TIME = 30_000, 2_000
"""Number of random postures of a robot, and batch size of their kinematics."""
_MATCHING = 800
"""Number of postures with the tool nearest to the wanted height and tilt."""
_HEIGHT = 0.2
"""Height error that counts as much as a radian of tilt [m]."""
_OVERLAP = 0.03
"""Largest collision depth of a configuration before it is refined to the exact pose [m]."""
_TAKEN = 24
"""Number of configurations that are refined at a time."""
_ROUNDS = 6
_ITERATIONS = 12
_STAYING = 12
"""Number of configurations with the base at its place, or turned there, that are tried first."""
_APART = 0.2
"""Difference below which two solutions count as one, in every joint [rad or m]."""
_HEADINGS = 16
"""Number of headings of a base whose goal leaves the heading free."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Reachability of a robot, relative to its base.

    | field | meaning                                   | unit     | shape      |
    |-------|-------------------------------------------|----------|------------|
    | arm   | random postures                           | rad or m | sample arm |
    | X_BT  | pose of the tool in the frame of the base |          | sample 4 4 |
    """

    arm: Float[Array, "sample arm"]
    X_BT: Float[Array, "sample 4 4"]


@per_layout
def reach_of(scene: Scene) -> Reach:
    """Sample arm postures of a scene's robot; the samples are the same in every call."""
    rng = np.random.default_rng(0)
    lower, upper = scene.limits.position[BASE:].T
    endless = scene.endless[BASE:]
    lower, upper = np.where(endless, -np.pi, lower), np.where(endless, np.pi, upper)
    arm = rng.uniform(lower, upper, (_SAMPLES, len(lower)))
    q = np.column_stack([np.zeros((_SAMPLES, BASE)), arm])
    kernels = compile_scene(scene).kernels
    found = [kernels.tool_pose(q[k : k + _AT_A_TIME]) for k in range(0, _SAMPLES, _AT_A_TIME)]
    return Reach(arm, np.concatenate(found))


def solve_whole_body(
    goal: PoseGoal,
    scene: Scene,
    start: Float[Array, " nq"],
    *,
    free: FreeTest,
    count: int = 8,
    seed: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
) -> IKResult:
    """Find configurations of base and arm that reach a pose, those nearest to the start first.

    Args:
        goal: The pose.
        scene: Scene whose robot has a base.
        start: Start configuration.
        free: Test that a configuration may be used.
        count: Number of different solutions at which the search stops.
        seed: Random seed.
        cancelled: Polled during the search; once it returns True, the solutions found are returned.
    """
    solver, reach, rng = PoseSolver(goal, scene, cancelled), reach_of(scene), np.random.default_rng(seed)
    best, colliding = (np.inf, np.inf), 0
    found: list[Array] = []
    for seeds, held in _rounds(goal, scene, start, reach, rng):
        if len(found) >= count or cancelled():
            break
        reached, ended = solver.search(seeds, _ITERATIONS, held)
        best = min(best, solver.errors(ended[0]), key=solver.badness)
        good = compile_scene(scene).kernels.free(reached, TARGET_CLEARANCE)  # a base cannot step out of tight places
        good[good] = free(reached[good])
        colliding += int((~good).sum())
        for q in reached[good]:
            if all(np.abs(q - other).max() > _APART for other in found):
                found.append(q)
    q = np.array(found).reshape(-1, len(start))
    return IKResult(q[np.argsort(way_to(start, q), kind="stable")][:count], *best, colliding)


def way_to(start: Float[Array, " nq"], q: Float[Array, "n nq"]) -> Float[Array, " n"]:
    """Return distances to configurations: turn, drive forwards or backwards, turn, and move the arm [rad and m]."""
    way, turned = q[:, :2] - start[:2], q[:, 2] - start[2]
    metres = np.linalg.norm(way, axis=1)
    along = np.arctan2(way[:, 1], way[:, 0])[:, None] + np.array([0.0, np.pi])
    turns = np.abs(_wrapped(along - start[2])) + np.abs(_wrapped(q[:, 2:3] - along))
    driven = np.where(metres > 1e-3, turns.min(axis=1), np.abs(_wrapped(turned)))
    return metres + driven + np.linalg.norm(q[:, BASE:] - start[BASE:], axis=1)


def _rounds(goal: PoseGoal, scene: Scene, start: Float[Array, " nq"], reach: Reach, rng: np.random.Generator):
    """Yield seeds and the fixed joints: with the base at its place, turned there, and anywhere."""
    standing = _standing(goal, start, reach)
    yield standing, slice(0, BASE)
    yield standing, slice(0, BASE - 1)
    anywhere = _placed(goal, scene, start, reach, rng)
    for k in range(0, min(len(anywhere), _ROUNDS * _TAKEN), _TAKEN):
        yield anywhere[k : k + _TAKEN], slice(0, 0)


def _standing(goal: PoseGoal, start: Float[Array, " nq"], reach: Reach) -> Float[Array, "n nq"]:
    """Return the start, and the postures whose tool is nearest to the pose with the base at its place."""
    c, s = np.cos(start[2]), np.sin(start[2])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    p = R @ (goal.X_WT[:3, 3] - np.append(start[:2], 0.0))
    away = np.linalg.norm(reach.X_BT[:, :3, 3] - p, axis=1) / _HEIGHT + np.linalg.norm(
        reach.X_BT[:, :3, 2] - R @ goal.X_WT[:3, 2], axis=1
    )
    nearest = np.argpartition(away, _STAYING)[:_STAYING]
    q = np.tile(start, (1 + len(nearest), 1))
    q[1:, BASE:] = reach.arm[nearest]
    return q


def _placed(
    goal: PoseGoal, scene: Scene, start: Float[Array, " nq"], reach: Reach, rng: np.random.Generator
) -> Float[Array, "n nq"]:
    """Return configurations with the base placed for postures of about the right tool height and tilt."""
    k = _matching(goal, reach)
    X, R = reach.X_BT[k], goal.X_WT[:3, :3]
    turn = np.einsum("ij,nkj->nik", R, X[:, :3, :3])
    yaw = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    if goal.free_yaw:
        yaw = np.arctan2(R[1, 2], R[0, 2]) - np.arctan2(X[:, 1, 2], X[:, 0, 2])
        upright = np.hypot(*R[:2, 2]) < 0.1
        yaw = rng.uniform(-np.pi, np.pi, len(k)) if upright else yaw
    c, s, (x, y) = np.cos(yaw), np.sin(yaw), X[:, :2, 3].T
    q = np.column_stack(
        [
            goal.X_WT[0, 3] - (c * x - s * y),
            goal.X_WT[1, 3] - (s * x + c * y),
            start[2] + _wrapped(yaw - start[2]),
            reach.arm[k],
        ]
    )
    lower, upper = scene.limits.position.T
    q = q[((q >= lower) & (q <= upper)).all(axis=1)]
    q = q[compile_scene(scene).kernels.free(q, -_OVERLAP)]
    return q[np.argsort(way_to(start, q), kind="stable")]


def _matching(goal: PoseGoal, reach: Reach) -> Int[Array, " n"]:
    """Return the postures whose tool is nearest to the wanted height and tilt."""
    height = np.abs(reach.X_BT[:, 2, 3] - goal.X_WT[2, 3]) / _HEIGHT
    up = reach.X_BT[:, 2, :3] - goal.X_WT[2, :3]
    tilt = np.abs(up[:, 2]) if goal.free_yaw else np.linalg.norm(up, axis=1)
    return np.argpartition(height + tilt, _MATCHING)[:_MATCHING]


def _wrapped(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def standing(goal: BasePose, scene: Scene, start: Float[Array, " nq"]) -> Resolved:
    """Return configurations with the base at a pose and the arm of the start, the nearest heading first."""
    towards = np.arctan2(goal.y - start[1], goal.x - start[0])
    turns = np.arange(_HEADINGS) * 2.0 * np.pi / _HEADINGS
    q = np.tile(start, (1 if goal.yaw is not None else _HEADINGS, 1))
    q[:, 0], q[:, 1], q[:, 2] = goal.x, goal.y, towards + turns if goal.yaw is None else goal.yaw
    q = wrapped_near(q, start, scene)
    q = q[np.argsort(np.abs(q[:, 2] - towards), kind="stable")]
    found = usable(goal_labels(len(q)), q, scene, Travel(start))
    # With a free heading, one usable heading is enough.
    return Resolved(found.q, (0,) * len(found.q), found.notes, () if len(found.q) else found.problems[:1])


@final
class WholeBodyGoals(BaseGoals):
    """Goals for a base, and for the tool of an arm on it."""

    def standing(self, goal: BasePose, scene: Scene, start: Float[Array, " nq"]) -> Resolved:
        """Return usable configurations with the base at a pose, the nearest heading first."""
        return standing(goal, scene, start)

    def reaching(
        self,
        goal: PoseGoal,
        scene: Scene,
        start: Float[Array, " nq"],
        *,
        free: FreeTest,
        seed: int,
        cancelled: Callable[[], bool],
    ) -> IKResult:
        """Return configurations of base and arm with the tool at a pose: see `solve_whole_body`."""
        return solve_whole_body(goal, scene, start, free=free, seed=seed, cancelled=cancelled)
