"""Trajectory: interpolation laws, sampling, strict reading."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.exceptions import FormatError, NonFiniteError, SettingError, ShapeError
from graceful_plan.timing.trajectory import Trajectory

_TOLERANCE = 1e-9
"""The cubics are evaluated in closed form, so only rounding differs."""


def _random(seed: int, n: int = 6, nq: int = 2) -> Trajectory:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.05, 0.5, n))
    return Trajectory(t, *rng.normal(size=(3, n, nq)), tuple("abcdefg"[:nq]))


@given(st.integers(0, 10**6))
def test_a_cubic_motion_is_reproduced_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    coefficients = rng.normal(size=(4, 3))
    motion = [np.polynomial.Polynomial(c) for c in coefficients.T]
    t = np.cumsum(rng.uniform(0.1, 0.5, 5))

    def of(order: int, times: np.ndarray) -> np.ndarray:
        return np.stack([p.deriv(order)(times) if order else p(times) for p in motion], axis=-1)

    trajectory = Trajectory(t, of(0, t), of(1, t), of(2, t), ("a", "b", "c"))
    times = rng.uniform(t[0], t[-1], 50)
    for order, value in enumerate(trajectory.at(times)):
        np.testing.assert_allclose(value, of(order, times), atol=1e-8)


@given(st.integers(0, 10**6))
def test_positions_equal_those_of_the_states(seed: int) -> None:
    trajectory = _random(seed)
    times = np.append(np.random.default_rng(seed).uniform(-1.0, 4.0, 50), trajectory.t)
    np.testing.assert_allclose(trajectory.positions(times), trajectory.at(times).q, atol=_TOLERANCE)


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_state_at_one_time_is_that_at_many(seed: int, n: int) -> None:
    trajectory = _random(seed, n=n)
    times = [*np.random.default_rng(seed).uniform(-1.0, 4.0, 8).tolist(), *trajectory.t.tolist()]
    for order, values in enumerate(trajectory.at(times)):
        one = [trajectory.at(t)[order] for t in times]
        np.testing.assert_allclose(one, values, atol=_TOLERANCE)


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_backwards_every_moment_has_the_opposite_velocity(seed: int, n: int) -> None:
    trajectory = _random(seed, n=n)
    back = trajectory.reversed()
    inside = np.random.default_rng(seed).uniform(trajectory.t[0], trajectory.t[-1], 20)
    one, two = trajectory.at(inside), back.at(trajectory.t[0] + trajectory.t[-1] - inside)
    for sign, a, b in zip((1.0, -1.0, 1.0), one, two, strict=True):
        np.testing.assert_allclose(sign * b, a, atol=1e-6)
    np.testing.assert_allclose(back.reversed().q, trajectory.q, atol=_TOLERANCE)


def test_places_are_times_by_piece() -> None:
    trajectory = _random(3)
    pieces = len(trajectory) - 1
    place = np.append(np.random.default_rng(0).uniform(0.0, pieces, 200), np.arange(pieces + 1.0))
    t, q = trajectory.at_places(place)
    np.testing.assert_allclose(t, np.interp(place, np.arange(pieces + 1), trajectory.t), atol=_TOLERANCE)
    np.testing.assert_allclose(q, trajectory.positions(t), atol=_TOLERANCE)


def test_a_single_sample_has_its_position_at_every_place() -> None:
    standing = Trajectory(np.array([0.5]), np.array([[1.0, 2.0]]), np.zeros((1, 2)), np.zeros((1, 2)), ("a", "b"))
    t, q = standing.at_places(np.zeros(3))
    np.testing.assert_array_equal(t, 0.5)
    np.testing.assert_array_equal(q, [[1.0, 2.0]] * 3)


def test_a_moving_end_cannot_be_delayed() -> None:
    moving = _random(3)
    with pytest.raises(SettingError, match=r"qd\[0\]"):
        moving.delayed(1.0)
    for wait in (-1.0, np.nan, np.inf):
        with pytest.raises(SettingError, match="seconds"):
            moving.delayed(wait)
    at_rest = np.where(np.arange(len(moving))[:, None] == 0, 0.0, moving.qd)
    still = Trajectory(moving.t, moving.q, at_rest, moving.qdd, moving.joints)
    later = still.delayed(0.5)
    assert later.duration == pytest.approx(still.duration + 0.5) and not later.qd[0].any()
    np.testing.assert_array_equal(later.at(later.t[0] + np.array([0.0, 0.2, 0.5])).q, np.repeat(still.q[:1], 3, axis=0))
    times = np.linspace(still.t[0], still.t[-1], 40)
    np.testing.assert_allclose(later.at(times + 0.5).q, still.at(times).q, atol=_TOLERANCE)
    assert still.delayed(0.0) is still


def test_samples_are_met() -> None:
    trajectory = _random(0)
    state = trajectory.at(trajectory.t)
    np.testing.assert_allclose(state.q, trajectory.q, atol=_TOLERANCE)
    np.testing.assert_allclose(state.qd, trajectory.qd, atol=_TOLERANCE)


@pytest.mark.parametrize("shape", [(), (1,), (2, 3)])
def test_at_keeps_the_shape_of_the_times(shape: tuple[int, ...]) -> None:
    trajectory = _random(1)
    assert trajectory.at(np.full(shape, trajectory.t[1])).q.shape == (*shape, 2)


def test_a_trajectory_rests_outside_its_time() -> None:
    trajectory = _random(2)
    before, after = trajectory.t[0] - 1.0, trajectory.t[-1] + 1.0
    state = trajectory.at([before, after])
    np.testing.assert_allclose(state.q, trajectory.q[[0, -1]], atol=_TOLERANCE)
    assert not state.qd.any() and not state.qdd.any()


@given(st.floats(0.001, 3.0), st.integers(0, 100))
def test_sampling_keeps_both_ends_and_the_step(dt: float, seed: int) -> None:
    trajectory = _random(seed)
    sampled = trajectory.sample(dt)
    assert sampled.t[0] == trajectory.t[0]
    assert sampled.t[-1] == pytest.approx(trajectory.t[-1], abs=1e-12)
    np.testing.assert_array_equal(sampled.q[[0, -1]], np.stack([trajectory.at(trajectory.t[0]).q, trajectory.q[-1]]))
    steps = np.diff(sampled.t)
    assert np.allclose(steps[:-1], dt) and steps[-1] <= dt * (1 + 1e-5)
    np.testing.assert_allclose(sampled.q, trajectory.at(sampled.t).q, atol=_TOLERANCE)


def test_a_single_sample_is_a_trajectory() -> None:
    still = np.zeros((1, 1))
    trajectory = Trajectory(np.array([2.0]), still + 1.0, still, still, ("a",))
    assert trajectory.duration == 0.0
    assert len(trajectory.sample(0.1)) == 1
    assert trajectory.at([0.0, 2.0, 9.0]).q.tolist() == [[1.0]] * 3


def test_arrays_are_read_only_copies() -> None:
    q = np.zeros((2, 1))
    trajectory = Trajectory(np.array([0.0, 1.0]), q, q, q, ("a",))
    q[:] = 7.0
    assert not trajectory.q.any()
    with pytest.raises(ValueError, match="read-only"):
        trajectory.q[0] = 1.0


@given(st.integers(0, 1000))
def test_json_round_trip_is_exact(seed: int) -> None:
    trajectory = _random(seed)
    back = Trajectory.from_json(trajectory.to_json())
    assert back.joints == trajectory.joints
    for name in ("t", "q", "qd", "qdd"):
        np.testing.assert_array_equal(getattr(back, name), getattr(trajectory, name))


def test_json_and_csv_files(tmp_path) -> None:
    trajectory = _random(3)
    text = trajectory.to_json(tmp_path / "a.json")
    assert (tmp_path / "a.json").read_text() == text
    assert Trajectory.from_json(tmp_path / "a.json").to_json() == text
    trajectory.to_csv(tmp_path / "a.csv")
    header, *rows = csv.reader(io.StringIO((tmp_path / "a.csv").read_text()))
    assert header[:3] == ["t [s]", "q a [rad or m]", "q b [rad or m]"]
    np.testing.assert_array_equal(
        np.array(rows, float), np.column_stack([trajectory.t, trajectory.q, trajectory.qd, trajectory.qdd])
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 2}, "version is 2"),
        ({"schema": "other"}, "schema is 'other'"),
        ({"units": {}}, "units is"),
        ({"extra": 1}, "unknown keys: extra"),
        ({"qd": None}, "qd must be a list of numbers"),
        ({"q": [["0", 1.0]]}, "q must be a list of numbers"),
        ({"t": [True, False]}, "t must be a list of numbers"),
        ({"joints": "ab"}, "joints must be a list of names"),
    ],
)
def test_from_json_refuses(change: dict[str, object], message: str) -> None:
    document = json.loads(_random(4).to_json()) | change
    with pytest.raises(FormatError, match=message):
        Trajectory.from_json(json.dumps(document))


@pytest.mark.parametrize("text", ["{", "{}", '{"schema": "graceful_plan.trajectory"}', "{" + '"a":[' * 100_000])
def test_from_json_refuses_broken_text(text: str) -> None:
    with pytest.raises(FormatError):
        Trajectory.from_json(text)


def test_from_json_refuses_non_finite_numbers() -> None:
    document = json.loads(_random(4).to_json())
    document["q"][0][0] = float("nan")
    with pytest.raises(NonFiniteError, match=r"q .*finite"):
        Trajectory.from_json(json.dumps(document))


@pytest.mark.parametrize(
    ("t", "nq", "error", "message"),
    [
        ([0.0, 0.0], 1, SettingError, r"t\[1\]"),
        ([1.0, 0.0], 1, SettingError, "time must increase"),
        ([], 1, ShapeError, "t has shape"),
        ([0.0, 1.0], 2, ShapeError, "q has shape"),
        ([0.0, np.nan], 1, NonFiniteError, "t is not finite"),
    ],
)
def test_construction_refuses(t: list[float], nq: int, error: type[Exception], message: str) -> None:
    q = np.zeros((len(t), nq))
    with pytest.raises(error, match=message):
        Trajectory(np.array(t), q, q, q, ("a",))


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf])
def test_sample_refuses_a_bad_step(dt: float) -> None:
    with pytest.raises(SettingError, match="dt"):
        _random(0).sample(dt)
