"""Searches on a lattice: against Dijkstra over all states, and paths checked by exact geometry."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError
from graceful_plan.mobile.floor.lattice import LatticeSettings, LatticeStatus, StateLattice
from graceful_plan.mobile.floor.reeds_shepp import Curves, Steering, shortest_curves
from sizes import first_quick

DISCS = np.array([[-0.12, 0.0, 0.15], [0.12, 0.0, 0.15]])
RESOLUTION = 0.1
CAR = Steering(radius=0.4)
AHEAD = Steering(radius=0.4, reverse=False)
BASE = Steering(radius=0.4, yaw_length=0.3, reverse_penalty=1.5)
COARSE = LatticeSettings(steering=CAR, headings=16, inflations=(1.0,), shots=0)

_TOLERANCE = 1e-5  # of costs: the heuristic is stored in single precision


def distances(occupied, resolution=RESOLUTION):
    """Return exact distances from cell centres to occupied squares; 0 inside."""
    rows, columns = np.indices(occupied.shape)
    nearest = np.full(occupied.shape, 1e3)
    for r, c in np.argwhere(occupied):
        gap = np.hypot(np.maximum(np.abs(rows - r) - 0.5, 0), np.maximum(np.abs(columns - c) - 0.5, 0))
        nearest = np.minimum(nearest, gap * resolution)
    nearest[occupied] = 0.0
    return nearest


def floor(seed, shape=(26, 30), share=0.006):
    occupied = np.random.default_rng(seed).uniform(size=shape) < share
    occupied[2:12, 2:12] = occupied[-12:-2, -12:-2] = False
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return occupied


def impacts(seed, shape, headings):
    rng = np.random.default_rng(seed)
    y, x = np.indices(shape)[..., None]
    field = np.zeros((*shape, headings))
    yaw = np.arange(headings) * 2 * np.pi / headings
    for _ in range(3):
        cx, cy, towards = rng.uniform(0, shape[1]), rng.uniform(0, shape[0]), rng.uniform(0, 2 * np.pi)
        field += np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 20) * (1.2 + np.cos(yaw - towards))
    return field.astype(np.float32)


def pose(column, row, heading, headings=16):
    return np.array([(column + 0.5) * RESOLUTION, (row + 0.5) * RESOLUTION, 2 * np.pi * heading / headings])


START, GOAL = pose(6, 6, 2), pose(23, 19, 5)


def least_costs(lattice, start, w=0.0):
    """Return the costs of all states by Dijkstra over all moves, with the lattice's documented collision check."""
    s, D = lattice.settings, np.asarray(lattice.distance, dtype=np.float32)
    rows, columns = D.shape
    arm, pad = np.hypot(*DISCS[:, :2].T).max(), 40
    padded = np.pad(D, pad, constant_values=-1.0)
    ids = np.arange(rows * columns).reshape(rows, columns)
    edges = []
    for a, b, dx, dy, cost, pieces in lattice.native.moves():
        here, ok, impact = np.array([0.0, 0.0, 2 * np.pi * a / s.headings]), np.ones((rows, columns), bool), 0.0
        for piece in pieces:
            curve = Curves(steering=s.steering, start=here, pieces=piece[None])
            n = 2 * max(1, math.ceil((abs(piece[0]) + arm * (abs(piece[0] * piece[1]) + abs(piece[2]))) / RESOLUTION))
            way = abs(piece[0]) + arm * (abs(piece[0] * piece[1]) + abs(piece[2]))
            at = curve.at(np.linspace(0, curve.measure.sum(), n + 1))
            c, q = np.cos(at[:, 2]), np.sin(at[:, 2])
            for x, y, r in [*DISCS, (0, 0, None)]:
                points = at[:, :2] + np.stack([c * x - q * y, q * x + c * y], axis=-1)
                for p in points:
                    cell = np.floor(p / RESOLUTION + 0.5).astype(int)
                    need = 0.0 if r is None else r + s.margin + np.hypot(*(p - cell * RESOLUTION)) + 0.5 * way / n
                    low = pad + cell[1], pad + cell[0]
                    ok &= padded[low[0] : low[0] + rows, low[1] : low[1] + columns] >= np.float32(need)
            if w:
                for x, y, yaw in curve.at((np.arange(n) + 0.5) / n * curve.measure.sum()):
                    heading = round(yaw / (2 * np.pi / s.headings)) % s.headings
                    shift = np.floor(np.array([y, x]) / RESOLUTION + 0.5).astype(int)
                    shifted = np.pad(lattice.impact[..., heading], pad)[pad + shift[0] :, pad + shift[1] :]
                    impact = impact + shifted[:rows, :columns] * curve.measure.sum() / n
            here = curve.at([curve.measure.sum()])[0]
        y, x = np.nonzero(ok)
        inside = (y + dy >= 0) & (y + dy < rows) & (x + dx >= 0) & (x + dx < columns)
        y, x = y[inside], x[inside]
        charge = cost + w * (impact[y, x] if w else np.zeros(len(y)))
        edges.append([ids[y, x] * s.headings + a, ids[y + dy, x + dx] * s.headings + b, charge])
    tail, head, costs = (np.concatenate(part) for part in zip(*edges, strict=True))
    order = np.lexsort((costs, head, tail))
    tail, head, costs = tail[order], head[order], costs[order]
    first = np.r_[True, (np.diff(tail) != 0) | (np.diff(head) != 0)]  # the cheaper of two equal moves
    n = rows * columns * s.headings
    graph = coo_array((costs[first], (tail[first], head[first])), shape=(n, n)).tocsr()
    column, row = (int(v / RESOLUTION) for v in start[:2])
    k = round(start[2] / (2 * np.pi / s.headings)) % s.headings
    return dijkstra(graph, indices=(row * columns + column) * s.headings + k).reshape(rows, columns, s.headings)


def cost_at(costs, at):
    return costs[int(at[1] / RESOLUTION), int(at[0] / RESOLUTION), round(at[2] / (2 * np.pi / 16)) % 16]


def least_gap(path, occupied):
    """Return the least distance between the discs along a path and occupied squares, finely sampled."""
    at = path.curve.sampled(0.005)
    c, s = np.cos(at[:, 2]), np.sin(at[:, 2])
    cells = np.argwhere(occupied)[:, ::-1] + 0.5
    gaps = []
    for x, y, r in DISCS:
        p = at[:, :2] + np.stack([c * x - s * y, s * x + c * y], axis=-1)
        aside = np.maximum(np.abs(p[:, None] - cells * RESOLUTION) - RESOLUTION / 2, 0)
        gaps.append(np.hypot(aside[..., 0], aside[..., 1]).min() - r)
    return min(gaps)


@pytest.mark.parametrize("steering", [CAR, AHEAD, BASE], ids=["car", "ahead", "base"])
@pytest.mark.parametrize("seed", first_quick([0, 1]))
def test_costs_equal_those_of_dijkstra(seed, steering):
    lattice = StateLattice(
        distance=distances(floor(seed)),
        resolution=RESOLUTION,
        discs=DISCS,
        settings=replace(COARSE, steering=steering),
    )
    costs = least_costs(lattice, START)
    rng, reached = np.random.default_rng(seed), 0
    for column, row, heading in [(23, 19, 5), *rng.integers([3, 3, 0], [27, 23, 16], (20, 3))]:
        goal = pose(column, row, heading)
        path, best = lattice.path(START, goal), cost_at(costs, goal)
        if path.status is LatticeStatus.GOAL_BLOCKED:
            continue
        assert (path.status is LatticeStatus.SOLVED) == np.isfinite(best)
        if path.curve is not None:
            reached += 1
            assert path.cost == pytest.approx(best, abs=_TOLERANCE)
            assert path.bound == 1.0
    assert reached >= 1


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_costs_with_impact_equal_those_of_dijkstra(seed):
    occupied = floor(seed)
    lattice = StateLattice(
        distance=distances(occupied),
        resolution=RESOLUTION,
        discs=DISCS,
        settings=replace(COARSE, steering=BASE),
        impact=impacts(seed, occupied.shape, 16),
    )
    for w in (0.3, 3.0):
        path = lattice.path(START, GOAL, w)
        assert path.cost == pytest.approx(cost_at(least_costs(lattice, START, w), GOAL), abs=_TOLERANCE)
        assert path.cost == pytest.approx(float(path.curve.cost) + w * path.impact, abs=1e-9)


@pytest.mark.parametrize("steering", [CAR, AHEAD, BASE], ids=["car", "ahead", "base"])
@pytest.mark.parametrize("seed", range(4))
def test_paths_join_the_ends_exactly_and_are_free(seed, steering):
    occupied, rng = floor(seed, share=0.01), np.random.default_rng(seed)
    settings = LatticeSettings(steering=steering, margin=0.01)
    lattice = StateLattice(distance=distances(occupied), resolution=RESOLUTION, discs=DISCS, settings=settings)
    solved = 0
    for _ in range(12):
        start, goal = rng.uniform([0.3, 0.3, -4], [2.7, 2.3, 4], (2, 3))
        path = lattice.path(start, goal)
        if path.curve is None:
            continue
        solved += 1
        assert least_gap(path, occupied) >= 0.01 - 1e-6
        end = path.curve.at([path.curve.measure.sum()])[0]
        np.testing.assert_allclose(end[:2], goal[:2], atol=1e-9)
        assert math.cos(end[2] - goal[2]) == pytest.approx(1.0)
        assert np.abs(path.curve.pieces[:, 1]).max() <= 1 / steering.radius + 1e-9
        assert steering.reverse or path.curve.pieces[:, 0].min() >= 0
        assert float(path.curve.cost) == pytest.approx(path.cost)
        assert path.cost <= path.first_cost
    assert solved >= 1


@pytest.mark.parametrize("steering", [CAR, AHEAD, BASE], ids=["car", "ahead", "base"])
def test_moves_end_on_states(steering):
    settings = replace(COARSE, steering=steering, headings=72)
    lattice = StateLattice(distance=np.ones((5, 5)), resolution=RESOLUTION, discs=DISCS, settings=settings)
    left = dict.fromkeys(range(72), 0)
    for a, b, dx, dy, cost, pieces in lattice.native.moves():
        left[a] += 1
        start = pose(0, 0, a, 72)
        curve = Curves(steering=steering, start=start, pieces=pieces)
        end = curve.at([curve.measure.sum()])[0]
        np.testing.assert_allclose(end[:2], pose(dx, dy, b, 72)[:2], atol=1e-9)
        assert math.cos(end[2] - pose(0, 0, b, 72)[2]) == pytest.approx(1.0)
        assert float(curve.cost) == pytest.approx(cost)
    assert min(left.values()) >= 4


def test_an_open_floor_is_crossed_on_the_shortest_curve():
    lattice = StateLattice(
        distance=np.full((60, 60), 5.0),
        resolution=RESOLUTION,
        discs=DISCS,
        settings=LatticeSettings(steering=CAR, inflations=(1.0,)),
    )
    start, goal = [1.0, 1.0, 0.3], [4.7, 4.1, 2.0]
    path = lattice.path(start, goal)
    assert path.cost <= float(shortest_curves(start, goal, CAR).cost) + 1e-9


def test_cells_off_the_map_are_obstacles():
    settings = LatticeSettings(steering=BASE, headings=16)
    lattice = StateLattice(
        distance=np.full((30, 30), 9.0), resolution=RESOLUTION, discs=DISCS, settings=settings,
        impact=np.ones((30, 30, 16)),
    )  # fmt: skip
    for x in np.linspace(2.75, 2.999, 9):  # only the part ahead of the middle is off the map
        assert lattice.path([1, 1, 0], [x, 1, 0]).status is LatticeStatus.GOAL_BLOCKED
    assert lattice.path([1, 1, 0], [2.7, 1, math.pi / 2]).status is LatticeStatus.SOLVED
    rng = np.random.default_rng(0)
    for start, goal in rng.uniform([0.5, 0.5, -4], [2.5, 2.5, 4], (20, 2, 3)):
        path = lattice.path(start, goal, 1.0)
        at = path.curve.sampled(0.01)
        assert at[:, :2].min() > 0.15 and at[:, :2].max() < 2.85
        assert path.impact == pytest.approx(float(path.curve.measure.sum()))


def test_impact_is_kept_away_from_and_weights_mean_something():
    shape = (40, 60)
    y, x = np.indices(shape)
    impact = np.repeat(np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 40)[..., None], 16, axis=-1)
    lattice = StateLattice(
        distance=np.full(shape, 5.0),
        resolution=RESOLUTION,
        discs=DISCS,
        settings=LatticeSettings(steering=BASE, headings=16, inflations=(1.5, 1.0)),
        impact=impact,
    )
    found = [lattice.path([0.5, 2.05, 0], [5.5, 2.05, 0], w) for w in (0.0, 1.0, 10.0)]
    assert [path.impact for path in found] == sorted((path.impact for path in found), reverse=True)
    assert found[2].impact < 0.3 * found[0].impact
    assert float(found[2].curve.cost) < 1.5 * float(found[0].curve.cost)


def test_bounds_hold_and_more_time_gives_no_worse_paths():
    lattices = [
        StateLattice(
            distance=distances(floor(7)),
            resolution=RESOLUTION,
            discs=DISCS,
            settings=replace(COARSE, inflations=inflations),
        )
        for inflations in ((1.0,), (3.0,), (3.0, 1.3), (3.0, 1.0))
    ]
    best, rough, better, exact = (lattice.path(START, GOAL) for lattice in lattices)
    assert exact.cost == pytest.approx(best.cost)
    assert best.cost - 1e-9 <= exact.cost <= better.cost <= rough.cost
    for path in (rough, better):
        assert path.cost <= path.bound * best.cost + 1e-9
    assert exact.first_cost == rough.cost


def test_searches_repeat_themselves():
    lattice = StateLattice(
        distance=distances(floor(3)), resolution=RESOLUTION, discs=DISCS, settings=LatticeSettings(steering=BASE)
    )
    one, two = (lattice.path(START, GOAL) for _ in range(2))
    np.testing.assert_array_equal(one.curve.pieces, two.curve.pieces)
    assert one.expansions == two.expansions


def test_a_map_may_be_turned():
    occupied = floor(2)
    settings = LatticeSettings(steering=CAR)
    common = {"distance": distances(occupied), "resolution": RESOLUTION, "discs": DISCS, "settings": settings}
    origin = (1.0, -2.0, 0.8)

    def in_world(at):
        c, s = math.cos(origin[2]), math.sin(origin[2])
        return [origin[0] + c * at[0] - s * at[1], origin[1] + s * at[0] + c * at[1], at[2] + origin[2]]

    turned = StateLattice(**common, origin=origin).path(in_world(START + 0.01), in_world(GOAL))
    assert turned.cost == pytest.approx(StateLattice(**common).path(START + 0.01, GOAL).cost, rel=1e-6)


def test_ends_that_are_blocked_walls_and_limits_have_their_status():
    occupied = floor(0, share=0.0)
    open_floor = StateLattice(distance=distances(occupied), resolution=RESOLUTION, discs=DISCS, settings=COARSE)
    assert open_floor.path([0.1, 0.1, 0], GOAL).status is LatticeStatus.START_BLOCKED
    assert open_floor.path(START, [9.0, 9.0, 0]).status is LatticeStatus.GOAL_BLOCKED
    occupied[:, 15] = True
    walled = replace(open_floor, distance=distances(occupied))
    assert walled.path(START, GOAL).status is LatticeStatus.NO_PATH
    few = replace(open_floor, settings=replace(COARSE, max_expansions=3))
    path = few.path(START, GOAL)
    assert (path.status, path.curve, path.expansions) == (LatticeStatus.STOPPED, None, 3)
    assert open_floor.path(START, START).cost == pytest.approx(0.0, abs=1e-9)


def test_misuse():
    for settings in ({"headings": 10}, {"inflations": (0.5,)}, {"margin": -1.0}, {"time_limit": 0.0}):
        with pytest.raises(SettingError, match=next(iter(settings))):
            replace(COARSE, **settings)
    fields = {"distance": np.ones((5, 5)), "resolution": 0.1, "discs": DISCS, "settings": COARSE}
    for wrong, error in (
        ({"distance": np.full((5, 5), np.nan)}, NonFiniteError),
        ({"resolution": 0.0}, SettingError),
        ({"discs": np.zeros((1, 3))}, SettingError),
        ({"discs": np.zeros((0, 3))}, ShapeError),
        ({"impact": np.ones((5, 5, 3))}, ShapeError),
        ({"impact": -np.ones((5, 5, 16))}, SettingError),
    ):
        with pytest.raises(error, match=next(iter(wrong))):
            StateLattice(**{**fields, **wrong})
    with pytest.raises(SettingError, match="w = -1"):
        StateLattice(**fields).path(START, GOAL, -1.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_path_of_the_lead_is_free_and_its_bound_is_true(seed):
    occupied = floor(seed)
    impact = impacts(seed, occupied.shape, 16)
    for w in (0.0, 0.5):
        found = {}
        for lead, inflations in ((1.5, ()), (0.0, (1.0,))):
            lattice = StateLattice(
                distance=distances(occupied),
                resolution=RESOLUTION,
                discs=DISCS,
                settings=replace(COARSE, steering=BASE, lead=lead, inflations=inflations),
                impact=impact,
            )
            found[lead] = lattice.path(START, GOAL, w)
        quick, best = found[1.5], found[0.0]
        assert quick.status is best.status
        if quick.curve is not None:
            assert least_gap(quick, occupied) > -1e-6 and quick.cost >= best.cost - _TOLERANCE
            if w == 0.0:  # with impact the bound is no proof
                assert quick.cost <= quick.bound * best.cost + _TOLERANCE


def test_driving_backwards_has_its_own_impact():
    occupied = np.zeros((26, 60), dtype=bool)
    one = np.ones((*occupied.shape, 16), dtype=np.float32)
    made = {
        name: StateLattice(
            distance=distances(occupied),
            resolution=RESOLUTION,
            discs=DISCS,
            settings=replace(COARSE, steering=CAR, lead=0.0, inflations=(1.0,)),
            impact=one,
            impact_back=back,
        )
        for name, back in (("same", None), ("none", 0.0 * one))
    }
    start, goal = pose(40, 12, 0), pose(20, 12, 0)  # straight back
    same, none = made["same"].path(start, goal, 1.0), made["none"].path(start, goal, 1.0)
    length = 20 * RESOLUTION
    assert same.cost == pytest.approx(2.0 * length) and none.cost == pytest.approx(length)
    assert none.impact == pytest.approx(0.0)
    with pytest.raises(SettingError, match="impact_back"):
        replace(made["same"], impact=None, impact_back=one)


def test_a_lead_or_an_inflation_is_needed():
    with pytest.raises(SettingError, match="inflations"):
        LatticeSettings(steering=CAR, lead=0.0)
    with pytest.raises(SettingError, match="lead"):
        LatticeSettings(steering=CAR, lead=0.5)
