"""Trees in tool space: steps move the tool to the target, and paths around blocked straight edges are found."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.compare.problems.analytic import disc
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.costs.objective import Objective
from graceful_plan.exceptions import SettingError
from graceful_plan.planners import ToolRRT
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.trees.tool_rrt import _SpaceTree, _ToolSpace
from graceful_plan.query.endpoints.endpoints import Endpoints, find_endpoints

_TASKS = (("desk", "lift_coffee"), ("kitchen_counter", "shelve_jar"), ("tabletop_l3", "near_to_blue"))
"""Tasks whose straight edge is blocked."""


def _problem(scene_name: str, task_name: str) -> tuple[SceneProblem, gp.Scene]:
    task = gp.load_scene(scene_name).tasks[task_name]
    ends = find_endpoints(task.start, task.goal, SceneConstraints(task.scene, ()), np.random.default_rng(0))
    assert isinstance(ends, Endpoints)
    goals = np.stack([arrival.q[0] for arrival in ends.arrivals])
    return SceneProblem(kernels=ends.constraints.kernels, start=ends.departure.q[-1], goals=goals), task.scene


@pytest.mark.parametrize(("scene_name", "task_name"), _TASKS)
def test_finds_free_paths_where_the_straight_edge_is_blocked(scene_name, task_name):
    problem, scene = _problem(scene_name, task_name)
    objective = Objective(w=0.0).bind(scene)
    assert not problem.edges_free(np.tile(problem.start, (len(problem.goals), 1)), problem.goals).any()
    for seed in range(3):
        budget = Budget(iterations=300)
        path = next(ToolRRT(shortcut=None).solve(problem, objective, budget, np.random.default_rng(seed)))
        np.testing.assert_array_equal(path.q[0], problem.start)
        assert np.abs(problem.goals - path.q[-1]).max(axis=1).min() == 0.0
        assert problem.kernels.edges_free(path.q[:-1], path.q[1:], FINE_STEP).mean() > 0.9
        assert ((path.q >= problem.lower) & (path.q <= problem.upper)).all()
        assert budget.spent <= 300


@pytest.fixture(scope="module")
def space(scene):
    kernels = compile_scene(scene).kernels
    return _ToolSpace(kernels, kernels.robot.lower, kernels.robot.upper, step=0.05, lever=0.2)


def test_steps_bring_the_tool_nearer_and_are_bounded(space):
    rng = np.random.default_rng(1)
    q, goal = rng.uniform(space.lower, space.upper, size=(2, 40, 7))
    moved = space.towards(q, goal)
    assert ((moved >= space.lower) & (moved <= space.upper)).all() and np.abs(moved - q).max() <= 0.2 + 1e-12
    before, after, there = (space.places(x) for x in (q, moved, goal))
    nearer = np.linalg.norm(after - there, axis=1) < np.linalg.norm(before - there, axis=1)
    assert nearer.mean() > 0.8  # joint limits and singular postures hinder some


def test_distances_are_metres_and_scaled_angles(space, scene):
    q = scene.keyframes["ready"]
    turned = q.copy()
    turned[6] += 0.1  # the tool turns in place
    a, b = space.places(np.stack([q, turned]))
    assert np.linalg.norm(a - b) == pytest.approx(0.2 * 0.1, rel=1e-2)


def test_nodes_know_their_parents_and_edges_are_free(space, scene):
    problem = SceneProblem(kernels=space.kernels, start=scene.keyframes["ready"], goals=scene.keyframes["left"][None])
    questions = InterruptibleProblem(problem, Objective(w=0.0).bind(scene), Budget())
    tree = _SpaceTree(problem.start[None], space)
    rng = np.random.default_rng(2)
    for _ in range(10):
        new = tree.grow(rng.uniform(problem.lower, problem.upper, size=(8, 7)), 6, questions)
        assert (new < len(tree.nodes)).all()
    q, parents = tree.nodes.q, np.array(tree.nodes.parents)
    assert len(q) > 20 and (parents[1:] < np.arange(1, len(q))).all() and (parents[1:] >= 0).all()
    assert problem.edges_free(q[parents[1:]], q[1:]).all()


def test_same_seed_same_path():
    problem, scene = _problem(*_TASKS[2])
    objective = Objective(w=0.0).bind(scene)
    first, again = (
        list(ToolRRT().solve(problem, objective, Budget(iterations=60), np.random.default_rng(4)))[-1].q
        for _ in range(2)
    )
    np.testing.assert_array_equal(first, again)


def test_full_trees_restart():
    problem, scene = _problem(*_TASKS[2])
    budget = Budget(iterations=400)
    solved = list(
        ToolRRT(max_nodes=60, shortcut=None).solve(
            problem, Objective(w=0.0).bind(scene), budget, np.random.default_rng(0)
        )
    )
    assert len(solved) <= 1 and budget.spent <= 400


def test_a_problem_without_a_tool_is_searched_in_its_own_coordinates():
    instance = disc()
    path = next(ToolRRT().solve(instance.problem, instance.objective, Budget(iterations=500), np.random.default_rng(0)))
    assert instance.problem.edges_free(path.q[:-1], path.q[1:]).all()


@pytest.mark.parametrize("setting", [{"step": 0.0}, {"lever": -1.0}, {"steps": 0}, {"max_nodes": 1}])
def test_settings_are_checked(setting):
    with pytest.raises(SettingError, match=next(iter(setting))):
        ToolRRT(**setting)
