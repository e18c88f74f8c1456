"""Inverse kinematics for callers: the solutions that `plan` would choose a goal from, with their residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.query.endpoints import ik
from graceful_plan.query.endpoints.usable import free_of_collision
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.scene.tasks import named_configuration


@dataclass(frozen=True, kw_only=True, eq=False)
class IKSolutions:
    """Configurations that bring the tool to a pose, the nearest first; possibly none.

    | field             | meaning                                                             | unit     | shape       |
    |-------------------|---------------------------------------------------------------------|----------|-------------|
    | q                 | configurations within the limits and the tolerances of the goal     | rad or m | solution nq |
    | position_error    | distance of the tool's origin from the goal                         | m        | solution    |
    | orientation_error | angle to the goal's orientation; with free yaw, that of the z axes  | rad      | solution    |
    | best_error        | both errors of the best configuration, also if it collides or misses| m, rad   |             |
    | colliding         | number of configurations at the pose that are left out: they collide|          |             |
    """

    q: Float[Array, "solution nq"]
    position_error: Float[Array, " solution"]
    orientation_error: Float[Array, " solution"]
    best_error: tuple[float, float]
    colliding: int

    def __len__(self) -> int:
        return len(self.q)

    def __str__(self) -> str:
        """Describe the outcome in one line."""
        position, orientation = self.best_error
        missed = f"the nearest configuration misses the pose by {1e3 * position:.3g} mm and {orientation:.3g} rad"
        told = f"{len(self)} solutions" if len(self) else f"no solution; {missed}"
        return f"{told}; {self.colliding} more collide" if self.colliding else told


def solve_ik(
    goal: PoseGoal,
    scene: Scene,
    near: ArrayLike | str,
    *,
    count: int = 8,
    avoid_collisions: bool = True,
    seed: int = 0,
) -> IKSolutions:
    """Find configurations that bring the tool to a pose.

    Redundant arms have infinitely many solutions: this returns distinct ones, which differ by at least 0.1 rad or m in
    some joint. The search is not complete: an empty result is no proof that there is none. Constraints along motions,
    such as a level cup, are not considered. A mobile base counts as joints that move freely.

    Args:
        goal: Pose of the tool, with tolerances. Up to 5 mm and 0.05 rad, solutions are exact where that is possible.
        scene: Robot and surroundings.
        near: Configuration, or name of a keyframe; the search starts there, and the nearest solutions come first.
        count: Largest number of solutions.
        avoid_collisions: Whether to leave out configurations that collide, by exact geometry.
        seed: Seed of the random numbers; the result depends on nothing else.

    Returns:
        The solutions; none is a result, not an error.

    Raises:
        SettingError: If `goal` is not a PoseGoal, or `count` is below 1.
        ShapeError: If `near` does not have one number per planned joint.
        UnknownNameError: If there is no such keyframe.
    """
    if not isinstance(goal, PoseGoal):
        raise SettingError("goal", goal, "a PoseGoal")
    start = named_configuration(near, checked_scene(scene)) if isinstance(near, str) else near
    free = (lambda q: free_of_collision(q, scene)) if avoid_collisions else None
    found = ik.solve_ik(goal, scene, start, free=free, count=count, seed=seed)
    errors = np.array([pose_error(goal, X) for X in scene.pose(found.q)]).reshape(-1, 2)
    return IKSolutions(
        q=found.q,
        position_error=errors[:, 0],
        orientation_error=errors[:, 1],
        best_error=(found.position_error, found.orientation_error),
        colliding=found.colliding,
    )
