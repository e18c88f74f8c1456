"""Straight motions: the tool stays on its line at all times, or the result gives the place where it cannot."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError, UnknownNameError
from graceful_plan.result import PlanStatus
from sizes import first_quick

Array = np.ndarray

_SCENES = ("desk", "dining_table", "kitchen_counter", "tabletop")
_SAMPLES = 400
"""Times at which motions are checked here."""
_ROUNDING = 1e-9
"""Difference between this test's errors and the judge's [m, rad]."""


@cache
def _scene(name: str) -> gp.Scene:
    return gp.load_scene(name)


def _tool_poses(scene: gp.Scene, q: Array) -> tuple[Array, Array]:
    """Return position and rotation matrix of the tool in W, by MuJoCo."""
    data = mujoco.MjData(scene.model)
    p, R = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    for i, configuration in enumerate(q):
        data.qpos[scene.qpos_adr] = configuration
        mujoco.mj_kinematics(scene.model, data)
        p[i], R[i] = data.site(scene.tool).xpos, data.site(scene.tool).xmat.reshape(3, 3)
    return p, R


def _angle(R: Array) -> Array:
    """Return the angle of rotation matrices [rad], accurate for small ones (|R - I| is 2 sqrt(2) sin of half of it)."""
    return 2.0 * np.arcsin(np.clip(np.linalg.norm(R - np.eye(3), axis=(-2, -1)) / np.sqrt(8.0), 0.0, 1.0))


def _worst(result: gp.PlanResult, scene: gp.Scene, goal: gp.PoseGoal) -> tuple[float, float]:
    """Return the greatest distance from the line [m], and from the orientation at the nearest point on it [rad]."""
    trajectory = result.unwrap()
    t = np.linspace(trajectory.t[0], trajectory.t[-1], _SAMPLES)
    p, R = _tool_poses(scene, trajectory.at(t).q)
    whole = goal.X_WT[:3, 3] - p[0]
    share = np.clip((p - p[0]) @ whole / (whole @ whole), 0.0, 1.0)
    off = np.linalg.norm(p - p[0] - share[:, None] * whole, axis=1)
    turn = np.empty(3)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(goal.X_WT[:3, :3] @ R[0].T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    angles = []
    for s, reached in zip(share, R, strict=True):
        due, matrix = np.array([1.0, 0.0, 0.0, 0.0]), np.empty(9)
        mujoco.mju_quatIntegrate(due, turn, float(s))
        mujoco.mju_quat2Mat(matrix, due)
        angles.append(_angle(reached @ (matrix.reshape(3, 3) @ R[0]).T))
    return float(off.max()), float(np.max(angles))


_vectors = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)


@pytest.mark.long
@given(
    name=st.sampled_from(_SCENES),
    seed=st.integers(0, 10_000),
    direction=_vectors.filter(lambda v: np.linalg.norm(v) > 0.1),
    length=st.floats(0.02, 0.3),
    turn=_vectors.map(lambda v: 0.7 * v),
)
def test_the_tool_stays_on_its_line_or_the_result_names_the_place(name, seed, direction, length, turn):
    scene = _scene(name)
    q = scene.keyframes["ready"] + np.random.default_rng(seed).normal(size=7) * 0.3
    q = np.clip(q, *scene.limits.position.T)
    translation = length * direction / np.linalg.norm(direction)
    goal = gp.PoseGoal.from_tool(q, scene, translation=translation, rotation=turn)
    result = gp.plan_cartesian(q, goal, scene)
    if result.status is not PlanStatus.SOLVED:
        assert result.status in (PlanStatus.INVALID_START, PlanStatus.INFEASIBLE, PlanStatus.INVALID_GOAL)
        assert result.detail and result.trajectory is None
        if result.status is not PlanStatus.INVALID_START:
            assert any(f"{length + rounding:.3f} m" in result.detail for rounding in (-1e-9, 1e-9))
        return
    off, angle = _worst(result, scene, goal)
    assert off < 1e-3 and angle < np.deg2rad(0.5)
    assert {"deviation", "orientation", "collision", "goal", "rest", "velocity_limits"} <= set(result.verdict.checks)
    # The nearest point is found differently, to 0.1 mm, over which the tool turns.
    turned = 1e-4 * np.linalg.norm(turn) / length
    for key, measured, away in (("deviation", off, 0.0), ("orientation", angle, turned)):
        check = result.verdict.checks[key]
        assert check.passed and abs(check.worst - measured) < 0.1 * check.limit + away
    assert result.cost == gp.evaluate(result.unwrap(), scene)
    np.testing.assert_allclose(result.unwrap().q[0], q, atol=1e-12)
    # No stop on the way: the tool moves at every time except the first and the last.
    inner = result.unwrap().qd[1:-1]
    assert (np.abs(inner).max(axis=1) > 0.0).all()


@pytest.mark.parametrize("name", first_quick(_SCENES))
def test_retreat_and_approach_in_every_scene(name):
    scene = _scene(name)
    back = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, translation=[0.0, 0.0, -0.3], frame="tool")
    result = gp.plan_cartesian("ready", back, scene)
    assert result.status is PlanStatus.SOLVED, result.detail
    off, angle = _worst(result, scene, back)
    assert off < 1e-3 and angle < np.deg2rad(0.5)
    there = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene)
    again = gp.plan_cartesian(result.unwrap().q[-1], there, scene)
    assert again.status is PlanStatus.SOLVED, again.detail


def test_pouring_turns_the_tool_where_it_is(scene):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, rotation=[np.deg2rad(60.0), 0.0, 0.0])
    result = gp.plan_cartesian("ready", goal, scene, deviation=5e-4)
    p, _ = _tool_poses(scene, result.unwrap().sample(0.01).q)
    assert np.linalg.norm(p - p[0], axis=1).max() < 5e-4
    assert result.verdict.checks["orientation"].passed


def test_tighter_bounds_are_kept(scene):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, translation=[0.1, 0.2, 0.0])
    result = gp.plan_cartesian("ready", goal, scene, deviation=2e-6, angle=2e-6)
    off, angle = _worst(result, scene, goal)
    assert off < 2e-6 + _ROUNDING and angle < 2e-6 + _ROUNDING


def test_free_yaw_turns_nothing_but_the_axis(scene):
    q = scene.keyframes["ready"]
    goal = gp.PoseGoal.from_tool(q, scene, translation=[0.0, 0.25, 0.0], rotation=[0.0, 0.0, 2.5], free_yaw=True)
    result = gp.plan_cartesian(q, goal, scene)
    _, R = _tool_poses(scene, result.unwrap().sample(0.01).q)
    np.testing.assert_allclose(R[:, :, 2] @ R[0, :, 2], 1.0, atol=1e-5)
    checks = result.verdict.checks
    assert checks["deviation"].passed and checks["orientation"].passed


def test_an_obstacle_on_the_line_is_named_with_its_place(scene):
    q = scene.keyframes["ready"]
    p = _tool_poses(scene, q[None])[0][0]
    X = np.eye(4)
    X[:3, 3] = p + [0.0, 0.15, 0.0]
    blocked = scene.add_box("post", [0.02, 0.02, 0.1], X)
    goal = gp.PoseGoal.from_tool(q, blocked, translation=[0.0, 0.3, 0.0])
    result = gp.plan_cartesian(q, goal, blocked)
    assert result.status is PlanStatus.INFEASIBLE and "post" in result.detail
    assert any(f"{place / 1000:.3f} m of 0.300 m" in result.detail for place in range(1, 150))
    assert not result.verdict.checks["collision"].passed
    assert gp.plan_cartesian(q, goal, scene).status is PlanStatus.SOLVED


@pytest.mark.parametrize("far", [3.0, 1e6])
def test_a_line_out_of_reach_is_reported_with_its_place(scene, far):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, translation=[far, 0.0, 0.0])
    result = gp.plan_cartesian("ready", goal, scene)
    assert result.status is PlanStatus.INVALID_GOAL
    assert "line" in result.detail and "limits" in result.detail


def test_a_goal_that_is_reachable_but_not_by_the_line(scene):
    q = scene.keyframes["ready"].copy()
    q[6] = scene.limits.position[6, 0] + 0.01
    result = gp.plan_cartesian(q, gp.PoseGoal.from_tool(q, scene, rotation=[0.0, 0.0, 1.5]), scene)
    assert result.status is PlanStatus.INFEASIBLE
    assert "of 85.9 degrees" in result.detail and "'panda/joint7'" in result.detail


def test_half_a_turn_is_refused(scene):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, rotation=[np.pi, 0.0, 0.0])
    result = gp.plan_cartesian("ready", goal, scene)
    assert result.status is PlanStatus.INFEASIBLE and "180.0 degrees" in result.detail


def test_nothing_to_travel(scene):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene)
    result = gp.plan_cartesian("ready", goal, scene)
    assert result.status is PlanStatus.SOLVED and result.unwrap().duration == 0.0


def test_a_colliding_start_is_reported(scene):
    q = np.array([0.0, 1.7, 0.0, -0.1, 0.0, 1.6, 0.0])
    result = gp.plan_cartesian(q, gp.PoseGoal.from_tool(q, scene, translation=[0.0, 0.0, 0.1]), scene)
    assert result.status is PlanStatus.INVALID_START and "start" in result.detail


def test_speed_scales_the_duration(scene):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, translation=[0.0, 0.2, 0.0])
    fast, slow = (gp.plan_cartesian("ready", goal, scene, speed=s, w=0.0).unwrap() for s in (1.0, 0.5))
    assert slow.duration == pytest.approx(2.0 * fast.duration, rel=0.05)


def test_same_seed_same_motion(scene):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, translation=[0.1, 0.2, 0.1])
    first, again = (gp.plan_cartesian("ready", goal, scene, seed=3).unwrap().q for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_the_carried_object_comes_along(task):
    goal = gp.PoseGoal.from_tool(task.start, task.scene, translation=[0.0, 0.0, 0.15])
    result = gp.plan_cartesian(task.start, goal, task.scene, w=1.0)
    assert result.status is PlanStatus.SOLVED, result.detail
    assert result.cost.w == 1.0


def test_misuse(scene):
    goal = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, translation=[0.0, 0.2, 0.0])
    with pytest.raises(ShapeError, match="start"):
        gp.plan_cartesian(np.zeros(3), goal, scene)
    with pytest.raises(NonFiniteError, match="start"):
        gp.plan_cartesian(np.full(7, np.nan), goal, scene)
    with pytest.raises(UnknownNameError, match="keyframe"):
        gp.plan_cartesian("nowhere", goal, scene)
    for name in ("deviation", "angle"):
        for value in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(SettingError, match=name):
                gp.plan_cartesian("ready", goal, scene, **{name: value})
    with pytest.raises(SettingError, match="speed"):
        gp.plan_cartesian("ready", goal, scene, speed=2.0)
    with pytest.raises(SettingError, match="seed"):
        gp.plan_cartesian("ready", goal, scene, seed=-1)
