"""Starts of real robots: turns away, a little outside of a limit, or in a grazing contact."""

import numpy as np
import pytest
from goal_arms import arm

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError

TURN = 2.0 * np.pi
ENDLESS = arm("planar", {"j0": None})


def plan(start, goal, scene=ENDLESS, **given):
    return gp.plan(start, goal, scene, w=0.0, **{"iterations": 10, **given})


# --- joints that turn without end -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "goal", "travel"),
    [(6.0, 0.5, 0.5 + TURN - 6.0), (7.5, 7.0, 0.5), (-40.0, -40.3, 0.3), (7.5, 7.5 - TURN, 0.0),
     (3.0, -3.0, TURN - 6.0), (0.2, 30.0 * TURN, 0.2)],
)  # fmt: skip
def test_an_endless_joint_turns_the_short_way_from_any_number_of_turns(start, goal, travel):
    result = plan([start, 0.4, 0.2], [goal, 0.4, 0.2])
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    q = result.trajectory.q[:, 0]
    assert q[0] == pytest.approx(start, abs=1e-9) and result.path.q[0, 0] == pytest.approx(start, abs=1e-9)
    assert np.abs(np.diff(q)).sum() == pytest.approx(travel, abs=0.02)
    assert np.exp(1j * q[-1]) == pytest.approx(np.exp(1j * goal), abs=1e-6)
    verdict = gp.verify(result.trajectory, ENDLESS, start=[start, 0.4, 0.2], goal=[goal, 0.4, 0.2])
    assert verdict.passed, verdict.failures


def test_via_configurations_count_on_the_circle():
    result = plan([6.0, 0.4, 0.2], [9.0, 0.4, 0.2], via=[[0.5 + TURN, 0.6, 0.2], [1.5, 0.6, 0.2]], time_limit=20.0)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    q = result.trajectory.q[:, 0]
    assert q[0] == pytest.approx(6.0) and q[-1] == pytest.approx(9.0, abs=1e-6)
    assert np.abs(np.diff(q)).sum() < 3.3


def test_a_joint_with_limits_keeps_its_turns():
    wide = arm("planar", {"j0": (-40.0, 40.0)})
    result = plan([0.0, 0.4, 0.2], [7.0, 0.4, 0.2], wide)
    assert result.trajectory.q[-1, 0] == 7.0


@pytest.mark.parametrize("limit", [40.0, 900.0, 1e5])
def test_a_pose_is_reached_without_spin_in_a_wide_range(limit):
    wide = arm("six", {f"j{k}": (-limit, limit) for k in range(6)})
    start = np.array([20.1, -0.4, 0.9, 0.2, -20.5, 0.3])
    X = compile_scene(wide).kernels.tool_pose(start + [0.5, 0.2, -0.4, 0.3, 0.4, 0.1])
    result = plan(start, gp.PoseGoal(X), wide)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert np.abs(np.diff(result.trajectory.q, axis=0)).sum(axis=0).max() < 1.0


@pytest.mark.parametrize("planner", ["auto", "rrt_connect", "rrt_star", "prm"])
def test_planners_go_round_an_obstacle_in_a_huge_range(planner):
    scene = arm("planar", {f"j{k}": (-900.0, 900.0) for k in range(3)})
    scene = scene.add_box("post", [0.05, 0.05, 0.2], [0.45, 0.2, 0.4])
    result = plan([0.0, 0.0, 0.0], [1.2, 0.0, 0.0], scene, planner=planner, iterations=400, time_limit=20.0)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert np.abs(np.diff(result.trajectory.q, axis=0)).sum(axis=0).max() < 8.0


# --- a little outside of a limit --------------------------------------------------------------------------------------


@pytest.mark.parametrize("outside", [2e-6, 1.1e-5, 1e-4, 1e-3, 4e-3])
def test_a_start_just_outside_of_a_limit_moves_inside_first(outside):
    scene = arm("seven")
    upper = scene.limits.position[1, 1]
    start = np.array([0.1, upper + outside, 0.3, -1.0, 0.2, 1.0, 0.1])
    result = plan(start, start + [0.2, -0.5, 0.0, -0.3, 0.0, 0.2, 0.0], scene)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    np.testing.assert_array_equal(result.trajectory.q[0], start)
    np.testing.assert_array_equal(result.path.q[0], start)
    assert "'arm/j1'" in result.detail and result.verdict.checks["position_limits"].passed
    assert result.cost.motion == pytest.approx(gp.evaluate(result.trajectory, scene, gp.Objective(w=0.0)).motion)
    # The judge accepts it with the tolerance only, and nothing may go farther out.
    assert gp.verify(result.trajectory, scene, start=start, start_tolerance=0.005).passed
    assert "position_limits" in gp.verify(result.trajectory, scene, start=start).failures


def test_a_start_farther_outside_is_refused_unless_asked_for():
    scene = arm("seven")
    start = np.array([0.1, scene.limits.position[1, 1] + 0.02, 0.3, -1.0, 0.2, 1.0, 0.1])
    goal = start - [0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    refused = plan(start, goal, scene)
    assert refused.status is gp.PlanStatus.INVALID_START and "'arm/j1'" in refused.detail
    assert plan(start, goal, scene, start_tolerance=0.03).status is gp.PlanStatus.SOLVED
    start[1] -= 0.0199
    assert plan(start, goal, scene, start_tolerance=0.0).status is gp.PlanStatus.INVALID_START
    for tolerance in (-0.1, np.nan, 1.0):
        with pytest.raises(SettingError, match="start_tolerance"):
            plan(start, goal, scene, start_tolerance=tolerance)


def test_a_goal_outside_of_a_limit_is_refused():
    scene = arm("seven")
    start = np.array([0.1, 1.0, 0.3, -1.0, 0.2, 1.0, 0.1])
    goal = start.copy()
    goal[1] = scene.limits.position[1, 1] + 1e-3
    assert plan(start, goal, scene).status is gp.PlanStatus.INVALID_GOAL


def test_a_motion_that_goes_farther_out_is_no_way_back():
    scene = arm("planar")
    upper = scene.limits.position[0, 1]
    t, still = np.array([0.0, 1.0, 2.0]), np.zeros((3, 3))
    q = np.array([[upper + 0.001, 0.0, 0.0], [upper + 0.002, 0.0, 0.0], [upper - 0.1, 0.0, 0.0]])
    verdict = gp.verify(gp.Trajectory(t, q, still, still, scene.joints), scene, start_tolerance=0.005)
    assert "position_limits" in verdict.failures


# --- grazing contacts -------------------------------------------------------------------------------------------------

PRESS = """
<mujoco><worldbody><geom name="table" type="box" size="1 1 .1" pos="0 0 -.1"/>
  <body name="arm/x" pos="0 0 .05"><joint name="arm/z" type="slide" axis="0 0 1" range="-.1 .5"/>
    <geom name="foot" type="box" size=".05 .05 .05" mass="1"/>
    <body name="arm/y"><joint name="arm/y" type="slide" axis="0 1 0" range="-.5 .5"/>
    <geom name="knee" type="sphere" size=".02" pos="0 0 .2" mass="1"/><site name="arm/tip" pos="0 0 .2"/></body></body>
</worldbody></mujoco>"""


def press():
    return gp.Scene.from_mjcf(PRESS, robot="arm/x", tool="arm/tip", velocity=[1.0, 1.0], acceleration=[5.0, 5.0])


@pytest.mark.parametrize("depth", [1e-9, 5e-7])
def test_depths_of_nanometres_are_no_collision(depth):
    scene = press()
    trajectory = gp.retime(gp.Path(np.array([[-depth, 0.0], [-depth, 0.2]])), scene.limits, scene.joints)
    assert gp.verify(trajectory, scene).passed
    deep = gp.retime(gp.Path(np.array([[-1e-4, 0.0], [-1e-4, 0.2]])), scene.limits, scene.joints)
    assert gp.verify(deep, scene).failures == ("collision",)


@pytest.mark.parametrize("depth", [1e-5, 4e-4])
def test_a_grazing_start_moves_out_first(depth):
    scene = press()
    start = np.array([-depth, 0.0])
    result = plan(start, [0.2, 0.1], scene)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    np.testing.assert_array_equal(result.trajectory.q[0], start)
    assert "foot" in result.detail and "table" in result.detail
    assert gp.verify(result.trajectory, scene, start=start, start_tolerance=0.005).passed
    assert gp.verify(result.trajectory, scene, start=start).failures == ("collision",)


def test_a_deeper_contact_is_refused():
    result = plan([-2e-3, 0.0], [0.2, 0.1], press())
    assert result.status is gp.PlanStatus.INVALID_START and "foot" in result.detail


def test_a_motion_along_a_grazing_contact_is_a_collision():
    scene = press()
    trajectory = gp.retime(gp.Path(np.array([[-3e-4, 0.0], [-4e-4, 0.2], [0.1, 0.2]])), scene.limits, scene.joints)
    assert "collision" in gp.verify(trajectory, scene, start_tolerance=0.005).failures
