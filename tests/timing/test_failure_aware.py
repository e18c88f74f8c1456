"""Failure-aware timing: closed forms, limits, never worse than the plain timing, misuse."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError, UnknownNameError
from graceful_plan.path import Path
from graceful_plan.scene.elements import Limits
from graceful_plan.timing.failure_aware import SLOWEST, timed_cost
from graceful_plan.timing.retiming import retime
from graceful_plan.timing.trajectory import Trajectory

_TOLERANCE = 1e-6
"""Relative, what the library promises of limits."""


def _limits(velocity: ArrayLike, acceleration: ArrayLike, torque: float = np.inf) -> Limits:
    velocity, acceleration = np.array(velocity), np.array(acceleration)
    position = np.stack([np.full(len(velocity), -np.inf), np.full(len(velocity), np.inf)], axis=1)
    torques = np.full(len(velocity), torque)
    return Limits(position=position, velocity=velocity, acceleration=acceleration, torque=torques)


_PANDA = _limits([2.175] * 4 + [2.61] * 3, [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])
_LINE = Path(np.array([[0.0], [3.0]]))
_QUICK = _limits([2.0], [1000.0])
"""One joint that reaches its speed at once."""


def _squared(factor: float):
    """Impact in proportion to the square of the speed."""
    return lambda q, qd: factor * (qd**2).sum(axis=1)


def _bumps(seed: int):
    """Smooth impact between 0 and 10 that depends on place and speed in some random way."""
    rng = np.random.default_rng(seed)
    place, pace, threshold = rng.normal(size=7), rng.normal(size=7), rng.uniform(0.2, 2.0)

    def impact(q, qd):
        fast = 1.0 / (1.0 + np.exp(-(np.linalg.norm(qd, axis=1) - threshold) / 0.1))
        return 10.0 * np.sin(q @ place + 0.3 * (qd @ pace)) ** 2 * (0.1 + 0.9 * fast)

    return impact


def _zigzag(seed: int, n: int, size: float) -> Path:
    return Path(np.cumsum(np.random.default_rng(seed).normal(size=(n, 7)) * size, axis=0))


def _speed_at(trajectory: Trajectory, q: float) -> float:
    times = np.linspace(trajectory.t[0], trajectory.t[-1], 4000)
    state = trajectory.at(times)
    return float(np.interp(q, state.q[:, 0], state.qd[:, 0]))


@given(st.floats(0.3, 20.0), st.floats(0.1, 10.0))
@settings(max_examples=25, deadline=None)
def test_the_best_speed_under_kinetic_energy(factor: float, w: float) -> None:
    """(1 + w c v^2)/v is least at v = 1/sqrt(w c)."""
    best = 1.0 / np.sqrt(w * factor)
    trajectory = retime(_LINE, _QUICK, impact=_squared(factor), w=w)
    if SLOWEST * 2.0 < best < 2.0:
        for q in (0.7, 1.5, 2.3):
            assert _speed_at(trajectory, q) == pytest.approx(best, rel=0.05)
        assert timed_cost(trajectory, _squared(factor), w) == pytest.approx(2.0 * 3.0 / best, rel=0.01)
    elif best > 2.0:
        assert trajectory.duration == retime(_LINE, _QUICK).duration


def test_it_is_slow_only_where_speed_does_harm() -> None:
    def impact(q, qd):
        return np.where((q[:, 0] > 1.0) & (q[:, 0] < 2.0) & (qd[:, 0] > 0.5), 10.0, 0.0)

    trajectory = retime(_LINE, _limits([2.0], [20.0]), impact=impact)
    assert _speed_at(trajectory, 0.5) == pytest.approx(2.0, rel=0.01)
    assert 0.4 < _speed_at(trajectory, 1.5) < 0.55
    assert _speed_at(trajectory, 2.5) == pytest.approx(2.0, rel=0.01)


def test_harm_that_does_not_depend_on_speed_is_left_as_soon_as_possible() -> None:
    path = _zigzag(0, 6, 0.4)
    plain = retime(path, _PANDA)
    aware = retime(path, _PANDA, impact=lambda q, qd: 5.0 + np.sin(q[:, 0]), w=3.0)
    np.testing.assert_array_equal(aware.t, plain.t)


def test_without_weight_it_is_the_plain_timing() -> None:
    path = _zigzag(1, 6, 0.4)
    np.testing.assert_array_equal(retime(path, _PANDA, impact=_squared(9.0), w=0.0).t, retime(path, _PANDA).t)


@given(st.integers(0, 10**6), st.integers(2, 8), st.floats(0.01, 1.0), st.sampled_from([0.0, 0.003, 0.05, 0.3]))
@settings(max_examples=25, deadline=None)
def test_limits_hold_and_it_is_never_worse_than_plain(seed: int, n: int, size: float, deviation: float) -> None:
    path, impact = _zigzag(seed, n, size), _bumps(seed)
    plain, aware = (retime(path, _PANDA, deviation=deviation, impact=given) for given in (None, impact))
    assert timed_cost(aware, impact, 1.0) <= timed_cost(plain, impact, 1.0)
    assert plain.duration <= aware.duration * (1.0 + 1e-9) <= 1.05 * plain.duration / SLOWEST
    state = aware.at(np.concatenate([np.linspace(0.0, aware.duration, 4000), aware.t - 1e-9, aware.t + 1e-9]))
    assert (np.abs(state.qd) / _PANDA.velocity).max() <= 1.0 + _TOLERANCE
    assert (np.abs(state.qdd) / _PANDA.acceleration).max() <= 1.0 + _TOLERANCE
    assert not aware.qd[[0, -1]].any()
    np.testing.assert_array_equal(aware.q[[0, -1]], path.q[[0, -1]])


@given(st.integers(0, 10**6))
@settings(max_examples=6, deadline=None)
def test_no_other_weight_gives_a_better_timing(seed: int) -> None:
    """Up to the lattice, 2 % on one of 60 random paths: what is best at a weight is not beaten by what is at others."""
    path, impact = _zigzag(seed, 4, 0.3), _bumps(seed)
    weights = (0.0, 0.3, 3.0)
    timings = [retime(path, _PANDA, impact=impact, w=w) for w in weights]
    for w, best in zip(weights, timings, strict=True):
        least = min(timed_cost(other, impact, w) for other in timings)
        assert timed_cost(best, impact, w) <= 1.03 * least


def test_the_same_input_gives_the_same_timing() -> None:
    path = _zigzag(2, 6, 0.4)
    first, second = (retime(path, _PANDA, impact=_bumps(2)) for _ in range(2))
    assert first.to_json() == second.to_json()


def test_a_fraction_of_the_speed_bounds_it_too() -> None:
    path, impact = _zigzag(3, 5, 0.4), _bumps(3)
    plain, aware = (retime(path, _PANDA, speed=0.5, impact=given) for given in (None, impact))
    assert (np.abs(aware.qd) / _PANDA.velocity).max() <= 0.5 + _TOLERANCE
    assert (np.abs(aware.qdd) / _PANDA.acceleration).max() <= 0.25 + _TOLERANCE
    assert timed_cost(aware, impact, 1.0) < timed_cost(plain, impact, 1.0)


def test_torque_limits_hold() -> None:
    """A pendulum of inertia 1 and gravity torque 4 cos q against a limit of 6 N m."""
    limits = _limits([10.0], [50.0], 6.0)

    def torque(q, qd, qdd):
        return qdd + 4.0 * np.cos(q)

    path = Path(np.array([[-1.0], [1.0]]))
    trajectory = retime(path, limits, inverse_dynamics=torque, impact=_squared(1.0))
    state = trajectory.at(np.linspace(0.0, trajectory.duration, 4000))
    assert np.abs(torque(state.q, state.qd, state.qdd)).max() <= 6.0 * (1.0 + 1e-3)
    assert trajectory.duration > retime(path, limits, inverse_dynamics=torque).duration


def test_a_path_without_length_stays_where_it_is() -> None:
    trajectory = retime(Path(np.zeros((2, 1))), _QUICK, impact=_squared(1.0))
    assert trajectory.duration == 0.0 == timed_cost(trajectory, _squared(1.0), 1.0)


def test_broken_impacts_are_refused() -> None:
    for impact, error, message in (
        (lambda q, qd: np.full(len(q), np.nan), NonFiniteError, "impact"),
        (lambda q, qd: np.full(len(q), -1.0), SettingError, "at least 0"),
        (lambda q, qd: np.zeros((len(q), 2)), ShapeError, "impact"),
    ):
        with pytest.raises(error, match=message):
            retime(_LINE, _QUICK, impact=impact)
    for w in (-1.0, np.nan, np.inf):
        with pytest.raises(SettingError, match="w = "):
            retime(_LINE, _QUICK, impact=_squared(1.0), w=w)


# --- in plan ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Energy(gp.Cost):
    """Impact in proportion to the square of the speed."""

    def state(self, batch: gp.StateBatch) -> np.ndarray:
        return batch.speed**2


@pytest.fixture(scope="module")
def objective() -> gp.Objective:
    return gp.Objective(impact=Energy())


def test_plans_are_timed_so_that_failing_does_less_harm(task: gp.Task, objective: gp.Objective) -> None:
    given = {"objective": objective, "iterations": 200, "seed": 1, "planner": "rrt_connect"}
    plain = gp.plan(task.start, task.goal, task.scene, **given)
    aware, again = (gp.plan(task.start, task.goal, task.scene, speed="failure_aware", **given) for _ in range(2))
    np.testing.assert_array_equal(aware.path.q, plain.path.q)
    assert aware.unwrap().to_json() == again.unwrap().to_json()
    assert aware.verdict.passed and set(aware.verdict.checks) == set(plain.verdict.checks)
    states = objective.bind(task.scene).states
    assert timed_cost(aware.trajectory, states, 1.0) < timed_cost(plain.trajectory, states, 1.0)
    assert aware.trajectory.duration > plain.trajectory.duration


def test_plans_without_weight_are_timed_plainly(task: gp.Task, objective: gp.Objective) -> None:
    plain, aware = (
        gp.plan(task.start, task.goal, task.scene, 0.0, objective=objective, iterations=300, speed=speed)
        for speed in (1.0, "failure_aware")
    )
    np.testing.assert_array_equal(plain.unwrap().t, aware.unwrap().t)


def test_the_drop_model_makes_plans_slower_where_it_pays() -> None:
    """Over all tasks of a scene; on some paths the fastest timing is the best."""
    scene = gp.load_scene("tabletop_l3")
    objective = gp.Objective(impact=gp.ImpactCost(model="footprint"), w=1.0)
    gains = []
    for task in scene.tasks.values():
        states = objective.bind(task.scene).states
        path = gp.Path(np.stack([task.start, np.atleast_2d(task.goal)[0]]))
        plain, aware = (retime(path, task.scene.limits, impact=given) for given in (None, states))
        gains.append(timed_cost(plain, states, 1.0) - timed_cost(aware, states, 1.0))
    assert min(gains) >= 0.0 and max(gains) > 0.01


def test_unknown_speeds_are_refused(task: gp.Task) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown speed 'fast'; valid: a fraction in .*, failure_aware"):
        gp.plan(task.start, task.goal, task.scene, speed="fast")
    for speed in (np.nan, 0.0, -1.0, 1.01):
        with pytest.raises(SettingError, match=r"a fraction in .* or 'failure_aware'"):
            gp.plan(task.start, task.goal, task.scene, speed=speed)
