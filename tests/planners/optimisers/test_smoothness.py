"""The smoothness metric: its noise, its solutions, and smooth motions at limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.exceptions import SettingError
from graceful_plan.planners.optimisers.smoothness import Smoothness

_SMALL = st.builds(Smoothness, st.integers(1, 40), st.sampled_from([1, 2]))
_TETHERED = st.builds(Smoothness, st.integers(1, 40), st.sampled_from([1, 2]), st.sampled_from([0.0, 0.01, 1.0]))


@given(metric=_TETHERED)
def test_matrix_is_banded_symmetric_and_its_inverse_inverts_it(metric: Smoothness) -> None:
    n = metric.n
    np.testing.assert_array_equal(metric.matrix, metric.matrix.T)
    far = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) > metric.order
    assert not metric.matrix[far].any()
    np.testing.assert_allclose(metric.matrix @ metric.inverse, np.eye(n), atol=1e-8)
    np.testing.assert_allclose(metric.factor @ metric.factor.T, metric.matrix, atol=1e-12)


def test_inner_rows_of_the_matrix_are_the_textbook_stencils() -> None:
    np.testing.assert_array_equal(Smoothness(5, 1).matrix[2], [0, -1, 2, -1, 0])
    np.testing.assert_array_equal(Smoothness(7, 2).matrix[3], [0, 1, -4, 6, -4, 1, 0])


@pytest.mark.parametrize(("order", "tether"), [(1, 0.0), (2, 0.0), (2, 0.3)])
def test_noise_has_the_inverse_as_covariance(order: int, tether: float) -> None:
    metric = Smoothness(8, order, tether)
    noise = metric.noise(50_000, 2, np.random.default_rng(0))
    expected = metric.inverse / metric.inverse.diagonal().max()
    for joint in range(2):
        covariance = np.cov(noise[:, :, joint], rowvar=False)
        assert np.linalg.norm(covariance - expected) < 0.02 * np.linalg.norm(expected)
    across = noise[:, :, 0].T @ noise[:, :, 1] / len(noise)
    assert np.linalg.norm(across) < 0.05 * np.linalg.norm(expected)


def test_noise_falls_towards_the_ends_without_a_jump() -> None:
    deviation = Smoothness(60).noise(2000, 1, np.random.default_rng(0)).std(axis=0)[:, 0]
    assert deviation.max() == pytest.approx(1.0, abs=0.05)
    assert deviation[0] < 0.07 and deviation[-1] < 0.07


@given(metric=_SMALL, seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_one_newton_step_reaches_the_smoothest_path(metric: Smoothness, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(metric.n + 2, 3))
    q[1:-1] -= metric.solve(metric.difference[:, 1:-1].T @ (metric.difference @ q))
    np.testing.assert_allclose(q, np.linspace(q[0], q[-1], metric.n + 2), atol=1e-8)


@given(metric=_SMALL, seed=st.integers(0, 1000), batch=st.sampled_from([(), (1,), (2, 3)]))
@settings(max_examples=25, deadline=None)
def test_points_always_end_within_the_limits(metric: Smoothness, seed: int, batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    lower, upper = np.array([-1.0, -0.1]), np.array([1.0, 0.2])
    inner = rng.normal(size=(*batch, metric.n, 2)) * 10.0 ** rng.uniform(-2, 1)
    moved = metric.into_limits(inner, lower, upper)
    assert np.all((moved >= lower) & (moved <= upper))
    within = np.clip(inner, lower, upper) == inner
    if within.all():
        np.testing.assert_array_equal(moved, inner)


def test_a_tether_keeps_bumps_within_a_stretch() -> None:
    metric = Smoothness(99, 2, (6.7 / 25.0) ** 4)
    bump = metric.inverse[:, 49] / metric.inverse[49, 49]
    width = np.flatnonzero(np.diff(np.sign(bump)))
    assert 20 <= np.min(width[width >= 49]) - np.max(width[width < 49]) <= 30
    assert np.abs(bump[:20]).max() < 0.06


def test_limits_bend_a_path_rather_than_cut_it() -> None:
    metric = Smoothness(50)
    s = np.linspace(0.0, np.pi, 52)[1:-1]
    inner = 1.2 * np.sin(s)[:, None]
    moved = metric.into_limits(inner, np.array([-1.0]), np.array([1.0]))
    cut = np.clip(inner, -1.0, 1.0)

    def roughness(points: np.ndarray) -> float:
        return float(np.square(metric.difference @ np.pad(points, ((1, 1), (0, 0)))).sum())

    assert moved.max() <= 1.0
    assert roughness(moved) < 0.1 * roughness(cut)


@pytest.mark.parametrize(("n", "order", "name"), [(0, 2, "n"), (5, 3, "order"), (5, 0, "order")])
def test_settings_are_checked(n: int, order: int, name: str) -> None:
    with pytest.raises(SettingError, match=name):
        Smoothness(n, order)
    with pytest.raises(SettingError, match="tether"):
        Smoothness(5, 2, -1.0)
