"""The native descent of whole paths, and its use in roadmaps."""

import itertools
import threading

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.core.compile import compile_scene
from graceful_plan.planners.native import native_space
from graceful_plan.planners.planner import Budget, path_total
from graceful_plan.planners.scene_problem import SceneProblem
from sizes import first_quick

KEPT = 0.005
"""Clearance at the ends of paths [m]."""


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop_l3").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def problem(task):
    kernels = compile_scene(task.scene).kernels
    q = gp.plan(task.start, task.goal, task.scene, w=0.0, planner="rrt_connect", iterations=500).unwrap().path.q
    first, last = q[kernels.free(q, KEPT)][[0, -1]]
    return SceneProblem(kernels=kernels, start=first, goals=last[None], margin=0.002)


def space_of(task, problem, w):
    return native_space(problem, gp.Objective(w=w).bind(task.scene))


def descent(space, path, pieces=24, step=0.06):
    return _native.Descent(space, np.ascontiguousarray(path), pieces, step)


def straight(problem):
    return np.stack([problem.start, problem.goals[0]])


def free_pair(problem, free, seed=0):
    """Two free configurations; the straight edge between them is free or blocked."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(problem.lower, problem.upper, (4000, len(problem.lower)))
    q = q[problem.kernels.free(q, KEPT)]
    q0, q1 = q[:-1], q[1:]
    near = np.linalg.norm(q1 - q0, axis=1) < 4.0
    return np.stack([q0, q1], axis=1)[near & (problem.edges_free(q0, q1) == free)]


def is_free(problem, path):
    return problem.edges_free(path[:-1], path[1:]).all()


@pytest.mark.parametrize("w", first_quick([1.0, 1e-9, 1e9]))
def test_energy_falls_ends_stay_and_limits_hold(task, problem, w):
    run = descent(space_of(task, problem, w), straight(problem))
    before, energies = run.value, [run.energy]
    while run.run(3) == 3:
        energies.append(run.energy)
        assert len(energies) < 500
    assert all(later <= earlier for earlier, later in itertools.pairwise(energies))
    assert run.value < before
    assert run.run(3) == 0
    np.testing.assert_array_equal(run.path[[0, -1]], straight(problem))
    assert (run.path >= problem.lower).all() and (run.path <= problem.upper).all()


def test_paths_beyond_the_limits_are_brought_inside(task, problem):
    beyond = np.insert(straight(problem), 1, problem.upper + 0.3, axis=0)
    path = descent(space_of(task, problem, 1.0), beyond).path
    assert (path >= problem.lower).all() and (path <= problem.upper).all()
    assert (path == problem.upper).any()


def test_a_path_through_something_comes_free(task, problem):
    space = space_of(task, problem, 1e-6)
    freed = 0
    pairs = free_pair(problem, free=False)[:12]
    for pair in pairs:
        run = descent(space, pair, pieces=40)
        for _ in range(3):
            run.run(150)
            if is_free(problem, run.path):
                break
            run.harden()
        freed += is_free(problem, run.path)
    assert freed >= len(pairs) // 4


def test_without_impact_a_free_straight_line_stays(task, problem):
    space = space_of(task, problem, 0.0)
    for pair in free_pair(problem, free=True)[:5]:
        run = descent(space, pair)
        before = run.path
        run.run(100)
        assert run.value == pytest.approx(np.linalg.norm(pair[1] - pair[0]), rel=1e-9)
        np.testing.assert_allclose(run.path, before, atol=1e-6)


def test_the_value_of_a_free_path_is_its_cost_up_to_sampling(task, problem):
    objective = gp.Objective(w=1.0).bind(task.scene)
    for pair in free_pair(problem, free=True)[:5]:
        run = descent(space_of(task, problem, 1.0), pair, pieces=40, step=0.02)
        assert run.value == pytest.approx(path_total(objective, gp.Path(run.path)), rel=0.02)


def test_one_piece_has_nothing_to_move(task, problem):
    pair = free_pair(problem, free=True)[0]
    run = descent(space_of(task, problem, 0.0), pair, pieces=1)
    assert run.run(5) <= 1
    assert run.value == pytest.approx(np.linalg.norm(pair[1] - pair[0]))
    run.harden()
    np.testing.assert_array_equal(run.path, pair)


@pytest.mark.parametrize("bad", [{"pieces": 0}, {"step": 0.0}, {"path": np.zeros((1, 7))}, {"path": np.zeros((2, 3))}])
def test_misuse_is_refused(task, problem, bad):
    with pytest.raises(ValueError, match=r"descent|path"):
        descent(space_of(task, problem, 1.0), **({"path": straight(problem)} | bad))


def test_a_space_without_slopes_is_refused(task, problem):
    space = native_space(problem, gp.Objective(impact=gp.ImpactCost("box_overlap")).bind(task.scene))
    with pytest.raises(ValueError, match="gradients"):
        descent(space, straight(problem))


def test_a_discarded_search_leaves_no_threads(task, problem):
    before = set(threading.enumerate())
    found = gp.Auto(workers=3).solve(problem, gp.Objective().bind(task.scene), Budget(), np.random.default_rng(0))
    next(found), next(found)
    assert set(threading.enumerate()) > before
    found.close()
    assert set(threading.enumerate()) == before
