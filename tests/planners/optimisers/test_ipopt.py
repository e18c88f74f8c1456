"""CasADi as a planner: known optima from bad paths of the right homotopy class, and better paths of an arm."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.compare.problems.analytic import AnalyticProblem, analytic_problems, disc
from graceful_plan.compare.problems.function_problem import DensityObjective
from graceful_plan.exceptions import CostError, SettingError
from graceful_plan.path import Path
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.ipopt import CasADi
from graceful_plan.planners.optimisers.path_program import PathProgram
from graceful_plan.planners.planner import Budget, path_total
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.planners.trees.rrt_connect import RRTConnect
from graceful_plan.query.candidates.search import is_solution
from sizes import first_quick

Array = np.ndarray

_WITHIN = 1.005
_BELOW = 0.998
"""J is a sum over samples; at a jump of the density it may be slightly below the optimum."""
_SWING = {"disc": 1.8, "two_media": 0.6, "hyperbolic": 0.3, "catenary": -0.5}


def _bad_path(instance: AnalyticProblem) -> Path:
    """Return a long, wavy detour in the homotopy class of the optimum."""
    problem = instance.problem
    t = np.linspace(0.0, 1.0, 9)[:, None]
    q = (1.0 - t) * problem.start + t * problem.goals[0]
    q[1:-1, 1] += (_SWING.get(instance.name, 0.5) * np.sin(np.pi * t) + 0.12 * np.cos(9.0 * t))[1:-1, 0]
    return Path(np.clip(q, problem.lower, problem.upper))


@pytest.mark.parametrize("name", first_quick(analytic_problems()))
def test_known_optima(name: str) -> None:
    instance = analytic_problems()[name]
    first = _bad_path(instance)
    assert path_total(instance.objective, first) > 1.02 * instance.optimum
    planner = CasADi(initial=first, bend=None)
    paths = list(planner.solve(instance.problem, instance.objective, Budget(iterations=120), np.random.default_rng(0)))
    totals = [path_total(instance.objective, path) / instance.optimum for path in paths]
    assert totals == sorted(totals, reverse=True)
    assert _BELOW <= totals[-1] <= _WITHIN


@functools.cache
def _panda(scene: str, task: str, w: float = 1.0):
    found = gp.load_scene(scene).tasks[task]
    objective = gp.Objective(w=w).bind(found.scene)
    problem = SceneProblem(
        kernels=objective.kernels, start=np.asarray(found.start), goals=np.atleast_2d(found.goal), margin=0.002
    )
    first = list(RRTConnect().solve(problem, objective, Budget(iterations=2000), np.random.default_rng(0)))[-1]
    return problem, objective, first


@pytest.mark.long
def test_paths_of_an_arm_cost_less() -> None:
    problem, objective, first = _panda("tabletop_l1", "green_to_blue")
    paths = list(CasADi(initial=first).solve(problem, objective, Budget(iterations=60), np.random.default_rng(0)))
    assert path_total(objective, paths[-1]) < 0.98 * path_total(objective, first)
    assert all(is_solution(path, problem) for path in paths)


def test_two_runs_are_the_same() -> None:
    instance = disc()
    planner = CasADi(initial=_bad_path(instance))
    runs = [
        list(planner.solve(instance.problem, instance.objective, Budget(iterations=60), np.random.default_rng(1)))
        for _ in range(2)
    ]
    assert runs[0]
    assert [path.q.tobytes() for path in runs[0]] == [path.q.tobytes() for path in runs[1]]


def test_a_path_that_is_not_free_is_pushed_out() -> None:
    instance = disc()
    t = np.linspace(-2.0, 2.0, 12)
    through = Path(np.stack([t, 0.5 * np.cos(np.pi * t / 4.0)], axis=1))
    paths = list(
        CasADi(initial=through).solve(
            instance.problem, instance.objective, Budget(iterations=150), np.random.default_rng(0)
        )
    )
    assert path_total(instance.objective, paths[-1]) <= _WITHIN * instance.optimum


def test_the_program_has_correct_derivatives() -> None:
    # Without impact, since sums over samples jump where an edge gets one more sample.
    problem, objective, first = _panda("tabletop_l1", "green_to_blue", w=0.0)
    q = np.stack([first.resampled(0.2).q[k] for k in np.linspace(0, len(first.resampled(0.2)) - 1, 7).astype(int)])
    program = PathProgram(q, Slopes(problem, objective, Budget()), 1e-3, 0.1, path_total(objective, Path(q)), 0.5)
    np.testing.assert_allclose(program.path(program.first), q, atol=1e-12)
    x = program.first
    values = program.evaluate(x)
    np.testing.assert_allclose(values.constraints[-q[1:-1].size :], program.least[-q[1:-1].size :], atol=1e-9)
    jacobian = np.zeros((len(program.least), len(x)))
    np.add.at(jacobian, (program.jacobian_pattern.row, program.jacobian_pattern.column), values.jacobian)
    # Along the ties between points and whitened variables: moving one moves the other.
    n = q[1:-1].size
    rng, step = np.random.default_rng(0), 1e-4
    for _ in range(5):
        points = rng.normal(size=n)
        move = np.append(points, -jacobian[-n:, :n] @ points / jacobian[-n:, n:].diagonal())
        np.testing.assert_allclose(jacobian[-n:] @ move, 0.0, atol=1e-9)
        move *= step / np.abs(points).max() / 30.0
        up, down = program.evaluate(x + move), program.evaluate(x - move)
        assert values.gradient @ move == pytest.approx(0.5 * (up.cost - down.cost), rel=2e-3, abs=1e-7)
        rows = slice(0, len(program.least) - n)
        expected = 0.5 * (up.constraints - down.constraints)[rows]
        np.testing.assert_allclose((jacobian @ move)[rows], expected, atol=2e-5)


def test_a_broken_cost_is_named() -> None:
    instance = disc()
    broken = DensityObjective(density=lambda q: np.full(len(q), np.nan))
    with pytest.raises(CostError):
        list(
            CasADi(initial=_bad_path(instance)).solve(
                instance.problem, broken, Budget(iterations=5), np.random.default_rng(0)
            )
        )


@pytest.mark.parametrize(
    "settings",
    [{"edges": 1}, {"memory": 0}, {"reach": 0.0}, {"widths": (-0.1,)}, {"clearance": np.inf}, {"bend": -1.0}],
)
def test_misuse_is_refused(settings: dict) -> None:
    with pytest.raises(SettingError, match=next(iter(settings))):
        CasADi(**settings)


def test_plan_accepts_the_planner_by_name() -> None:
    task = gp.load_scene("tabletop_l1").tasks["far_to_near"]
    result = gp.plan(task.start, task.goal, task.scene, planner="casadi", iterations=60)
    assert result.status is gp.PlanStatus.SOLVED
