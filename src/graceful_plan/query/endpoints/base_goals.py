"""Interface to goals of robots with a mobile base: configurations for a pose of the base or of the tool."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from graceful_plan.array_types import Array, Float
from graceful_plan.query.endpoints.ik import FreeTest, IKResult
from graceful_plan.query.endpoints.usable import Resolved
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.mobile.optional import import_mobile
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene


class BaseGoals(ABC):
    """Finds configurations of a robot with a mobile base for poses."""

    @abstractmethod
    def standing(self, goal: BasePose, scene: Scene, start: Float[Array, " nq"]) -> Resolved:
        """Return usable configurations with the base at a pose and the arm as at the start."""

    @abstractmethod
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
        """Return configurations of base and arm with the tool at a pose, nearest to the start first.

        Args:
            goal: The pose of the tool.
            scene: Scene whose robot has a base and an arm.
            start: Start of the motion.
            free: Test which configurations are free.
            seed: Seed of the random numbers.
            cancelled: Polled during the search; once it returns True, the solutions up to then are returned.
        """


def base_goals(scene: Scene) -> BaseGoals | None:
    """Return the `BaseGoals` for a scene whose robot has a mobile base; None if it has none.

    Raises:
        UnsupportedError: If the robot has a base, and `graceful_plan.mobile` is not installed.
    """
    if scene.base is None:
        return None
    goals: BaseGoals = import_mobile("query.whole_body").WholeBodyGoals()
    return goals
