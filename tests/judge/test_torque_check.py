"""The check of joint torques, against MuJoCo's inverse dynamics and in closed form."""

import numpy as np
import pytest
from torque_arms import HOLDS, lifter, odd_arm, states

import graceful_plan as gp
from graceful_plan.judge.torque_check import joint_torques, torque_check
from graceful_plan.timing.dynamics import RobotDynamics


@pytest.mark.parametrize(
    ("gravcomp", "drives"), [("", ""), ('gravcomp=".7"', ""), ('gravcomp="1"', 'actuatorgravcomp="true"')]
)
def test_torques_of_an_odd_arm_are_those_of_mujoco(gravcomp, drives):
    scene = odd_arm(gravcomp, drives)
    given = states(scene, 20)
    inverse = RobotDynamics(scene)
    expected = [inverse(*state) for state in zip(*given, strict=True)]
    np.testing.assert_allclose(joint_torques(*given, scene), expected, atol=1e-9)


@pytest.mark.parametrize("name", ["tabletop", "dining_table"])
def test_torques_with_a_carried_object_are_those_of_mujoco(name):
    scene = next(iter(gp.load_scene(name).tasks.values())).scene
    given = states(scene, 10, seed=1)
    inverse = RobotDynamics(scene)
    expected = [inverse(*state) for state in zip(*given, strict=True)]
    np.testing.assert_allclose(joint_torques(*given, scene), expected, atol=1e-8)


def test_a_payload_beyond_the_torque_is_warned_about_with_joint_ratio_and_time():
    scene = lifter(40.0)
    result = gp.plan([-0.6], [0.6], scene, w=0.0, iterations=2)
    assert result.status is gp.PlanStatus.SOLVED
    assert result.verdict.passed and "torque" in result.verdict.warnings
    check = result.verdict.checks["torque"]
    assert check.worst == pytest.approx(HOLDS / 40.0, rel=0.05)
    assert "'arm/turn'" in check.detail and "torque" in result.detail
    assert check.first == 0.0  # cos(0.6) of it is too much, too


def test_enough_torque_passes_and_none_is_not_checked():
    enough = gp.plan([-0.6], [0.6], lifter(1.1 * HOLDS), w=0.0, iterations=2)
    assert enough.verdict.checks["torque"].passed and not enough.verdict.warnings
    unlimited = gp.plan([-0.6], [0.6], lifter(None), w=0.0, iterations=2)
    assert "torque" not in unlimited.verdict.checks


def test_a_trajectory_at_rest_is_checked_too():
    scene, still = lifter(40.0), np.zeros((2, 1))
    assert not torque_check(gp.Trajectory(np.array([0.0, 1.0]), still, still, still, scene.joints), scene).passed
    assert not torque_check(gp.Trajectory(np.zeros(1), still[:1], still[:1], still[:1], scene.joints), scene).passed
    assert not torque_check(gp.Path(np.array([[-0.1], [0.1]])), scene).passed


def test_fast_motions_need_more_torque_than_slow_ones():
    scene = lifter(40.0, velocity=3.0, acceleration=30.0)
    path = gp.Path(np.array([[-0.6], [0.6]]))
    fast, slow = (torque_check(gp.retime(path, scene.limits, scene.joints, speed=s), scene).worst for s in (1.0, 0.2))
    assert fast > slow


@pytest.mark.long
@pytest.mark.parametrize(("name", "task"), [("tabletop", "green_to_blue"), ("dining_table", "pass_bottle")])
def test_plans_of_bundled_tasks_stay_within_the_torques(name, task):
    task = gp.load_scene(name).tasks[task]
    assert np.isfinite(task.scene.limits.torque).any()
    result = gp.plan(task.start, task.goal, task.scene, iterations=3)
    assert result.verdict.warnings == (), result.detail
