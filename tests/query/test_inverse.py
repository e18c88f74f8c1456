"""gp.solve_ik: solutions are at the pose, free and near; no solution is a result."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError
from graceful_plan.judge.exact import state_contacts


def test_solutions_are_at_the_pose_and_free() -> None:
    task = next(iter(gp.load_scene("desk").tasks.values()))
    scene, goal = task.scene, gp.PoseGoal.from_tool(task.start, task.scene, translation=[0.0, 0.05, 0.1])
    found = gp.solve_ik(goal, scene, near=task.start)
    assert len(found) > 1
    for q, far, angle in zip(found.q, found.position_error, found.orientation_error, strict=True):
        data = scene.data_at(q).site(scene.tool)
        assert far == pytest.approx(np.linalg.norm(data.xpos - goal.X_WT[:3, 3]), abs=1e-9) and far <= 1e-3
        assert angle <= 1e-2 and not state_contacts(q, scene)
    away = np.linalg.norm(found.q - task.start, axis=1)
    assert away[0] == away.min()
    again = gp.solve_ik(goal, scene, near=task.start)
    np.testing.assert_array_equal(found.q, again.q)


def test_poses_in_an_obstacle_have_colliding_solutions_only() -> None:
    scene = gp.load_scene("desk")
    q = next(iter(scene.keyframes.values()))
    X = scene.pose(q)
    blocked = scene.add_sphere("ball", 0.04, X[:3, 3])
    found = gp.solve_ik(gp.PoseGoal(X), blocked, q)
    assert len(found) == 0 and found.colliding > 0 and found.best_error[0] < 1e-3 and "collide" in str(found)
    assert len(gp.solve_ik(gp.PoseGoal(X), blocked, q, avoid_collisions=False)) > 0


def test_no_solution_is_a_result_with_the_distance_that_is_missing() -> None:
    scene = gp.load_scene("desk")
    found = gp.solve_ik(gp.PoseGoal.at([5.0, 0.0, 0.5], free_yaw=True), scene, next(iter(scene.keyframes)))
    assert found.q.shape == (0, len(scene.joints)) and found.position_error.shape == (0,)
    assert 2.0 < found.best_error[0] < 5.0 and "no solution" in str(found)


def test_misuse_is_named() -> None:
    scene = gp.load_scene("desk")
    goal = gp.PoseGoal.at([0.4, 0.0, 0.5])
    with pytest.raises(UnknownNameError):
        gp.solve_ik(goal, scene, "nowhere")
    with pytest.raises(ShapeError):
        gp.solve_ik(goal, scene, np.zeros(2))
    with pytest.raises(SettingError, match="count"):
        gp.solve_ik(goal, scene, np.zeros(len(scene.joints)), count=0)
