"""Paths over cells: Dijkstra and A* against scipy and brute force; Theta* between any-angle and octile length."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError
from graceful_plan.mobile.floor.grid_paths import METHODS, FloorGrid, GridStatus
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid

_RELATIVE = 1e-6  # the cost per metre in a cell is in single precision
RESOLUTION = 0.1


def case(seed, most=14):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, most, 2))
    occupied = rng.uniform(size=shape) < rng.uniform(0.0, 0.4)
    occupied[0, 0] = occupied[-1, -1] = False
    weight = 10.0 ** rng.integers(-2, 6)
    charge = None if seed % 3 == 0 else weight * rng.uniform(size=shape)
    return FloorGrid(floor=OccupancyGrid(occupancy=occupied, resolution=RESOLUTION), charge=charge)


def reference(grid):
    """Return costs from cell (0, 0) by scipy; a diagonal needs both adjacent cells."""
    free = ~grid.floor.occupied
    rows, columns = free.shape
    charge = np.zeros(free.shape) if grid.charge is None else grid.charge
    edges = []
    for r, c, dr, dc in itertools.product(range(rows), range(columns), (-1, 0, 1), (-1, 0, 1)):
        if (dr or dc) and 0 <= r + dr < rows and 0 <= c + dc < columns:
            if free[r, c] and free[r + dr, c + dc] and free[r + dr, c] and free[r, c + dc]:
                price = 1.0 + 0.5 * (charge[r, c] + charge[r + dr, c + dc])
                edges.append((r * columns + c, (r + dr) * columns + c + dc, np.hypot(dr, dc) * RESOLUTION * price))
    tail, head, cost = (np.array(part) for part in zip(*edges, strict=True)) if edges else ([], [], [])
    graph = coo_array((cost, (tail, head)), shape=(free.size, free.size)).tocsr()
    return dijkstra(graph, indices=0).reshape(free.shape)


@given(seed=st.integers(0, 10_000))
def test_dijkstra_and_a_star_are_exact(seed):
    grid = case(seed)
    start, goal = grid.floor.centres([[0, 0], np.array(grid.floor.shape[::-1]) - 1])
    known = reference(grid)
    np.testing.assert_allclose(grid.costs(start), known, rtol=_RELATIVE)
    for method in ("dijkstra", "a_star"):
        path = grid.path(start, goal, method=method)
        if np.isinf(known[-1, -1]):
            assert path.status is GridStatus.NO_PATH and path.cost == np.inf
        else:
            assert path.status is GridStatus.SOLVED
            np.testing.assert_allclose(path.cost, known[-1, -1], rtol=_RELATIVE)
            steps = np.abs(np.diff(path.cells, axis=0))
            assert steps.max(initial=0) <= 1 and tuple(path.cells[0]) == (0, 0)
            if grid.charge is None:
                assert path.length == pytest.approx(path.cost, rel=_RELATIVE)


def charged(grid, a, b, n=2000):
    """Return the cost of a straight line, and whether it is free, by fine samples."""
    t = (np.arange(n) + 0.5) / n
    xy = a + t[:, None] * (b - a)
    column, row = grid.floor.cells(xy).T
    charge = 0.0 if grid.charge is None else grid.charge[row, column].mean()
    return np.hypot(*(b - a)) * (1.0 + charge), not grid.floor.occupied[row, column].any()


@given(seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_theta_star_is_free_and_not_above_octile(seed):
    grid = case(seed)
    start, goal = grid.floor.centres([[0, 0], np.array(grid.floor.shape[::-1]) - 1])
    octile, path = grid.path(start, goal), grid.path(start, goal, method="theta_star")
    assert path.status is octile.status
    if len(path.xy):
        parts = [charged(grid, a, b) for a, b in itertools.pairwise(path.xy)]
        assert all(free for _, free in parts)
        assert path.cost == pytest.approx(sum(cost for cost, _ in parts), rel=0.02, abs=1e-9)
        assert path.cost <= octile.cost * (1 + _RELATIVE)


def visible_length(grid, start, goal):
    """Return the shortest any-angle length between cell centres by brute force over all visible pairs."""
    free = np.argwhere(~grid.floor.occupied)[:, ::-1].astype(np.int32)
    n = len(free)
    cost = np.zeros((n, n))
    for i, j in itertools.combinations(range(n), 2):
        cost[i, j] = cost[j, i] = grid.native.straight(free[i], free[j])
    index = {tuple(cell): k for k, cell in enumerate(free.tolist())}
    cost[np.isinf(cost)] = 0.0
    return dijkstra(cost, indices=index[start])[index[goal]]


def test_theta_star_is_close_to_the_shortest_way_of_any_angle():
    ratios = []
    for seed in range(0, 45, 3):  # cases without additional costs
        grid = case(seed, most=11)
        columns, rows = grid.floor.shape[::-1]
        start, goal = grid.floor.centres([[0, 0], [columns - 1, rows - 1]])
        path = grid.path(start, goal, method="theta_star")
        if len(path.xy):
            best = visible_length(grid, (0, 0), (columns - 1, rows - 1))
            assert path.cost >= best * (1 - 1e-9)
            ratios.append(path.cost / best)
    assert len(ratios) > 5 and np.mean(ratios) < 1.03 and max(ratios) < 1.2  # Theta* is not optimal


def test_open_floor_has_the_known_lengths():
    grid = FloorGrid(floor=OccupancyGrid(occupancy=np.zeros((30, 50), dtype=bool), resolution=1.0))
    a, b = (2.5, 3.5), (45.5, 21.5)
    assert grid.path(a, b).cost == pytest.approx(43 - 18 + 18 * np.sqrt(2))
    assert grid.path(a, b, method="theta_star").cost == pytest.approx(np.hypot(43, 18))


def test_the_radius_is_kept():
    occupied = np.zeros((20, 20), dtype=bool)
    occupied[10, :9] = occupied[10, 12:] = True  # a gap of three cells
    floor = OccupancyGrid(occupancy=occupied, resolution=0.1)
    ends = (1.0, 0.5), (1.0, 1.5)
    path = FloorGrid(floor=floor, radius=0.14).path(*ends)
    assert path.status is GridStatus.SOLVED and floor.distance[path.cells[:, 1], path.cells[:, 0]].min() >= 0.14
    assert FloorGrid(floor=floor, radius=0.16).path(*ends).status is GridStatus.NO_PATH


@pytest.mark.parametrize("method", METHODS)
def test_unhappy_ends_and_limits(method):
    occupied = np.zeros((400, 400), dtype=bool)
    occupied[5, 5] = True
    grid = FloorGrid(floor=OccupancyGrid(occupancy=occupied, resolution=1.0))
    assert grid.path((5.5, 5.5), (1.0, 1.0), method=method).status is GridStatus.START_BLOCKED
    assert grid.path((1.0, 1.0), (-1.0, 1.0), method=method).status is GridStatus.GOAL_BLOCKED
    if method == "dijkstra":  # the other methods finish before they check the time
        assert grid.path((1.0, 1.0), (390.0, 380.0), method=method, time_limit=1e-9).status is GridStatus.STOPPED
    assert len(grid.path((1.0, 1.0), (1.0, 1.0), method=method).xy) == 1
    assert np.isinf(grid.costs((5.5, 5.5))).all()


def test_misuse_is_refused():
    floor = OccupancyGrid(occupancy=np.zeros((3, 4), dtype=bool), resolution=1.0)
    with pytest.raises(ShapeError, match="charge"):
        FloorGrid(floor=floor, charge=np.zeros((4, 3)))
    with pytest.raises(SettingError, match="charge"):
        FloorGrid(floor=floor, charge=np.full((3, 4), -1.0))
    with pytest.raises(SettingError, match="radius"):
        FloorGrid(floor=floor, radius=-1.0)
    with pytest.raises(UnknownNameError, match="method"):
        FloorGrid(floor=floor).path((0.0, 0.0), (1.0, 1.0), method="bfs")
