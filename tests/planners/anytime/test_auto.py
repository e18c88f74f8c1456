"""The default planner: its searches, what they share, and initial paths."""

import hashlib
import inspect
import itertools
import subprocess
import sys
from dataclasses import replace

import jaxtyping
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.exceptions import SettingError
from graceful_plan.planners.planner import Budget, path_total
from graceful_plan.planners.scene_problem import SceneProblem
from sizes import first_quick

ITERATIONS = 500


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop_l3").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def problem(task):
    """A problem whose ends are clear of the surface below the object; leaving contact is the task of plan()."""
    kernels = compile_scene(task.scene).kernels
    q = gp.plan(task.start, task.goal, task.scene, w=0.0, planner="rrt_connect", iterations=500).unwrap().path.q
    first, last = q[kernels.free(q, 0.005)][[0, -1]]
    return SceneProblem(kernels=kernels, start=first, goals=last[None], margin=0.002)


@pytest.fixture(scope="module")
def objective(task):
    return gp.Objective(w=1.0).bind(task.scene)


@pytest.fixture(scope="module")
def length(task):
    return gp.Objective(w=0.0).bind(task.scene)


def solved(planner, problem, objective, iterations=ITERATIONS, seed=0):
    budget = Budget(iterations=iterations)
    return list(planner.solve(problem, objective, budget, np.random.default_rng(seed))), budget


def digest(task_name, seed):
    code = f"""
import hashlib, graceful_plan as gp
task = gp.load_scene("tabletop_l3").tasks["{task_name}"]
result = gp.plan(task.start, task.goal, task.scene, iterations={ITERATIONS}, seed={seed})
print(hashlib.sha256(result.path.q.tobytes()).hexdigest())
"""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_is_the_default():
    assert inspect.signature(gp.plan).parameters["planner"].default == "auto"


@pytest.mark.long
def test_same_seed_and_iterations_same_bytes_in_every_process(task):
    first, second, other = digest("green_to_blue", 3), digest("green_to_blue", 3), digest("green_to_blue", 4)
    assert first == second != other
    here = gp.plan(task.start, task.goal, task.scene, iterations=ITERATIONS, seed=3)
    assert hashlib.sha256(here.path.q.tobytes()).hexdigest() == first


@pytest.mark.long
@pytest.mark.parametrize("workers", first_quick([2, 1, 3]))
def test_searches_share_the_budget_and_only_improve(workers, problem, objective):
    paths, budget = solved(gp.Auto(workers=workers), problem, objective)
    totals = [path_total(objective, path) for path in paths]
    assert all(later < earlier for earlier, later in itertools.pairwise(totals))
    assert totals[-1] < 0.8 * totals[0]
    assert budget.spent == ITERATIONS


@pytest.mark.long
@pytest.mark.parametrize("setting", first_quick(["descents", "scouts"]))
def test_parts_of_the_default_search_can_be_switched_off(setting, problem, objective):
    paths, _ = solved(gp.Auto(search=gp.Anytime(**{setting: False})), problem, objective)
    whole, _ = solved(gp.Auto(), problem, objective)
    assert path_total(objective, paths[-1]) < path_total(objective, paths[0])
    assert not np.array_equal(paths[-1].q, whole[-1].q)


def test_without_impact_there_is_one_search(problem, length):
    one, _ = solved(gp.Auto(workers=1), problem, length)
    several, _ = solved(gp.Auto(workers=4), problem, length)
    assert np.array_equal(one[-1].q, several[-1].q)


def test_no_vertices_can_be_left_out_of_a_first_path_where_length_alone_counts(problem, length):
    corners = 0
    for seed in range(4):
        q = next(iter(gp.Auto().solve(problem, length, Budget(iterations=2000), np.random.default_rng(seed)))).q
        first, last = np.triu_indices(len(q), k=2)
        for a, b in zip(q[first], q[last], strict=True):
            coarse = problem.edges_free(a[None], b[None])[0]
            assert not (coarse and problem.kernels.edges_free(a, b, FINE_STEP, problem.margin))
        corners += len(first)
    assert corners > 0


def test_a_cost_without_gradient_is_lowered_too(task, problem):
    objective = gp.Objective(impact=gp.ImpactCost("box_overlap"), w=1.0).bind(task.scene)
    paths, _ = solved(gp.Auto(), problem, objective, iterations=4000)
    assert path_total(objective, paths[-1]) < 0.8 * path_total(objective, paths[0])


def test_begins_with_a_free_path_and_improves_it(problem, objective):
    """Initial paths are checked at the fine step, which shortcuts need not pass."""
    given = solved(gp.RRTConnect(shortcut=None), problem, objective)[0][-1]
    paths, _ = solved(gp.Auto(initial=given), problem, objective)
    np.testing.assert_array_equal(paths[0].q, given.without_duplicates().q)
    assert path_total(objective, paths[-1]) < path_total(objective, given)


def test_a_path_that_is_not_free_is_only_a_hint(problem, objective):
    through = gp.Path(np.stack([problem.start, problem.lower, problem.goals[0]]))
    assert not problem.edges_free(through.q[:-1], through.q[1:]).all()
    paths, _ = solved(gp.Auto(initial=through), problem, objective)
    assert paths and all(problem.edges_free(path.q[:-1], path.q[1:]).all() for path in paths)


def test_an_initial_path_is_brought_into_the_limits(problem, objective):
    beyond = np.stack([problem.start, problem.upper + 0.5, problem.goals[0]])
    paths, _ = solved(gp.Auto(initial=beyond), problem, objective)
    assert paths and all((path.q >= problem.lower).all() and (path.q <= problem.upper).all() for path in paths)


@pytest.mark.long
def test_an_initial_path_that_grazes_something_between_two_checks_is_only_a_hint(problem, objective):
    coarse = replace(problem, check_step=10.0)  # checks little more than the ends of edges
    via = np.random.default_rng(0).uniform(problem.lower, problem.upper, (3000, len(problem.lower)))
    start, goal = np.broadcast_to(problem.start, via.shape), np.broadcast_to(problem.goals[0], via.shape)
    seems, is_free = (p.edges_free(start, via) & p.edges_free(via, goal) for p in (coarse, problem))
    through = np.stack([problem.start, via[seems & ~is_free][0], problem.goals[0]])
    paths, _ = solved(gp.Auto(initial=through), coarse, objective)
    assert paths and all(problem.edges_free(path.q[:-1], path.q[1:]).all() for path in paths)


@pytest.mark.long
def test_an_initial_path_is_joined_to_the_ends(problem, objective):
    given = solved(gp.RRTConnect(), problem, objective)[0][-1].q
    paths, _ = solved(gp.Auto(initial=given[1:-1]), problem, objective)
    np.testing.assert_array_equal(paths[0].q[[0, -1]], given[[0, -1]])


@pytest.mark.parametrize("settings", [{"workers": 0}, {"search": "anytime"}, {"initial": "path"}])
def test_bad_settings_are_named(settings):
    with pytest.raises((SettingError, jaxtyping.TypeCheckError), match=next(iter(settings))):
        gp.Auto(**settings)
