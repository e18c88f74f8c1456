import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from graceful_plan.timing.bspline import DEGREE, basis

U = tuple(np.linspace(0.0, 1.0, 41).tolist())


@pytest.mark.parametrize("controls", [6, 7, 9, 20])
def test_values_and_derivatives_are_those_of_scipy(controls):
    spans = controls - DEGREE
    knots = np.concatenate([np.zeros(DEGREE), np.arange(spans + 1) / spans, np.ones(DEGREE)])
    points = np.random.default_rng(controls).normal(size=(controls, 2))
    for order, matrix in enumerate(basis(controls, U)):
        expected = BSpline(knots, points, DEGREE)(U, nu=order)
        np.testing.assert_allclose(matrix @ points, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@given(st.integers(6, 30), st.floats(0.0, 1.0))
def test_a_curve_is_a_mean_of_its_control_points(controls, u):
    weights = basis(controls, (u,))[0, 0]
    assert weights.min() >= -1e-15 and weights.sum() == pytest.approx(1.0)


def test_a_curve_begins_and_ends_at_its_outer_control_points_and_is_tangent_there():
    value, slope = basis(9, (0.0, 1.0))[:2]
    np.testing.assert_allclose(value, np.eye(9)[[0, -1]], atol=1e-15)
    assert slope[0, 0] == -slope[0, 1] != 0.0 and np.all(slope[0, 2:] == 0.0)
