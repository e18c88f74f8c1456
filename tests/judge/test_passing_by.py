"""The judge of those who walk past, against distances in closed form."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.passing_by import passing_check
from hall import hall

SCENE = hall(extra="").edit(remove=["person", "pillar"])


def straight(speed=1.0, length=4.0):
    n = 41
    t = np.linspace(0.0, length / speed, n)
    q = np.zeros((n, 3))
    q[:, 0] = speed * t
    return gp.Trajectory(t, q, np.tile([speed, 0.0, 0.0], (n, 1)), np.zeros((n, 3)), SCENE.joints)


def at(position, t=None, **given):
    t = [0.0] if t is None else t
    return SCENE.with_moving(gp.MovingEntity("ann", "adult", size=[0.25, 0.85], t=t, position=position, **given))


def test_the_least_clearance_is_that_of_the_closed_form():
    check = passing_check(straight(), at([[2.0, 0.8, 0.85]]))
    assert check.passed
    assert check.worst == pytest.approx(0.8 - 0.25 - (0.1878 + 0.02), abs=2e-3)


def test_who_is_driven_into_is_named_with_the_moment():
    check = passing_check(straight(), at([[3.0, 0.0, 0.85]]))
    assert not check.passed and "'ann'" in check.detail
    assert check.first == pytest.approx(3.0 - 0.25 - (0.131 + 0.098), abs=0.05)


def test_who_has_left_before_or_comes_later_is_not_met():
    times = [0.0, 1.0, 2.0, 4.0]
    gone = [[2.0, 0.0, 0.85], [2.0, 0.0, 0.85], [2.0, 1.9, 0.85], [2.0, 1.9, 0.85]]
    assert passing_check(straight(), at(gone, times)).passed
    assert not passing_check(straight(), at(gone[::-1], times)).passed


def test_a_base_that_stands_drives_into_nobody():
    still = gp.Trajectory(np.array([0.0, 5.0]), np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)), SCENE.joints)
    assert passing_check(still, at([[0.0, -2.0, 0.85], [0.0, 2.0, 0.85]], [0.0, 5.0])).passed


def test_who_is_beside_is_met_by_the_corners_of_a_base_that_turns_in_place():
    t = np.linspace(0.0, 2.0, 41)
    q = np.column_stack([np.zeros((41, 2)), t])
    turning = gp.Trajectory(t, q, np.tile([0.0, 0.0, 1.0], (41, 1)), np.zeros((41, 3)), SCENE.joints)
    beside = at([[0.0, 0.49, 0.85]])  # 3 cm from the wheels of a base that stands as it begins
    assert not passing_check(turning, beside).passed
    assert passing_check(turning, at([[0.0, 0.7, 0.85]])).passed


def test_verdicts_have_it_for_bases_among_those_who_move_alone():
    trajectory = straight()
    assert "passing_by" not in gp.verify(trajectory, SCENE).checks
    assert "passing_by" in gp.verify(trajectory, at([[2.0, 0.8, 0.85]])).checks
