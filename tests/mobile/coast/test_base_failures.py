"""Stopping distances against integration in time, and the four-wheel model against closed forms and MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest
from coast_twin import stopping_distances
from hypothesis import given
from hypothesis import strategies as st

from failbench.mobile.coasting import BaseFailure, coasting
from failbench.mobile.following import within_reach
from failbench.mobile.wheeled import wheeled
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.four_wheel import Case, integrated, one_sided_trajectories
from graceful_plan.mobile.coast.steering import FASTER, MOTORS, TICK, OneSideSteering, reference_motion
from graceful_plan.mobile.coast.tables import coast_tables
from graceful_plan.mobile.control.diff_drive_controller import Tracking
from graceful_plan.mobile.control.drive_state import DriveState
from hall import hall
from jackals import jackal

BODY = coast_tables(hall()).body


@pytest.mark.parametrize(("v", "a", "k"), [(2.0, 0.5, 0.4), (1.0, 1.2, 0.0), (0.3, 0.4, 2.0)])
def test_rolling_equals_integration(v, a, k):
    dt, speed, far = 1e-4, v, 0.0
    while speed > 0.0:
        far += speed * dt
        speed -= (a + k * speed) * dt
    _, braked = stopping_distances(v, np.array([[1.0, a, k, 0.0, 0.0, 0.0]]))
    assert braked[0] == pytest.approx(far, rel=2e-3)


def case(held, *, delay=10.0, left=True, friction=0.6):
    return Case(left, held, np.array(friction), np.array(0.8), np.array(0.4), delay=np.array(delay), brakes=1.5)


def test_a_blocked_side_spins_a_skid_steer_at_the_rate_of_its_slip():
    places = integrated(BODY, np.array(1.0), np.array(0.0), case(True, delay=3.0))
    rate = np.gradient(places[:, 2], places[:, 4])[140]  # in steps of 0.02 s; long before the other side stops
    assert rate == pytest.approx(1.0 / (BODY.base.slip * BODY.base.track), rel=0.1)


def test_two_wheels_pivot_about_the_one_that_is_held():
    body = replace(BODY, base=replace(BODY.base, slip=1.0))
    places = integrated(body, np.array(0.5), np.array(0.0), case(True, delay=3.0))
    x, y = places[100:140, 0], places[100:140, 1]
    turned = places[100:140, 2]
    radius = np.hypot(np.diff(x), np.diff(y)).sum() / (turned[-1] - turned[0])
    assert radius == pytest.approx(0.5 * body.base.track, rel=0.1)


def test_left_and_right_are_mirror_images_and_rest_stays_rest():
    straight = BODY.__class__(base=BODY.base, mass=18.0, gyration=0.17, centre=(0.0, 0.0))
    left, right = (integrated(straight, np.array(1.0), np.array(0.3 * s), case(True, left=s > 0)) for s in (1, -1))
    np.testing.assert_allclose(left * [1, -1, -1, 1, 1], right, atol=1e-9)
    assert np.abs(integrated(straight, np.array(0.0), np.array(0.0), case(False))[:, :4]).max() < 1e-12


def test_a_jackals_wheels_are_behind_its_pivot_and_its_mass_ahead_of_them():
    body = coast_tables(jackal()).body
    assert body.middle == pytest.approx((-0.035, 0.0)) and body.middle[0] < body.centre[0] < 0.0


@pytest.mark.parametrize("v, omega", [(2.0, 0.0), (1.0, 1.0)])
def test_a_continuing_controller_oscillates_as_in_mujoco(v, omega):
    scene = jackal()
    wheels, body = wheeled(scene), coast_tables(scene).body
    failure = BaseFailure("side_locked", 5.9, 0.0, 2.0, left=True, steered=True)
    states = coasting(wheels, np.zeros(3), np.array([v, 0.0, omega]), failure, 2.0)
    poses = np.array([wheels.pose(data) for data, _ in states])[::10]
    locked = Case(True, True, np.array(5.9 / 9.81), np.array(0.8), np.array(0.4), np.array(2.0), 1.5, np.array(True))
    (found,) = integrated(body, np.array([v]), np.array([omega]), locked)[:, : len(poses)]
    np.testing.assert_allclose(found[:, :2], poses[:, :2], atol=0.12)
    # The steering limits the pivoting, which alone would turn the base around.
    (alone,) = integrated(body, np.array([v]), np.array([omega]), locked._replace(steered=np.array(False)))
    assert found[:, 2].max() < 2.8 and found[-1, 2] < found[:, 2].max() - 0.1 and alone[:, 2].max() > 4.0


@given(st.floats(-2.0, 2.0), st.floats(0.0, 4.0))
def test_a_motion_that_goes_on_gets_as_fast_as_it_may_be(v, time):
    base = BODY.base
    (far,), (speed,) = reference_motion(base, np.array([v]), time)
    later = np.linspace(0.0, time, 4001)
    fast = np.minimum(abs(v) + base.a_max * later, max(base.v_max, abs(v)))
    assert far == pytest.approx(np.sign(v) * np.trapezoid(fast, later), abs=1e-5)
    assert speed == pytest.approx(np.sign(v) * fast[-1], abs=1e-9)


@pytest.mark.parametrize("held", [True, False])
def test_failing_bases_move_as_in_mujoco(held):
    scene = jackal()
    wheels = wheeled(scene)
    failure = BaseFailure("side_locked" if held else "side_dead", 5.4 if held else 0.8, 0.4, 0.25, left=True)
    q, qd = np.zeros(3), np.array([1.5, 0.0, 0.5])
    poses = np.array([wheels.pose(data) for data, _ in coasting(wheels, q, qd, failure, 3.0)])
    body = coast_tables(scene).body
    found = integrated(body, np.array(1.5), np.array(0.5), case(held, delay=0.25, friction=5.4 / 9.81 if held else 0.6))
    np.testing.assert_allclose(found[-1, :2], poses[-1, :2], atol=0.15)


def test_tables_share_out_the_probability_and_are_made_once():
    ways = one_sided_trajectories(BODY, CoastSettings.shipped())
    settings = CoastSettings.shipped()
    weights = {name: way.weight for name, way in settings.ways.items()}
    total = sum(weights.values()) + settings.astray.weight + settings.weak.weight
    each = (1.0 - settings.harmless) / total
    share = each * (weights["side_locked"] + weights["side_dead"])
    assert ways.share.sum() == pytest.approx(share)
    others = 1.0 - settings.harmless - share - each * (settings.astray.weight + settings.weak.weight)
    assert settings.unable_to_turn()[:, 0].sum() == pytest.approx(each * settings.weak.weight * settings.weak.lasts)
    assert len(settings.only("runaway").unable_to_turn()) == 0
    assert settings.stops()[:, 0].sum() == pytest.approx(others)
    lasts = settings.beside(BODY.base)[:, 0].sum()
    assert lasts == pytest.approx(each * settings.astray.weight * settings.astray.lasts)
    assert len(settings.only("runaway").beside(BODY.base)) == 0
    assert settings.only("runaway").stops()[:, 0].sum() == pytest.approx(1.0)
    assert one_sided_trajectories(BODY, settings) is ways
    assert len(one_sided_trajectories(BODY, settings.only("runaway")).share) == 0


def test_continued_steering_equals_the_tracking_controller_and_its_motors():
    base, rng = BODY.base, np.random.default_rng(0)
    for _ in range(20):
        v, omega = rng.uniform(0.0, 2.0), rng.uniform(-2.0, 2.0)
        steers, follows, summed, told = OneSideSteering(base, np.array([v]), np.array([omega])), Tracking(), 0.0, None
        for tick in range(3):
            (x, y, turned, rate), rims = rng.normal(0.0, 0.3, 4), rng.uniform(-2.0, 2.0, 2)
            t = tick * TICK
            way = omega * t
            # The target continues with this turning rate, at the greatest speed of the base.
            later, whole = np.linspace(0.0, t, 1001), np.minimum(v + base.a_max * np.linspace(0.0, t, 1001), base.v_max)
            chord = np.trapezoid(whole, later) * np.sinc(0.5 * way / np.pi)
            wanted = DriveState(chord * np.cos(0.5 * way), chord * np.sin(0.5 * way), way, whole[-1], omega)
            state = DriveState(x, y, turned, v, rate)
            command = follows.command(state, wanted)
            summed = follows.summed(summed, command, state, TICK)
            before = (np.array([-1.0, 1.0]) * base.lever * omega + v) / base.radius if told is None else told
            held = follows.held(command, state, summed)
            held = within_reach(held, before, rims / base.radius, base, MOTORS * base.a_max * TICK)
            told = (held.v + np.array([-1.0, 1.0]) * base.lever * held.omega) / base.radius
            told = np.clip(told, -FASTER * base.rim_max / base.radius, FASTER * base.rim_max / base.radius)
            pose, two = tuple(np.array([p]) for p in (x, y, turned)), tuple(np.array([rim]) for rim in rims)
            found = steers.tell(t, pose, np.array([rate]), two)
            np.testing.assert_allclose(np.concatenate(found), base.radius * told, atol=1e-9)
