"""Any-angle paths over a floor map cut from the scene: first paths over large floors.

The map contains everything between the floor and the robot's top. Theta* moves a disc around the robot, in which the
robot can turn anywhere; if it does not pass, smaller discs are tried. The path becomes turns in place and straight
stretches, which `plan` checks exactly and replaces by smooth drives. The impact is averaged over driving directions,
because a point on a map has no heading.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.mobile.floor.grid_paths import FloorGrid
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.mobile.planners.bases_only import of_a_base
from graceful_plan.mobile.planners.footprint import floor_around, footprint, near_entities, radii, turns_and_straights
from graceful_plan.mobile.planners.postures import BASE, postures
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem, path_total
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.setting_checks import positive_or_none

_COARSE = 4
"""Row and column stride of the cells in which impact is evaluated."""
_DIRECTIONS = 8
_CRUISE = 0.6
"""Share of the fastest speed at which the impact per metre is evaluated."""
_SHARES = (1.0, 0.5, 0.0)
"""Disc radii tried in order, interpolated from the disc inside the robot (0) to the one around it (1)."""


@final
@dataclass(frozen=True, kw_only=True)
class FloorThetaStar(Planner):
    """Theta* over the cells of a floor map, ignoring headings; one path for each disc that passes.

    The arm keeps one posture, as in `DriveLattice`. One iteration is one search.

    Args:
        resolution: Width of a cell [m].
        around: Extent of the map beyond start and goals, within the limits of the base [m].
    """

    name: ClassVar[str] = "floor_theta_star"
    anytime: ClassVar[bool] = True
    drives: ClassVar[bool] = True

    resolution: float = 0.05
    around: float = 8.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("resolution", self.resolution)
        positive_or_none("around", self.around)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost.

        Raises:
            SettingError: If the robot has no base.
        """
        del rng
        charging, _ = of_a_base(objective, self.name)
        best = np.inf
        for begin in postures(problem):
            for path in self._searched(begin, problem, charging, budget):
                if (total := path_total(objective, path)) < best:
                    best = total
                    yield path

    def _searched(self, begin: Path, problem: Problem, objective: SceneObjective, budget: Budget) -> Iterator[Path]:
        start = begin.q[-1]
        goals = [goal for goal in problem.goals if np.array_equal(goal[BASE:], start[BASE:])]
        discs, top = footprint(objective.scene, start)
        inside, outside = radii(discs)
        ends = np.array([start, *problem.goals])[:, :2]
        floor = floor_around(objective.scene, top, ends, (self.resolution, self.around))
        # The search without impact comes first, because evaluating the impact takes time.
        for with_impact in (False, True)[: 1 + (objective.w > 0.0)]:
            charge = objective.w * self._impact(floor, objective, start, budget) if with_impact else None
            for share in _SHARES:
                grid = FloorGrid(floor=floor, radius=inside + share * (outside - inside), charge=charge)
                for goal in goals:
                    if not budget.spend():
                        return
                    found = grid.path(start[:2], goal[:2], method="theta_star", time_limit=_left(budget))
                    if not len(found.xy):
                        continue
                    q = np.concatenate([begin.q[:-1], turns_and_straights(found.xy, start, goal)])
                    if problem.edges_free(q[:-1], q[1:]).all():
                        yield Path(q).without_duplicates()

    def _impact(
        self, floor: OccupancyGrid, objective: SceneObjective, start: Float[Array, " nq"], budget: Budget
    ) -> Float[Array, "row column"]:
        """Return the mean impact per metre over directions near entities; 0 elsewhere."""
        base = objective.scene.base
        assert base is not None
        speed = _CRUISE * base.v_max
        rows, columns = (math.ceil(n / _COARSE) for n in floor.shape)
        cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        xy = floor.centres((cells + 0.5) * _COARSE - 0.5)
        near = near_entities(xy, objective.scene)
        field, n = np.zeros((rows, columns)), int(near.sum())
        q, qd = np.tile(start, (n, 1)), np.zeros((n, len(start)))
        q[:, :2] = xy[near]
        for yaw in 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
            if budget.exhausted:
                break
            q[:, 2], qd[:, :2] = yaw, speed * np.array([np.cos(yaw), np.sin(yaw)])
            field[near] += objective.approximate_states(q, qd) / (speed * _DIRECTIONS)
        fine = field.repeat(_COARSE, axis=0).repeat(_COARSE, axis=1)
        return fine[: floor.shape[0], : floor.shape[1]]


def _left(budget: Budget) -> float:
    return max(budget.remaining_seconds, 1e-3)
