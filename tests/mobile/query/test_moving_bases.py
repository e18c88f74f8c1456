"""Moving starts of bases: motions continue speed and turning rate, brake where they must, and say if they cannot."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.mobile.motions.arc_stops import arc_stops
from jackals import jackal


@pytest.fixture(scope="module")
def drive() -> tuple[gp.Scene, gp.Trajectory]:
    scene = jackal((3.0, 1.5))
    return scene, gp.plan([0.0, 0.0, 0.0], gp.BasePose(6.0, 2.0), scene, iterations=100).unwrap()


def moving(v: float, turn: float = 0.0, x: float = 0.0, yaw: float = 0.3) -> gp.State:
    return gp.State(np.array([x, 0.0, yaw]), np.array([v * np.cos(yaw), v * np.sin(yaw), turn]))


def assert_continues(trajectory: gp.Trajectory, state: gp.State, scene: gp.Scene) -> None:
    np.testing.assert_allclose(trajectory.q[0], state.q, atol=1e-9)
    np.testing.assert_allclose(trajectory.qd[0], state.qd, atol=1e-6)
    assert gp.verify(trajectory, scene, start=state).passed


def speeds(trajectory: gp.Trajectory) -> np.ndarray:
    inner = trajectory.at(np.linspace(0.0, 0.97 * trajectory.duration, 500))
    return np.linalg.norm(inner.qd[:, :2], axis=1)


@pytest.mark.parametrize(
    ("share", "goal"), [(0.1, (6.0, 2.0)), (0.3, (6.0, -2.0)), (0.6, (6.0, 2.0)), (0.8, (0.0, 0.0))]
)
def test_motions_continue_the_velocity_within_limits(
    drive: tuple[gp.Scene, gp.Trajectory], share: float, goal: tuple[float, float]
) -> None:
    scene, motion = drive
    state = motion.at(share * motion.duration)
    result = gp.plan(state, gp.BasePose(*goal), scene, w=0.0, iterations=60)
    assert_continues(result.unwrap(), state, scene)
    np.testing.assert_allclose(result.unwrap().q[-1, :2], goal, atol=1e-6)


def test_straight_ahead_the_base_does_not_slow_down_first() -> None:
    scene, state = jackal((9.0, 9.0)), moving(1.0, yaw=0.0)
    trajectory = gp.plan(state, gp.BasePose(5.0, 0.0, 0.0), scene, w=0.0, iterations=60).unwrap()
    assert_continues(trajectory, state, scene)
    assert scene.base is not None
    v, a = scene.base.v_max, scene.base.a_max
    fastest = (v - 1.0) / a + v / a + (5.0 - (v**2 - 1.0) / (2.0 * a) - v**2 / (2.0 * a)) / v
    assert fastest <= trajectory.duration <= 1.1 * fastest
    assert speeds(trajectory)[:400].min() > 0.99


def test_to_a_goal_behind_it_brakes_first() -> None:
    scene, state = jackal((9.0, 9.0)), moving(1.5)
    trajectory = gp.plan(state, gp.BasePose(-3.0, 0.0), scene, w=0.0, iterations=60).unwrap()
    assert_continues(trajectory, state, scene)
    assert speeds(trajectory).min() < 0.05


def test_backwards_it_goes_on_backwards() -> None:
    scene, state = jackal((9.0, 9.0)), moving(-0.8, 0.3)
    trajectory = gp.plan(state, gp.BasePose(-4.0, -1.0), scene, w=0.0, iterations=60).unwrap()
    assert_continues(trajectory, state, scene)


def test_a_base_that_turns_in_place_stops_turning() -> None:
    scene, state = jackal((9.0, 9.0)), moving(0.0, 2.0)
    assert_continues(gp.plan(state, gp.BasePose(2.0, 0.0), scene, w=0.0, iterations=60).unwrap(), state, scene)


@pytest.mark.parametrize(("v", "turn"), [(1.0, 0.0), (1.2, 1.1), (-0.5, 2.0), (0.0, 3.0), (1e-4, 0.5)])
def test_stops_follow_the_arc(v: float, turn: float) -> None:
    """Closed form: the speed falls evenly, and the path is a circle of radius v over the turning rate."""
    scene, state = jackal((9.0, 9.0)), moving(v, turn)
    assert scene.base is not None
    stop, straighter = arc_stops(state, SceneConstraints(scene, ()), 1.0)
    assert gp.verify(stop, scene, start=state).passed and gp.verify(straighter, scene, start=state).passed
    assert abs(straighter.q[-1, 2] - state.q[2]) <= abs(stop.q[-1, 2] - state.q[2]) + 1e-12
    seconds = max(abs(v) / scene.base.a_max, abs(turn) / scene.base.alpha_max)
    assert stop.duration == pytest.approx(seconds, rel=0.02)
    turned = 0.5 * turn * stop.duration
    assert stop.q[-1, 2] - state.q[2] == pytest.approx(turned, abs=1e-9)
    chord = 0.5 * v * stop.duration if turn == 0.0 else 2.0 * v / turn * np.sin(0.5 * turned)
    middle = state.q[2] + 0.5 * turned
    np.testing.assert_allclose(stop.q[-1, :2], chord * np.array([np.cos(middle), np.sin(middle)]), atol=1e-9)


def test_a_velocity_that_wheels_cannot_have_is_no_start() -> None:
    scene, goal = jackal((9.0, 9.0)), gp.BasePose(3.0, 0.0)
    base = scene.base
    assert base is not None
    sideways = gp.State(np.zeros(3), np.array([0.5, 0.2, 0.0]))
    for state, word in (
        (sideways, "sideways"),
        (moving(1.1 * base.v_max, yaw=0.0), "speed"),
        (moving(0.0, 1.1 * base.omega_max), "rate of turning"),
        (moving(0.6 * base.v_max, 0.9 * base.omega_max), "across"),
    ):
        result = gp.plan(state, goal, scene, iterations=5)
        assert result.status is gp.PlanStatus.INVALID_START and word in result.detail


def test_towards_an_obstacle_nearer_than_its_braking_distance_is_no_start() -> None:
    scene = jackal((2.0, 0.0))  # the braking distance at 1.9 m/s is 1.2 m, and the base is half a metre long
    near = gp.plan(moving(1.9, x=0.8, yaw=0.0), gp.BasePose(0.0, 3.0), scene, iterations=20)
    assert near.status is gp.PlanStatus.INVALID_START and "child0" in near.detail and "takes 1.28 s" in near.detail
    far = gp.plan(moving(1.9, x=-1.0, yaw=0.0), gp.BasePose(0.0, 3.0), scene, w=0.0, iterations=60)
    assert_continues(far.unwrap(), moving(1.9, x=-1.0, yaw=0.0), scene)


@pytest.mark.long
def test_with_a_moving_arm_the_base_goes_on_and_the_arm_keeps_its_velocity_at_the_start() -> None:
    """A Fetch with a bottle; the shoulder turns."""
    task = gp.load_scene("hallway").tasks["carry_bottle"]
    scene, qd = task.scene.without_moving(), np.zeros(11)
    qd[[0, 2, 4]] = 0.6, 0.05, 0.2
    state = gp.State(np.asarray(task.start), qd)
    trajectory = gp.plan(state, gp.BasePose(3.0, 0.1), scene, w=0.0, iterations=20, stop="first").unwrap()
    assert_continues(trajectory, state, scene)


def test_among_pedestrians_the_onward_motion_meets_them_where_they_are_by_then() -> None:
    walker = gp.MovingEntity("walker", "adult", size=[0.25, 0.85], t=[0.0, 4.0], position=[[3, -3, 0.9], [3, 3, 0.9]])
    scene, state = jackal((9.0, 9.0)).with_moving(walker), moving(1.5, yaw=0.0)
    result = gp.plan(state, gp.BasePose(6.0, 0.0), scene, iterations=60)
    assert_continues(result.unwrap(), state, scene)
    assert gp.verify(result.unwrap(), scene, start=state).checks["passing_by"].passed


def test_replanning_keeps_on_or_takes_over(drive: tuple[gp.Scene, gp.Trajectory]) -> None:
    scene, motion = drive
    at = 0.4 * motion.duration
    kept = gp.replan(motion, scene, at=at, w=0.0, iterations=40)
    assert kept.status is gp.PlanStatus.SOLVED
    other = gp.replan(motion, scene, at=at, goal=gp.BasePose(6.0, -1.0), w=0.0, iterations=40)
    assert other.status is gp.PlanStatus.SOLVED
    for result in (kept, other):
        whole = motion.spliced(result.unwrap())
        assert gp.verify(whole, scene).passed


def test_replanning_goes_round_a_new_obstacle_or_stops(drive: tuple[gp.Scene, gp.Trajectory]) -> None:
    scene, motion = drive
    at = 0.3 * motion.duration
    place = motion.at(0.75 * motion.duration).q
    blocked = scene.add_box("crate", [0.2, 0.2, 0.3], [*place[:2], 0.3])
    result = gp.replan(motion, blocked, at=at, w=0.0, iterations=60)
    assert result.status is gp.PlanStatus.SOLVED
    assert gp.verify(motion.spliced(result.unwrap()), blocked).passed
