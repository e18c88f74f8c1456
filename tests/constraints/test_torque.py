"""The constraint on joint torques, in searches, timing and the judge."""

import numpy as np
import pytest
from torque_arms import HOLDS, lifter, odd_arm, states

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnsupportedError


def test_a_posture_that_cannot_be_held_is_refused_as_start_and_as_goal():
    scene = lifter(40.0)
    start = gp.plan([0.0], [1.5], scene, w=0.0, constraints=[gp.TorqueWithin()], iterations=10)
    assert start.status is gp.PlanStatus.INVALID_START and "TorqueWithin" in start.detail
    goal = gp.plan([1.5], [0.0], scene, w=0.0, constraints=[gp.TorqueWithin()], iterations=10)
    assert goal.status is gp.PlanStatus.INVALID_GOAL


def test_timing_slows_down_to_the_torques_and_the_judge_agrees():
    path = [[-0.6], [0.6]]
    scene = lifter(1.3 * HOLDS, velocity=3.0, acceleration=30.0)
    free = gp.plan(*path, scene, w=0.0, iterations=10)
    assert "torque" in free.verdict.warnings
    held = gp.plan(*path, scene, w=0.0, constraints=[gp.TorqueWithin()], iterations=10)
    assert held.status is gp.PlanStatus.SOLVED, held.detail
    assert held.verdict.checks["torque_within"].passed and not held.verdict.warnings
    assert free.trajectory.duration < held.trajectory.duration < 4.0 * free.trajectory.duration
    gentle = gp.plan(*path, scene, w=0.0, constraints=[gp.TorqueWithin(0.9)], iterations=10)
    assert gentle.trajectory.duration > held.trajectory.duration


def test_the_judge_fails_a_motion_beyond_the_share():
    scene = odd_arm(torque=[500.0] * 5)
    motion = gp.retime(gp.Path(states(scene, 2)[0]), scene.limits, scene.joints)
    worst = gp.verify(motion, scene).checks["torque"].worst
    for share, passed in ((0.95 * worst, False), (min(1.0, 1.05 * worst), True)):
        verdict = gp.verify(motion, scene, constraints=[gp.TorqueWithin(share)])
        assert verdict.checks["torque_within"].passed == passed


def test_a_scene_without_torque_limits_is_refused_by_name():
    with pytest.raises(UnsupportedError, match="TorqueWithin"):
        gp.plan([0.0], [0.5], lifter(None), constraints=[gp.TorqueWithin()])
    for share in (0.0, 1.5, np.nan):
        with pytest.raises(SettingError, match="share"):
            gp.TorqueWithin(share)
