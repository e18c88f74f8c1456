"""Descents of single paths return free and cheaper paths, and report when there are none."""

from __future__ import annotations

import numpy as np
import pytest
from saddles import saddle

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem
from graceful_plan.planners.native_descents import NativeDescents
from graceful_plan.planners.planner import Budget, path_total
from graceful_plan.planners.scene_problem import SceneProblem


@pytest.fixture(scope="module", params=["tabletop/right_to_left", "tabletop_l3/green_to_blue"])
def task(request: pytest.FixtureRequest) -> gp.Task:
    scene, name = request.param.split("/")
    return gp.load_scene(scene).tasks[name]


@pytest.fixture(scope="module")
def path(task: gp.Task) -> Path:
    """A free path between configurations that are clear of the surface below the object."""
    found = gp.plan(task.start, task.goal, task.scene, w=0.0, planner="rrt_connect", iterations=500).unwrap().path
    q = found.resampled(0.05).q
    clear = np.flatnonzero(compile_scene(task.scene).kernels.free(q, 0.005))
    return Path(q[clear[0] : clear[-1] + 1])


def _questions(task: gp.Task, path: Path, objective: Objective, budget: Budget | None = None) -> InterruptibleProblem:
    kernels = compile_scene(task.scene).kernels
    problem = SceneProblem(kernels=kernels, start=path.q[0], goals=path.q[-1:], margin=0.002)
    return InterruptibleProblem(problem, objective.bind(task.scene, search_paces()), budget or Budget())


@pytest.mark.parametrize("exposure", ["time", "length"])
def test_paths_become_cheaper_and_stay_free(task: gp.Task, path: Path, exposure: str) -> None:
    questions = _questions(task, path, Objective(w=1.0, exposure=exposure))
    descents = NativeDescents.of(questions)
    assert descents is not None
    lower = descents.lowered(path, np.inf)
    assert lower is not None
    np.testing.assert_allclose(lower.q[[0, -1]], path.q[[0, -1]], atol=1e-12)
    assert questions.problem.edges_free(lower.q[:-1], lower.q[1:]).all()
    assert questions.path_cost(lower) < path_total(questions.objective, path)


def test_a_hopeless_path_is_discarded(task: gp.Task, path: Path) -> None:
    descents = NativeDescents.of(_questions(task, path, Objective(w=1.0)))
    assert descents is not None
    assert descents.lowered(path, 1e-3) is None


def test_descents_end_with_the_time(task: gp.Task, path: Path) -> None:
    descents = NativeDescents.of(_questions(task, path, Objective(w=1.0), Budget(cancelled=lambda: True)))
    assert descents is not None
    with pytest.raises(Interrupted):
        descents.lowered(path, np.inf)


def test_without_a_native_gradient_there_are_none(task: gp.Task, path: Path) -> None:
    questions = _questions(task, path, Objective(w=1.0))
    assert NativeDescents.of(questions) is not None
    boxes = gp.ImpactCost(model="box_overlap")
    for objective in (Objective(w=0.0), Objective(w=1.0, exposure="waypoints"), Objective(impact=boxes, w=1.0)):
        assert NativeDescents.of(_questions(task, path, objective)) is None
    instance = saddle()
    assert NativeDescents.of(InterruptibleProblem(instance.problem, instance.objective, Budget())) is None
