"""Searches from scratch: what they keep, tell and spend."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.planners import Planner
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.request import Request
from graceful_plan.query.restarts import search_for_motions
from graceful_plan.query.search import Callback, Search
from graceful_plan.result import TracePoint

_ENOUGH = 600
"""Iterations for three searches."""


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("tabletop").tasks["green_to_blue"]


def searched(
    task: gp.Task,
    budget: Budget,
    *,
    planner: Planner | None = None,
    objective: gp.Objective | None = None,
    callback: Callback | None = None,
) -> Search:
    bound = (Objective() if objective is None else objective).bind(task.scene, search_paces(1.0))
    problem = SceneProblem(
        kernels=bound.kernels, start=np.asarray(task.start), goals=np.atleast_2d(task.goal), margin=0.002
    )
    request = Request(
        planner=gp.Auto() if planner is None else planner,
        objective=bound,
        constraints=SceneConstraints(task.scene, ()),
        preference=None,
        speed=1.0,
        max_wait=0.0,
        callback=callback,
    )
    return search_for_motions(request, problem, budget, np.random.default_rng(4))


def test_each_search_leaves_its_best_and_its_first_path(task: gp.Task) -> None:
    told: list[TracePoint] = []
    found = searched(task, Budget(iterations=_ENOUGH), callback=told.append)
    assert len(found.firsts) == 3 and len(found.others) == 2
    assert found.trace == told
    totals = [point.total for point in found.trace]
    assert totals == sorted(totals, reverse=True) and len(set(totals)) == len(totals)
    assert len({path.q.tobytes() for path in [found.paths[-1], *found.others]}) == 3


def test_the_best_of_all_searches_is_at_the_end(task: gp.Task) -> None:
    objective = Objective().bind(task.scene, search_paces(1.0))

    def total(path: gp.Path) -> float:
        motion, impact = objective.edges(path.q[:-1], path.q[1:]).sum(axis=0)
        return motion + objective.w * impact

    found = searched(task, Budget(iterations=_ENOUGH))
    best, *others = (total(path) for path in [found.paths[-1], *found.others])
    assert others == sorted(others) and best <= others[0]
    assert best == pytest.approx(found.trace[-1].total)


def test_the_iterations_are_those_of_all_searches_and_decide(task: gp.Task) -> None:
    budgets = [Budget(iterations=_ENOUGH) for _ in range(2)]
    a, b = (searched(task, budget) for budget in budgets)
    assert [budget.spent for budget in budgets] == [_ENOUGH] * 2
    assert [path.q.tobytes() for path in a.paths + a.others] == [path.q.tobytes() for path in b.paths + b.others]


def test_a_callback_ends_them_all(task: gp.Task) -> None:
    found = searched(task, Budget(iterations=_ENOUGH), callback=lambda point: True)
    assert found.stopped and len(found.trace) == 1 and len(found.paths) == 1 and not found.others


@pytest.mark.parametrize(
    "given",
    [
        {"planner": gp.RRTConnect()},
        {"objective": gp.Objective(w=0.0)},
    ],
)
def test_other_planners_and_objectives_are_searched_once(task: gp.Task, given: dict) -> None:
    found = searched(task, Budget(iterations=_ENOUGH), **given)
    assert found.paths and not found.others and not found.firsts


def test_without_time_there_is_nothing(task: gp.Task) -> None:
    found = searched(task, Budget(time_limit=0.0))
    assert not found.paths and not found.trace and not found.others
