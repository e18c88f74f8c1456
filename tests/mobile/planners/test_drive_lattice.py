import heapq
from dataclasses import replace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError
from graceful_plan.planners.planner import Budget, path_total
from graceful_plan.planners.scene_problem import SceneProblem
from hall import BASE, hall
from jackals import jackal

MOVES = [(1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)]
MOVES += [(-x, -y) for x, y in MOVES]


def asked(scene, start, goals, w=0.0):
    start, goals = np.array(start, dtype=float), np.atleast_2d(np.array(goals, dtype=float))
    problem = SceneProblem(kernels=compile_scene(scene).kernels, start=start, goals=goals, margin=0.005)
    return problem, gp.Objective(w=w).bind(scene)


def solve(scene, start, goals, iterations=300_000, w=0.0, **settings):
    planner = gp.DriveLattice(**settings)
    problem, objective = asked(scene, start, goals, w)
    paths = planner.solve(problem, objective, Budget(iterations=iterations), np.random.default_rng(0))
    return list(paths), objective


def rolls(path):
    way, heading = np.diff(path.q[:, :3], axis=0), path.q[:-1, 2]
    side = -way[:, 0] * np.sin(heading) + way[:, 1] * np.cos(heading)
    both = np.linalg.norm(way[:, :2], axis=1) * np.abs(way[:, 2])
    return np.abs(side).max() < 1e-9 and both.max() < 1e-9


def brute_force(problem, objective, cell, goal):
    """Return the cost by Dijkstra over the same lattice, in Python, with a goal on the lattice."""
    start = problem.start

    def state(key):
        x, y, h = key
        return np.array([start[0] + cell * x, start[1] + cell * y, np.arctan2(MOVES[h][1], MOVES[h][0])])

    best, queue = {(0, 0, 0): 0.0}, [(0.0, (0, 0, 0))]
    while queue:
        cost, key = heapq.heappop(queue)
        if key == goal:
            return cost
        if cost > best[key]:
            continue
        x, y, h = key
        dx, dy = MOVES[h]
        for to in ((x + dx, y + dy, h), (x - dx, y - dy, h), (x, y, (h + 1) % 16), (x, y, (h - 1) % 16)):
            a, b = state(key), state(to)
            b[2] = a[2] + np.remainder(b[2] - a[2] + np.pi, 2 * np.pi) - np.pi
            if np.abs(b[:2]).max() > 8.0 or not problem.edges_free(a[None], b[None])[0]:
                continue
            total = cost + (objective.edges(a[None], b[None]) @ [1.0, objective.w]).item()
            if total < best.get(to, np.inf):
                best[to] = total
                heapq.heappush(queue, (total, to))
    return np.inf


def test_paths_roll_and_get_better():
    paths, objective = solve(hall(), [-4, 0, 0], [[4, 0, 0]])
    totals = [path_total(objective, path) for path in paths]
    assert len(paths) >= 2 and totals == sorted(totals, reverse=True)
    for path in paths:
        assert rolls(path)
        np.testing.assert_allclose(path.q[[0, -1]], [[-4, 0, 0], [4, 0, 0]], atol=1e-9)


@pytest.mark.long
def test_a_path_is_at_least_as_good_as_the_best_of_its_lattice():
    walls = '<body name="block" pos="1 0 .5"><geom type="box" size=".1 .8 .5"/></body>'
    scene = hall(walls=walls)
    (path, *_), objective = solve(scene, [0, 0, 0], [[2, 0, 0]], cells=(0.25,), weights=(1.0,))
    problem, _ = asked(scene, [0, 0, 0], [[2, 0, 0]])
    expected = brute_force(problem, objective, 0.25, (8, 0, 0))
    # The last curve to the goal may have any heading, so it can be shorter than lattice moves.
    assert 0.85 * expected < path_total(objective, path) <= expected + 1e-9


def test_backwards_only_where_that_is_allowed():
    back = [-4.5, 0, 0]
    (path, *_), _ = solve(hall(), [-3.5, 0, 0], [back], cells=(0.1,), weights=(1.0,))
    assert path.length == pytest.approx(1.0)
    (path, *_), _ = solve(hall(replace(BASE, reverse=False)), [-3.5, 0, 0], [back], cells=(0.1,), weights=(1.0,))
    assert path.length == pytest.approx(1.0 + 2.0 * np.pi)


def test_whole_turns_make_no_difference():
    (path, *_), _ = solve(hall(), [-3, 0, 3.0], [[-3, 0, -3.0]], cells=(0.1,))
    assert path.length == pytest.approx(2 * np.pi - 6.0)


def test_the_arm_moves_where_the_base_stands():
    (*_, path), _ = solve(hall(arm=True), [-4, 0, 0, 0.0], [[-2, 0.5, 0, -0.8]])
    arm, base = np.abs(np.diff(path.q[:, 3])), np.abs(np.diff(path.q[:, :3], axis=0)).max(axis=1)
    assert arm.sum() == pytest.approx(0.8) and (np.minimum(arm, base) < 1e-9).all()


def test_iterations_decide_and_the_same_seed_is_the_same():
    first, second = (solve(hall(), [-4, 0, 0], [[4, 0.5, 1]], iterations=3000)[0] for _ in range(2))
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_no_way_is_no_path():
    wall = '<body name="wall" pos="0 0 .5"><geom type="box" size=".05 8 .5"/></body>'
    paths, _ = solve(hall(walls=wall), [-4, 0, 0], [[4, 0, 0]], iterations=400_000, cells=(0.4,))
    assert paths == []


def test_misuse():
    for settings in ({"cells": ()}, {"cells": (0.0,)}, {"weights": (2.0,)}, {"weights": (1.0, 2.0, 1.0)}):
        with pytest.raises(SettingError):
            gp.DriveLattice(**settings)
    with pytest.raises(SettingError, match="DiffDrive"):
        solve(hall(None), [-4, 0, 0], [[4, 0, 0]])


def test_where_no_lattice_has_a_path_the_floor_is_searched():
    """Lattices that are abandoned prove nothing."""
    paths, _ = solve(hall(), [-4, 0, 0], [[4, 0, 0]], max_nodes=100)
    assert paths and rolls(paths[-1])
    np.testing.assert_allclose(paths[-1].q[[0, -1]], [[-4, 0, 0], [4, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("planner", ["auto", "drive_lattice", "floor_theta_star"])
def test_a_base_drives_where_there_is_nothing_else(planner):
    scene = jackal()
    result = gp.plan([0.0, 0.0, 0.0], [3.0, 2.0, 1.0], scene, planner=planner, iterations=20)
    assert result.status is gp.PlanStatus.SOLVED
    assert gp.verify(result.trajectory, scene).passed
