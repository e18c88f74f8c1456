"""Short, distinct floor paths of a base ("ways"), used as initial guesses for descents.

A disc moves over the cells of a map cut from the scene. A small disc passes everywhere, a large one keeps clear of
obstacles. Further searches add a cost to cells near previous paths, until no new path is found. The paths are not
checked for collision of the robot; the curves that descend from them are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core import _native
from graceful_plan.mobile.floor.grid_paths import FloorGrid
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.mobile.planners.footprint import floor_around, footprint, radii
from graceful_plan.path import evenly
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

_CELL, _AROUND = 0.05, 8.0
"""Width of a cell, and the margin of the map around both ends [m]."""
_SHARES = (0.0, 0.5)
"""Disc radii, interpolated from the disc inside the robot (0) to the one around it (1)."""
_MOST, _NEAR, _DEAR = 4, 0.6, 1.5
"""Largest number of paths; distance from a path within which cells cost more [m], and their extra cost per metre."""
_APART = 0.4
"""Least distance between different paths, at the point where they are farthest apart [m]."""
_LOOKED_AT = 40
"""Number of points of a path that are compared."""
_HARDLY = 1e-3
"""Length of a path below which there is nothing to drive [m]."""
_SECONDS = 1.0
"""Time limit of one search [s]."""


def ways(scene: Scene, start: Float[Array, " nq"], goal: Float[Array, " nq"]) -> Iterator[Float[Array, "point 2"]]:
    """Yield floor paths from a base's start to its goal, the shortest first.

    Args:
        scene: Scene with a base.
        start: Start configuration, including the arm posture.
        goal: Goal configuration.
    """
    if np.hypot(*(goal - start)[:2]) < _HARDLY:
        return
    discs, top = footprint(scene, start)
    inside, outside = radii(discs)
    ends = np.stack([start[:2], goal[:2]])
    floor = _floor(scene, round(top, 2), tuple(ends.min(axis=0).round(1)), tuple(ends.max(axis=0).round(1)))
    found: list[Float[Array, "point 2"]] = []
    for share in _SHARES:
        grid = FloorGrid(floor=floor, radius=inside + share * (outside - inside))
        way = _found(grid, ends)
        if way is not None and _differs(way, found):
            found.append(way)
            yield way
    while found and len(found) < _MOST:
        grid = FloorGrid(floor=floor, radius=inside, charge=_dear(floor, found))
        way = _found(grid, ends)
        if way is None or not _differs(way, found):
            return
        found.append(way)
        yield way


@per_scene(most=4)
def _floor(scene: Scene, top: float, low: tuple[float, float], high: tuple[float, float]) -> OccupancyGrid:
    return floor_around(scene, top, np.array([low, high]), (_CELL, _AROUND))


def _found(grid: FloorGrid, ends: Float[Array, "2 2"]) -> Float[Array, "point 2"] | None:
    xy = grid.path(ends[0], ends[1], method="theta_star", time_limit=_SECONDS).xy
    return np.concatenate([ends[:1], xy[1:-1], ends[1:]]) if len(xy) else None


def _differs(way: Float[Array, "point 2"], others: Sequence[Float[Array, "_ 2"]]) -> bool:
    here = evenly(way, _LOOKED_AT)
    apart = [np.linalg.norm(here[:, None] - evenly(other, 4 * _LOOKED_AT), axis=2).min(axis=1) for other in others]
    return all(float(one.max()) > _APART for one in apart)


def _dear(floor: OccupancyGrid, found: Sequence[Float[Array, "_ 2"]]) -> Float[Array, "row column"]:
    """Return the additional cost of cells near previous paths."""
    near = np.zeros(floor.shape, dtype=np.uint8)
    for way in found:
        n = int(np.ceil(np.linalg.norm(np.diff(way, axis=0), axis=1).sum() / floor.resolution)) + 2
        cells = floor.cells(evenly(way, n))
        near[cells[:, 1], cells[:, 0]] = 1
    distance = _native.distance_field(blocked=near, resolution=floor.resolution, outside=False)
    return np.where(distance < _NEAR, _DEAR, 0.0)
