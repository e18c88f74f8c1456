"""The judge's pendulum: a slow Python twin, the closed form of small swings, order of convergence, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from graceful_plan.judge import _pendulum

Array = np.ndarray
G = 9.81


def _felt(n: int, dt: float) -> Array:
    """Random specific forces in all directions, with accelerations up to gravity."""
    t = dt * np.arange(n)
    turns = np.array([7.0, 11.0, 5.0])
    return np.sin(turns * t[:, None] + [0.0, 1.0, 2.0]) * [4.0, 9.0, 6.0] + [0.0, 0.0, G]


def _twin(felt: Array, dt: float, length: float, drag: float) -> Array:
    """Integrate a bob on a stiff rod by a general solver, between linearly interpolated samples."""

    def slope(t: float, state: Array) -> Array:
        at = np.array([np.interp(t, dt * np.arange(len(felt)), column) for column in felt.T])
        bob, rate = state[:3], state[3:]
        pull = -at / length
        return np.concatenate([rate, pull - drag * rate - (pull @ bob + rate @ rate) * bob])

    begin = np.concatenate([-felt[0] / np.linalg.norm(felt[0]), np.zeros(3)])
    normals, state = [-begin[:3]], begin
    for k in range(len(felt) - 1):  # no step across a kink of the specific force
        state = solve_ivp(slope, (k * dt, (k + 1) * dt), state, rtol=1e-10, atol=1e-12).y[:, -1]
        normals.append(-state[:3] / np.linalg.norm(state[:3]))
    return np.array(normals)


@pytest.mark.parametrize(("length", "drag"), [(0.02, 0.4), (0.05, 0.0), (0.006, 2.0)])
def test_the_pendulum_equals_its_python_twin(length: float, drag: float) -> None:
    felt = _felt(60, 0.004)
    found = _pendulum.swung(felt, dt=0.004, length=length, drag=drag)
    np.testing.assert_allclose(found, _twin(felt, 0.004, length, drag), atol=3e-5)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    assert np.abs(found - found[0]).max() > 0.3  # it does swing


def test_small_swings_have_the_frequency_and_the_decay_of_a_damped_oscillator() -> None:
    """A push tilts it and ends: x = a e^(-c t / 2) (cos w t + c / (2 w) sin w t), w^2 = g / l - c^2 / 4."""
    length, drag, dt, a, n = 0.03, 1.5, 0.002, 1e-3, 1500
    felt = np.tile([0.0, 0.0, G], (n, 1))
    felt[0] = [G * a, 0.0, G]
    t = dt * np.arange(n)
    w = np.sqrt(G / length - drag**2 / 4.0)
    found = _pendulum.swung(felt, dt=dt, length=length, drag=drag)
    # The push fades linearly within the first interval, about as if it ended in its middle.
    t = np.maximum(t - 0.5 * dt, 0.0)
    wanted = a * np.exp(-0.5 * drag * t) * (np.cos(w * t) + 0.5 * drag / w * np.sin(w * t))
    np.testing.assert_allclose(found[:, 0], wanted, atol=2e-3 * a)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-12)


def test_without_drag_a_large_swing_keeps_its_energy() -> None:
    felt = np.tile([0.0, 0.0, G], (4000, 1))
    felt[0] = [G, 0.0, 0.01]
    up = _pendulum.swung(felt, dt=0.002, length=0.02, drag=0.0)[:, 2]
    assert up[100:].min() == pytest.approx(up[:100].min(), abs=2e-3)
    assert up.max() == pytest.approx(1.0, abs=2e-3)


def test_half_the_step_leaves_a_sixteenth_of_the_error() -> None:
    """Samples every 1/400 s are one step each; the same lines sampled at 1/800 s and finer take more steps."""
    coarse = _felt(80, 0.0025)

    def at(parts: int) -> Array:
        t = np.arange(79 * parts + 1) / parts
        fine = np.stack([np.interp(t, np.arange(80), column) for column in coarse.T], axis=1)
        return _pendulum.swung(fine, dt=0.0025 / parts, length=0.004, drag=0.3)[::parts]

    finest = at(32)
    first, second = (np.abs(at(parts) - finest).max() for parts in (1, 2))
    assert 1e-8 < second < first < 1e-4
    assert 10.0 < first / second < 24.0


def test_turning_the_world_turns_the_surface() -> None:
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    felt = _felt(200, 0.003)
    given = {"dt": 0.003, "length": 0.02, "drag": 0.5}
    np.testing.assert_allclose(
        _pendulum.swung(felt @ turn.T, **given), _pendulum.swung(felt, **given) @ turn.T, atol=1e-9
    )


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"felt": np.zeros((0, 3))}, "felt: at least one row"),
        ({"felt": np.zeros((2, 3))}, "felt: the first row"),
        ({"felt": np.full((2, 3), np.nan)}, "felt: finite"),
        ({"felt": np.full((2, 3), 1e300)}, "felt: .* beyond"),
        ({"dt": 0.0}, "dt: "),
        ({"dt": np.nan}, "dt: "),
        ({"dt": 1.5}, "dt: "),
        ({"length": 0.0}, "length: "),
        ({"length": np.inf}, "length: "),
        ({"drag": -1.0}, "drag: "),
        ({"drag": np.nan}, "drag: "),
    ],
)
def test_what_makes_no_sense_is_refused(changed: dict[str, object], said: str) -> None:
    given = {"felt": _felt(3, 0.002), "dt": 0.002, "length": 0.02, "drag": 0.5} | changed
    felt = given.pop("felt")
    with pytest.raises(ValueError, match=said):
        _pendulum.swung(felt, **given)


def test_other_shapes_are_refused() -> None:
    with pytest.raises(TypeError, match="incompatible function arguments"):
        _pendulum.swung(np.zeros((3, 2)), dt=0.002, length=0.02, drag=0.5)
