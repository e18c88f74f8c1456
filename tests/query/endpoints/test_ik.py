"""Inverse kinematics: solutions reach the pose within the limits; unreachable poses are reported."""

from __future__ import annotations

import numpy as np
import pytest

from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.query.endpoints.ik import solve_ik
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene


@pytest.fixture(scope="module")
def scene(scene: Scene) -> Scene:
    return scene.tasks["lift_to_goal"].scene


@pytest.fixture(scope="module")
def start(scene: Scene) -> np.ndarray:
    return scene.tasks["lift_to_goal"].start


def _tool(scene: Scene, q: np.ndarray) -> np.ndarray:
    site = scene.data_at(q).site(scene.tool)
    X_WT = np.eye(4)
    X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos
    return X_WT


def _anywhere(scene: Scene, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(*scene.limits.position.T)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("free_yaw", [False, True])
def test_solutions_of_reachable_poses(scene: Scene, start: np.ndarray, seed: int, free_yaw: bool) -> None:
    goal = PoseGoal(_tool(scene, _anywhere(scene, seed)), free_yaw=free_yaw)
    found = solve_ik(goal, scene, start)
    assert len(found.q) > 0 and found.colliding == 0
    lower, upper = scene.limits.position.T
    for q in found.q:
        position, angle = pose_error(goal, _tool(scene, q))
        assert position <= 1e-6 and angle <= 1e-6
        assert (lower <= q).all() and (q <= upper).all()
    distances = np.linalg.norm(found.q - start, axis=1)
    assert (np.diff(distances) >= 0.0).all()
    apart = np.abs(found.q[:, None] - found.q[None]).max(axis=2)[np.triu_indices(len(found.q), 1)]
    assert (apart > 0.1).all()


def test_the_start_itself_is_the_nearest_solution(scene: Scene, start: np.ndarray) -> None:
    found = solve_ik(PoseGoal(_tool(scene, start)), scene, start)
    np.testing.assert_array_equal(found.q[0], start)


def test_same_seed_same_solutions(scene: Scene, start: np.ndarray) -> None:
    goal = PoseGoal(_tool(scene, _anywhere(scene, 3)))
    first, again = (solve_ik(goal, scene, start, seed=5).q for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_free_yaw_allows_poses_that_a_full_pose_forbids(scene: Scene, start: np.ndarray) -> None:
    X_WT = _tool(scene, _anywhere(scene, 1))
    q = solve_ik(PoseGoal(X_WT, free_yaw=True), scene, start).q[0]
    position, angle = pose_error(PoseGoal(X_WT), _tool(scene, q))
    assert position < 1e-5 and angle > 0.1


def test_out_of_reach_tells_how_far(scene: Scene, start: np.ndarray) -> None:
    found = solve_ik(PoseGoal.at([3.0, 0.0, 0.5], free_yaw=True), scene, start)
    assert len(found.q) == 0 and found.colliding == 0
    assert 1.5 < found.position_error < 3.0


def test_colliding_solutions_are_dropped_and_counted(scene: Scene, start: np.ndarray) -> None:
    goal = PoseGoal(_tool(scene, _anywhere(scene, 2)))
    none = solve_ik(goal, scene, start, free=lambda q: np.zeros(len(q), dtype=bool))
    assert len(none.q) == 0 and none.colliding > 8 and none.position_error < 1e-5
    half = solve_ik(goal, scene, start, free=lambda q: q[:, 0] > 0.0)
    assert (half.q[:, 0] > 0.0).all()


@pytest.mark.parametrize("free_yaw", [False, True])
def test_solutions_are_exact_to_double_precision(scene: Scene, start: np.ndarray, free_yaw: bool) -> None:
    goal = PoseGoal(_tool(scene, _anywhere(scene, 4)), free_yaw=free_yaw)
    found = solve_ik(goal, scene, start)
    assert len(found.q) == 8
    for q in found.q:
        assert max(pose_error(goal, _tool(scene, q))) < 1e-6


def test_poses_with_joints_at_their_limits_are_reached(scene: Scene, start: np.ndarray) -> None:
    lower, upper = scene.limits.position.T
    for seed in range(20):
        q, rng = _anywhere(scene, seed), np.random.default_rng(seed)
        at = rng.choice(len(q), 3, replace=False)
        q[at] = np.where(rng.random(3) < 0.5, lower[at], upper[at])
        found = solve_ik(PoseGoal(_tool(scene, q)), scene, start)
        assert len(found.q) and (lower <= found.q).all() and (found.q <= upper).all()


def test_where_the_usual_rounds_fail_more_seeds_and_iterations_follow(scene: Scene, start: np.ndarray) -> None:
    goal = PoseGoal(_tool(scene, _anywhere(scene, 2)))
    assert len(solve_ik(goal, scene, start, seeds=1, rounds=1, iterations=1).q)


def test_a_quaternion_makes_the_same_pose_as_its_matrix() -> None:
    goal = PoseGoal.at([1.0, 2.0, 3.0], [2.0, 0.0, 0.0, 2.0])
    np.testing.assert_allclose(goal.X_WT[:3], [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]], atol=1e-12)


def test_pose_error_of_half_a_turn() -> None:
    goal, other = PoseGoal.at([0.0, 0.0, 0.0]), PoseGoal.at([0.0, 0.3, 0.4], [0.0, 1.0, 0.0, 0.0])
    assert pose_error(goal, other.X_WT) == pytest.approx((0.5, np.pi))
    yaw = PoseGoal.at([0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0])
    assert pose_error(goal, yaw.X_WT) == pytest.approx((0.0, np.pi / 2.0))
    assert pose_error(PoseGoal(np.eye(4), free_yaw=True), yaw.X_WT) == pytest.approx((0.0, 0.0))


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, np.inf])
def test_bad_tolerances_are_refused(tolerance: float) -> None:
    with pytest.raises(SettingError, match="position_tolerance"):
        PoseGoal(np.eye(4), position_tolerance=tolerance)
    with pytest.raises(SettingError, match="orientation_tolerance"):
        PoseGoal(np.eye(4), orientation_tolerance=tolerance)


def test_bad_poses_are_refused(scene: Scene, start: np.ndarray) -> None:
    with pytest.raises(SettingError, match="X_WT"):
        PoseGoal(2.0 * np.eye(4))
    with pytest.raises(SettingError, match="X_WT"):
        PoseGoal(np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(SettingError, match="quaternion"):
        PoseGoal.at([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ShapeError, match="position has shape"):
        PoseGoal.at([0.0, 0.0])
    with pytest.raises(ShapeError, match="start has shape"):
        solve_ik(PoseGoal(np.eye(4)), scene, start[:3])
    with pytest.raises(SettingError, match="seeds"):
        solve_ik(PoseGoal(np.eye(4)), scene, start, seeds=0)
