"""Moving starts: motions continue the present velocity, within limits, and say when the robot cannot stop."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planned_tasks import assert_within_limits

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.exceptions import NonFiniteError, RetimingError, SettingError, ShapeError
from graceful_plan.query.endpoints.moving_start import find_start

COUNT = 8


def assert_continues(trajectory: gp.Trajectory, state: gp.State, scene: gp.Scene) -> None:
    np.testing.assert_allclose(trajectory.q[0], state.q, atol=1e-9)
    np.testing.assert_allclose(trajectory.qd[0], state.qd, atol=1e-6)
    dense = trajectory.at(np.linspace(0.0, trajectory.duration, 2000))
    assert_within_limits(dense, scene)
    assert np.abs(trajectory.qd[-1]).max() < 1e-9
    # Positions belong to the velocities: a trapezoidal sum reproduces them.
    dt = np.diff(np.linspace(0.0, trajectory.duration, 2000))[:, None]
    travelled = np.cumsum(0.5 * dt * (dense.qd[1:] + dense.qd[:-1]), axis=0)
    np.testing.assert_allclose(dense.q[0] + travelled, dense.q[1:], atol=1e-4)


@settings(max_examples=COUNT, deadline=None)
@given(share=st.floats(0.02, 0.98), back=st.booleans())
def test_motions_continue_the_velocity_within_limits(
    block: tuple[gp.Task, gp.Trajectory], share: float, back: bool
) -> None:
    motion, scene = block[1], block[0].scene
    state = motion.at(share * motion.duration)
    goal = motion.q[0] if back else motion.q[-1]
    result = gp.plan(state, goal, scene, w=0.0, iterations=20)
    trajectory = result.unwrap()
    assert_continues(trajectory, state, scene)
    np.testing.assert_allclose(trajectory.q[-1], goal, atol=1e-6)  # the tolerance of the judge
    assert gp.verify(trajectory, scene, start=state, goal=goal).passed
    assert result.verdict.checks["rest"].passed


@pytest.mark.parametrize("refine", [True, False])
def test_a_moving_start_is_used_rather_than_stopped_at(block: tuple[gp.Task, gp.Trajectory], refine: bool) -> None:
    (task, motion), at = block, 0.3 * block[1].duration
    onward = gp.plan(motion.at(at), task.goal, task.scene, w=0.0, iterations=40, refine=refine).unwrap()
    stop = gp.plan_stop(motion, task.scene, at=at).unwrap()
    after = gp.plan(stop.q[-1], task.goal, task.scene, w=0.0, iterations=40, refine=refine).unwrap()
    assert onward.duration < stop.duration + after.duration


def test_without_a_velocity_the_result_is_that_of_the_configuration(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, q = block[0], np.asarray(block[0].start)
    given_q = gp.plan(q, task.goal, task.scene, iterations=20)
    given_state = gp.plan(gp.State(q, np.zeros(7)), task.goal, task.scene, iterations=20)
    np.testing.assert_array_equal(given_q.unwrap().q, given_state.unwrap().q)
    np.testing.assert_array_equal(given_q.unwrap().t, given_state.unwrap().t)


def test_the_same_seed_gives_the_same_motion(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), state = block, block[1].at(0.2)
    one, two = (gp.plan(state, task.start, task.scene, iterations=20, seed=3).unwrap() for _ in range(2))
    np.testing.assert_array_equal(one.q, two.q)
    assert motion.joints == one.joints


def test_at_the_goal_and_moving_the_robot_comes_back(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, state = block[0], block[1].at(0.4 * block[1].duration)
    trajectory = gp.plan(state, state.q, task.scene, w=0.0, iterations=20).unwrap()
    assert_continues(trajectory, state, task.scene)
    np.testing.assert_allclose(trajectory.q[-1], state.q, atol=1e-9)
    assert trajectory.duration > 0.0


@pytest.mark.parametrize("size", [1e-5, 1e-3, 1.0])
def test_speeds_from_crawling_to_the_limit(block: tuple[gp.Task, gp.Trajectory], size: float) -> None:
    task, scene = block[0], block[0].scene
    q = block[1].at(0.5 * block[1].duration).q
    qd = np.zeros(7)
    qd[6] = size * scene.limits.velocity[6]
    state = gp.State(q, qd)
    assert_continues(gp.plan(state, task.start, scene, w=0.0, iterations=20).unwrap(), state, scene)


@pytest.mark.parametrize("joint", [0, 3])
def test_above_a_limit_is_no_start(block: tuple[gp.Task, gp.Trajectory], joint: int) -> None:
    task, scene = block[0], block[0].scene
    qd = np.zeros(7)
    qd[joint] = 1.01 * scene.limits.velocity[joint]
    result = gp.plan(gp.State(block[1].q[0], qd), task.goal, scene, iterations=5)
    assert result.status is gp.PlanStatus.INVALID_START and scene.joints[joint] in result.detail
    slower = gp.plan(gp.State(block[1].q[0], 0.6 * qd), task.goal, scene, speed=0.5, iterations=5)
    assert slower.status is gp.PlanStatus.INVALID_START


def test_towards_a_joint_limit_or_a_wall_is_no_start(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), scene = block, block[0].scene
    state = motion.at(0.5 * motion.duration)
    q, qd = state.q.copy(), np.zeros(7)
    q[6], qd[6] = scene.limits.position[6, 1] - 0.01, scene.limits.velocity[6]
    beyond = gp.plan(gp.State(q, qd), task.goal, scene, iterations=5)
    assert beyond.status is gp.PlanStatus.INVALID_START and "position_limits" in beyond.detail
    tool = gp.StateBatch(scene, motion.at(0.5 * motion.duration + 0.06).q[None]).tool_poses[0, :3, 3]
    wall = scene.edit(add=[gp.StaticBody(name="wall", kind="box", size=(0.01, 0.01, 0.01), pose=tool)])
    blocked = gp.plan(state, task.start, wall, iterations=5)
    assert blocked.status is gp.PlanStatus.INVALID_START and "collision" in blocked.detail


def test_misuse_raises(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, q, still = block[0], block[1].q[0], np.zeros(7)
    with pytest.raises(NonFiniteError, match=r"start\.qd"):
        gp.plan(gp.State(q, np.append(still[:6], np.nan)), task.goal, task.scene)
    with pytest.raises(ShapeError, match=r"start\.qd"):
        gp.plan(gp.State(q, still[:6]), task.goal, task.scene)
    with pytest.raises(ShapeError, match=r"start\.q"):
        gp.plan(block[1].at(np.array([0.1, 0.2])), task.goal, task.scene)
    with pytest.raises(ShapeError, match=r"start\.qd"):
        gp.verify(block[1], task.scene, start=gp.State(q, still[:5]))


def test_a_moving_robot_cannot_wait(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task = block[0]
    comer = gp.MovingEntity(
        "person", "adult", size=[0.2, 0.85], t=[0.0, 3.0], position=[[-0.5, -2, 0.85], [-0.5, 2, 1]]
    )
    with pytest.raises(SettingError, match="max_wait"):
        gp.plan(block[1].at(0.2), task.goal, task.scene.with_moving(comer), max_wait=1.0, iterations=5)


def test_through_poses_the_robot_stops_first(block: tuple[gp.Task, gp.Trajectory]) -> None:
    (task, motion), state = block, block[1].at(0.25 * block[1].duration)
    result = gp.plan(state, task.start, task.scene, via=[motion.q[-1]], w=0.0, iterations=20)
    assert_continues(result.unwrap(), state, task.scene)
    assert "it stops first" in result.detail


def test_contents_stay_in(coffee: tuple[gp.Task, gp.Trajectory]) -> None:
    task, state = coffee[0], coffee[1].at(0.9 * coffee[1].duration)
    result = gp.plan(state, task.goal, task.scene, w=0.0, iterations=20)
    assert result.verdict.checks["contents"].passed
    assert_continues(result.unwrap(), state, task.scene)


def test_once_it_is_late_no_more_stops_are_timed(
    coffee: tuple[gp.Task, gp.Trajectory], monkeypatch: pytest.MonkeyPatch
) -> None:
    task, state = coffee[0], coffee[1].at(0.5 * coffee[1].duration)
    timed = list[gp.Path]()

    def retimed(self: SceneConstraints, path: gp.Path, **_: object) -> gp.Trajectory:
        timed.append(path)
        raise RetimingError("not in time")

    monkeypatch.setattr(SceneConstraints, "retimed", retimed)
    held = SceneConstraints(task.scene, default_constraints(task.scene))
    found = find_start(state, held, 0.0, 1.0, late=lambda: bool(timed))
    assert isinstance(found, gp.PlanResult) and found.status is gp.PlanStatus.TIMEOUT and len(timed) == 1


def test_a_motion_from_rest_is_refused_for_a_robot_that_moves(block: tuple[gp.Task, gp.Trajectory]) -> None:
    task, state = block[0], block[1].at(0.5 * block[1].duration)
    resting = gp.plan(state.q, task.goal, task.scene, w=0.0, iterations=20).unwrap()
    assert gp.verify(resting, task.scene, start=state.q).passed
    assert gp.verify(resting, task.scene, start=state).failures == ("rest",)
    moving = gp.plan(state, task.goal, task.scene, w=0.0, iterations=20).unwrap()
    assert gp.verify(moving, task.scene, start=state.q).failures == ("rest",)


def test_states_and_results_can_be_pickled(block: tuple[gp.Task, gp.Trajectory]) -> None:
    state = block[1].at(0.2)
    again = pickle.loads(pickle.dumps(state))
    np.testing.assert_array_equal(again.qd, state.qd)
    result = gp.plan(again, block[0].goal, block[0].scene, w=0.0, iterations=10)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(result)).unwrap().q, result.unwrap().q)
