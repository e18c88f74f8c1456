"""The native speed profile: limits hold, and a small change of the curve changes the profile little."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.core import _native

POINTS, JOINTS = 40, 2
VELOCITY, ACCELERATION = np.full(JOINTS, 2.0), np.full(JOINTS, 5.0)


def curve(rng):
    """Return a smooth curve at both ends of each interval: steps, first and second derivatives."""
    s = np.linspace(0.0, 1.0, POINTS + 1)
    size, rate, phase = rng.uniform(0.3, 1.5, JOINTS), rng.uniform(2.0, 9.0, JOINTS), rng.uniform(0.0, 6.0, JOINTS)
    slope = size * rate * np.cos(np.outer(s, rate) + phase) + rng.uniform(0.5, 2.0, JOINTS)
    bend = -size * rate**2 * np.sin(np.outer(s, rate) + phase)
    return np.diff(s), ends(slope), ends(bend)


def ends(values):
    return np.ascontiguousarray(np.stack([values[:-1], values[1:]], axis=1))


def limits(rng):
    """Return one-sided limits a u + b x <= c on each interval, the form of contents constraints."""
    a = np.repeat(rng.uniform(0.05, 0.4, (1, 3)) * rng.choice([-1.0, 1.0], (1, 3)), POINTS, axis=0)
    b = rng.uniform(0.1, 1.0, (1, 3)) * np.ones((POINTS, 3))
    return np.stack([a, b, rng.uniform(0.3, 1.0, (POINTS, 3))], axis=2)


def speeds(found, limit):
    step, slope, bend = found
    stop = np.zeros(POINTS + 1, bool)
    stop[[0, -1]] = True
    found = _native.fastest(
        step=step,
        q=np.zeros((POINTS + 1, JOINTS)),  # speeds do not depend on q
        slope=slope,
        bend=bend,
        stop=stop,
        velocity=VELOCITY,
        acceleration=ACCELERATION,
        limit=np.ascontiguousarray(limit),
    )
    return found.speeds


@given(seed=st.integers(0, 10_000), at=st.integers(5, POINTS - 6))
def test_profiles_are_continuous_at_nearly_vanishing_coefficients(seed, at):
    rng = np.random.default_rng(seed)
    found, limit = curve(rng), limits(rng)
    either = []
    for a in (-1e-9, 1e-9):
        limit[at, 0, 0] = a
        either.append(speeds(found, limit))
    np.testing.assert_allclose(*either, rtol=1e-4, atol=1e-6)


@given(seed=st.integers(0, 10_000))
def test_limits_hold(seed):
    rng = np.random.default_rng(seed)
    found, limit = curve(rng), limits(rng)
    (step, slope, bend), x = found, speeds(found, limit) ** 2
    u = np.diff(x) / (2.0 * step)
    assert np.all(np.abs(slope) * np.sqrt(np.stack([x[:-1], x[1:]], axis=1))[..., None] <= 2.0 + 1e-6)
    for side, squared in enumerate((x[:-1], x[1:])):
        felt = slope[:, side] * u[:, None] + bend[:, side] * squared[:, None]
        assert np.all(np.abs(felt) <= 5.0 + 1e-6)
    felt = limit[..., 0] * u[:, None] + limit[..., 1] * x[:-1, None]
    assert np.all(felt <= limit[..., 2] + 1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_profiles_are_at_least_as_fast_as_reachability_analysis(seed):
    rng = np.random.default_rng(seed)
    found, limit = curve(rng), limits(rng)
    limit[rng.integers(5, POINTS - 5, 4), 0, 0] = 1e-3
    eased, greedy = speeds(found, limit), np.sqrt(greedily(found, limit))
    duration = [np.sum(2.0 * found[0] / (v[:-1] + v[1:])) for v in (eased, greedy)]
    assert duration[0] <= duration[1] * (1.0 + 1e-9)


def greedily(found, limit):
    """Return greatest squared speeds by reachability analysis, with bisection in Python."""
    step, slope, bend = found
    rows = []
    for i in range(POINTS):
        two = [(slope[i, 0], bend[i, 0]), (slope[i, 1] + 2 * step[i] * bend[i, 1], bend[i, 1])]
        a, b = (np.concatenate([part for pair in two for part in (pair[k], -pair[k])]) for k in (0, 1))
        c = np.concatenate([ACCELERATION] * 4)
        rows.append([np.concatenate([own, limit[i, :, k]]) for k, own in enumerate((a, b, c))])
    fast = VELOCITY.min() ** 2 / np.maximum(np.abs(slope).max(axis=2), 1e-12) ** 2
    top = np.minimum(np.append(fast[:, 0], np.inf), np.append(np.inf, fast[:, 1]))
    top[[0, -1]] = 0.0

    def range_of(i, x):
        """Return least and greatest acceleration at a squared speed; infeasible if the first exceeds the second."""
        a, b, c = rows[i]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (c - b * x) / a
        lower, upper = at[a < 0].max(initial=-x / (2 * step[i])), at[a > 0].min(initial=np.inf)
        return lower, min(upper, (top[i + 1] - x) / (2 * step[i]))

    for i in reversed(range(POINTS)):
        low, high = 0.0, top[i]
        for _ in range(80):
            middle = 0.5 * (low + high)
            lower, upper = range_of(i, middle)
            low, high = (middle, high) if lower <= upper else (low, middle)
        top[i] = low
    x = np.zeros(POINTS + 1)
    for i in range(POINTS):
        x[i + 1] = max(0.0, x[i] + 2 * step[i] * range_of(i, x[i])[1])
    return x
