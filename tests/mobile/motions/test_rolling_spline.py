"""Smooth curves of bases: they roll within all limits, as fast as possible."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.mobile.motions.drive import Drive, StraightMove, joined
from graceful_plan.mobile.motions.drive_limits import drive_limits
from graceful_plan.mobile.motions.drive_timing import slower
from graceful_plan.mobile.motions.rolling_spline import RollingSpline
from graceful_plan.timing.retiming import timed
from hall import BASE, hall

SCENE = hall()
CONTROLS = np.array([[0, 0], [0.4, 0], [0.8, 0], [1.2, 0.4], [1.6, 1.0], [2.0, 1.5], [2.6, 1.5], [3.0, 1.5]])


def rolling(controls=CONTROLS, forward=True, share=0.0):
    """Return the curve of control points in the plane, at a logarithm of the share of the speed."""
    first = np.asarray(controls[1]) - controls[0]
    sign = 1.0 if forward else -1.0
    shares = np.full(len(controls), share)
    return RollingSpline(np.column_stack([controls, shares]), forward, np.arctan2(sign * first[1], sign * first[0]))


def travelled(drive, scene=SCENE, speed=1.0):
    base = scene.base
    return timed(drive, scene.limits, scene.joints, speed=speed, restraint=lambda grid: drive_limits(base, grid))


def rates(trajectory, n=4000):
    """Return speeds along and across the heading, acceleration along it, and turning rate."""
    state = trajectory.at(np.linspace(0.0, trajectory.duration, n))
    c, s = np.cos(state.q[:, 2]), np.sin(state.q[:, 2])
    along = state.qd[:, 0] * c + state.qd[:, 1] * s
    across = -state.qd[:, 0] * s + state.qd[:, 1] * c
    return along, across, state.qdd[:, 0] * c + state.qdd[:, 1] * s, state.qd[:, 2]


@pytest.mark.parametrize("forward", [True, False])
def test_derivatives_of_the_heading_equal_differences(forward):
    grid = rolling(forward=forward).grid(16)
    du = np.diff(grid.s)
    inside = slice(40, -40)
    between = 0.5 * (grid.slope[:, 0] + grid.slope[:, 1])
    np.testing.assert_allclose((np.diff(grid.q, axis=0) / du[:, None])[inside], between[inside], atol=1e-4)
    bend = 0.5 * (grid.bend[:, 0] + grid.bend[:, 1])
    change = (grid.slope[:, 1] - grid.slope[:, 0]) / du[:, None]
    np.testing.assert_allclose(change[inside], bend[inside], atol=2e-3)


@pytest.mark.parametrize("forward", [True, False])
def test_a_drive_rolls_within_all_limits_and_reaches_one_of_them_everywhere(forward):
    curve = rolling(forward=forward)
    end = curve.samples[-1]
    turned = end + [0.0, 0.0, 1.0]
    start = curve.samples[0] - [0.0, 0.0, 1.0]
    trajectory = travelled(joined(start, [curve], turned))
    v, side, a, omega = rates(trajectory)
    assert np.abs(side).max() < 5e-4
    assert (v > -1e-3).all() if forward else (v < 1e-3).all()
    rim = np.abs(v) + BASE.lever * np.abs(omega)
    assert rim.max() <= BASE.rim_max * 1.001
    assert np.abs(a).max() <= BASE.a_max * 1.01
    assert np.abs(v * omega).max() <= BASE.lateral_max * 1.01
    np.testing.assert_allclose(trajectory.q[[0, -1]], [start, turned], atol=1e-12)
    # Time-optimal: some limit is active almost everywhere.
    lateral = np.abs(v * omega) / BASE.lateral_max
    used = np.maximum.reduce([rim / BASE.rim_max, np.abs(a) / BASE.a_max, lateral, np.abs(omega) / BASE.omega_max])
    alpha = np.abs(trajectory.at(np.linspace(0.0, trajectory.duration, 4000)).qdd[:, 2]) / BASE.alpha_max
    assert np.median(np.maximum(used, alpha)) > 0.9


def test_straight_ahead_takes_the_time_of_a_trapezoid():
    line = np.linspace([0.0, 0.0], [5.0, 0.0], 6)
    duration = travelled(Drive((rolling(line),))).duration
    assert duration == pytest.approx(5.0 / BASE.v_max + BASE.v_max / BASE.a_max, rel=0.015)


@given(st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=9))
@settings(max_examples=25, deadline=None)
def test_curves_of_any_shape_roll_within_limits(offsets):
    controls = np.column_stack([0.6 * np.arange(len(offsets) + 3), [0.0, 0.0, *offsets, offsets[-1]]])
    v, side, a, omega = rates(travelled(Drive((rolling(controls),))))
    assert np.abs(side).max() < 1e-3
    assert (np.abs(v) + BASE.lever * np.abs(omega)).max() <= BASE.rim_max * 1.01
    assert np.abs(a).max() <= BASE.a_max * 1.02


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_shares_of_the_speed_hold_on_their_curve_alone(share):
    slow = rolling(np.linspace([0.0, 0.0], [6.0, 0.0], 8), share=np.log(share))
    there = slow.samples[-1]
    drive = joined(np.zeros(3), [slow, rolling(np.linspace([6.0, 0.0], [12.0, 0.0], 8))], there + [6.0, 0.0, 1.0])
    fast = travelled(drive)
    restraint = slower(drive, fast.t, fast.qd)
    both = lambda grid: np.concatenate([drive_limits(BASE, grid), restraint(grid)], axis=1)  # noqa: E731
    slowed = timed(drive, SCENE.limits, SCENE.joints, restraint=both)

    def speed(motion, x):
        first = motion.q[:, 0] < motion.q[-1, 0] - 1e-6
        return np.interp(x, motion.q[first, 0], np.abs(motion.qd[first, 0]))

    middle, later = np.linspace(2.0, 4.0, 50), np.linspace(7.5, 11.0, 50)
    np.testing.assert_allclose(speed(slowed, middle), share * speed(fast, middle), rtol=0.02)
    np.testing.assert_allclose(speed(slowed, later), speed(fast, later), rtol=0.02)


def test_a_curve_with_other_control_points_is_about_the_same():
    curve = rolling()
    np.testing.assert_allclose(curve.with_controls(30).even(50), curve.even(50), atol=1e-2)
    np.testing.assert_array_equal(curve.with_controls(30).even(5)[[0, -1], :2], curve.even(5)[[0, -1], :2])


def test_moves_that_lead_nowhere_are_left_out():
    curve = rolling()
    ends = curve.samples[[0, -1]]
    assert [type(part) for part in joined(ends[0], [curve], ends[1]).parts] == [RollingSpline]
    assert [type(part) for part in joined(ends[0] + [0, 0, 0.5], [curve], ends[1]).parts] == [
        StraightMove,
        RollingSpline,
    ]
