"""Planning for robots with a base: implements the contract in `query.driving`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from graceful_plan.mobile.motions.drive_source import DriveSource
from graceful_plan.mobile.planners import DRIVING
from graceful_plan.mobile.planners.drive_lattice import DriveLattice
from graceful_plan.mobile.query.rolling_endpoints import rolling_endpoints
from graceful_plan.planners.planner import Planner
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.base_planning import BasePlanning
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import PlanResult


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
        """See `rolling_endpoints`."""
        return rolling_endpoints(ends)

    def motions(
        self, request: Request, ends: Endpoints, problem: SceneProblem, rng: np.random.Generator
    ) -> DriveSource:
        """See `DriveSource`."""
        return DriveSource(request, ends, problem, rng)
