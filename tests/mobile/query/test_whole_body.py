"""Tool poses with a free base: reached, free, the nearest first, also through the front door."""

from __future__ import annotations

import time

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.judge.exact import exactly_free
from graceful_plan.mobile.query.arm_detours import with_arm_detours
from graceful_plan.mobile.query.whole_body import reach_of, solve_whole_body, way_to
from graceful_plan.query.endpoints.endpoints import find_endpoints
from graceful_plan.scene.pose_goal import pose_error
from hall import hall

KITCHEN = gp.load_scene("kitchen")
READY = np.array(KITCHEN.keyframes["ready"])


def tool(q: np.ndarray) -> np.ndarray:
    return gp.PoseGoal.from_tool(q, KITCHEN).X_WT


def reached(goal: gp.PoseGoal, **given) -> np.ndarray:
    return solve_whole_body(goal, KITCHEN, READY, free=lambda q: exactly_free(q, KITCHEN), **given).q


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=10, deadline=None)
def test_reachable_poses_are_reached(seed, free_yaw):
    rng = np.random.default_rng(seed)
    q = rng.uniform(*KITCHEN.limits.position.T)
    q[2] = rng.uniform(-np.pi, np.pi)
    if gp.clearance(q, KITCHEN) < 0.02:
        return
    goal = gp.PoseGoal.from_tool(q, KITCHEN, free_yaw=free_yaw)
    found = reached(goal)
    assert len(found) and gp.clearance(found, KITCHEN).min() >= 0.002
    for one in found:
        distance, angle = pose_error(goal, tool(one))
        assert distance < 1e-5 and angle < 1e-4
    assert (np.diff(way_to(READY, found)) >= 0.0).all()


def test_poses_within_reach_of_the_arm_need_no_driving():
    q = READY.copy()
    q[4] += 0.5
    np.testing.assert_allclose(reached(gp.PoseGoal.from_tool(q, KITCHEN))[0, :3], READY[:3], atol=1e-9)


def test_the_way_to_a_configuration_is_turn_drive_turn():
    start, q = np.zeros(4), np.array([[2.0, 0.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0], [-2.0, 0.0, 0.0, 0.5], [0, 0, 1, 0]])
    np.testing.assert_allclose(way_to(start, q), [2.0, 2.0 + np.pi, 2.5, 1.0], atol=1e-9)


def test_stored_postures_have_the_right_tool_pose():
    reach = reach_of(KITCHEN)
    for k in (0, 777):
        q = np.concatenate([[0.0, 0.0, 0.0], reach.arm[k]])
        np.testing.assert_allclose(tool(q), reach.X_BT[k], atol=1e-6)


def test_poses_out_of_reach_are_reported():
    result = gp.plan("ready", gp.PoseGoal.at([3.0, 2.0, 4.0]), KITCHEN, iterations=1)
    assert result.status is gp.PlanStatus.INVALID_GOAL and "pose" in result.detail


def test_a_search_that_is_called_off_ends():
    assert len(reached(gp.PoseGoal.at([3.9, 1.3, 0.95]), cancelled=lambda: True)) == 0


def test_base_and_arm_go_to_a_pose():
    goal = gp.PoseGoal.at([3.9, 1.3, 0.95])
    result = gp.plan("ready", goal, KITCHEN, w=0.0, iterations=300)
    assert result.status is gp.PlanStatus.SOLVED
    assert gp.verify(result.trajectory, KITCHEN, goal=goal).passed
    assert result.verdict.checks["rolling"].passed
    assert np.linalg.norm(result.trajectory.q[-1, :2] - READY[:2]) > 1.0


def test_arms_move_around_obstacles():
    bar = '<body name="bar" pos="4.6 0 .4"><geom type="box" size=".05 .5 .02"/></body>'
    scene = hall(arm=True, extra=bar)
    above, below = np.array([4.0, 0.0, 0.0, -0.6]), np.array([4.0, 0.0, 0.0, 0.6])
    start = np.array([-4.0, 0.0, 0.0, -0.6])
    held = SceneConstraints(scene, [])
    assert gp.clearance(np.stack([above, below]), scene).min() > 0.002
    ends = find_endpoints(start, below, held, np.random.default_rng(0))
    # With one joint there is no detour, so the goal stays.
    assert len(with_arm_detours(ends).arrivals) == 1


def test_ways_round_a_corner_are_free_where_the_straight_one_is_not():
    held, rng = SceneConstraints(KITCHEN, []), np.random.default_rng(2)
    q = np.tile(READY, (400, 1))
    q[:, 3:] = rng.uniform(*KITCHEN.limits.position[3:].T, (400, 8))
    q = q[held.kernels.clearance(q) > 0.02]
    blocked = q[~held.kernels.edges_free(READY, q)][:12]
    assert len(blocked) == 12
    ends = find_endpoints(READY, blocked, held, np.random.default_rng(0))
    found = with_arm_detours(ends)
    new = found.arrivals[len(ends.arrivals) :]
    assert len(new) >= 3 and found.goal_index[: len(ends.arrivals)] == ends.goal_index
    for arrival, index in zip(new, found.goal_index[len(ends.arrivals) :], strict=True):
        assert len(arrival) == 3 and (arrival.q[:, :3] == READY[:3]).all()
        reached_straight = ends.arrivals[ends.goal_index.index(index)]
        np.testing.assert_array_equal(arrival.q[[0, -1]], [READY, reached_straight.q[-1]])
        assert held.kernels.edges_free(arrival.q[:-1], arrival.q[1:]).all()


def test_a_late_stop_does_not_use_the_whole_time_limit():
    """Motions near a path used to take half a minute of this minute; now they take as long as the search."""
    q = np.array([3.6, 1.82, -1.06, 0.18, -1.44, 0.54, -0.81, 0.39, -0.42, 1.7, -2.92])

    def stops(_: object) -> bool:
        time.sleep(0.15)  # earlier stops end with a quick motion
        return True

    gp.plan(READY, READY, KITCHEN, iterations=1)  # compile the scene
    result = gp.plan(READY, gp.PoseGoal.from_tool(q, KITCHEN), KITCHEN, time_limit=60.0, callback=stops)
    assert result.status is gp.PlanStatus.SOLVED
    assert result.stats["total_time"] < 15.0


def test_the_first_motion_ends_the_call_of_a_base():
    q = np.array([3.6, 1.82, -1.06, 0.18, -1.44, 0.54, -0.81, 0.39, -0.42, 1.7, -2.92])
    told = []
    goal = gp.PoseGoal.from_tool(q, KITCHEN)
    result = gp.plan(READY, goal, KITCHEN, time_limit=60.0, stop="first", callback=told.append)
    assert result.status is gp.PlanStatus.SOLVED and len(told) == 2  # path and motion
    assert result.stats["total_time"] < 15.0
