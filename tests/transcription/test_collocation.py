"""Collocation: exact where it should be, of the order that it should have, and true to the dynamics."""

from __future__ import annotations

from dataclasses import replace

import casadi
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from graceful_plan.exceptions import NonFiniteError, SettingError, UnknownNameError
from graceful_plan.planners.optimisers.nlp import Outcome
from graceful_plan.transcription.collocation import METHODS, ControlProblem, collocate

_INF = np.array([np.inf])
LEAST_EFFORT = ControlProblem(
    dynamics=lambda x, u: casadi.vertcat(x[1], u[0]),
    cost=lambda x, u: u[0] ** 2,
    start=np.zeros(2),
    end=np.array([1.0, 0.0]),
    least_control=-_INF,
    most_control=_INF,
    duration=1.0,
)
LEAST_TIME = replace(
    LEAST_EFFORT,
    cost=lambda x, u: 1.0,
    least_control=-2.0 * np.ones(1),
    most_control=2.0 * np.ones(1),
    duration=(0.1, 9.0),
)
PENDULUM = ControlProblem(
    dynamics=lambda x, u: casadi.vertcat(x[1], u[0] - casadi.sin(x[0])),
    cost=lambda x, u: u[0] ** 2 + 0.1 * x[1] ** 2,
    start=np.zeros(2),
    end=np.array([2.0, 0.0]),
    least_control=-_INF,
    most_control=_INF,
    duration=2.0,
)


@pytest.mark.parametrize("intervals", [1, 5, 10, 20, 40])
def test_hermite_simpson_is_exact_for_a_double_integrator(intervals: int) -> None:
    result = collocate(LEAST_EFFORT, intervals)
    assert result.cost == pytest.approx(12.0, abs=1e-8)
    np.testing.assert_allclose(result.u[:, 0], 6.0 - 12.0 * result.t, atol=1e-6)


@pytest.mark.parametrize(("intervals", "cost"), [(5, 13.8889), (10, 12.4611), (20, 12.1166), (40, 12.0295)])
def test_trapezoid_has_the_error_that_is_known(intervals: int, cost: float) -> None:
    assert collocate(LEAST_EFFORT, intervals, "trapezoid").cost == pytest.approx(cost, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_least_time_is_that_of_full_acceleration_and_braking(method: str) -> None:
    errors = [collocate(LEAST_TIME, n, method).cost / (2.0 * np.sqrt(1.0 / 2.0)) - 1.0 for n in (10, 40)]
    assert -1e-7 < errors[1] < 1e-3
    assert errors[1] <= max(errors[0] / 3.0, 1e-8)


@pytest.mark.parametrize(("method", "order"), [("trapezoid", 2.0), ("hermite_simpson", 4.0)])
def test_error_falls_with_the_order_of_the_method(method: str, order: float) -> None:
    exact = collocate(PENDULUM, 128).cost
    errors = [abs(collocate(PENDULUM, n, method).cost - exact) for n in (4, 8, 16)]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(rates > order - 0.5), rates


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("problem", [LEAST_EFFORT, LEAST_TIME, PENDULUM], ids=["effort", "time", "pendulum"])
def test_equations_are_met(problem: ControlProblem, method: str) -> None:
    result = collocate(problem, 12, method)
    assert result.outcome is Outcome.SOLVED
    assert result.defect < 1e-8
    np.testing.assert_allclose(result.x[[0, -1]], [problem.start, problem.end], atol=1e-12)


def test_controls_lead_to_the_end_when_simulated() -> None:
    result = collocate(PENDULUM, 40)

    def slope(t: float, x: np.ndarray) -> list[float]:
        return [x[1], float(result.control(np.array(t))[0]) - np.sin(x[0])]

    found = solve_ivp(slope, (0.0, result.t[-1]), PENDULUM.start, method="RK45", rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.y[:, -1], PENDULUM.end, atol=1e-5)


def test_free_ends_and_state_limits() -> None:
    free = replace(LEAST_EFFORT, end=np.array([1.0, np.nan]), most_state=np.array([np.inf, 1.2]))
    result = collocate(free, 20)
    assert result.x[:, 1].max() <= 1.2 + 1e-8
    assert result.cost < 12.0
    assert result.x[-1, 1] > 0.1


def test_a_guess_is_taken() -> None:
    first = collocate(PENDULUM, 10)
    again = collocate(PENDULUM, 10, guess=(first.x, first.u, 2.0))
    assert again.cost == pytest.approx(first.cost, rel=1e-8)


def test_what_cannot_be_done_in_time_is_infeasible() -> None:
    assert collocate(replace(LEAST_TIME, duration=0.5), 10).outcome is Outcome.INFEASIBLE


def test_misuse_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="euler"):
        collocate(LEAST_EFFORT, 5, "euler")
    with pytest.raises(SettingError, match="intervals"):
        collocate(LEAST_EFFORT, 0)
    with pytest.raises(SettingError, match="duration"):
        replace(LEAST_EFFORT, duration=(2.0, 1.0))
    with pytest.raises(SettingError, match="least_control"):
        replace(LEAST_EFFORT, least_control=np.ones(1), most_control=np.zeros(1))
    with pytest.raises(NonFiniteError, match="start"):
        replace(LEAST_EFFORT, start=np.array([np.nan, 0.0]))
    with pytest.raises(SettingError, match="guess"):
        collocate(LEAST_EFFORT, 5, guess=(np.zeros((3, 2)), np.zeros((3, 1)), 1.0))
