"""How `plan` plans for robots that drive: see the contract, `query.driving`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from graceful_plan.mobile.planners import DRIVING
from graceful_plan.mobile.planners.drive_lattice import DriveLattice
from graceful_plan.mobile.query.answer import driven_answer
from graceful_plan.planners.planner import Budget, Planner
from graceful_plan.query.driving import Driving
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.result import PlanResult


@final
class PlansForBases(Driving):
    """Search on a lattice, smooth drives near what was found, and the judge."""

    @property
    def planners(self) -> Mapping[str, type[Planner]]:
        """Every planner for bases by name."""
        return DRIVING

    def default_planner(self) -> Planner:
        """Return the lattice."""
        return DriveLattice()

    def answer(self, request: Request, ends: Endpoints, budget: Budget, rng: np.random.Generator) -> PlanResult:
        """Search, time, judge, and search more cautiously while the judge objects: see `driven_answer`."""
        return driven_answer(request, ends, budget, rng)
