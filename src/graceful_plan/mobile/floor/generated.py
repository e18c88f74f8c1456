"""Random floors for studies: rooms with doors, furniture and entities; and obstacle courses.

The same seed gives the same floor. An object is only placed if a disc of given radius can still pass between all rooms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.scene.edit import StaticBody

_WALL = 0.15
"""Thickness of walls [m]."""
_DOOR = (1.0, 1.3)
"""Range of door widths [m]."""
_CLEAR = 0.15
"""Clearance at starts and goals, in addition to the passage radius [m]."""
_RADIUS = {"adult": 0.25, "child": 0.18, "pet": 0.15, "heirloom": 0.15, "glass": 0.1}
"""Radii of the cylinders that represent entities [m]."""
_HEIGHT = {"adult": 1.7, "child": 1.1, "pet": 0.5, "heirloom": 0.6, "glass": 0.5}
_TRIES = 200
CYLINDER = 0.075
"""Radius of the obstacles of a course [m], as in the BARN challenge."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class GeneratedFloor:
    """A floor and a planning problem on it.

    Args:
        floor: The map.
        start: Pose of the base in W, (x, y, yaw) [m, m, rad].
        goal: Goal pose, likewise.
        length: Length of the shortest path between them for a disc of the passage radius [m].
    """

    floor: OccupancyGrid
    start: Float[Array, " xyyaw"]
    goal: Float[Array, " xyyaw"]
    length: float


def floor_plan(
    seed: int,
    *,
    rooms: tuple[int, int] = (3, 2),
    room: float = 4.5,
    furniture: int = 4,
    people: int = 5,
    passage: float = 0.4,
    resolution: float = 0.05,
) -> GeneratedFloor:
    """Generate a floor of rooms with doors, furniture and entities, with start and goal in different rooms.

    Args:
        seed: Random seed, at least 0.
        rooms: Number of rooms along x and y.
        room: Approximate width of a room [m].
        furniture: Largest number of pieces in each room.
        people: Total number of entities: adults, children, pets and things.
        passage: Radius of the disc that can pass between all rooms [m].
        resolution: Width of a cell [m].

    Raises:
        SettingError: If a setting is out of its range.
    """
    checks = {
        "seed": (seed >= 0, "at least 0"),
        "rooms": (min(rooms) >= 1 and max(rooms) <= 40, "from 1 to 40 each"),
        "room": (2.5 <= room <= 50.0, "from 2.5 to 50 m"),
        "furniture": (0 <= furniture <= 100, "from 0 to 100"),
        "people": (0 <= people <= 200, "from 0 to 200"),
        "passage": (0.0 < passage <= 0.45, "above 0 and at most 0.45 m, as doors are 1 m wide"),
        "resolution": (0.01 <= resolution <= 0.1, "from 0.01 to 0.1 m"),
    }
    _check(checks, locals())
    rng = np.random.default_rng((16, seed))
    walls, middles = _walls(rng, rooms, room, resolution)
    field = _Field(walls, resolution, passage, middles)
    for x, y in middles:
        for _ in range(int(rng.integers(0, furniture + 1))):
            size = rng.uniform(0.3, 1.2, 2)
            at = (x, y) + rng.uniform(-0.5, 0.5, 2) * room
            field.put(_rectangle(field.occupied.shape, resolution, at - 0.5 * size, at + 0.5 * size))
    furnished = field.occupied.copy()
    entities = []
    names = tuple(_RADIUS)
    for k in range(people):
        category = names[k % len(names)]
        for _ in range(_TRIES):
            at = rng.uniform(0.0, np.array(walls.shape[::-1]) * resolution)
            disc = _disc(field.occupied.shape, resolution, at, _RADIUS[category])
            if disc.any() and not (disc & field.occupied).any() and field.put(disc):
                entities.append(_person(f"{category}_{k}", category, at))
                break
    floor = OccupancyGrid(
        occupancy=furnished, resolution=resolution, entities=tuple(entities), name=f"floor_plan_{seed}"
    )
    start, goal, length = _ends(rng, field, min(6.0, 0.8 * room * max(rooms)))
    return GeneratedFloor(floor=floor, start=start, goal=goal, length=length)


def obstacle_course(
    seed: int,
    *,
    length: float = 10.0,
    width: float = 4.5,
    fill: float = 0.2,
    passage: float = 0.3,
    resolution: float = 0.05,
) -> GeneratedFloor:
    """Generate a course of cylinders of radius 0.075 m in the style of the BARN challenge, to be crossed end to end.

    D. Perille, A. Truong, X. Xiao, P. Stone, "Benchmarking metric ground navigation", SSRR 2020: cells of 0.15 m are
    filled at random, then smoothed by a cellular automaton. Courses that the disc cannot pass are drawn again.

    Args:
        seed: Random seed, at least 0.
        length: Distance between start and goal [m].
        width: Width of the course [m].
        fill: Share of cells filled before smoothing.
        passage: Radius of the disc that can pass [m].
        resolution: Width of a cell of the map [m]; the cells of cylinders are 0.15 m wide.

    Raises:
        SettingError: If a setting is out of its range.
    """
    checks = {
        "seed": (seed >= 0, "at least 0"),
        "length": (3.0 <= length <= 100.0, "from 3 to 100 m"),
        "width": (2.0 <= width <= 100.0, "from 2 to 100 m"),
        "fill": (0.0 <= fill <= 0.3, "from 0 to 0.3"),
        "passage": (0.0 < passage <= 0.5, "above 0 and at most 0.5 m"),
        "resolution": (0.01 <= resolution <= 0.1, "from 0.01 to 0.1 m"),
    }
    _check(checks, locals())
    rng, cell, free = np.random.default_rng((17, seed)), 2.0 * CYLINDER, 1.0
    for _ in range(_TRIES):
        filled = automaton(rng, (round(width / cell), round((length - 1.0) / cell)), fill)
        rows, columns = round(width / resolution), round((length + 2.0 * free) / resolution)
        occupied = np.zeros((rows, columns), dtype=bool)
        for row, column in np.argwhere(filled):
            at = np.array([free + 0.5 + (column + 0.5) * cell, (row + 0.5) * cell])
            occupied |= _disc(occupied.shape, resolution, at, CYLINDER)
        ends = np.array([[free, 0.5 * width], [free + length, 0.5 * width]])
        field = _Field(occupied, resolution, passage, ends)
        way = field.lengths(ends[0])[tuple((ends[1] / resolution).astype(int)[::-1])]
        if np.isfinite(way):
            floor = OccupancyGrid(occupancy=occupied, resolution=resolution, name=f"obstacle_course_{seed}")
            start, goal = (np.array([*end, 0.0]) for end in ends)
            return GeneratedFloor(floor=floor, start=start, goal=goal, length=float(way))
    raise SettingError("fill", fill, f"a smaller share: none of {_TRIES} courses can be passed")


def _check(checks: dict[str, tuple[bool, str]], given: dict[str, object]) -> None:
    for name, (holds, expected) in checks.items():
        if not holds:
            raise SettingError(name, given[name], expected)


class _Field:
    """Occupied cells, with a check that a set of places stays connected when objects are added."""

    def __init__(self, occupied: Bool[Array, "row column"], resolution: float, passage: float, places: Array) -> None:
        self.occupied, self.resolution, self.passage, self.places = occupied, resolution, passage, places

    def distance(self) -> Float[Array, "row column"]:
        blocked = np.ascontiguousarray(self.occupied, dtype=np.uint8)
        return _native.distance_field(blocked=blocked, resolution=self.resolution, outside=True)

    def lengths(self, start: Float[Array, " 2"]) -> Float[Array, "row column"]:
        """Return the lengths of the shortest paths from a point to all cells."""
        closed = np.ascontiguousarray(self.distance() < self.passage, dtype=np.uint8)
        grid = _native.FloorGrid(closed=closed, resolution=self.resolution, charge=None)
        column, row = (start / self.resolution).astype(int).tolist()
        return grid.costs(column, row)

    def put(self, more: Bool[Array, "row column"]) -> bool:
        """Add an object; undo this and return False if it disconnects the places."""
        before, self.occupied = self.occupied, self.occupied | more
        ways = self.lengths(self.places[0])
        column, row = (np.asarray(self.places) / self.resolution).astype(int).T
        if not np.isfinite(ways[row, column]).all():
            self.occupied = before
            return False
        return True


def _walls(
    rng: np.random.Generator, rooms: tuple[int, int], room: float, resolution: float
) -> tuple[Bool[Array, "row column"], Float[Array, "room 2"]]:
    """Return walls with doors such that every room can be reached, and the centres of the rooms."""
    borders = []
    for n in rooms:
        inner = room * np.arange(1, n) + rng.uniform(-0.15, 0.15, n - 1) * room
        borders.append(np.array([0.0, *inner, room * n]))
    shape = tuple(round(border[-1] / resolution) for border in borders[::-1])
    occupied = np.zeros(shape, dtype=bool)
    for axis, border in enumerate(borders):
        for at in border:
            low, high = np.zeros(2), np.array([borders[0][-1], borders[1][-1]])
            low[axis], high[axis] = at - 0.5 * _WALL, at + 0.5 * _WALL
            occupied |= _rectangle(shape, resolution, low, high)
    for (i, j), axis in _doors(rng, rooms):
        other, k, m = 1 - axis, (i, j)[axis], (i, j)[1 - axis]
        door, (a, b) = rng.uniform(*_DOOR), (borders[other][m] + _WALL, borders[other][m + 1] - _WALL)
        low, high = np.zeros(2), np.zeros(2)
        low[axis], high[axis] = borders[axis][k + 1] - _WALL, borders[axis][k + 1] + _WALL
        low[other] = rng.uniform(a, b - door)
        high[other] = low[other] + door
        occupied &= ~_rectangle(shape, resolution, low, high)
    x, y = (0.5 * (border[1:] + border[:-1]) for border in borders)
    return occupied, np.array([(a, b) for b in y for a in x])


def _doors(rng: np.random.Generator, rooms: tuple[int, int]) -> Iterator[tuple[tuple[int, int], int]]:
    """Yield the walls with doors, by room and axis: those of a random spanning tree and a third of the others."""
    walls = [((i, j), axis) for i in range(rooms[0]) for j in range(rooms[1]) for axis in (0, 1)]
    walls = [wall for wall in walls if wall[0][wall[1]] + 1 < rooms[wall[1]]]
    group = {(i, j): (i, j) for i in range(rooms[0]) for j in range(rooms[1])}
    for k in rng.permutation(len(walls)):
        (i, j), axis = walls[k]
        a, b = group[(i, j)], group[(i + (axis == 0), j + (axis == 1))]
        if a != b:
            group = {place: a if own == b else own for place, own in group.items()}
        if a != b or rng.uniform() < 1.0 / 3.0:
            yield walls[k]


def _rectangle(
    shape: tuple[int, ...], resolution: float, low: Float[Array, " 2"], high: Float[Array, " 2"]
) -> Bool[Array, "row column"]:
    cells = np.zeros(shape, dtype=bool)
    (a, b), (c, d) = (np.maximum(np.rint(corner / resolution).astype(int), 0) for corner in (low, high))
    cells[b:d, a:c] = True
    return cells


def _disc(
    shape: tuple[int, ...], resolution: float, at: Float[Array, " 2"], radius: float
) -> Bool[Array, "row column"]:
    """Return the cells that a disc touches."""
    cells = np.zeros(shape, dtype=bool)
    first = np.maximum(np.floor((at - radius) / resolution).astype(int), 0)
    last = np.ceil((at + radius) / resolution).astype(int)
    part = cells[first[1] : last[1], first[0] : last[0]]
    row, column = np.ogrid[: part.shape[0], : part.shape[1]]
    dx = np.maximum(np.abs((column + first[0] + 0.5) * resolution - at[0]) - 0.5 * resolution, 0.0)
    dy = np.maximum(np.abs((row + first[1] + 0.5) * resolution - at[1]) - 0.5 * resolution, 0.0)
    part |= dx * dx + dy * dy < radius * radius * (1.0 - 1e-9)
    return cells


def automaton(
    rng: np.random.Generator, shape: tuple[int, int], fill: float, smoothings: int = 2
) -> Bool[Array, "row column"]:
    """Fill cells at random, then smooth: a cell is filled if 5 of its 3 x 3 cells are, and stays filled with 3."""
    filled = rng.uniform(size=shape) < fill
    for _ in range(smoothings):
        around = np.pad(filled, 1).astype(int)
        count = sum(around[1 + i : 1 + i + shape[0], 1 + j : 1 + j + shape[1]] for i in (-1, 0, 1) for j in (-1, 0, 1))
        filled = (count >= 5) | (filled & (count >= 3))
    return filled


def _person(name: str, category: str, at: Float[Array, " 2"]) -> StaticBody:
    half = 0.5 * _HEIGHT[category]
    return StaticBody(
        name=name, kind="cylinder", size=[_RADIUS[category], half], pose=np.array([*at, half]), entity=category
    )


def _ends(rng: np.random.Generator, field: _Field, least: float) -> tuple[Array, Array, float]:
    """Return two poses with clearance to turn, and their path length: at least `least`, or the longest found."""
    row, column = np.nonzero(field.distance() > field.passage + _CLEAR)
    if len(row) == 0:
        row, column = np.nonzero(field.distance() >= field.passage)
    best: tuple[Array, Array, float] | None = None
    for _ in range(_TRIES):
        k, m = rng.integers(0, len(row), 2)
        start, goal = ((np.array([column[i], row[i]]) + 0.5) * field.resolution for i in (k, m))
        way = float(field.lengths(start)[row[m], column[m]])
        if np.isfinite(way) and (best is None or way > best[2]):
            yaw = rng.uniform(-np.pi, np.pi, 2)
            best = np.array([*start, yaw[0]]), np.array([*goal, yaw[1]]), way
        if best is not None and best[2] >= least:
            break
    assert best is not None  # the rooms are connected
    return best
