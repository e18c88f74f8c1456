"""Whole trajectories: better than the initial one, within every limit, or with the right status."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import GracefulPlanError, SettingError, ShapeError, UnknownNameError
from graceful_plan.scene.elements import Limits
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.dynamics import RobotDynamics
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.transcription.motion_check import violations
from graceful_plan.transcription.symbolic import symbolic_robot
from graceful_plan.transcription.trajectory_optimisation import OptimisationStatus, optimise_trajectory

_PIECES = 16
_BETTER = (OptimisationStatus.SOLVED, OptimisationStatus.STOPPED)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene


@pytest.fixture(scope="module")
def first(scene: Scene) -> Trajectory:
    task = scene.tasks["green_to_blue"]
    return gp.plan(task.start, task.goal, scene, w=0.0, planner="rrt_connect", iterations=2000).unwrap()


def _with_limits(scene: Scene, **changes: np.ndarray) -> Scene:
    parts = {name: getattr(scene.limits, name) for name in ("position", "velocity", "acceleration", "torque")}
    return replace(scene, limits=Limits(**(parts | changes)))


def _torques(motion: Trajectory, scene: Scene) -> np.ndarray:
    """Return torques by MuJoCo, at both ends and the middle of every piece."""
    dynamics, (a0, a1), h = RobotDynamics(scene), motion.piece_accelerations, np.diff(motion.t)
    found = []
    for k in range(len(h)):
        for u in (0.0, 0.5, 1.0):
            state = motion.at(motion.t[k] + u * h[k])
            found.append(dynamics(state.q, state.qd, (1.0 - u) * a0[k] + u * a1[k]))
    return np.array(found)


def test_least_time_beats_timing_of_a_fixed_path(scene: Scene, first: Trajectory) -> None:
    result = optimise_trajectory(first, scene, intervals=_PIECES, iterations=60, time_limit=np.inf)
    assert result.status in _BETTER
    assert result.trajectory is not None
    assert result.cost == pytest.approx(result.trajectory.duration, rel=1e-6)
    assert result.cost < result.initial_cost == pytest.approx(first.duration)
    assert gp.verify(result.trajectory, scene, start=first.q[0], goal=first.q[-1]).passed
    assert not violations(result.trajectory, scene.limits, robot=symbolic_robot(scene))


def test_jerk_is_limited_and_acceleration_does_not_jump(scene: Scene, first: Trajectory) -> None:
    jerk = 2000.0
    result = optimise_trajectory(first, scene, jerk=jerk, intervals=_PIECES, iterations=60, time_limit=np.inf)
    assert result.trajectory is not None
    assert result.initial_cost == np.inf  # accelerations of the fastest timing jump
    a0, a1 = result.trajectory.piece_accelerations
    h = np.diff(result.trajectory.t)[:, None]
    assert np.abs((a1 - a0) / h).max() <= jerk * (1.0 + 1e-6)
    jumps = np.concatenate([a0[:1], a0[1:] - a1[:-1], a1[-1:]])
    assert np.abs(jumps).max() <= 1e-3
    assert result.trajectory.duration > 0.95 * first.duration


@pytest.mark.long
@pytest.mark.parametrize("objective", ["effort", "acceleration"])
def test_effort_falls_within_the_time_allowed(scene: Scene, first: Trajectory, objective: str) -> None:
    short, long = (
        optimise_trajectory(first, scene, objective, duration=share * first.duration, intervals=_PIECES, iterations=25)
        for share in (1.2, 2.0)
    )
    for result, share in ((short, 1.2), (long, 2.0)):
        assert result.trajectory is not None
        assert result.trajectory.duration <= share * first.duration * (1.0 + 1e-6)
        assert result.cost < result.initial_cost
    if objective == "acceleration":  # holding the arm up takes torque all the time
        assert long.cost < 0.7 * short.cost


def test_exposure_falls(scene: Scene, first: Trajectory) -> None:
    result = optimise_trajectory(first, scene, w=3.0, intervals=_PIECES, iterations=25, time_limit=np.inf)
    assert result.status in _BETTER
    assert result.trajectory is not None
    objective = gp.Objective(exposure="time")
    before, after = (gp.evaluate(motion, scene, objective).impact for motion in (first, result.trajectory))
    assert after < 0.5 * before
    assert result.cost < result.initial_cost


def test_torque_limits_hold_with_a_payload(scene: Scene, first: Trajectory) -> None:
    assert scene.carried is not None
    needed, rest = np.abs(_torques(first, scene)).max(axis=0), np.zeros(7)
    dynamics = RobotDynamics(scene)
    held = np.max([np.abs(dynamics(q, rest, rest)) for q in first.q], axis=0)
    weak = _with_limits(scene, torque=np.maximum(0.6 * needed, 1.15 * held + 0.3))
    assert np.any(needed > weak.limits.torque)
    result = optimise_trajectory(first, weak, intervals=_PIECES, iterations=60, time_limit=np.inf)
    assert result.status in _BETTER
    assert result.initial_cost == np.inf
    assert result.trajectory is not None
    assert np.all(np.abs(_torques(result.trajectory, weak)) <= weak.limits.torque * (1.0 + 1e-6))
    ignored = optimise_trajectory(first, weak, torque=False, intervals=_PIECES, iterations=60, time_limit=np.inf)
    assert ignored.trajectory is not None
    assert ignored.trajectory.duration < 0.95 * result.trajectory.duration


def test_torque_that_cannot_hold_the_arm_is_named(scene: Scene, first: Trajectory) -> None:
    torque = scene.limits.torque.copy()
    torque[1] = 5.0
    result = optimise_trajectory(
        first, _with_limits(scene, torque=torque), intervals=8, iterations=40, time_limit=np.inf
    )
    assert (result.status, result.trajectory) == (OptimisationStatus.INFEASIBLE, None)
    assert [(v.limit, v.joint) for v in result.violated][:1] == [("torque", scene.joints[1])]
    assert "torque of " + scene.joints[1] in result.detail


@pytest.mark.parametrize(("share", "limit"), [(0.3, "velocity"), (0.8, "acceleration")])
def test_too_little_time_is_named(scene: Scene, first: Trajectory, share: float, limit: str) -> None:
    """Less time than a single joint needs on any path."""
    way = np.abs(first.q[-1] - first.q[0])
    cruise = (way / scene.limits.velocity).max()
    triangle = 2.0 * np.sqrt(way / scene.limits.acceleration).max()
    duration = share * cruise if limit == "velocity" else 0.5 * (cruise + max(triangle, cruise * 1.02))
    result = optimise_trajectory(first, scene, duration=float(duration))
    assert (result.status, result.trajectory) == (OptimisationStatus.INFEASIBLE, None)
    assert [violation.limit for violation in result.violated] == [limit]
    assert result.violated[0].joint in scene.joints
    assert result.violated[0].value > result.violated[0].bound


def test_a_goal_outside_of_the_limits_is_named(scene: Scene, first: Trajectory) -> None:
    q = np.linspace(first.q[0], first.q[-1], 5)
    q[-1, 3] = scene.limits.position[3, 1] + 0.2
    result = optimise_trajectory(gp.Path(q), scene)
    assert (result.status, result.trajectory) == (OptimisationStatus.INFEASIBLE, None)
    assert [(v.limit, v.joint) for v in result.violated] == [("position", scene.joints[3])]
    assert result.violated[0].bound == scene.limits.position[3, 1]


def test_a_collision_that_cannot_be_left_is_named(scene: Scene, first: Trajectory) -> None:
    """A post through the gripper at the end of the motion, which no path avoids."""
    hand = scene.data_at(first.q[-1]).site(scene.tool).xpos
    blocked = scene.add_sphere("post", 0.05, [float(x) for x in hand])
    result = optimise_trajectory(first, blocked, intervals=6, iterations=10, time_limit=np.inf)
    assert (result.status, result.trajectory) == (OptimisationStatus.INFEASIBLE, None)
    assert "clearance" in [violation.limit for violation in result.violated]
    assert not result.verdict.passed


@pytest.mark.parametrize("moment", [0.0, 0.3, 0.8])
def test_an_interrupted_solve_returns_the_best_iterate(scene: Scene, first: Trajectory, moment: float) -> None:
    end = time.perf_counter() + moment
    result = optimise_trajectory(first, scene, w=3.0, intervals=_PIECES, cancelled=lambda: time.perf_counter() >= end)
    assert result.status is not OptimisationStatus.INFEASIBLE
    assert result.trajectory is not None
    assert gp.verify(result.trajectory, scene).passed
    assert result.cost <= result.initial_cost
    assert moment or result.status is OptimisationStatus.UNCHANGED


@pytest.mark.long
def test_iterations_make_it_reproducible(scene: Scene, first: Trajectory) -> None:
    a, b = (optimise_trajectory(first, scene, w=1.0, intervals=8, iterations=8, time_limit=np.inf) for _ in range(2))
    assert a.trajectory is not None
    assert b.trajectory is not None
    assert a.trajectory.to_json() == b.trajectory.to_json()


def test_a_path_is_timed_first_and_one_without_length_is_done(scene: Scene, first: Trajectory) -> None:
    timed = optimise_trajectory(gp.Path(first.q[[0, len(first) // 2, -1]]), scene, intervals=8, iterations=20)
    assert timed.status is not OptimisationStatus.SOLVED or timed.cost < timed.initial_cost
    still = optimise_trajectory(gp.Path(first.q[:1]), scene)
    assert (still.status, still.cost) == (OptimisationStatus.SOLVED, 0.0)
    assert still.trajectory is not None
    assert len(still.trajectory) == 1


def test_misuse_is_refused(scene: Scene, first: Trajectory) -> None:
    wrong: list[tuple[type[GracefulPlanError], str, dict[str, Any]]] = [
        (UnknownNameError, "speed", {"objective": "speed"}),
        (SettingError, "w = -1", {"w": -1.0}),
        (SettingError, "duration", {"duration": 0.0}),
        (SettingError, "jerk", {"jerk": -3.0}),
        (ShapeError, "jerk", {"jerk": np.ones(3)}),
        (SettingError, "margin", {"margin": np.nan}),
        (SettingError, "intervals", {"intervals": 1}),
        (SettingError, "iterations", {"iterations": -1}),
        (SettingError, "time_limit", {"time_limit": -1.0}),
    ]
    for error, words, settings in wrong:
        with pytest.raises(error, match=words):
            optimise_trajectory(first, scene, **settings)
    with pytest.raises(ShapeError, match="initial"):
        optimise_trajectory(gp.Path(np.zeros((2, 3))), scene)
    moving = Trajectory(first.t, first.q, first.qd + 0.1, first.qdd, first.joints)
    with pytest.raises(SettingError, match="rest"):
        optimise_trajectory(moving, scene)
