"""Shortest curves of a steered base: against OMPL, and laws of all curves."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError
from graceful_plan.mobile.floor.reeds_shepp import Steering, shortest_curves

CAR = Steering(radius=0.7)
AHEAD = Steering(radius=0.7, reverse=False)
BASE = Steering(radius=0.7, yaw_length=0.3)
EVERY = [
    CAR,
    AHEAD,
    BASE,
    Steering(radius=0.7, reverse=False, yaw_length=0.3),
    Steering(radius=0.7, reverse_penalty=3.0),
]

_TOLERANCE = 1e-6  # of lengths, the target against OMPL; both compute in double precision
poses = st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(-math.pi, math.pi)).map(np.array)


def random_poses(n, seed=0):
    return np.random.default_rng(seed).uniform([-4, -4, -math.pi], [4, 4, math.pi], (n, 3))


def ends(curves):
    return curves.at(curves.measure.sum(axis=-1, keepdims=True))[..., 0, :]


def off(a, b):
    turn = (a[..., 2] - b[..., 2] + math.pi) % (2 * math.pi) - math.pi
    return np.abs(np.concatenate([a[..., :2] - b[..., :2], turn[..., None]], axis=-1)).max()


def of_ompl(space, a, b):
    states = [space.allocState() for _ in range(2)]
    lengths = []
    for pair in zip(a, b, strict=True):
        for state, (x, y, yaw) in zip(states, pair, strict=True):
            state.setXY(float(x), float(y))
            state.setYaw(float(yaw))
        lengths.append(space.distance(*states))
    return np.array(lengths)


@pytest.mark.parametrize("n", [2_000, pytest.param(100_000, marks=pytest.mark.long)])
@pytest.mark.parametrize("steering", [CAR, AHEAD], ids=["Reeds-Shepp", "Dubins"])
def test_lengths_equal_those_of_ompl(steering, n):
    from ompl import base as ob

    space = (ob.ReedsSheppStateSpace if steering.reverse else ob.DubinsStateSpace)(steering.radius)
    a, b = random_poses(n), random_poses(n, 1)
    b[: n // 4, :2] = a[: n // 4, :2] + 0.2 * b[: n // 4, :2]  # near each other there are many words
    ours = shortest_curves(a, b, steering).cost
    assert np.abs(ours - of_ompl(space, a, b)).max() < _TOLERANCE


@pytest.mark.parametrize("steering", EVERY, ids=str)
def test_curves_end_at_the_goal_and_bend_no_tighter_than_the_radius(steering):
    a, b = random_poses(5_000, 2), random_poses(5_000, 3)
    curves = shortest_curves(a, b, steering)
    assert off(ends(curves), b) < 1e-8
    assert np.abs(curves.pieces[..., 1]).max() <= 1 / steering.radius + 1e-12
    assert steering.reverse or curves.pieces[..., 0].min() >= 0
    assert steering.yaw_length is not None or not curves.pieces[..., 2].any()
    assert (curves.cost >= np.hypot(*(b - a)[:, :2].T) - 1e-9).all()


@given(poses, poses)
def test_there_and_back_is_as_long(a, b):
    for steering in (CAR, BASE):
        there, back = shortest_curves(a, b, steering).cost, shortest_curves(b, a, steering).cost
        assert there == pytest.approx(back, abs=1e-6)


@given(poses, poses, poses)
def test_a_detour_is_not_shorter(a, b, c):
    for steering in (CAR, AHEAD):
        direct = shortest_curves(a, c, steering).cost
        # At some goals, rounding makes Dubins' curves longer by whole circles.
        near = shortest_curves(a, c + [0, 0, 1e-7], steering).cost, shortest_curves(a, c - [0, 0, 1e-7], steering).cost
        detour = shortest_curves(a, b, steering).cost + shortest_curves(b, c, steering).cost
        assert min(direct, *near) <= detour + 1e-5


@given(poses, poses, poses)
def test_lengths_do_not_depend_on_the_frame(a, b, frame):
    c, s = math.cos(frame[2]), math.sin(frame[2])
    turned = [np.array([*(frame[:2] + [c * q[0] - s * q[1], s * q[0] + c * q[1]]), q[2] + frame[2]]) for q in (a, b)]
    for steering in (CAR, BASE):
        length = shortest_curves(a, b, steering).cost
        assert shortest_curves(*turned, steering).cost == pytest.approx(length, abs=1e-6)


def test_known_curves():
    start = [0, 0, 0]
    assert shortest_curves(start, [3, 0, 0], CAR).cost == pytest.approx(3)
    assert shortest_curves(start, [-3, 0, 0], CAR).cost == pytest.approx(3)
    assert shortest_curves(start, [0.7, 0.7, math.pi / 2], CAR).cost == pytest.approx(0.7 * math.pi / 2)
    assert shortest_curves(start, [0, 0, math.pi / 2], BASE).cost == pytest.approx(0.3 * math.pi / 2)
    assert shortest_curves(start, [0, 2, 0], BASE).cost == pytest.approx(2 + 0.3 * math.pi)
    assert shortest_curves(start, start, AHEAD).cost == 0
    assert shortest_curves(start, [-3, 0, 0], Steering(radius=0.7, reverse_penalty=2.0)).cost == pytest.approx(6)


@given(poses, poses, st.floats(1.0, 5.0))
def test_a_penalty_makes_no_curve_cheaper_and_none_dearer_than_that_of_the_shortest(a, b, penalty):
    dear = Steering(radius=0.7, reverse_penalty=penalty)
    least = shortest_curves(a, b, CAR).cost
    cost = shortest_curves(a, b, dear).cost
    assert least - 1e-9 <= cost <= penalty * least + 1e-9


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches(batch):
    a, b = random_poses(6)[: math.prod(batch)].reshape(*batch, 3), np.array([1.0, 2.0, 0.3])
    curves = shortest_curves(a, b, CAR)
    assert curves.cost.shape == batch
    assert curves.at([0.0, 0.5]).shape == (*batch, 2, 3)
    np.testing.assert_allclose(curves.at([0.0])[..., 0, :], a)


def test_samples_are_near_each_other_and_hit_the_ends():
    curve = shortest_curves([0, 0, 0], [1, 2, 3], BASE)
    at = curve.sampled(0.05)
    assert np.hypot(*np.diff(at[:, :2], axis=0).T).max() <= 0.05 + 1e-12
    np.testing.assert_allclose(at[0], [0, 0, 0], atol=1e-12)
    assert off(at[-1], np.array([1.0, 2.0, 3.0])) < 1e-9


def test_misuse():
    for settings in ({"radius": 0.0}, {"radius": 1.0, "yaw_length": -1.0}, {"radius": 1.0, "reverse_penalty": 0.5}):
        with pytest.raises(SettingError, match=r"Steering\."):
            Steering(**settings)
    with pytest.raises(ShapeError, match="goal"):
        shortest_curves([0, 0, 0], [0, 0], CAR)
    with pytest.raises(NonFiniteError, match="start"):
        shortest_curves([0, 0, math.nan], [0, 0, 0], CAR)
    with pytest.raises(ShapeError, match="start"):
        shortest_curves(random_poses(2), [0, 0, 0], CAR).sampled(0.1)
