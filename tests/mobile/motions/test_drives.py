import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.mobile.motions.drive import Drive, StraightMove
from graceful_plan.mobile.motions.drive_timing import slower
from graceful_plan.mobile.motions.stages import Move, stages
from hall import BASE, WALLS, hall

SCENE = hall()


def planned(goal, scene=SCENE, start="west", **given):
    given.setdefault("iterations", 2000)
    return gp.plan(start, goal, scene, **given)


@pytest.fixture(scope="module")
def east():
    return planned("east", w=1.0)


def test_a_base_drives_around_obstacles():
    result = planned("east", w=0.0)  # with w > 0 it is slow near the person
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["rolling"].passed
    trajectory = result.trajectory
    np.testing.assert_allclose(trajectory.q[[0, -1]], [[-4, 0, 0], [4, 0, 0]], atol=1e-9)
    # One smooth curve without stops, hardly slower than the straight line.
    speed = np.linalg.norm(trajectory.at(np.linspace(0.3, trajectory.duration - 0.3, 500)).qd[:, :2], axis=1)
    assert speed.min() > 0.3
    assert trajectory.duration < 1.15 * (8.0 / BASE.v_max + BASE.v_max / BASE.a_max)


def test_results_have_the_stated_cost_and_pass_an_independent_check(east):
    assert gp.evaluate(east.trajectory, SCENE, gp.Objective(w=1.0)).total == pytest.approx(east.cost.total)
    assert gp.verify(east.trajectory, SCENE, start=[-4, 0, 0], goal=[4, 0, 0]).passed


def test_candidates_drive_other_ways_and_pass_the_judge(east):
    result = planned("east", w=1.0, candidates=3)
    np.testing.assert_array_equal(result.trajectory.q, east.trajectory.q)
    assert 2 <= len(result.candidates) <= 3 and result.candidates[0].trajectory is result.trajectory
    for one in result.candidates:
        assert gp.verify(one.trajectory, SCENE, start=[-4, 0, 0], goal=[4, 0, 0]).passed
        assert result.cost.total <= one.cost.total < 4.0 * result.cost.total


@pytest.mark.long
@given(st.floats(-5, 5), st.floats(-1.3, 1.3), st.floats(-3.1, 3.1))
@settings(max_examples=12, deadline=None)
def test_goals_anywhere_are_reached_rolling_or_refused(x, y, yaw):
    result = planned(gp.BasePose(x, y, yaw), iterations=2000)
    assert result.status in (gp.PlanStatus.SOLVED, gp.PlanStatus.INVALID_GOAL)
    if result.status is gp.PlanStatus.SOLVED:
        end = result.trajectory.q[-1]
        np.testing.assert_allclose(end[:2], [x, y], atol=1e-6)
        assert abs(np.remainder(end[2] - yaw + np.pi, 2 * np.pi) - np.pi) < 1e-6
        assert gp.verify(result.trajectory, SCENE).passed


def test_tight_places_are_reported():
    tight = gp.BasePose(0.0, 0.578125, 2.625)  # half a millimetre beside the pillar
    result = planned(tight)
    assert result.status is gp.PlanStatus.INVALID_GOAL and "clearance" in result.detail
    away = planned("west", start=[0.0, 0.578125, 2.625])
    assert away.status is gp.PlanStatus.INVALID_START and "clearance" in away.detail


def test_any_heading_will_do_where_none_is_given():
    result = planned(gp.BasePose(-4.0, 1.0))
    assert result.status is gp.PlanStatus.SOLVED and result.goal_index == 0
    turned = planned(gp.BasePose(-4.0, 1.0, 0.0))
    assert result.cost.motion < turned.cost.motion


def test_one_of_several_poses():
    result = planned([gp.BasePose(4.0, 0.0, 0.0), gp.BasePose(-3.0, 0.0, 0.0)], w=0.0)
    assert result.goal_index == 1


def test_a_pose_in_a_wall_is_no_goal():
    result = planned(gp.BasePose(0.0, 2.0))
    assert result.status is gp.PlanStatus.INVALID_GOAL and "north" in result.detail


def test_a_missing_path_is_reported():
    wall = '<body name="wall" pos="-2 0 .5"><geom type="box" size=".05 2 .5"/></body>'
    ends = '<body name="end" pos="-6 0 .5"><geom type="box" size=".05 2 .5"/></body>'
    planner = gp.DriveLattice(cells=(0.4,))
    result = planned("east", hall(walls=WALLS + wall + ends), planner=planner, iterations=2_000_000)
    assert result.status is gp.PlanStatus.TIMEOUT and result.trajectory is None
    assert "drive_lattice" in result.detail  # it gave up, which proves nothing


def test_staying_is_a_motion():
    result = planned("west")
    assert result.status is gp.PlanStatus.SOLVED and result.trajectory.duration == 0.0


def test_the_arm_moves_with_the_base():
    scene = hall(arm=True)
    result = planned([4.0, 0.5, 0.0, -0.9], scene)
    assert result.status is gp.PlanStatus.SOLVED
    assert gp.verify(result.trajectory, scene, goal=[4.0, 0.5, 0.0, -0.9]).passed


def test_slower_is_slower():
    full, half = (planned("east", w=0.0, speed=speed).trajectory.duration for speed in (1.0, 0.5))
    assert 1.7 * full < half < 2.05 * full  # slower motions may turn tighter


def test_a_drive_whose_timing_merges_points_drives_at_full_speed():
    q = np.zeros(3), np.array([1.0, 0.0, 0.0])
    drive = Drive((StraightMove(*q),))
    assert slower(drive, np.array([0.0, 1e-5]), np.zeros((2, 3))) is None


def test_other_planners_do_not_roll():
    with pytest.raises(SettingError, match="rrt_connect"):
        planned("east", planner="rrt_connect")
    with pytest.raises(SettingError, match="DiffDrive"):
        planned("east", hall(None), planner=gp.DriveLattice())
    with pytest.raises(SettingError, match="DiffDrive"):
        planned(gp.BasePose(0.0, 1.0), hall(None))


def test_pareto_and_roadmap_refuse_bases():
    with pytest.raises(UnsupportedError, match="pareto"):
        gp.pareto("west", "east", SCENE, time_limit=1.0)
    with pytest.raises(UnsupportedError, match="roadmap"):
        gp.Roadmap.build(SCENE, time_limit=1.0)


@pytest.mark.long
def test_poses_on_the_way_are_passed():
    result = planned("east", via=[[0.0, 1.2, 0.0]])
    assert result.status is gp.PlanStatus.SOLVED and gp.verify(result.trajectory, SCENE).passed
    assert np.linalg.norm(result.trajectory.q - [0.0, 1.2, 0.0], axis=1).min() < 1e-6


@pytest.mark.long
def test_the_same_seed_is_the_same_motion():
    first, second = (planned(gp.BasePose(3.0, 1.0, 2.0)) for _ in range(2))
    np.testing.assert_array_equal(first.trajectory.q, second.trajectory.q)


def test_stages_of_a_path():
    q = [[0, 0, 0], [1, 0, 0], [1, 0, 0.5], [1.5, 0.5 * np.tan(0.5), 0.5], [1.5, 0.5 * np.tan(0.5), 3.0]]
    found = stages(gp.Path(np.array(q)))
    assert [stage.kind for stage in found] == [Move.FORWARD, Move.TURN]
    assert [len(stage.q) for stage in found] == [4, 2]
    back = gp.Path(np.array([[0, 0, 0], [1, 0, 0], [0.5, 0, 0]], dtype=float))
    assert [stage.kind for stage in stages(back)] == [Move.FORWARD, Move.BACKWARD]
