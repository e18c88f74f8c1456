"""gp.pareto on scenes: its motions are verified, and impossible requests end with their exact status."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.tuning.fronts import ChoiceStatus, FrontProgress
from graceful_plan.tuning.points import dominated_area

_ITERATIONS = 600


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop_l1").tasks["green_to_blue"]


@pytest.fixture(scope="module")
def front(task):
    return gp.pareto(task.start, task.goal, task.scene, points=10, iterations=_ITERATIONS)


def test_a_front_is_found_and_every_point_is_verified(task, front):
    assert front.status is gp.PlanStatus.SOLVED
    assert 4 <= len(front) <= 10
    assert front.scene == task.scene.notes.name
    assert np.all(np.diff(front.costs[:, 0]) > 0.0) and np.all(np.diff(front.costs[:, 1]) < 0.0)
    for point in front.points:
        assert point.verdict.passed
        assert gp.verify(point.trajectory, task.scene, start=task.start, goal=task.goal).passed
        cost = gp.evaluate(point.trajectory, task.scene)
        assert (point.motion, point.impact) == (pytest.approx(cost.motion), pytest.approx(cost.impact))
        assert point.cost.impact_by_entity == pytest.approx(cost.impact_by_entity)


def test_a_front_is_worth_more_than_its_planner_alone(task, front):
    """Compare with two weighted sums, each with half as many iterations as the whole front."""
    costs = [gp.plan(task.start, task.goal, task.scene, w=w, iterations=_ITERATIONS // 2).cost for w in (0.0, 1.0)]
    alone = np.array([(cost.motion, cost.impact) for cost in costs])
    reference = 1.1 * np.vstack([front.costs, alone]).max(axis=0)
    assert dominated_area(front.costs, reference) > dominated_area(alone, reference)


@pytest.mark.long
def test_front_repeats_itself_by_iterations(task, front):
    again = gp.pareto(task.start, task.goal, task.scene, points=10, iterations=_ITERATIONS)
    assert [p.path.q.tobytes() for p in again.points] == [p.path.q.tobytes() for p in front.points]


def test_front_comes_back_from_its_file(front, tmp_path):
    front.save(tmp_path / "front.json")
    again = gp.ParetoFront.load(tmp_path / "front.json")
    assert again.to_json() == front.to_json()
    np.testing.assert_array_equal(again.points[-1].trajectory.qd, front.points[-1].trajectory.qd)


def test_choice_of_a_front(front):
    choice = front.choose(target_impact=0.5 * front.points[0].impact)
    assert choice.status is ChoiceStatus.MET
    assert choice.point.impact <= 0.5 * front.points[0].impact


@pytest.mark.long
def test_times_are_recorded_and_reported(task):
    told: list[FrontProgress] = []
    front = gp.pareto(task.start, task.goal, task.scene, points=4, iterations=_ITERATIONS, callback=told.append)
    assert front.status is gp.PlanStatus.SOLVED
    assert told and told[-1].candidates >= 2
    assert [p.time for p in told] == sorted(p.time for p in told)
    assert front.stats["search_time"] <= front.stats["total_time"]


def test_callbacks_end_the_search(task):
    front = gp.pareto(task.start, task.goal, task.scene, iterations=10**9, callback=lambda progress: True)
    assert front.status is gp.PlanStatus.SOLVED
    assert front.stats["candidates"] == 1.0


def test_no_time_is_a_timeout(task):
    for budget in ({"time_limit": 0.0}, {"iterations": 0}):
        front = gp.pareto(task.start, task.goal, task.scene, **budget)
        assert (front.status, len(front)) == (gp.PlanStatus.TIMEOUT, 0)
        assert "no path" in front.detail
        assert front.choose(target_impact=1.0).status is ChoiceStatus.NO_FRONT


def test_start_at_the_goal_is_one_point_without_cost(task):
    front = gp.pareto(task.start, task.start, task.scene, iterations=50)
    assert front.status is gp.PlanStatus.SOLVED
    assert front.costs.tolist() == [[0.0, 0.0]]
    assert front.choose(max_detour=0.1).point is front.points[0]
    assert front.hypervolume() == 0.0


def test_ends_that_cannot_be_used_have_their_status(task):
    low, high = task.scene.limits.position.T
    q = np.random.default_rng(0).uniform(low, high, (300, len(low)))
    colliding = q[gp.clearance(q, task.scene) < -0.02][0]
    start = gp.pareto(colliding, task.goal, task.scene, iterations=10)
    assert start.status is gp.PlanStatus.INVALID_START and " mm in " in start.detail
    goal = gp.pareto(task.start, high + 1.0, task.scene, iterations=10)
    assert goal.status is gp.PlanStatus.INVALID_GOAL and "limit" in goal.detail


@pytest.mark.long
def test_several_goals_and_other_exposures(task):
    goals = np.concatenate([task.goal, task.start[None]])
    front = gp.pareto(task.start, goals, task.scene, iterations=50)
    assert front.costs.tolist() == [[0.0, 0.0]]
    by_time = gp.Objective(exposure="time", impact=gp.ImpactCost(model="box_overlap"))
    front = gp.pareto(task.start, task.goal, task.scene, iterations=300, points=3, objective=by_time)
    assert front.status is gp.PlanStatus.SOLVED
    point = front.points[0]
    assert point.impact == pytest.approx(gp.evaluate(point.trajectory, task.scene, by_time).impact)


@pytest.mark.long
def test_planners_with_a_single_path_work(task):
    front = gp.pareto(task.start, task.goal, task.scene, iterations=400, points=4, planner=gp.RRTConnect())
    assert front.status is gp.PlanStatus.SOLVED
    assert len(front) > 1, "the roadmap and the refinement do the rest"


@pytest.mark.long
def test_sums_over_waypoints_do_without_a_roadmap(task):
    paper = gp.Objective(exposure="waypoints", impact=gp.ImpactCost(model="box_overlap"))
    front = gp.pareto(task.start, task.goal, task.scene, iterations=100, points=3, objective=paper)
    assert front.status is gp.PlanStatus.SOLVED
    assert all(point.made_by != "roadmap" for point in front.points)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"points": 1}, SettingError, "points"),
        ({"points": True}, SettingError, "points"),
        ({"planner": "hope"}, UnknownNameError, "hope"),
        ({"seed": -1}, SettingError, "seed"),
        ({"time_limit": np.nan}, SettingError, "time_limit"),
        ({"speed": 0.0}, SettingError, "speed"),
    ],
)
def test_misuse(task, settings, error, message):
    with pytest.raises(error, match=message):
        gp.pareto(task.start, task.goal, task.scene, **settings)


@pytest.mark.long
def test_every_point_keeps_the_constraints(task):
    upright = gp.Upright(np.deg2rad(20.0))
    front = gp.pareto(task.start, task.goal, task.scene, points=3, iterations=400, constraints=[upright])
    assert front.points and all(point.verdict.checks["upright"].passed for point in front.points)
    plain = gp.pareto(task.start, task.goal, task.scene, points=3, iterations=400, constraints=[])
    assert plain.points and not any("grasp_holds" in point.verdict.checks for point in plain.points)
