"""Problems with known optima: correct optima, additive integrals, refused arguments."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from saddles import mechanical_work, saddle, saddle_density

from graceful_plan.compare.problems.analytic import analytic_problems, disc, free_space, two_media
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path
from graceful_plan.planners.planner import path_total

_QUADRATURE = 0.005
"""Relative error of the trapezoid rule; a jump of the density costs half a step."""


def _arc(centre: tuple[float, float], radius: float, begin: float, end: float) -> np.ndarray:
    angle = np.linspace(begin, end, 200)
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _geodesic(name: str) -> np.ndarray:
    """Return the shortest curve by calculus of variations."""
    if name in ("free_space", "uniform_density"):
        return np.array([[-1.0, -1.0], [0.5, 0.5]])
    if name == "disc":
        touching = np.arccos(0.5)
        return np.concatenate([[[-2.0, 0.0]], 1.0001 * _arc((0, 0), 1.0, np.pi - touching, touching), [[2.0, 0.0]]])
    if name == "two_media":
        return np.array([[0.0, 1.0], [1.700040, 0.0], [2.0, -1.0]])
    if name == "hyperbolic":
        half = np.arctan2(0.5, 0.5)
        return _arc((0.5, 0.0), np.sqrt(0.5), np.pi - half, half)
    x = np.linspace(-1.0, 1.0, 200)
    return np.stack([x, 1.696676 * np.cosh(x / 1.696676)], axis=1)


@pytest.mark.parametrize("name", sorted(analytic_problems()))
def test_geodesic_has_the_stated_cost(name: str) -> None:
    instance = analytic_problems()[name]
    path = Path(_geodesic(name))
    assert path_total(instance.objective, path) == pytest.approx(instance.optimum, rel=_QUADRATURE)
    np.testing.assert_allclose(path.q[0], instance.problem.start, atol=1e-5)
    np.testing.assert_allclose(path.q[-1], instance.problem.goals[0], atol=1e-5)


@pytest.mark.parametrize("name", sorted(analytic_problems()))
@given(bumps=st.lists(st.floats(-0.3, 0.3), min_size=8, max_size=8))
@settings(max_examples=15, deadline=None)
def test_no_path_beats_the_optimum(name: str, bumps: list[float]) -> None:
    instance = analytic_problems()[name]
    line = Path(_geodesic(name)).resampled(0.05).q
    s = np.linspace(0.0, np.pi, len(line))
    waves = np.stack([np.sin((k + 1) * s) for k in range(4)], axis=1)
    q = line + waves @ np.array(bumps).reshape(4, 2)
    q = np.clip(q, instance.problem.lower, instance.problem.upper)
    if instance.problem.edges_free(q[:-1], q[1:]).all():
        assert path_total(instance.objective, Path(q)) >= instance.optimum * (1.0 - _QUADRATURE)


@pytest.mark.parametrize("build", [disc, two_media, free_space])
def test_optimum_does_not_depend_on_more_dimensions(build) -> None:
    assert build(5).optimum == pytest.approx(build(2).optimum * (np.sqrt(2.5) if build is free_space else 1.0))
    assert build(5).problem.start.shape == (5,)


@given(seed=st.integers(0, 10_000), n=st.integers(0, 6))
@settings(max_examples=25, deadline=None)
def test_edge_costs_are_additive_and_independent_of_the_batch(seed: int, n: int) -> None:
    objective = analytic_problems()["catenary"].objective
    rng = np.random.default_rng(seed)
    q0, q1 = rng.uniform([-2, 1], [2, 3], (n, 2)), rng.uniform([-2, 1], [2, 3], (n, 2))
    whole = objective.edges(q0, q1)
    middle = q0 + rng.uniform(size=(n, 1)) * (q1 - q0)
    np.testing.assert_allclose(objective.edges(q0, middle) + objective.edges(middle, q1), whole, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(objective.edges(q1, q0), whole, rtol=1e-12, atol=1e-12)
    for i in range(n):
        np.testing.assert_array_equal(objective.edges(q0[i : i + 1], q1[i : i + 1])[0], whole[i])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_exact_edge_test_agrees_with_dense_sampling(seed: int) -> None:
    problem = disc(3).problem
    rng = np.random.default_rng(seed)
    q0, q1 = rng.uniform(-3, 3, (20, 3)), rng.uniform(-3, 3, (20, 3))
    dense = q0[:, None] + np.linspace(0, 1, 2001)[None, :, None] * (q1 - q0)[:, None]
    nearest = np.linalg.norm(dense, axis=2).min(axis=1)
    clear = np.abs(nearest - 1.0) > 0.01
    np.testing.assert_array_equal(problem.edges_free(q0, q1)[clear], (nearest >= 1.0)[clear])


def test_sampled_edges_see_a_wall_and_empty_batches() -> None:
    problem = FunctionProblem(
        start=np.zeros(2),
        goals=np.ones((1, 2)),
        lower=np.full(2, -1.0),
        upper=np.full(2, 1.0),
        free=lambda q: np.abs(q[:, 0] - 0.5) > 0.05,
        step=0.05,
    )
    q0 = np.zeros((2, 2))
    assert problem.edges_free(q0, np.array([[1.0, 0.0], [0.4, 0.0]])).tolist() == [False, True]
    assert problem.edges_free(q0[:0], q0[:0]).shape == (0,)


@given(ys=st.lists(st.floats(-1.9, 1.9), min_size=1, max_size=5))
@settings(max_examples=25, deadline=None)
def test_no_path_over_the_saddle_works_less(ys: list[float]) -> None:
    instance = saddle()
    x = np.linspace(-1.5, 1.5, len(ys) + 2)
    path = Path(np.stack([x, [0.0, *ys, 0.0]], axis=1))
    assert mechanical_work(saddle_density, path, 0.005) >= instance.least_work * (1.0 - 1e-3)


def test_work_of_the_pass_is_the_least() -> None:
    through = Path(np.array([[-1.5, 0.0], [-1.5, 1.0], [1.5, 1.0], [1.5, 0.0]]))
    assert mechanical_work(saddle_density, through) == pytest.approx(saddle().least_work, rel=0.01)


def test_improper_values_are_refused() -> None:
    box = {"lower": np.zeros(2), "upper": np.ones(2)}
    with pytest.raises(SettingError, match="w = -1"):
        DensityObjective(density=lambda q: q[:, 0], w=-1.0)
    with pytest.raises(SettingError, match="step"):
        DensityObjective(density=lambda q: q[:, 0], step=0.0)
    with pytest.raises(SettingError, match="goals"):
        FunctionProblem(start=np.zeros(2), goals=np.zeros((0, 2)), **box)
    with pytest.raises(SettingError, match="lower"):
        FunctionProblem(start=np.zeros(2), goals=np.zeros((1, 2)), lower=np.ones(2), upper=np.zeros(2))
