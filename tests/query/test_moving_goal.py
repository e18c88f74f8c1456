"""Moving goals: motions end with the velocity that is asked for, within limits, or say why it is not possible."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planned_tasks import assert_within_limits

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError, UnsupportedError
from jackals import jackal

COUNT = 8
SLOWER = 0.95
"""Velocities of goals relative to a time-optimal motion that passes there: at its own, limits leave no other motion."""


def assert_arrives(trajectory: gp.Trajectory, goal: gp.State, scene: gp.Scene) -> None:
    np.testing.assert_allclose(trajectory.q[-1], goal.q, atol=1e-6)
    assert np.all(np.abs(trajectory.qd[-1] - goal.qd) <= 0.01 * scene.limits.velocity)
    dense = trajectory.at(np.linspace(trajectory.t[0], trajectory.t[-1], 2000))
    assert_within_limits(dense, scene)


@settings(max_examples=COUNT, deadline=None)
@given(share=st.floats(0.02, 0.98), back=st.booleans())
def test_motions_end_with_the_velocity_within_limits(
    block: tuple[gp.Task, gp.Trajectory], share: float, back: bool
) -> None:
    """Another motion passes the goal a bit faster, so that it is possible."""
    motion, scene = block[1], block[0].scene
    passed = motion.at(share * motion.duration)
    goal = gp.State(passed.q, SLOWER * passed.qd)
    start = motion.q[-1] if back else motion.q[0]
    result = gp.plan(start, goal, scene, w=0.0, iterations=20)
    trajectory = result.unwrap()
    assert_arrives(trajectory, goal, scene)
    assert np.abs(trajectory.qd[0]).max() < 1e-9
    assert gp.verify(trajectory, scene, start=start, goal=goal).passed


@settings(max_examples=COUNT, deadline=None)
@given(first=st.floats(0.05, 0.95), second=st.floats(0.05, 0.95))
def test_from_a_moving_start_to_a_moving_goal(
    block: tuple[gp.Task, gp.Trajectory], first: float, second: float
) -> None:
    motion, scene = block[1], block[0].scene
    state, passed = motion.at(first * motion.duration), motion.at(second * motion.duration)
    goal = gp.State(passed.q, SLOWER * passed.qd)
    trajectory = gp.plan(state, goal, scene, w=0.0, iterations=20).unwrap()
    assert_arrives(trajectory, goal, scene)
    np.testing.assert_allclose(trajectory.qd[0], state.qd, atol=1e-6)
    assert gp.verify(trajectory, scene, start=state, goal=goal).passed


@pytest.mark.parametrize("refine", [True, False])
def test_a_motion_to_a_moving_goal_is_the_mirror_image_of_one_from_a_moving_start(
    block: tuple[gp.Task, gp.Trajectory], refine: bool
) -> None:
    """Without impact, costs and limits do not depend on the direction of time."""
    (task, motion), scene = block, block[0].scene
    goal = motion.at(0.5 * motion.duration)
    there = gp.plan(task.start, goal, scene, w=0.0, iterations=100, refine=refine).unwrap()
    back = gp.plan(gp.State(goal.q, -goal.qd), task.start, scene, w=0.0, iterations=100, refine=refine).unwrap()
    mirrored = there.reversed()
    assert gp.verify(mirrored, scene, start=gp.State(goal.q, -goal.qd), goal=there.q[0]).passed
    assert gp.verify(back.reversed(), scene, start=back.q[-1], goal=goal).passed
    assert there.path.length == pytest.approx(back.path.length, rel=0.02)
    assert there.duration == pytest.approx(back.duration, rel=0.05)


def test_a_moving_goal_is_used_rather_than_a_stop_before_its_run_in(block: tuple[gp.Task, gp.Trajectory]) -> None:
    """The motion that passes the goal on its way needs no more time up to it."""
    (task, motion), at = block, 0.7 * block[1].duration
    trajectory = gp.plan(task.start, motion.at(at), task.scene, w=0.0, iterations=60).unwrap()
    assert trajectory.duration < 1.1 * at


def test_without_a_velocity_the_result_is_that_of_the_configuration(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, q = block[0], block[1].q[-1]
    one = gp.plan(task.start, q, task.scene, iterations=20).unwrap()
    two = gp.plan(task.start, gp.State(q, np.zeros(7)), task.scene, iterations=20).unwrap()
    np.testing.assert_array_equal(one.q, two.q)
    np.testing.assert_array_equal(one.t, two.t)


def test_where_the_robot_is_already_it_comes_back_with_the_velocity(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, goal = block[0], block[1].at(0.5 * block[1].duration)
    trajectory = gp.plan(goal.q, goal, task.scene, w=0.0, iterations=20).unwrap()
    assert_arrives(trajectory, goal, task.scene)
    assert trajectory.duration > 0.0


def test_from_about_where_the_run_in_begins(block: tuple[gp.Task, gp.Trajectory]) -> None:
    """The path before the run-in is then too short for a motion of its own."""
    scene, goal = block[0].scene, block[1].at(0.5 * block[1].duration)
    braking = 0.5 * float((np.abs(goal.qd) / scene.limits.acceleration).max())
    for off in (0.0, 3e-6, 3e-5):
        start = goal.q - (1.0001 * braking) * goal.qd + off
        assert_arrives(gp.plan(start, goal, scene, w=0.0, iterations=20).unwrap(), goal, scene)


@pytest.mark.parametrize("size", [1e-5, 1e-3, 1.0])
@pytest.mark.parametrize("speed", [1.0, 0.4])
def test_speeds_from_crawling_to_the_limit(block: tuple[gp.Task, gp.Trajectory], size: float, speed: float) -> None:
    task, scene = block[0], block[0].scene
    middle = block[1].at(0.5 * block[1].duration)
    fastest = speed / float((np.abs(middle.qd) / scene.limits.velocity).max())
    goal = gp.State(middle.q, size * fastest * middle.qd)
    result = gp.plan(task.start, goal, scene, speed=speed, w=0.0, iterations=20)
    assert_arrives(result.unwrap(), goal, scene)
    assert np.all(np.abs(result.unwrap().qd) <= speed * scene.limits.velocity * (1.0 + 1e-6))


@pytest.mark.parametrize("joint", [0, 3])
def test_above_a_limit_is_no_goal(block: tuple[gp.Task, gp.Trajectory], joint: int) -> None:
    task, scene = block[0], block[0].scene
    qd = np.zeros(7)
    qd[joint] = -2.0 * scene.limits.velocity[joint]
    result = gp.plan(task.start, gp.State(block[1].q[-1], qd), scene, iterations=5)
    assert result.status is gp.PlanStatus.INVALID_GOAL
    assert scene.joints[joint] in result.detail and "0.5 of the velocity" in result.detail


def test_away_from_a_joint_limit_or_a_wall_is_no_goal(block: tuple[gp.Task, gp.Trajectory]) -> None:
    """The run-in would begin beyond the limit, or in the wall."""
    (task, motion), scene = block, block[0].scene
    goal = motion.at(0.5 * motion.duration)
    q, qd = goal.q.copy(), np.zeros(7)
    q[6], qd[6] = scene.limits.position[6, 0] + 0.01, scene.limits.velocity[6]
    beyond = gp.plan(task.start, gp.State(q, qd), scene, iterations=5)
    assert beyond.status is gp.PlanStatus.INVALID_GOAL and "position_limits" in beyond.detail
    share = float(beyond.detail.split(" of the velocity is possible")[0].split()[-1])
    assert gp.plan(task.start, gp.State(q, share * qd), scene, w=0.0, iterations=20).status is gp.PlanStatus.SOLVED
    assert 0.01 >= 0.5 * (share * qd[6]) ** 2 / scene.limits.acceleration[6] > 0.008
    tool = gp.StateBatch(scene, motion.at(0.5 * motion.duration - 0.06).q[None]).tool_poses[0, :3, 3]
    wall = scene.edit(add=[gp.StaticBody(name="wall", kind="box", size=(0.01, 0.01, 0.01), pose=tool)])
    blocked = gp.plan(task.start, goal, wall, iterations=5)
    assert blocked.status is gp.PlanStatus.INVALID_GOAL and "collision" in blocked.detail


def test_a_goal_beyond_which_no_stop_exists_is_noted(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), scene = block, block[0].scene
    goal = motion.at(0.5 * motion.duration)
    safe = gp.plan(task.start, goal, scene, w=0.0, iterations=20)
    assert "no stop" not in safe.detail
    q, qd = goal.q.copy(), np.zeros(7)
    q[6], qd[6] = scene.limits.position[6, 1] - 0.01, scene.limits.velocity[6]
    result = gp.plan(task.start, gp.State(q, qd), scene, w=0.0, iterations=20)
    assert result.status is gp.PlanStatus.SOLVED and "no stop beyond" in result.detail
    assert_arrives(result.unwrap(), gp.State(q, qd), scene)


def test_a_goal_in_collision_is_told_as_without_a_velocity(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = block
    q = motion.q[-1]
    tool = gp.StateBatch(task.scene, q[None]).tool_poses[0, :3, 3]
    wall = task.scene.edit(add=[gp.StaticBody(name="wall", kind="box", size=(0.01, 0.01, 0.01), pose=tool)])
    at_rest = gp.plan(task.start, q, wall, iterations=5)
    moving = gp.plan(task.start, gp.State(q, 0.1 * np.ones(7)), wall, iterations=5)
    assert at_rest.status is moving.status is gp.PlanStatus.INVALID_GOAL
    assert at_rest.detail == moving.detail


def test_the_judge_checks_the_velocity_at_the_end(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, goal = block[0], block[1].at(0.5 * block[1].duration)
    moving = gp.plan(task.start, goal, task.scene, w=0.0, iterations=20).unwrap()
    resting = gp.plan(task.start, goal.q, task.scene, w=0.0, iterations=20).unwrap()
    assert gp.verify(moving, task.scene, goal=goal).passed
    assert gp.verify(moving, task.scene, goal=goal.q).failures == ("rest",)
    assert gp.verify(moving, task.scene).failures == ("rest",)
    assert gp.verify(resting, task.scene, goal=goal).failures == ("rest",)
    assert gp.verify(moving, task.scene, goal=gp.State(goal.q + 0.01, goal.qd)).failures == ("goal",)


def test_contents_stay_in(coffee: tuple[gp.Task, gp.Trajectory]) -> None:
    task, goal = coffee[0], coffee[1].at(0.2 * coffee[1].duration)
    result = gp.plan(task.start, goal, task.scene, w=0.0, iterations=20)
    assert result.verdict.checks["contents"].passed
    assert_arrives(result.unwrap(), goal, task.scene)


def test_replanning_keeps_the_velocity_at_the_end(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, goal = block[0], block[1].at(0.6 * block[1].duration)
    motion = gp.plan(task.start, goal, task.scene, w=0.0, iterations=20).unwrap()
    at = 0.4 * motion.duration
    kept = gp.replan(motion, task.scene, at=at, w=0.0, iterations=10)
    assert kept.status is gp.PlanStatus.SOLVED
    assert_arrives(motion.spliced(kept.unwrap()), goal, task.scene)
    to_rest = gp.replan(motion, task.scene, at=at, goal=goal.q, w=0.0, iterations=10).unwrap()
    assert np.abs(to_rest.qd[-1]).max() < 1e-9
    slower = gp.State(goal.q, 0.5 * goal.qd)
    assert_arrives(gp.replan(motion, task.scene, at=at, goal=slower, w=0.0, iterations=10).unwrap(), slower, task.scene)
    with pytest.raises(SettingError, match="ends with a velocity"):
        gp.replan(motion, task.scene, at=motion.duration + 1.0, iterations=5)


def test_misuse_raises(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, q, still = block[0], block[1].q[-1], np.zeros(7)
    moving = gp.State(q, 0.1 * np.ones(7))
    with pytest.raises(NonFiniteError, match=r"goal\.qd"):
        gp.plan(task.start, gp.State(q, np.append(still[:6], np.nan)), task.scene)
    with pytest.raises(ShapeError, match=r"goal\.qd"):
        gp.plan(task.start, gp.State(q, still[:6]), task.scene)
    with pytest.raises(ShapeError, match=r"goal\.qd"):
        gp.verify(block[1], task.scene, goal=gp.State(q, still[:6]))
    with pytest.raises(UnsupportedError, match="via"):
        gp.plan(task.start, moving, task.scene, via=[block[1].q[10]], iterations=5)
    with pytest.raises(UnsupportedError, match="only goal"):
        gp.plan(task.start, [moving, q], task.scene, iterations=5)
    with pytest.raises(UnsupportedError, match="mobile bases"):
        gp.plan(np.zeros(3), gp.State(np.array([1.0, 0.0, 0.0]), np.array([0.3, 0.0, 0.0])), jackal(), iterations=5)
