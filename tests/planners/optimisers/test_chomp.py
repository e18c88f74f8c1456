"""CHOMP: its steps, known optima, limits, obstacles and symmetry, and smeared hazards."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.compare.problems.analytic import AnalyticProblem, analytic_problems, disc, free_space
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.costs.objective import search_paces
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.optimisers.chomp import CHOMP
from graceful_plan.planners.optimisers.covariant import Descent, Memory
from graceful_plan.planners.optimisers.edge_derivatives import Slopes
from graceful_plan.planners.optimisers.incumbent import Incumbent, with_edges
from graceful_plan.planners.optimisers.path_energy import PathEnergy
from graceful_plan.planners.optimisers.smoothness import Smoothness
from graceful_plan.planners.planner import BoundObjective, Budget, Problem, path_total
from graceful_plan.planners.scene_problem import SceneProblem

_WITHIN = 1.005
_FINER = 50
"""J is evaluated with steps smaller than those of planning by this factor."""
_BAD = {
    "free_space": [[0.5, -1.8], [-1.0, 0.5]],
    "uniform_density": [[0.5, -1.8], [-1.0, 0.5]],
    "disc": [[-2.0, 2.5], [2.5, 2.2]],
    "two_media": [[-1.5, -1.5], [2.5, 2.0]],
    "hyperbolic": [[-0.4, 0.15], [0.5, 0.12], [1.4, 0.2]],
    "catenary": [[-1.8, 2.9], [1.7, 2.9]],
}
"""Initial detours in the homotopy class of the optimum."""


def _bad(instance: AnalyticProblem) -> Path:
    problem = instance.problem
    return Path(np.array([problem.start, *_BAD[instance.name], problem.goals[0]]))


def _solve(planner: CHOMP, problem: Problem, objective: BoundObjective, iterations: int, seed: int = 0) -> list[Path]:
    return list(planner.solve(problem, objective, Budget(iterations=iterations), np.random.default_rng(seed)))


def _exact(instance: AnalyticProblem, path: Path) -> float:
    return path_total(replace(instance.objective, step=instance.objective.step / _FINER), path) / instance.optimum


@pytest.mark.parametrize("name", _BAD)
def test_reaches_known_optima_from_a_bad_path(name: str) -> None:
    instance = analytic_problems()[name]
    bad = _bad(instance)
    assert _exact(instance, bad) > 2.0
    paths = _solve(CHOMP(initial=bad, bend=None), instance.problem, instance.objective, 200)
    assert 1.0 - 1e-9 <= _exact(instance, paths[-1]) <= _WITHIN


@pytest.mark.parametrize("name", ["uniform_density", "hyperbolic", "catenary"])
def test_plain_gradient_reaches_smooth_optima(name: str) -> None:
    instance = analytic_problems()[name]
    planner = CHOMP(initial=_bad(instance), method="gradient", bend=None)
    assert _exact(instance, _solve(planner, instance.problem, instance.objective, 60)[-1]) <= _WITHIN


def test_reaches_the_optimum_in_seven_dimensions() -> None:
    instance = disc(7)
    aside = np.zeros((2, 7))
    aside[:, :3] = [[-1.0, 1.5, 1.0], [1.0, 2.0, -0.5]]
    initial = Path(np.concatenate([instance.problem.start[None], aside, instance.problem.goals]))
    planner = CHOMP(initial=initial, bend=None)
    assert _exact(instance, _solve(planner, instance.problem, instance.objective, 300)[-1]) <= _WITHIN


@pytest.mark.parametrize("memory", [0, 8])
def test_smoothness_without_cost_needs_one_step(memory: int) -> None:
    """The energy of free space equals the metric, so the first full step is a Newton step."""
    instance = free_space(3)
    rng = np.random.default_rng(0)
    q = np.linspace(instance.problem.start, instance.problem.goals[0], 33)
    straight = q.copy()
    q[1:-1] += 0.05 * rng.normal(size=(31, 3))
    energy = PathEnergy(Slopes(instance.problem, instance.objective, Budget()))
    limits = instance.problem.lower, instance.problem.upper
    descent = Descent(energy, Smoothness(31, 1), limits, memory, longest=10.0)
    descent.begin(replace(energy(q), cost=np.linalg.norm(np.diff(q, axis=0), axis=1)))
    assert descent.attempt() is True
    np.testing.assert_allclose(descent.at.q, straight, atol=1e-9)


@given(seed=st.integers(0, 1000), size=st.integers(1, 8))
def test_memory_reproduces_the_last_curvature(seed: int, size: int) -> None:
    """L-BFGS maps the last change of the gradient exactly to its step, and gives a descent direction."""
    rng = np.random.default_rng(seed)
    metric = Smoothness(6, 1)
    memory = Memory(metric, 3.0, size)
    bend = rng.normal(size=(6, 6))
    curvature = bend @ bend.T + np.eye(6)
    steps = rng.normal(size=(10, 6, 2))
    for step in steps:
        memory.learn(step, curvature @ step)
    loose, held = np.zeros((6, 2), dtype=bool), rng.uniform(size=(6, 2)) < 0.4
    np.testing.assert_allclose(memory.direction(-curvature @ steps[-1], loose), steps[-1], atol=1e-7)
    gradient = rng.normal(size=(6, 2))
    assert np.vdot(gradient, memory.direction(gradient, loose)) < 0.0
    beside = memory.direction(gradient, held)
    assert not beside[held].any() and (np.vdot(gradient, beside) < 0.0 or held.all())
    assert memory.forget() and not memory.forget()
    np.testing.assert_allclose(memory.direction(gradient, loose), -metric.solve(gradient) / 3.0)


def test_memory_refuses_a_step_along_which_the_energy_bends_down() -> None:
    memory = Memory(Smoothness(3, 1), 1.0, 4)
    memory.learn(np.ones((3, 1)), -np.ones((3, 1)))
    assert not memory.forget()


def test_steps_never_lead_to_a_path_that_is_not_allowed() -> None:
    """The first step would end far beyond the line, which must not be crossed."""
    instance = analytic_problems()["hyperbolic"]
    problem, line = instance.problem, 0.52
    q = with_edges(Path(np.array([problem.start, [0.5, 0.2], problem.goals[0]])), 20)
    energy = PathEnergy(Slopes(problem, instance.objective, Budget()))
    asked: list[float] = []

    def allowed(tried: np.ndarray) -> bool:
        asked.append(float(tried[:, 1].max()))
        return asked[-1] <= line

    descent = Descent(energy, Smoothness(19, 1), (problem.lower, problem.upper), 8, 1.0, allowed)
    descent.begin(energy(q))
    first = descent.at.energy
    for _ in range(40):
        if descent.attempt() is None:
            break
        assert descent.at.q[:, 1].max() <= line
    assert max(asked) > line and descent.at.energy < 0.7 * first


def test_every_path_is_free_inside_the_limits_and_cheaper() -> None:
    """The least cost lies beyond the limits, so the path follows them."""
    problem = FunctionProblem(
        start=np.array([-1.0, 0.0]), goals=np.array([[1.0, 0.0]]), lower=np.full(2, -1.2), upper=np.array([1.2, 0.4])
    )
    objective = DensityObjective(
        density=lambda q: 4.0 * np.exp(-2.0 * q[:, 1]),
        gradient=lambda q: np.stack([np.zeros(len(q)), -8.0 * np.exp(-2.0 * q[:, 1])], axis=1),
    )
    straight = Path(np.array([problem.start, problem.goals[0]]))
    paths = _solve(CHOMP(initial=straight), problem, objective, 100)
    totals = [path_total(objective, straight), *(path_total(objective, path) for path in paths)]
    assert len(totals) > 3 and np.all(np.diff(totals) < 0.0)
    for path in paths:
        assert np.all(path.q >= problem.lower) and np.all(path.q <= problem.upper)
    assert np.isclose(paths[-1].q[:, 1], 0.4).sum() > 5
    assert totals[-1] < 7.4875  # cost of a converged search; a search that clips its steps at the limits reaches 7.4906
    np.testing.assert_array_equal(paths[-1].q[[0, -1]], straight.q)


def test_leaves_a_symmetric_saddle() -> None:
    """A ridge across a straight path: both sides are equal, so the gradient points to neither."""
    problem = FunctionProblem(
        start=np.array([-1.0, 0.0]), goals=np.array([[1.0, 0.0]]), lower=np.full(2, -2.0), upper=np.full(2, 2.0)
    )

    def hill(q: np.ndarray) -> np.ndarray:
        return 6.0 * np.exp(-np.sum(q**2, axis=1) / 0.18)

    objective = DensityObjective(density=hill, gradient=lambda q: hill(q)[:, None] * q / -0.09)
    straight = Path(np.array([problem.start, problem.goals[0]]))
    energy = PathEnergy(Slopes(problem, objective, Budget()))
    assert np.abs(energy(with_edges(straight, 48)).gradient[:, 1]).max() < 1e-12
    sides = set()
    for seed in range(6):
        path = _solve(CHOMP(initial=straight, bend=None), problem, objective, 80, seed)[-1]
        assert path_total(objective, path) < 0.75 * path_total(objective, straight)
        sides.add(float(np.sign(path.q[len(path) // 2, 1])))
    assert sides == {-1.0, 1.0}


def test_without_weight_paths_are_as_short_as_obstacles_let_them() -> None:
    instance = disc()
    objective = DensityObjective(density=lambda q: 100.0 + q[:, 0], w=0.0)
    path = _solve(CHOMP(initial=_bad(instance), bend=None), instance.problem, objective, 200)[-1]
    assert path.length <= _WITHIN * instance.optimum


def test_a_path_that_is_not_free_is_pushed_out() -> None:
    """A path straight through the disc, slightly off its centre."""
    instance = disc()
    initial = Path(np.array([[-2.0, 0.0], [0.0, 0.3], [2.0, 0.0]]))
    assert not instance.problem.edges_free(initial.q[:-1], initial.q[1:]).all()
    paths = _solve(CHOMP(initial=initial, bend=None), instance.problem, instance.objective, 200)
    assert _exact(instance, paths[-1]) <= _WITHIN
    assert all(instance.problem.edges_free(path.q[:-1], path.q[1:]).all() for path in paths)


def test_obstacles_without_a_clearance_still_bound_the_path() -> None:
    blind = replace(disc().problem, clearance=None)
    initial = _bad(disc())
    paths = _solve(CHOMP(initial=initial), blind, disc().objective, 400)
    assert path_total(disc().objective, paths[-1]) < 0.7 * path_total(disc().objective, initial)
    assert all(blind.edges_free(path.q[:-1], path.q[1:]).all() for path in paths)


def test_begins_with_a_path_of_its_own() -> None:
    instance = disc()
    paths = _solve(CHOMP(), instance.problem, instance.objective, 400)
    assert _exact(instance, paths[-1]) <= _WITHIN


def test_a_path_of_one_edge_and_no_path_at_all_have_nothing_to_improve() -> None:
    instance = free_space()
    straight = Path(np.array([instance.problem.start, instance.problem.goals[0]]))
    assert _solve(CHOMP(initial=straight, bend=None), instance.problem, instance.objective, 50) == []
    assert _solve(CHOMP(initial=_bad(free_space())), instance.problem, instance.objective, 0) == []


def test_a_cost_of_nothing_is_left_alone() -> None:
    instance = free_space()

    @dataclass(frozen=True)
    class Nothing:
        w: float = 1.0

        def edges(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
            return np.zeros((len(q0), 2))

        def states(self, q: np.ndarray) -> np.ndarray:
            return np.zeros(len(q))

    assert _solve(CHOMP(initial=_bad(instance)), instance.problem, Nothing(), 30) == []


def test_same_seed_same_paths() -> None:
    instance = analytic_problems()["hyperbolic"]
    first, second = (_solve(CHOMP(initial=_bad(instance)), instance.problem, instance.objective, 90, 5) for _ in "ab")
    assert len(first) == len(second) > 3
    assert all(np.array_equal(a.q, b.q) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("edges", 1),
        ("memory", 0),
        ("method", "newton"),
        ("stage_iterations", 0),
        ("widths", (0.1, 0.0)),
        ("obstacle_weight", 0.0),
        ("obstacle_reach", np.nan),
        ("obstacle_step", -1.0),
        ("longest_step", np.inf),
        ("bend", 0.0),
    ],
)
def test_improper_settings_are_refused(name: str, value: object) -> None:
    with pytest.raises(SettingError, match=name):
        CHOMP(**{name: value})  # pyright: ignore[reportArgumentType]


# --- cutting up and blending ------------------------------------------------------------------------------------------


@given(corners=st.integers(2, 60), edges=st.integers(2, 40), seed=st.integers(0, 100))
@settings(max_examples=40, deadline=None)
def test_a_path_is_cut_up_evenly(corners: int, edges: int, seed: int) -> None:
    path = Path(np.random.default_rng(seed).normal(size=(corners, 3)))
    q = with_edges(path, edges)
    assert len(q) == edges + 1
    np.testing.assert_allclose(q[[0, -1]], path.q[[0, -1]])
    if corners <= edges + 1:
        assert Path(q).length == pytest.approx(path.length)
        assert all((np.abs(q - corner).max(axis=1) < 1e-12).any() for corner in path.q)
        lengths = np.linalg.norm(np.diff(q, axis=0), axis=1)
        assert lengths.max() <= 2.0 * max(path.length / edges, np.median(lengths)) + path.length / edges


def test_free_stretches_of_a_better_path_are_taken() -> None:
    """A disc blocks the middle of the straight path; elsewhere the incumbent moves closer to that path."""
    instance = disc()
    around = Path(np.array([[-2.0, 0.0], [-2.0, 1.5], [2.0, 1.5], [2.0, 0.0]]))
    kept = Incumbent(around, 40, InterruptibleProblem(instance.problem, instance.objective, Budget()))
    before = kept.total
    through = np.linspace([-2.0, 0.0], [2.0, 0.0], 41)
    assert not list(kept.offer(through, 4.0))
    (path,) = kept.approach(through, 4.0)
    assert instance.problem.edges_free(path.q[:-1], path.q[1:]).all()
    assert path_total(instance.objective, path) == pytest.approx(kept.total) and kept.total < before
    assert not list(kept.approach(path.q, kept.total))


def test_a_blocked_path_gives_nothing_to_fall_back_on() -> None:
    instance = disc()
    through = Path(np.array([[-2.0, 0.0], [2.0, 0.0]]))
    kept = Incumbent(through, 10, InterruptibleProblem(instance.problem, instance.objective, Budget()))
    assert kept.total == np.inf and not kept.free
    assert not list(kept.approach(kept.q, 4.0))


# --- in a scene -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def initial(task: gp.Task) -> Path:
    objective = gp.Objective().bind(task.scene)
    problem = SceneProblem(kernels=objective.kernels, start=np.asarray(task.start), goals=np.atleast_2d(task.goal))
    paths = gp.RRTConnect().solve(problem, objective, Budget(iterations=300), np.random.default_rng(1))
    path = next(iter(paths))
    return path


def test_improves_a_path_in_a_scene_and_smearing_helps(task: gp.Task, initial: Path) -> None:
    """Same initial path and iterations; both costs are of the original objective."""
    totals = {}
    for widths in ((), (0.2, 0.06)):
        planner = gp.CHOMP(initial=initial, widths=widths, bend=None)
        found: list[float] = []
        objective = gp.Objective().bind(task.scene, search_paces())
        problem = SceneProblem(kernels=objective.kernels, start=initial.q[0], goals=initial.q[-1:])
        for path in planner.solve(problem, objective, Budget(iterations=60), np.random.default_rng(0)):
            found.append(path_total(objective, path))
        totals[widths] = min(found)
    assert totals[()] < path_total(objective, initial)
    assert totals[0.2, 0.06] < totals[()]
