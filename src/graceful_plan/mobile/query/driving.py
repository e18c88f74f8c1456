"""Planning for robots with a base: implements the contract in `query.driving`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.mobile.motions.arc_stops import arc_stops, impossible_velocity
from graceful_plan.mobile.motions.drive_source import DriveSource
from graceful_plan.mobile.motions.passing import cheaper, passing_motions
from graceful_plan.mobile.planners import DRIVING
from graceful_plan.mobile.planners.drive_lattice import DriveLattice
from graceful_plan.mobile.query.arm_detours import with_arm_detours
from graceful_plan.planners.motion_descent import DRIVING_TIME_PRICE
from graceful_plan.planners.planner import Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.base_planning import BasePlanning
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import State, Trajectory

_TIGHT = "{}: free, but with less than 2 mm of clearance in the planner's sphere model; a base cannot step out of it"


@final
class PlansForBases(BasePlanning):
    """Plans for bases by curves that descend from floor paths and lattice paths."""

    @property
    def planners(self) -> Mapping[str, type[Planner]]:
        """All planners for bases, by name."""
        return DRIVING

    def default_planner(self) -> Planner:
        """Return the lattice planner."""
        return DriveLattice()

    def ends(self, ends: Endpoints) -> Endpoints | PlanResult:
        """Return the ends that a base can leave and reach by rolling, or a failed result if there are none."""
        if len(ends.departure) > 1:
            return PlanResult(status=PlanStatus.INVALID_START, detail=_TIGHT.format("start"))
        clear = [k for k, arrival in enumerate(ends.arrivals) if len(arrival) == 1]
        if not clear:
            return PlanResult(status=PlanStatus.INVALID_GOAL, detail=_TIGHT.format("goal"))
        arrivals, index = (tuple(of[k] for k in clear) for of in (ends.arrivals, ends.goal_index))
        return with_arm_detours(replace(ends, arrivals=arrivals, goal_index=index))

    def motions(
        self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator
    ) -> DriveSource:
        """See `DriveSource`."""
        return DriveSource(request, ends, problem, rng)

    def impossible_velocity(self, state: State, scene: Scene, speed: float) -> str:
        """Return why the base cannot move like this: sideways, or beyond a limit."""
        return impossible_velocity(state, scene, speed)

    def stops(self, state: State, held: SceneConstraints, speed: float) -> Iterator[Trajectory]:
        """Yield stops along the present arc."""
        return arc_stops(state, held, speed)

    def passing(self, stop: Trajectory, onward: Trajectory, whole: Trajectory, request: Request) -> list[Trajectory]:
        """See `passing_motions`."""
        return cheaper(list(passing_motions(stop, onward, request)), whole, request, DRIVING_TIME_PRICE)
