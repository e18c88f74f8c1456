"""Via poses: passed in order, without a stop where possible, or the result names the one that is not."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError, UnknownNameError
from graceful_plan.judge.passing import passing
from graceful_plan.query.via.legs import one_after_the_other
from graceful_plan.query.via.stages import find_stages
from graceful_plan.result import PlanStatus
from graceful_plan.scene.pose_goal import pose_error
from graceful_plan.timing.retiming import retime

Array = np.ndarray

_NEAR = 1e-4
"""Joint error at which a configuration counts as passed [rad]."""


def _plan(scene, start, goal, via, **settings):
    return gp.plan(start, goal, scene, via=via, **({"iterations": 100} | settings))


def _nearest(trajectory: gp.Trajectory, q: Array) -> tuple[float, float]:
    """Return the least joint error on the way [rad], and its time."""
    t = np.linspace(trajectory.t[0], trajectory.t[-1], 20_001)
    error = np.abs(trajectory.at(t).q - q).max(axis=1)
    return float(error.min()), float(t[error.argmin()])


def test_configurations_are_passed_in_order_and_without_a_stop(scene):
    via = [scene.keyframes["above_blue"], "above_green"]
    result = _plan(scene, "right", "left", via)
    assert result.status is PlanStatus.SOLVED and not result.detail
    trajectory = result.unwrap()
    found = [_nearest(trajectory, scene.keyframes[name]) for name in ("above_blue", "above_green")]
    assert all(error < 1e-3 for error, _ in found) and found[0][1] < found[1][1]
    assert (np.abs(trajectory.qd[1:-1]).max(axis=1) > 1e-3).all()
    assert result.verdict.checks["via"].passed and result.verdict.checks["via"].worst < 1.0
    assert result.cost == gp.evaluate(trajectory, scene)
    assert result.trace[-1].total == result.cost.total
    np.testing.assert_allclose(trajectory.q[-1], scene.keyframes["left"], atol=1e-9)


def test_poses_are_passed(scene):
    pose = gp.PoseGoal.from_tool(scene.keyframes["ready"], scene, translation=[0.0, 0.2, 0.1])
    result = _plan(scene, "right", "left", [pose])
    trajectory = result.unwrap()
    check, times = passing(trajectory, [pose], scene)
    assert check.passed and len(times) == 1 and f"{times[0]:.3f} s" in check.detail
    reached = gp.PoseGoal.from_tool(trajectory.at(np.array(times[0])).q, scene)
    distance, angle = pose_error(pose, reached.X_WT)
    assert distance <= 1e-3 and angle <= 1e-2


def test_the_same_place_twice_and_the_start_itself(scene):
    result = _plan(scene, "right", "right", ["left", "right", "left"])
    assert result.status is PlanStatus.SOLVED, result.detail
    _, times = passing(result.unwrap(), [scene.keyframes[n] for n in ("left", "right", "left")], scene)
    assert len(times) == 3 and times[0] < times[1] < times[2]
    assert _plan(scene, "right", "left", ["right"]).status is PlanStatus.SOLVED


def test_a_via_in_collision_is_named(scene):
    hit = scene.keyframes["right"].copy()
    hit[1] = 1.7
    result = _plan(scene, "right", "left", ["above_green", hit])
    assert result.status is PlanStatus.INVALID_GOAL and result.detail.startswith("via 1: panda/")


def test_a_via_out_of_reach_is_named(scene):
    result = _plan(scene, "right", "left", [gp.PoseGoal.at([3.0, 0.0, 0.5], free_yaw=True)])
    assert result.status is PlanStatus.INVALID_GOAL
    assert result.detail.startswith("via 0: no configuration within the limits reaches the pose")


def test_a_leg_without_budget_is_named(scene):
    result = _plan(scene, "right", "left", ["above_blue"], time_limit=0.0)
    assert result.status is PlanStatus.TIMEOUT and result.detail.startswith("from the start to via 0: ")


def test_no_via_is_no_via(scene):
    settings = {"iterations": 50, "seed": 1}
    plain = gp.plan("right", "left", scene, **settings)
    empty = gp.plan("right", "left", scene, via=[], **settings)
    np.testing.assert_array_equal(plain.unwrap().q, empty.unwrap().q)


def test_iterations_make_it_reproducible(scene):
    settings = {"iterations": 60, "seed": 2}
    first, again = (_plan(scene, "right", "left", ["above_blue"], **settings).unwrap().q for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_the_carried_object_comes_along(task):
    above = gp.PoseGoal.from_tool(task.start, task.scene, translation=[0.0, 0.0, 0.1])
    result = _plan(task.scene, task.start, task.goal, [above], w=1.0)
    assert result.status is PlanStatus.SOLVED, result.detail
    assert result.goal_index is not None and result.cost.w == 1.0


def test_cancelled_at_once(scene):
    result = _plan(scene, "right", "left", ["above_blue"], cancelled=lambda: True)
    assert result.status is PlanStatus.CANCELLED


def test_the_callback_gets_the_motion(scene):
    seen = []
    result = _plan(scene, "right", "left", ["above_blue"], callback=seen.append)
    assert [point.total for point in seen] == [result.cost.total]


def test_legs_in_a_row_stop_in_between(scene):
    q = [scene.keyframes[name] for name in ("right", "above_blue", "left")]
    legs = [retime(gp.Path(np.array(q[k : k + 2])), scene.limits, scene.joints) for k in range(2)]
    whole = one_after_the_other(legs)
    assert whole.duration == pytest.approx(sum(leg.duration for leg in legs))
    np.testing.assert_allclose(whole.at(np.array(legs[0].duration)).q, q[1], atol=1e-9)
    np.testing.assert_allclose(whole.at(np.array(legs[0].duration)).qd, 0.0, atol=1e-9)
    check, times = passing(whole, [q[1]], scene)
    assert check.passed and times[0] == pytest.approx(legs[0].duration, abs=1e-2)


def test_missed_and_misordered_poses_are_found(scene):
    right, blue, left = (scene.keyframes[name] for name in ("right", "above_blue", "left"))
    motion = retime(gp.Path(np.array([right, blue, left])), scene.limits, scene.joints, deviation=0.0)
    assert passing(motion, [right, blue, left], scene)[0].passed
    check, times = passing(motion, [left, blue], scene)
    assert not check.passed and "via 1 " in check.detail and len(times) == 1
    off = blue + 10.0 * _NEAR
    check, _ = passing(motion, [off], scene)
    assert not check.passed and check.worst == pytest.approx(10.0, rel=0.5)


def test_stages_take_the_configurations_that_make_the_way_short(scene):
    pose = gp.PoseGoal.from_tool(scene.keyframes["above_blue"], scene)
    stages = find_stages("right", [pose], "left", gp.Objective().bind(scene), 0)
    chosen = stages.chosen()
    lengths = [np.linalg.norm(q - chosen[0]) + np.linalg.norm(chosen[2] - q) for q in stages.usable[1]]
    np.testing.assert_array_equal(chosen[1], stages.usable[1][int(np.argmin(lengths))])


def test_misuse(scene):
    with pytest.raises(ShapeError, match=r"via\[1\]"):
        _plan(scene, "right", "left", ["above_blue", [0.0, 1.0]])
    with pytest.raises(NonFiniteError, match=r"via\[0\]"):
        _plan(scene, "right", "left", [np.full(7, np.nan)])
    with pytest.raises(UnknownNameError, match="nowhere"):
        _plan(scene, "right", "left", ["nowhere"])
    with pytest.raises(SettingError, match="via"):
        _plan(scene, "right", "left", "above_blue")
