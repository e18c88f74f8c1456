import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.mobile.motions.drive_curve import Drive, Roll, Straight, connected, drive_limits, rolled
from graceful_plan.timing.retiming import timed
from hall import BASE, hall

SCENE = hall()
CONTROLS = np.array([[0, 0], [0.4, 0], [0.8, 0], [1.2, 0.4], [1.6, 1.0], [2.0, 1.5], [2.6, 1.5], [3.0, 1.5]])


def roll(controls=CONTROLS, forward=True):
    first, last = controls[1] - controls[0], controls[-1] - controls[-2]
    sign = 1.0 if forward else -1.0
    headings = [np.arctan2(sign * way[1], sign * way[0]) for way in (first, last)]
    ends = [np.array([*controls[k], heading]) for k, heading in zip((0, -1), headings, strict=True)]
    ends[1][2] += 2.0 * np.pi * np.round((ends[0][2] - ends[1][2]) / (2.0 * np.pi))
    return Roll(controls, ends[0], ends[1], forward)


def travelled(drive, scene=SCENE, speed=1.0):
    base = scene.base
    return timed(drive, scene.limits, scene.joints, speed=speed, restraint=lambda grid: drive_limits(base, grid))


def rates(trajectory, n=4000):
    """Speeds along and across the heading, acceleration along, and rate of turning."""
    state = trajectory.at(np.linspace(0.0, trajectory.duration, n))
    c, s = np.cos(state.q[:, 2]), np.sin(state.q[:, 2])
    along = state.qd[:, 0] * c + state.qd[:, 1] * s
    across = -state.qd[:, 0] * s + state.qd[:, 1] * c
    return along, across, state.qdd[:, 0] * c + state.qdd[:, 1] * s, state.qd[:, 2]


@pytest.mark.parametrize("forward", [True, False])
def test_derivatives_of_the_heading_are_those_of_differences(forward):
    curve, h = roll(forward=forward), 1e-5
    u = np.linspace(0.05, 0.95, 60)
    before, at, after = (curve.at(u + k * h) for k in (-1, 0, 1))
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), at[1], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), at[2], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("forward", [True, False])
def test_a_drive_rolls_within_all_limits_and_reaches_one_of_them_everywhere(forward):
    curve = roll(forward=forward)
    turned = np.array([3.0, 1.5, curve.end[2] + 1.0])
    drive = connected((Straight(np.array([0.0, 0.0, -1.0]), curve.begin), curve, Straight(curve.end, turned)))
    trajectory = travelled(drive)
    v, side, a, omega = rates(trajectory)
    assert np.abs(side).max() < 5e-4
    assert (v > -1e-3).all() if forward else (v < 1e-3).all()
    rim = np.abs(v) + BASE.lever * np.abs(omega)
    assert rim.max() <= BASE.rim_max * 1.001
    assert np.abs(a).max() <= BASE.a_max * 1.01
    assert np.abs(v * omega).max() <= BASE.lateral_max * 1.01
    np.testing.assert_allclose(trajectory.q[[0, -1]], [[0.0, 0.0, -1.0], turned], atol=1e-12)
    # Time-optimal: almost always something is at its limit.
    lateral = np.abs(v * omega) / BASE.lateral_max
    used = np.maximum.reduce([rim / BASE.rim_max, np.abs(a) / BASE.a_max, lateral, np.abs(omega) / BASE.omega_max])
    alpha = np.abs(trajectory.at(np.linspace(0.0, trajectory.duration, 4000)).qdd[:, 2]) / BASE.alpha_max
    assert np.median(np.maximum(used, alpha)) > 0.9


def test_straight_ahead_takes_the_time_of_a_trapezoid():
    line = np.linspace([0.0, 0.0], [5.0, 0.0], 6)
    duration = travelled(Drive((roll(line),))).duration
    assert duration == pytest.approx(5.0 / BASE.v_max + BASE.v_max / BASE.a_max, rel=5e-3)


@given(st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=9))
@settings(max_examples=25, deadline=None)
def test_curves_of_any_shape_roll_within_limits(offsets):
    controls = np.column_stack([0.6 * np.arange(len(offsets) + 3), [0.0, 0.0, *offsets, offsets[-1]]])
    v, side, a, omega = rates(travelled(Drive((roll(controls),))))
    assert np.abs(side).max() < 1e-3
    assert (np.abs(v) + BASE.lever * np.abs(omega)).max() <= BASE.rim_max * 1.01
    assert np.abs(a).max() <= BASE.a_max * 1.02


def test_batches_are_curves_one_by_one():
    P = np.random.default_rng(0).normal(size=(4, 5, 7, 2))
    together = rolled(P, True)
    for k in range(5):
        np.testing.assert_array_equal(together[:, k], rolled(P[:, k], True))


def test_what_leads_nowhere_is_left_out():
    q = np.zeros(3)
    assert connected((Straight(q, q), roll(), Straight(q, q))).stretches[0] is not None
    assert len(connected((Straight(q, q), roll(), Straight(q, q))).stretches) == 1
