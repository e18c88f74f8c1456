"""Replanning on the way: continuous splices, the present motion kept or left, and stops when there is no way on."""

from __future__ import annotations

import numpy as np
import pytest
from planned_tasks import planned

import graceful_plan as gp
from graceful_plan.exceptions import SettingError


@pytest.fixture(scope="module")
def block() -> tuple[gp.Task, gp.Trajectory]:
    return planned("tabletop", "lift_to_goal", speed=0.6, iterations=60)


def blocked(task: gp.Task, motion: gp.Trajectory, at: float, half: float = 0.02) -> gp.Scene:
    """Return the scene with a box where the tool will be at a time [s]."""
    tool = gp.StateBatch(task.scene, motion.at(np.array([at])).q).tool_poses[0, :3, 3]
    return task.scene.edit(add=[gp.StaticBody(name="post", kind="box", size=(half, half, half), pose=tool)])


def test_the_present_motion_is_kept_unless_another_one_is_better(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, _), at = block, 0.2
    best = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=200).unwrap()
    kept = gp.replan(best, task.scene, at=at, w=0.0, iterations=5)
    assert kept.status is gp.PlanStatus.SOLVED and kept.verdict.passed
    np.testing.assert_allclose(best.spliced(kept.unwrap()).at(0.3).q, best.at(0.3).q, atol=1e-9)
    slow = gp.plan(task.start, task.goal, task.scene, w=0.0, speed=0.2, iterations=40).unwrap()
    better = gp.replan(slow, task.scene, at=0.3, w=0.0, iterations=40).unwrap()
    assert better.t[-1] < slow.t[-1]


def test_a_blocked_motion_is_left_without_a_jump(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), at = block, 0.1 * block[1].duration
    scene = blocked(task, motion, 0.6 * motion.duration)
    assert "collision" in gp.verify(motion, scene).failures
    result = gp.replan(motion, scene, at=at, iterations=60)
    trajectory = result.unwrap()
    assert trajectory.t[0] == at and result.verdict.passed
    assert gp.verify(trajectory, scene, start=motion.at(at), goal=motion.q[-1]).passed
    whole = motion.spliced(trajectory)
    before, after = (whole.at(at + side * 1e-7) for side in (-1.0, 1.0))
    np.testing.assert_allclose(before.qd, after.qd, atol=1e-4)
    assert not set(gp.verify(whole, scene, goal=motion.q[-1]).failures)


def test_another_goal_is_reached(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), at = block, 0.4 * block[1].duration
    trajectory = gp.replan(motion, task.scene, at=at, goal=motion.q[0], iterations=40).unwrap()
    np.testing.assert_allclose(trajectory.q[-1], motion.q[0], atol=1e-9)
    assert gp.verify(trajectory, task.scene, start=motion.at(at)).passed


def test_without_a_way_to_the_goal_the_robot_stops(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), at = block, 0.2 * block[1].duration
    scene = blocked(task, motion, motion.duration, half=0.03)
    result = gp.replan(motion, scene, at=at, iterations=5)
    assert result.status is gp.PlanStatus.INVALID_GOAL and result.verdict.passed
    stop = result.trajectory
    assert stop is not None and np.abs(stop.qd[-1]).max() < 1e-9
    assert gp.verify(stop, scene, start=motion.at(at)).passed


def test_too_late_to_stop_there_is_no_trajectory(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), at = block, 0.5 * block[1].duration
    scene = blocked(task, motion, at + 0.02)
    result = gp.replan(motion, scene, at=at, iterations=5)
    assert result.status is gp.PlanStatus.INVALID_START and result.trajectory is None


def test_contents_that_swing_already_are_taken_into_account() -> None:
    task, motion = planned("desk", "bring_coffee", w=0.0, speed=0.4, iterations=40)
    for share in (0.3, 0.8):
        at = share * motion.duration
        result = gp.replan(motion, task.scene, at=at, w=0.0, iterations=10)
        whole = motion.spliced(result.unwrap())
        assert gp.verify(whole, task.scene, goal=motion.q[-1]).passed


def test_the_same_seed_gives_the_same_motion(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), at = block, 0.3
    scene = blocked(task, motion, 0.6 * motion.duration)
    one, two = (gp.replan(motion, scene, at=at, iterations=20, seed=1).unwrap() for _ in range(2))
    np.testing.assert_array_equal(one.q, two.q)


def test_misuse_raises(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = block
    with pytest.raises(SettingError, match="at"):
        gp.replan(motion, task.scene, at=float("nan"))
    with pytest.raises(SettingError, match="w"):
        gp.replan(motion, task.scene, at=0.1, w=float("nan"))


def test_motions_are_joined_only_where_they_meet(block: tuple[gp.Task, gp.Trajectory]) -> None:
    motion = block[1]
    rest = motion.since(0.3)
    whole = motion.spliced(rest)
    t = np.linspace(0.0, motion.duration, 300)
    for joined, own in zip(whole.at(t)[:2], motion.at(t)[:2], strict=True):
        np.testing.assert_allclose(joined, own, atol=1e-9)
    with pytest.raises(SettingError, match="jump"):
        motion.spliced(rest.later(0.05))
    other = gp.Trajectory(rest.t, rest.q, rest.qd, rest.qdd, tuple("abcdefg"))
    with pytest.raises(SettingError, match="joints"):
        motion.spliced(other)


def test_after_the_end_the_robot_rests(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = block
    result = gp.replan(motion, task.scene, at=motion.duration + 1.0, goal=motion.q[0], iterations=20)
    trajectory = result.unwrap()
    assert trajectory.t[0] == motion.duration + 1.0
    motion.spliced(trajectory)
