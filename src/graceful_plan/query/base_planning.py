"""Interface to planning for robots with a mobile base: planners, endpoints and motions."""

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
from graceful_plan.scene.mobile.room import import_mobile
from graceful_plan.scene.scene import Scene


class BasePlanning(ABC):
    """The parts of `plan` that differ for robots with a mobile base."""

    @property
    @abstractmethod
    def planners(self) -> Mapping[str, type[Planner]]:
        """Planners for bases by name; their `Planner.drives` is True."""

    @abstractmethod
    def default_planner(self) -> Planner:
        """Return the planner for "auto"."""

    @abstractmethod
    def ends(self, ends: Endpoints) -> Endpoints | PlanResult:
        """Return the ends that the base can leave and reach; if there are none, a result with the reason."""

    @abstractmethod
    def motions(
        self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator
    ) -> MotionMaker:
        """Return a maker of motions for a request.

        Args:
            request: The request.
            ends: Both ends.
            problem: Problem to search.
            rng: Random numbers.
        """


def base_planning(scene: Scene) -> BasePlanning | None:
    """Return the `BasePlanning` for a scene whose robot has a mobile base; None if it has none.

    Raises:
        UnsupportedError: If the robot has a base, and `graceful_plan.mobile` is not installed.
    """
    return None if scene.base is None else _room()


def planners_by_name() -> Mapping[str, type[Planner]]:
    """Return the planners for bases; empty if `graceful_plan.mobile` is not installed."""
    try:
        return _room().planners
    except UnsupportedError:
        return {}


def _room() -> BasePlanning:
    driving: BasePlanning = import_mobile("query.driving").PlansForBases()
    return driving
