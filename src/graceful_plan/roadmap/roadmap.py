"""A roadmap of one scene: collision-free nodes and edges with cached costs, searched again and again."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from graceful_plan.arguments import checked_seed
from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.compile import compile_scene
from graceful_plan.costs.objective import Objective
from graceful_plan.goals import Configuration, Goal
from graceful_plan.kernels import FINE_STEP
from graceful_plan.planners.roadmap_nodes import draw_nodes, neighbour_edges
from graceful_plan.planners.settings import count
from graceful_plan.roadmap.exposure import EdgePrices, Exposure
from graceful_plan.scene import Scene
from graceful_plan.severity import SeverityTable

Array = np.ndarray
Severity = SeverityTable | Mapping[str, float | Mapping[str, float]]

MARGIN = 0.002
"""Clearance that nodes and edges keep [m]."""


@dataclass(frozen=True, eq=False)
class FrontPath:
    """One path of a front: its vertices, and what it costs."""

    q: Float[Array, "n nq"]
    """Vertices [rad or m], from the start to a goal."""
    motion: float
    """V."""
    impact: float
    """S."""


class Roadmap:
    """Made by `build` or `load`."""

    def front(
        self,
        start: Configuration,
        goal: Goal,
        *,
        epsilon: float = 0.01,
        severity: Severity | None = None,
        max_points: int | None = None,
    ) -> list[FrontPath]:
        """Return the paths of the roadmap that no other one of it dominates, by ascending motion cost."""
        raise NotImplementedError
