"""Floor maps: distances, paths over cells beside other libraries, exactness, and courses that are planned."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

import graceful_plan as gp
from benchmarks import report, suite
from graceful_plan.mobile.floor import generated
from graceful_plan.mobile.floor.generated import obstacle_course
from graceful_plan.mobile.floor.grid_paths import FloorGrid
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid

Array = np.ndarray

TITLE = "Floor maps: distances and paths over cells"
CELLS, RESOLUTION, SMALL, COURSES, SECONDS = 1000, 0.05, 300, 50, 3.0
SEED = 16
FILLS, SMOOTHINGS = (0.15, 0.2, 0.25, 0.3), (2, 3, 4)
"""Of the published worlds (the makers' generator of the dataset)."""
MEASURED = f"""\
An office floor of {CELLS} x {CELLS} cells made at random, rooms with doors and boxes, each cell with a price; times are
those of the processor, one thread, the median of five, and of others' libraries where they are installed. They do not
all do the same: scikit-image and pyastar2d cut corners, the latter charges the cells that are entered. "Exact": {SMALL}
random maps of at most 24 x 24 cells with prices over seven orders of magnitude against scipy's Dijkstra on an explicit
graph. Courses: {COURSES} of cylinders of 0.075 m, of the kind of the BARN challenge, 10 m, planned for a Jackal in
{SECONDS:g} s each. What was published of the challenge's 300 worlds: 30 x 30 cells of 0.15 m, filled to 0.15, 0.2, 0.25
or 0.3 at first and smoothed 2, 3 or 4 times, 25 worlds for each. Cells that are then full are compared by this
library's own automaton, whose rule need not be theirs.
"""


def office(seed: int, cells: int = CELLS) -> tuple[Array, Array]:
    """Return what is occupied, and prices."""
    rng = np.random.default_rng((SEED, seed))
    occupied = np.zeros((cells, cells), dtype=bool)
    for wall in range(100, cells, 100):
        occupied[wall : wall + 3] = occupied[:, wall : wall + 3] = True
    for wall in range(100, cells, 100):
        for room in range(0, cells, 100):
            for view in (occupied, occupied.T):
                at = room + rng.integers(6, 60)
                view[wall : wall + 3, at : at + 26] = False
    for _ in range(cells // 5):
        (y, x), (h, w) = rng.integers(0, cells, 2), rng.integers(5, 30, 2)
        occupied[y : y + h, x : x + w] = True
    occupied[:12, :12] = occupied[-12:, -12:] = False
    row, column = np.indices((cells, cells))
    price = sum(
        np.exp(-((row - y) ** 2 + (column - x) ** 2) / (2 * 40.0**2)) for y, x in rng.uniform(0, cells, (40, 2))
    )
    return occupied, 4.0 * np.asarray(price)


def timed(function: Callable[[], Any], times: int = 5) -> float:
    """Return the median time of the processor [ms]."""
    taken = []
    for _ in range(times):
        began = time.thread_time()
        function()
        taken.append(1e3 * (time.thread_time() - began))
    return float(np.median(taken))


def graph(free: Array, charge: Array) -> csr_array:
    """Return the steps that lead from cell to cell, no corner cut."""
    rows, columns = free.shape
    ids = np.arange(free.size).reshape(free.shape)
    edges = []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, rows - dr), slice(max(0, -dc), columns - max(0, dc)))
        b = (slice(dr, rows), slice(max(0, dc), columns - max(0, -dc)))
        ok = free[a] & free[b]
        if dr and dc:
            ok &= free[a[0], b[1]] & free[b[0], a[1]]
        cost = np.hypot(dr, dc) * RESOLUTION * (1.0 + 0.5 * (charge[a] + charge[b]))
        edges.append((ids[a][ok], ids[b][ok], cost[ok]))
    tail, head, cost = (np.concatenate(part) for part in zip(*edges, strict=True))
    return coo_array((cost, (tail, head)), shape=(free.size, free.size)).tocsr()


def worst_difference(n: int) -> float:
    """Return the greatest relative difference of costs from those of scipy."""
    worst = 0.0
    for seed in range(n):
        rng = np.random.default_rng((SEED, seed, 1))
        shape = tuple(rng.integers(2, 25, 2))
        occupied = rng.uniform(size=shape) < rng.uniform(0, 0.4)
        occupied[0, 0] = False
        charge = 10.0 ** rng.integers(-2, 6) * rng.uniform(size=shape)
        floor = OccupancyGrid(occupancy=occupied, resolution=RESOLUTION)
        grid = FloorGrid(floor=floor, charge=charge)
        known = dijkstra(graph(~occupied, charge), directed=False, indices=0)
        start = floor.centres([0, 0])
        found = grid.costs(start).ravel()
        assert np.array_equal(np.isinf(found), np.isinf(known))
        some = np.flatnonzero(np.isfinite(known) & (known > 0.0))
        for k in rng.choice(some, min(5, len(some)), replace=False) if len(some) else ():
            cost = grid.path(start, floor.centres([k % shape[1], k // shape[1]])).cost
            worst = max(worst, abs(cost / known[k] - 1.0))
        worst = max(worst, float(np.abs(found[some] / known[some] - 1.0).max(initial=0.0)))
    return worst


def courses(job: int) -> tuple[str, float, float]:
    """Plan a course; return the status, the time to the first path [s] and the length over the shortest way's."""
    course = obstacle_course(job)
    scene = course.floor.to_scene()
    first: list[float] = []
    gp.plan(course.start, course.goal, scene, w=0.0, iterations=1)
    result = gp.plan(
        course.start,
        gp.BasePose(*course.goal[:2]),
        scene,
        w=0.0,
        time_limit=SECONDS,
        callback=lambda point: first.append(point.time),
    )
    length = np.nan
    if result.trajectory is not None:
        length = float(np.linalg.norm(np.diff(result.trajectory.q[:, :2], axis=0), axis=1).sum()) / course.length
    return result.status.name, first[0] if first else np.nan, length


def densities(n: int) -> tuple[Array, Array, Array]:
    """Return shares of full cells: of n courses, of ones filled as the published worlds are, and the parameters."""
    cells = 2.0 * generated.CYLINDER
    ours, theirs, kinds = [], [], []
    for seed in range(n):
        floor = obstacle_course(seed).floor
        column = np.arange(floor.shape[1]) * floor.resolution
        field = floor.occupied[:, (column >= 1.5) & (column < 10.5)]
        # Cylinders take pi/4 of their cells, and on the map whatever they touch.
        ours.append(field.mean() / _on_the_map(cells, floor.resolution))
    for fill in FILLS:
        for smoothings in SMOOTHINGS:
            for seed in range(25):
                filled = generated.automaton(np.random.default_rng((SEED, seed)), (30, 30), fill, smoothings)
                theirs.append(filled.mean())
                kinds.append((fill, smoothings))
    return np.array(ours), np.array(theirs), np.array(kinds)


def _on_the_map(cell: float, resolution: float) -> float:
    """Share of the area of a cell that its cylinder occupies on a map."""
    at = (np.arange(round(cell / resolution)) + 0.5) * resolution - 0.5 * cell
    nearest = np.maximum(np.abs(at) - 0.5 * resolution, 0.0)
    return float((nearest[:, None] ** 2 + nearest**2 < (0.5 * cell) ** 2).mean())


def _per_cent(shares: Array) -> str:
    return f"{100 * shares.mean():.1f} % ({100 * shares.min():.1f} to {100 * shares.max():.1f})"


def _reachable() -> int:
    """Return the first seed whose corners are connected."""
    seed = 0
    while True:
        grid = FloorGrid(floor=OccupancyGrid(occupancy=office(seed)[0], resolution=RESOLUTION))
        if grid.path(*grid.floor.centres([[5, 5], [CELLS - 6, CELLS - 6]])).xy.size:
            return seed
        seed += 1


def _rows(occupied: Array, price: Array) -> Iterator[list[str]]:
    floor = OccupancyGrid(occupancy=occupied, resolution=RESOLUTION)
    start, goal = floor.centres([[5, 5], [CELLS - 6, CELLS - 6]])
    plain, charged = FloorGrid(floor=floor), FloorGrid(floor=floor, charge=price)
    blocked = occupied.astype(np.uint8)
    from graceful_plan.core import _native

    field = timed(lambda: _native.distance_field(blocked=blocked, resolution=RESOLUTION, outside=True))
    yield ["distance field", "ours, to squares", f"{field:.1f}", ""]
    yield ["", "scipy, to centres", f"{timed(lambda: distance_transform_edt(~occupied)):.1f}", ""]
    yield ["Dijkstra, all cells, prices", "ours", f"{timed(lambda: charged.costs(start)):.1f}", ""]
    reached = int(np.isfinite(charged.costs(start)).sum())
    yield ["", "cells that it reaches", f"{reached}", ""]
    steps = graph(~occupied, price)
    yield ["", "scipy, graph made before", f"{timed(lambda: dijkstra(steps, directed=False, indices=5005), 1):.1f}", ""]
    if find_spec("skimage"):
        from skimage.graph import MCP_Geometric

        cost = np.where(occupied, np.inf, 1.0 + price)
        yield ["", "scikit-image", f"{timed(lambda: MCP_Geometric(cost).find_costs([(5, 5)]), 1):.1f}", ""]
    if find_spec("pyastar2d"):
        import pyastar2d

        cost = np.where(occupied, np.inf, 1.0 + price).astype(np.float32)
        ends = (5, 5), (CELLS - 6, CELLS - 6)
        taken = timed(lambda: pyastar2d.astar_path(cost, *ends, allow_diagonal=True), 1)
        yield ["one path, prices", "pyastar2d", f"{taken:.1f}", ""]
    for name, grid in (("prices", charged), ("no prices", plain)):
        for method in ("dijkstra", "a_star", "theta_star"):
            path = grid.path(start, goal, method=method)
            taken = timed(lambda grid=grid, method=method: grid.path(start, goal, method=method), 3)
            yield [f"one path, {name}", method, f"{taken:.1f}", f"{path.cost:.3f}"]


def run(options: suite.Options) -> str:
    """Measure all."""
    few = options.quick
    rows = list(_rows(*office(_reachable())))
    worst = worst_difference(20 if few else SMALL)
    planned = list(suite.spread(courses, list(range(3 if few else COURSES)), options.processes, "courses"))
    solved = sum(status == "SOLVED" for status, _, _ in planned)
    took = {(row[0], row[1]): float(row[2]) for row in rows}
    targets = [
        report.Target(
            what="distance field, 1000 x 1000",
            wanted="<= 25 ms",
            measured=f"{took['distance field', 'ours, to squares']:.1f} ms",
            met=took["distance field", "ours, to squares"] <= 25.0,
        ),
        report.Target(
            what="Dijkstra to all cells, with prices",
            wanted="<= 60 ms",
            measured=f"{took['Dijkstra, all cells, prices', 'ours']:.1f} ms",
            met=took["Dijkstra, all cells, prices", "ours"] <= 60.0,
        ),
        report.Target(
            what="Dijkstra and A*, farthest from the optimum",
            wanted="<= 1e-6",
            measured=f"{worst:.1g}",
            met=worst <= 1e-6,
        ),
        report.Target(
            what="courses planned", wanted="100 %", measured=f"{solved} of {len(planned)}", met=solved == len(planned)
        ),
    ]
    first, length = (np.array([one[k] for one in planned]) for k in (1, 2))
    told = (
        f"Courses: first path after {1e3 * np.nanmedian(first):.0f} ms (median), {1e3 * np.nanmax(first):.0f} at most; "
        f"motions are {np.nanmedian(length):.3f} times as long as the shortest way of a disc over cells.\n"
    )
    ours, theirs, kinds = densities(3 if few else COURSES)
    alike = theirs[(kinds == (0.2, 2.0)).all(axis=1)]
    told += (
        f"Full cells: {_per_cent(ours)} in the courses, which keep a way of 0.6 m and are filled to 0.2 and smoothed "
        f"twice; {_per_cent(theirs)} in fields that are filled as the published ones are, no way asked for; of these, "
        f"{_per_cent(alike)} where filled to 0.2 and smoothed twice.\n"
    )
    header = ("what", "by", "ms", "cost m")
    return f"{MEASURED}\n{report.targets(targets)}\n{report.table(header, rows)}\n{told}"
