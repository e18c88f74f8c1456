"""The checked arguments of a call of `plan`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.judge.verification import VerificationSettings
from graceful_plan.planners import Planner
from graceful_plan.query.candidates.risk_ranking import Preference
from graceful_plan.query.candidates.search import Callback
from graceful_plan.query.endpoints.lead_in import LeadIn, RunIn, Takeover
from graceful_plan.scene.pose_goal import PoseGoal
from graceful_plan.timing.topp import EndSpeeds

Stop = Literal["first", "converged", "time_limit"]
"""When to end: at the first verified motion, at convergence, or at the end of the budget."""
STOPS: tuple[str, ...] = get_args(Stop)


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """Checked arguments of a call.

    | field        | meaning                                                               | unit |
    |--------------|-----------------------------------------------------------------------|------|
    | planner      | planner that searches for paths                                       |      |
    | objective    | cost to minimise, bound to the scene                                  |      |
    | constraints  | constraints along the motion                                          |      |
    | preference   | ranks motions by a risk measure; None: by the mean impact             |      |
    | poses        | pose goal of each arrival; None where the goal is a configuration     |      |
    | speed        | fraction of the velocity limits to use                                |      |
    | max_wait     | longest wait at the start, in a scene with moving entities            | s    |
    | verification | resolution of the judge                                               |      |
    | refine       | whether paths become smooth motions that descend along the objective  |      |
    | stop         | when to end                                                           |      |
    | callback     | called with every improvement                                         |      |
    | lead         | lead-in of a moving start; None from rest                             |      |
    | takeover     | the motion that the robot leaves at the start; None: it has rested    |      |
    | run_in       | run-in of a moving goal; None to rest                                 |      |
    | candidates   | largest number of distinct motions to return                          |      |
    """

    planner: Planner
    objective: SceneObjective
    constraints: SceneConstraints
    preference: Preference | None = None
    poses: tuple[PoseGoal | None, ...] = ()
    speed: float = 1.0
    max_wait: float = 0.0
    verification: VerificationSettings | None = None
    refine: bool = True
    stop: Stop = "time_limit"
    callback: Callback | None = None
    lead: LeadIn | None = None
    takeover: Takeover | None = None
    run_in: RunIn | None = None
    candidates: int = 1

    @property
    def end_speeds(self) -> EndSpeeds:
        """Sizes of the velocity at both ends [rad/s]."""
        start, end = (0.0 if one is None else float(np.linalg.norm(one.velocity)) for one in (self.lead, self.run_in))
        return EndSpeeds(start, end)

    @property
    def only_length(self) -> bool:
        """Whether the shortest motion is the best one: the weight is 0, and nothing has to stay level."""
        return self.objective.w == 0.0 and self.objective.motion_is_length and not self.constraints.level

    def pose(self, arrival: int) -> PoseGoal | None:
        """Return the pose goal of an arrival; None if the goal is a configuration."""
        return self.poses[arrival] if self.poses else None
