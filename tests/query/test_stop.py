"""Stops along a motion: the quickest ones, and those that keep contents."""

from __future__ import annotations

import numpy as np
import pytest
from planned_tasks import planned

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.query.stop import _grid  # pyright: ignore[reportPrivateUsage]


@pytest.fixture(scope="module")
def book() -> tuple[gp.Task, gp.Trajectory]:
    return planned("desk", "put_book_away", w=0.0, iterations=40)


@pytest.fixture(scope="module")
def coffee() -> tuple[gp.Task, gp.Trajectory]:
    return planned("desk", "bring_coffee", w=0.0, iterations=40)


def test_one_joint_brakes_at_its_limit(book: tuple[gp.Task, gp.Trajectory]) -> None:
    scene, q = book[0].scene, book[0].start
    motion = gp.retime(gp.Path(np.stack([q, q + 0.5 * np.eye(7)[6]])), scene.limits, scene.joints)
    at = 0.5 * motion.duration
    stop = gp.plan_stop(motion, scene, at=at, constraints=[]).unwrap()
    braking = np.abs(motion.at(at).qd[6]) / scene.limits.acceleration[6]
    assert braking <= stop.duration <= 1.05 * braking


def test_stops_begin_as_the_motion_goes_on_and_follow_its_path(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = book
    everywhere = motion.at(np.linspace(motion.t[0], motion.t[-1], 4000)).q
    for at in np.linspace(0.1, 0.9, 5) * motion.duration:
        result = gp.plan_stop(motion, task.scene, at=at)
        stop, before = result.unwrap(), motion.at(float(at))
        np.testing.assert_allclose(stop.q[0], before.q, atol=1e-9)
        np.testing.assert_allclose(stop.qd[0], before.qd, atol=1e-9)
        assert stop.t[0] == at and np.abs(stop.qd[-1]).max() < 1e-12 and result.verdict.passed
        assert stop.duration < motion.t[-1] - at + 1e-9
        q = stop.at(np.linspace(stop.t[0], stop.t[-1], 50)).q
        assert np.linalg.norm(q[:, None] - everywhere, axis=2).min(axis=1).max() < 2e-3
        acceleration = stop.piece_accelerations[0] / task.scene.limits.acceleration
        assert np.abs(acceleration).max() < 1.0 + 1e-6


def test_contents_stay_in_where_the_quickest_stop_spills(coffee: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = coffee
    at = 0.4 * motion.duration
    careful = gp.plan_stop(motion, task.scene, at=at)
    quick = gp.plan_stop(motion, task.scene, at=at, constraints=[]).unwrap()
    assert careful.unwrap().duration > quick.duration
    assert careful.verdict.checks["contents"].passed
    before = motion.t < at
    whole = gp.Trajectory(
        *(np.concatenate([getattr(motion, x)[before], getattr(quick, x)]) for x in ("t", "q", "qd", "qdd")),
        motion.joints,
    )
    assert "contents" in gp.verify(whole, task.scene).failures


def test_at_rest_there_is_nothing_to_stop(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = book
    after = gp.plan_stop(motion, task.scene, at=motion.t[-1] + 1.0).unwrap()
    np.testing.assert_array_equal(after.q, motion.q[-1:])
    for at in (motion.t[0] - 1.0, motion.t[0]):  # the robot has not begun to move, and need not
        before = gp.plan_stop(motion, task.scene, at=float(at)).unwrap()
        np.testing.assert_array_equal(before.q, motion.q[:1])
        assert before.duration == 0.0 and before.t[0] == at


def test_a_motion_that_begins_at_speed_can_be_stopped_at_once(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = book
    rest = motion.since(0.4 * motion.duration)
    stop = gp.plan_stop(rest, task.scene, at=float(rest.t[0])).unwrap()
    np.testing.assert_allclose(stop.qd[0], rest.qd[0], atol=1e-9)
    assert stop.duration < 0.8 * rest.duration


def test_in_a_scene_that_has_changed_the_stop_may_collide(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = book
    at = 0.3 * motion.duration
    tool = gp.StateBatch(task.scene, motion.at(at + 0.05).q[None]).object_poses[0, :3, 3]
    blocked = task.scene.edit(add=[gp.StaticBody(name="post", kind="box", size=(0.02, 0.02, 0.02), pose=tool)])
    result = gp.plan_stop(motion, blocked, at=at)
    assert result.status is gp.PlanStatus.INFEASIBLE and "collision" in result.detail


@pytest.mark.parametrize("at", [float("nan"), float("inf")])
def test_times_that_are_none_are_refused(book: tuple[gp.Task, gp.Trajectory], at: float) -> None:
    with pytest.raises(SettingError, match="at"):
        gp.plan_stop(book[1], book[0].scene, at=at)


def test_grids_have_no_steps_within_rounding(book: tuple[gp.Task, gp.Trajectory]) -> None:
    """By rounding, the beginning of a stop plus the rest of the motion may end just after the motion's last sample."""
    _, motion = book
    for end in motion.t[-20:]:
        for at in (0.1 * end, 0.4 * end):
            for last in (end, np.nextafter(end, np.inf), end + 1e-12):
                grid = _grid(motion, at, last - at)
                assert np.diff(grid.s).min() > 1e-7
