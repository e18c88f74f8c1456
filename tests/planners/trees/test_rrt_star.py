"""RRT* and Informed RRT* in scenes and in the plane. Laws of all planners are in `test_planners`."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from saddles import saddle

import graceful_plan as gp
from graceful_plan.compare.problems.analytic import disc, free_space
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.costs.objective import Objective, SceneObjective, search_paces
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners import InformedRRTStar, RRTStar
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem, path_total
from graceful_plan.planners.scene_problem import SceneProblem
from sizes import first_quick

_PLANNERS = pytest.mark.parametrize("planner", [RRTStar(), InformedRRTStar()], ids=lambda planner: planner.name)
_ITERATIONS = 120
_FLAT = DensityObjective(density=lambda q: np.zeros(len(q)), w=0.0)


@pytest.fixture(scope="module")
def query() -> tuple[SceneProblem, SceneObjective]:
    """A problem between configurations that are clear of the surface below the object."""
    task = gp.load_scene("tabletop_l3").tasks["green_to_blue"]
    kernels = compile_scene(task.scene).kernels
    found = gp.plan(task.start, task.goal, task.scene, w=0.0, planner="rrt_connect", iterations=500)
    q = found.unwrap().path.resampled(0.05).q
    first, last = q[kernels.free(q, 0.005)][[0, -1]]
    problem = SceneProblem(kernels=kernels, start=first, goals=last[None], margin=0.002)
    return problem, Objective(w=1.0).bind(task.scene, search_paces())


def _solved(
    planner: Planner, problem: Problem, objective: BoundObjective, iterations: int = _ITERATIONS, seed: int = 0
) -> tuple[list[Path], Budget]:
    budget = Budget(iterations=iterations)
    return list(planner.solve(problem, objective, budget, np.random.default_rng(seed))), budget


@pytest.mark.long
@_PLANNERS
@pytest.mark.parametrize("seed", range(2))
def test_paths_in_a_scene_are_free_and_only_improve(
    planner: Planner, seed: int, query: tuple[SceneProblem, SceneObjective]
) -> None:
    problem, objective = query
    paths, budget = _solved(planner, problem, objective, seed=seed)
    assert budget.spent == _ITERATIONS
    for path in paths:
        np.testing.assert_array_equal(path.q[[0, -1]], [problem.start, problem.goals[0]])
        assert np.all((path.q >= problem.lower) & (path.q <= problem.upper))
        assert problem.kernels.edges_free(path.q[:-1], path.q[1:], FINE_STEP, problem.margin).all()
    totals = [path_total(objective, path) for path in paths]
    assert len(totals) > 1
    assert all(later < earlier for earlier, later in itertools.pairwise(totals))


@pytest.mark.long
@_PLANNERS
def test_same_seed_same_paths(planner: Planner, query: tuple[SceneProblem, SceneObjective]) -> None:
    first, second, other = (_solved(planner, *query, iterations=40, seed=seed)[0] for seed in (5, 5, 6))
    assert [path.q.tobytes() for path in first] == [path.q.tobytes() for path in second]
    assert [path.q.tobytes() for path in first] != [path.q.tobytes() for path in other]


def test_descents_gain_and_leave_the_tree_alone(query: tuple[SceneProblem, SceneObjective]) -> None:
    """The first path is the same with and without descents, and with them the best is cheaper."""
    with_, without = (_solved(RRTStar(descend=descend), *query, iterations=60)[0] for descend in (True, False))
    assert path_total(query[1], with_[-1]) < path_total(query[1], without[-1])
    assert with_[0].q.tobytes() == without[0].q.tobytes()


@_PLANNERS
@pytest.mark.parametrize("seed", first_quick(range(2)))
def test_more_iterations_are_never_worse(planner: Planner, seed: int) -> None:
    instance = saddle()
    totals = []
    for iterations in (50, 100, 200):
        paths, _ = _solved(planner, instance.problem, instance.objective, iterations, seed)
        totals.append(path_total(instance.objective, paths[-1]))
    assert totals == sorted(totals, reverse=True)


@_PLANNERS
def test_a_free_straight_line_needs_no_sample(planner: Planner) -> None:
    instance = free_space(dimension=4)
    (path,), budget = _solved(planner, instance.problem, _FLAT)
    np.testing.assert_array_equal(path.q, [instance.problem.start, instance.problem.goals[0]])
    assert budget.spent == 0


@_PLANNERS
def test_a_goal_that_cannot_be_reached(planner: Planner) -> None:
    """A goal in a closed cell uses the whole budget; the one outside is found."""

    def free(q: np.ndarray) -> np.ndarray:
        return np.abs(np.abs(q - 1.0).max(axis=1) - 0.4) > 0.1

    def problem(*goals: tuple[float, float]) -> FunctionProblem:
        limit = np.full(2, 2.0)
        return FunctionProblem(start=-np.ones(2), goals=np.array(goals), lower=-limit, upper=limit, free=free)

    cell, behind = (1.0, 1.0), (1.9, 1.9)
    paths, budget = _solved(planner, problem(cell), _FLAT)
    assert not paths
    assert budget.spent == _ITERATIONS
    paths, _ = _solved(planner, problem(cell, behind), _FLAT)
    np.testing.assert_array_equal([path.q[-1] for path in paths], np.tile(behind, (len(paths), 1)))
    assert paths


@_PLANNERS
@pytest.mark.parametrize("budget", [{"iterations": 0}, {"time_limit": 0.0}, {"cancelled": lambda: True}])
def test_without_a_budget_there_is_no_path(planner: Planner, budget: dict[str, object]) -> None:
    granted = Budget(**budget)  # pyright: ignore[reportArgumentType]
    assert not list(planner.solve(free_space().problem, _FLAT, granted, np.random.default_rng(0)))
    assert granted.spent == 0


@_PLANNERS
@pytest.mark.parametrize("iterations", [1, 7, 40, 101])
def test_no_more_samples_are_taken_than_granted(planner: Planner, iterations: int) -> None:
    assert _solved(planner, disc().problem, disc().objective, iterations)[1].spent == iterations


@pytest.mark.parametrize(
    ("name", "value"),
    [("range", 0.0), ("goal_bias", 1.1), ("trust", -1.0), ("path_bias", -0.1), ("rewire_factor", np.inf), ("batch", 0)],
)
@pytest.mark.parametrize("planner", [RRTStar, InformedRRTStar])
def test_settings_are_checked(planner: type[Planner], name: str, value: float) -> None:
    with pytest.raises(SettingError, match=name):
        planner(**{name: value})
