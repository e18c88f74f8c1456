"""Interface to planning for robots with a mobile base: planners, endpoints and motions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping

import numpy as np

from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.planners.planner import Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.maker import MotionMaker
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import PlanResult
from graceful_plan.scene.mobile.optional import import_mobile
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import State, Trajectory


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

    @abstractmethod
    def impossible_velocity(self, state: State, scene: Scene, speed: float) -> str:
        """Return why the robot cannot move like this within a fraction of its limits; empty if it can."""

    @abstractmethod
    def stops(self, state: State, held: SceneConstraints, speed: float) -> Iterator[Trajectory]:
        """Yield stops of a moving robot within a fraction of its velocity limits, the quickest first."""

    @abstractmethod
    def passing(self, stop: Trajectory, onward: Trajectory, whole: Trajectory, request: Request) -> list[Trajectory]:
        """Return motions that go over from the path of a stop to a motion from its end without a rest.

        Args:
            stop: The stop.
            onward: The motion from its end.
            whole: Both one after the other, with a rest between them.
            request: The request; only motions of less cost than `whole` are returned, the cheapest first.
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
