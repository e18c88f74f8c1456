"""Random floors: the same for a seed, connected, and suitable for planning."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.floor.generated import floor_plan, obstacle_course
from graceful_plan.mobile.floor.grid_paths import FloorGrid, GridStatus
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from sizes import first_quick


@pytest.mark.parametrize("seed", range(5))
def test_floor_plans_leave_a_way(seed):
    one, two = floor_plan(seed), floor_plan(seed)
    np.testing.assert_array_equal(one.floor.occupied, two.floor.occupied)
    np.testing.assert_array_equal(one.start, two.start)
    path = FloorGrid(floor=one.floor, radius=0.4).path(one.start[:2], one.goal[:2])
    # People block cells, too, so the path past them is no shorter.
    assert path.status is GridStatus.SOLVED and path.cost <= one.length + 1e-6
    assert {solid.entity for solid in one.floor.entities} <= {"adult", "child", "pet", "heirloom", "glass"}
    assert (gp.clearance(np.array([one.start, one.goal]), one.floor.to_scene()) > 0.05).all()


def test_seeds_differ_and_the_number_of_rooms_is_kept():
    assert not np.array_equal(floor_plan(0).floor.occupied, floor_plan(1).floor.occupied)
    assert floor_plan(3, rooms=(4, 3), people=9).floor.shape == (270, 360)
    assert len(floor_plan(3, people=9).floor.entities) == 9


def test_courses_are_10_m_and_have_cylinders():
    course = obstacle_course(1)
    assert course.goal[0] - course.start[0] == 10.0 and course.length >= 10.0
    assert 0.03 < course.floor.occupied.mean() < 0.3


def test_misuse_is_refused():
    with pytest.raises(SettingError, match="passage"):
        floor_plan(0, passage=0.6)
    with pytest.raises(SettingError, match="fill"):
        obstacle_course(0, fill=0.9)


@pytest.mark.parametrize("planner", first_quick(["auto", "floor_theta_star"]))
def test_plan_works_on_maps(planner):
    occupied = np.zeros((60, 60), dtype=bool)
    occupied[28:32, :40] = True
    person = gp.StaticBody(
        name="ann", kind="cylinder", size=[0.25, 0.85], pose=np.array([2.6, 0.6, 0.85]), entity="adult"
    )
    scene = OccupancyGrid(occupancy=occupied, resolution=0.05, entities=(person,)).to_scene()
    start, goal = np.array([0.6, 0.7, 0.0]), gp.BasePose(0.6, 2.4, 3.0)
    result = gp.plan(start, goal, scene, w=0.1, planner=planner, iterations=300)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.passed
    np.testing.assert_allclose(result.trajectory.q[-1, :2], [0.6, 2.4], atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_courses_are_planned(seed):
    course = obstacle_course(seed)
    goal = gp.BasePose(*course.goal[:2])
    result = gp.plan(course.start, goal, course.floor.to_scene(), w=0.0, iterations=20_000)
    assert result.status is gp.PlanStatus.SOLVED and result.path.length >= 0.95 * course.length


def test_arms_are_refused_by_planners_for_bases():
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    with pytest.raises(SettingError, match="no DiffDrive"):
        gp.plan(task.start, task.goal, task.scene, planner="floor_theta_star")
