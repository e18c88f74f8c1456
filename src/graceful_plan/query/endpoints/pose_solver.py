"""Inverse kinematics of one pose, from many seeds at once in the core."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene

PRECISION = 1e-3
"""Largest error of a solution that aims at the pose itself, as a share of the goal's tolerances."""
_FINE = np.array([0.005, 0.05])
"""Tolerances up to which the search first aims at the pose itself [m, rad]; greater ones are aimed at as sets."""
_AIMED, _ACCEPTED = 0.9, 0.99
"""Shares of the tolerances: radius of the set that the search aims at, and largest error of a solution."""
_PATIENCE = 10
"""Iterations within which a seed has to make progress."""


@final
class PoseSolver:
    """A solver for one pose: the core iterates from many seeds at once."""

    def __init__(
        self,
        goal: PoseGoal,
        scene: Scene,
        cancelled: Callable[[], bool] = lambda: False,
        ease: Float[Array, " nq"] | None = None,
    ) -> None:
        self.goal, self.scene, self.cancelled, self.ease = goal, scene, cancelled, ease
        self.kernels = compile_scene(scene).kernels
        self.lower, self.upper = scene.limits.position.T

    def search(
        self, seeds: Float[Array, "n nq"], iterations: int, held: slice = slice(0), *, loose: bool = False
    ) -> tuple[Float[Array, "m nq"], Float[Array, "n nq"]]:
        """Iterate from all seeds.

        Args:
            seeds: Configurations inside the limits.
            iterations: Largest number of iterations from each seed.
            held: Joints that do not move.
            loose: Whether fine tolerances are aimed at as sets, too.

        Returns:
            Configurations that reached the pose, and the final configurations of all seeds, the best first.
        """
        q, reached, missing = self.reached(seeds, iterations, held, loose=loose)
        return q[reached], q[np.argsort(np.linalg.norm(missing, axis=1), kind="stable")]

    def reached(
        self, seeds: Float[Array, "n nq"], iterations: int, held: slice = slice(0), *, loose: bool = False
    ) -> tuple[Float[Array, "n nq"], Bool[Array, " n"], Float[Array, "n 6"]]:
        """Return the final configuration of each seed, whether it reached the pose, and what is missing."""
        X_WG = np.broadcast_to(self.goal.X_WT, (len(seeds), 4, 4))
        free_yaw = np.full(len(seeds), self.goal.free_yaw)
        radius, rest = aims(np.tile(tolerances(self.goal), (len(seeds), 1)), loose=loose)
        q, missing = self.kernels.reach(
            seeds, X_WG, free_yaw, iterations=iterations, patience=_PATIENCE, held=held, radius=radius, ease=self.ease
        )
        return q, within(missing, *rest.T), missing

    def errors(self, q: Float[Array, " nq"]) -> tuple[float, float]:
        """Return the position [m] and orientation error [rad] of a configuration."""
        return pose_error(self.goal, self.kernels.tool_pose(q))

    def badness(self, error: tuple[float, float]) -> float:
        """Return the sum of position and orientation error, each relative to its tolerance."""
        return error[0] / self.goal.position_tolerance + error[1] / self.goal.orientation_tolerance


def tolerances(goal: PoseGoal) -> Float[Array, " 2"]:
    """Return the tolerances of position [m] and orientation [rad]."""
    return np.array([goal.position_tolerance, goal.orientation_tolerance])


def aims(tolerance: Float[Array, "n 2"], *, loose: bool) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"]]:
    """Return the radii of the sets of poses to aim at [m, rad], and the error beyond them that is accepted.

    Args:
        tolerance: Tolerances of position [m] and orientation [rad].
        loose: Whether fine tolerances are aimed at as sets, too.
    """
    as_set = loose | (tolerance > _FINE)
    free = (tolerance >= np.pi) & np.array([False, True])  # no rotation is farther away than that
    radius = np.where(free, np.inf, np.where(as_set, _AIMED * tolerance, 0.0))
    return radius, np.where(as_set, (_ACCEPTED - _AIMED) * tolerance, PRECISION * tolerance)


def within(
    error: Float[Array, "n 6"], distance: float | Float[Array, " n"], angle: float | Float[Array, " n"]
) -> Bool[Array, " n"]:
    """Return which pose errors are within a distance [m] and an angle [rad]."""
    return (np.linalg.norm(error[:, :3], axis=1) <= distance) & (np.linalg.norm(error[:, 3:], axis=1) <= angle)
