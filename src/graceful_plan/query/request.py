"""What was asked of `plan`."""

from __future__ import annotations

from dataclasses import dataclass, field

from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.judge.verification import Verification
from graceful_plan.planners import Planner
from graceful_plan.query.deadline.clock import Clock
from graceful_plan.query.prefer import Preference
from graceful_plan.query.search import Callback
from graceful_plan.scene.pose_goal import PoseGoal


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """What was asked for, all of it checked.

    | field        | meaning                                                               | unit |
    |--------------|-----------------------------------------------------------------------|------|
    | planner      | what searches                                                         |      |
    | objective    | what to minimise, in which scene                                      |      |
    | constraints  | what has to hold on the way                                           |      |
    | preference   | what decides between paths instead, if the mean impact does not       |      |
    | poses        | the pose to be reached by each way to a goal, None where that is none |      |
    | speed        | fraction of the velocity limits to use                                |      |
    | max_wait     | longest wait at the start, if something moves                         | s    |
    | verification | how closely the judge looks                                           |      |
    | callback     | told of every improvement                                             |      |
    | clock        | the time that there is                                                |      |
    """

    planner: Planner
    objective: SceneObjective
    constraints: SceneConstraints
    preference: Preference | None = None
    poses: tuple[PoseGoal | None, ...] = ()
    speed: float = 1.0
    max_wait: float = 0.0
    verification: Verification | None = None
    callback: Callback | None = None
    clock: Clock = field(default_factory=Clock)

    def pose(self, arrival: int) -> PoseGoal | None:
        """Return the pose that a way to a goal is to reach; None if that is a configuration."""
        return self.poses[arrival] if self.poses else None
