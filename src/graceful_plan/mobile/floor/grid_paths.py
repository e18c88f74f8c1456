"""Paths of a point over the cells of a floor map, by Dijkstra, A* and Theta*, with a cost per metre in each cell.

A step leads to any of the eight neighbours. Its cost is its length times one plus the mean charge of the two cells. A
diagonal step needs both adjacent cells to be free, so no corner is cut. Dijkstra and A* are exact. Theta* [Daniel2010]
connects cells in line of sight, at the cost of the cells between. Its cost is never above that over eight neighbours,
but it is not always the least.

[Daniel2010] K. Daniel, A. Nash, S. Koenig, A. Felner, "Theta*: any-angle path planning on grids", JAIR 39.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.path import finite_array
from graceful_plan.setting_checks import not_negative

METHODS = ("a_star", "dijkstra", "theta_star")
MOST_CHARGE = 1e12
"""Largest charge of a cell: additional cost per metre [m/m]."""


class GridStatus(Enum):
    """Outcome of a search, with a remedy."""

    SOLVED = "a path was found"
    NO_PATH = "no path leads from start to goal: try a smaller radius or finer cells"
    STOPPED = "the time limit was reached before a path was found"
    START_BLOCKED = "the start is off the map, or closer to an obstacle than the radius"
    GOAL_BLOCKED = "the goal is off the map, or closer to an obstacle than the radius"


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class GridPath:
    """Result of a search.

    | field      | meaning                                              | unit | shape   |
    |------------|------------------------------------------------------|------|---------|
    | status     | outcome                                              |      |         |
    | xy         | centres of the path's cells in W, from start to goal | m    | point 2 |
    | cells      | column and row of these cells                        |      | point 2 |
    | cost       | length and charges                                   | m    |         |
    | expansions | number of expanded cells                             |      |         |
    """

    status: GridStatus
    xy: Float[Array, "point 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    cells: Int[Array, "point 2"] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int32))
    cost: float = math.inf
    expansions: int = 0

    @property
    def length(self) -> float:
        """Length of the path [m]; infinite without one."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum()) if len(self.xy) else math.inf


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FloorGrid:
    """Free cells of a map for a point with a radius; made once, searched many times.

    Args:
        floor: The map.
        radius: Distance to keep from obstacles [m], such as the radius of a round base; at least 0.
        charge: Additional cost per metre in each cell, at least 0, such as w times an impact; None: 0.

    Raises:
        ShapeError: If the charge does not fit the map.
        NonFiniteError: If it is not finite.
        SettingError: If the radius or a charge is out of its range.
    """

    floor: OccupancyGrid
    radius: float = 0.0
    charge: Float[Array, "row column"] | None = None
    native: _native.FloorGrid = field(init=False, repr=False)
    """The grid in the core."""

    def __post_init__(self) -> None:
        not_negative("FloorGrid.radius", self.radius)
        charge = None
        if self.charge is not None:
            charge = np.ascontiguousarray(finite_array("charge", np.asarray(self.charge)), dtype=np.float32)
            if charge.shape != self.floor.shape:
                raise ShapeError("charge", charge.shape, str(self.floor.shape))
            if charge.min() < 0.0 or charge.max() > MOST_CHARGE:
                raise SettingError("FloorGrid.charge", [float(charge.min()), float(charge.max())], "from 0 to 1e12")
        closed = self.floor.occupied if self.radius == 0.0 else self.floor.distance < self.radius
        native = _native.FloorGrid(
            closed=np.ascontiguousarray(closed, dtype=np.uint8), resolution=self.floor.resolution, charge=charge
        )
        object.__setattr__(self, "native", native)

    def path(
        self,
        start: Sequence[float] | ArrayLike,
        goal: Sequence[float] | ArrayLike,
        *,
        method: str = "a_star",
        time_limit: float = math.inf,
    ) -> GridPath:
        """Search a path between the cells of two points in W.

        Args:
            start: x and y [m].
            goal: x and y [m].
            method: "a_star", "dijkstra" (both exact over eight neighbours), or "theta_star" (any angle).
            time_limit: Time limit [s], above 0.

        Raises:
            ShapeError: If a point is not (2,).
            NonFiniteError: If a point is not finite.
            UnknownNameError: If there is no such method.
            SettingError: If the time limit is not above 0.
        """
        if method not in METHODS:
            raise UnknownNameError("method", method, METHODS)
        if not time_limit > 0.0:
            raise SettingError("time_limit", time_limit, "a number of seconds above 0")
        ends = []
        for name, point, blocked in (
            ("start", start, GridStatus.START_BLOCKED),
            ("goal", goal, GridStatus.GOAL_BLOCKED),
        ):
            cell = self._cell(name, point)
            if cell is None:
                return GridPath(status=blocked)
            ends.append(cell)
        found = self.native.path(start=ends[0], goal=ends[1], method=method, time_limit=time_limit)
        if not found["found"]:
            status = GridStatus.STOPPED if found["stopped"] else GridStatus.NO_PATH
            return GridPath(status=status, expansions=found["expansions"])
        return GridPath(
            status=GridStatus.SOLVED,
            xy=self.floor.centres(found["cells"]),
            cells=found["cells"],
            cost=found["cost"],
            expansions=found["expansions"],
        )

    def costs(self, start: Sequence[float] | ArrayLike) -> Float[Array, "row column"]:
        """Return the exact least costs [m] from the cell of a point in W to all cells; infinite for unreachable ones.

        Raises:
            ShapeError: If the point is not (2,).
            NonFiniteError: If it is not finite.
        """
        cell = self._cell("start", start)
        if cell is None:
            return np.full(self.floor.shape, np.inf)
        return self.native.costs(int(cell[0]), int(cell[1]))

    def _cell(self, name: str, point: Sequence[float] | ArrayLike) -> Int[Array, " 2"] | None:
        """Return the cell of a point; None if it is not free."""
        xy = finite_array(name, np.asarray(point), ndim=1, last=2)
        column, row = self.floor.cells(xy).tolist()
        rows, columns = self.floor.shape
        if not (0 <= column < columns and 0 <= row < rows):
            return None
        closed = (
            self.floor.occupied[row, column] if self.radius == 0.0 else self.floor.distance[row, column] < self.radius
        )
        return None if closed else np.array([column, row], dtype=np.int32)
