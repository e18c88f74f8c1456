"""The contract of goals for bases: where to stand for a pose, of the base or of the tool of an arm on it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.query.endpoints.ik import FreeTest, IKResult
from graceful_plan.query.endpoints.usable import Resolved
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.mobile.room import mobile_room
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.scene.scene import Scene

Array = np.ndarray


class BaseGoals(ABC):
    """Configurations of robots with a base that drives, for poses."""

    @abstractmethod
    def standing(self, goal: BasePose, scene: Scene, start: Float[Array, " nq"]) -> Resolved:
        """Return usable configurations with the base at a pose and the arm as it is at the start."""

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
        """Return configurations of base and arm with the tool at a pose, the nearest to drive and to move to first.

        Args:
            goal: The pose.
            scene: A robot with a base and an arm.
            start: Where it is.
            free: Which configurations may be used.
            seed: Of the random numbers.
            cancelled: Asked all the time; once it returns True, what was found until then is returned.
        """


def base_goals(scene: Scene) -> BaseGoals | None:
    """Return what finds goals for the base of a scene's robot; None for a robot without one.

    Raises:
        UnsupportedError: If there is a base, and the room of what drives is not installed.
    """
    if scene.base is None:
        return None
    goals: BaseGoals = mobile_room("query.whole_body").WholeBodyGoals()
    return goals
