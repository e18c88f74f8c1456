"""The contract of planning for robots that drive: their planners, and the way from the ends of a motion to a result."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from graceful_plan.exceptions import UnsupportedError
from graceful_plan.planners.planner import Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.maker import MotionMaker
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import PlanResult
from graceful_plan.scene.mobile.room import mobile_room
from graceful_plan.scene.scene import Scene


class Driving(ABC):
    """What `plan` does for robots with a base."""

    @property
    @abstractmethod
    def planners(self) -> Mapping[str, type[Planner]]:
        """Every planner for bases that is known by name; each says so with `Planner.drives`."""

    @abstractmethod
    def default_planner(self) -> Planner:
        """Return the planner that "auto" stands for."""

    @abstractmethod
    def ends(self, ends: Endpoints) -> Endpoints | PlanResult:
        """Return the ends that a base can leave and reach; a result that says so if there are none."""

    @abstractmethod
    def motions(
        self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator
    ) -> MotionMaker:
        """Return what makes motions for a request.

        Args:
            request: What to plan.
            ends: Both ends.
            problem: Where to search.
            rng: Chance.
        """


def driving_of(scene: Scene) -> Driving | None:
    """Return how to plan for a scene's robot if it drives; None if it stands.

    Raises:
        UnsupportedError: If it drives, and the room of what drives is not installed.
    """
    return None if scene.base is None else _room()


def planners_by_name() -> Mapping[str, type[Planner]]:
    """Return the planners for bases; none if the room of what drives is not installed."""
    try:
        return _room().planners
    except UnsupportedError:
        return {}


def _room() -> Driving:
    driving: Driving = mobile_room("query.driving").PlansForBases()
    return driving
