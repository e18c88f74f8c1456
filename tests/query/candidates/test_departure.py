"""Plans among moving entities: timed costs, waiting, refused arguments."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.query.candidates.departure import WORTH, waits, with_best_departure

_OBJECTIVE = gp.Objective(impact=gp.ImpactCost(model="mixture"))


@pytest.fixture(scope="module")
def task(scene):
    return scene.tasks["right_to_left"]


@pytest.fixture(scope="module")
def still(task):
    return gp.plan(task.start, task.goal, task.scene, objective=_OBJECTIVE, iterations=300, seed=0)


def passer(trajectory, scene, share, **more):
    """Return a pedestrian who walks through the object's place when it is there and slightly later."""
    t = float(trajectory.t[0] + share * trajectory.duration)
    x, y, _ = scene.data_at(trajectory.at(np.array(t)).q).site(scene.tool).xpos
    times, offset = t + 0.35 + np.array([-2.0, 2.0]), np.array([-2.4, 2.4])
    position = np.column_stack([np.full(2, x), y + offset, np.full(2, 0.85)])
    return gp.MovingEntity("person", "adult", size=[0.2, 0.85], t=times, position=position, spread=0.03, **more)


@pytest.fixture(scope="module")
def crossing(task, still):
    return task.scene.with_moving(passer(still.trajectory, task.scene, 0.5))


# --- costs over time --------------------------------------------------------------------------------------------------


def test_a_trajectory_meets_entities_at_its_times(still, crossing):
    costs = {s: gp.evaluate(still.trajectory, crossing, _OBJECTIVE, start_time=s) for s in (-2.5, 0.0, 2.5)}
    assert costs[0.0].impact_by_entity["person"] > 1.0
    for s in (-2.5, 2.5):
        assert costs[s].impact_by_entity["person"] < 0.01 * costs[0.0].impact_by_entity["person"]
    anywhere = gp.evaluate(still.path, crossing, _OBJECTIVE).impact_by_entity["person"]
    assert 0.0 < anywhere < costs[0.0].impact_by_entity["person"]


@pytest.mark.parametrize("exposure", ["length", "time", "waypoints"])
def test_parts_add_up_for_every_exposure(still, crossing, exposure):
    objective = gp.Objective(impact=gp.ImpactCost(model="mixture"), exposure=exposure)
    cost = gp.evaluate(still.trajectory, crossing, objective)
    assert cost.impact == pytest.approx(sum(cost.impact_by_entity.values()))
    assert cost.impact == pytest.approx(sum(cost.impact_by_component.values()))
    assert cost.impact_by_entity["person"] > 0.0


@pytest.mark.parametrize("exposure", ["length", "time"])
def test_no_moving_entities_change_nothing(task, still, exposure):
    objective = gp.Objective(impact=gp.ImpactCost(model="mixture"), exposure=exposure)
    far = gp.MovingEntity("person", "adult", size=[0.2, 0.85], t=[0.0], position=[[30.0, 0.0, 0.85]])
    with_far = gp.evaluate(still.trajectory, task.scene.with_moving(far), objective)
    without = gp.evaluate(still.trajectory, task.scene, objective)
    assert with_far.total == pytest.approx(without.total)
    assert with_far.impact_by_entity.pop("person") == 0.0


def test_start_times_are_checked(still, crossing):
    with pytest.raises(SettingError, match="start_time"):
        gp.evaluate(still.trajectory, crossing, _OBJECTIVE, start_time=np.nan)


def test_explanations_and_risk_name_them(still, crossing):
    rows = gp.explain(still.trajectory, crossing, _OBJECTIVE).contributions
    assert "person" in {row.entity for row in rows}
    impact = _OBJECTIVE.impact
    alone = gp.risk(still.trajectory, crossing, impact).expected
    assert alone > gp.risk(still.trajectory.delayed(3.0), crossing, impact).expected


# --- waiting ----------------------------------------------------------------------------------------------------------


def test_waits():
    assert waits(0.0).tolist() == [0.0]
    for longest in (0.1, 1.0, 3.0, 100.0):
        tried = waits(longest)
        assert (tried[0], tried[-1]) == (0.0, longest)
        assert len(tried) <= 17


@pytest.mark.parametrize("exposure", ["length", "time"])
def test_waiting_pays_if_a_pedestrian_crosses(still, crossing, exposure):
    objective = gp.Objective(impact=gp.ImpactCost(model="mixture"), exposure=exposure).bind(crossing)
    now, cost_now = with_best_departure(still.trajectory, objective)
    later, cost_later = with_best_departure(still.trajectory, objective, max_wait=3.0)
    assert now.duration == still.trajectory.duration
    assert later.duration > now.duration + 0.2
    assert cost_later.impact_by_entity["person"] < 0.2 * cost_now.impact_by_entity["person"]
    assert cost_later.total < cost_now.total
    assert cost_later == objective.breakdown(later)


def test_no_plan_waits_without_need(task, still):
    gone = passer(still.trajectory, task.scene, 0.5).later(-10.0)
    objective = _OBJECTIVE.bind(task.scene.with_moving(gone))
    trajectory, cost = with_best_departure(still.trajectory, objective, max_wait=3.0)
    assert trajectory.duration == still.trajectory.duration
    assert cost.total == pytest.approx(_OBJECTIVE.bind(task.scene).breakdown(still.trajectory).total, rel=WORTH)


# --- plans ------------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_plan_waits_if_it_may(task, crossing):
    def planned(max_wait):
        return gp.plan(task.start, task.goal, crossing, objective=_OBJECTIVE, iterations=300, seed=0, max_wait=max_wait)

    swift, patient = planned(0.0), planned(3.0)
    for result in (swift, patient):
        assert result.status is gp.PlanStatus.SOLVED
        assert result.verdict.passed
        assert result.cost.total == pytest.approx(gp.evaluate(result.trajectory, crossing, _OBJECTIVE).total)
    assert patient.cost.total <= swift.cost.total * (1.0 + WORTH)
    assert patient.cost.impact_by_entity["person"] <= 0.1


def test_the_judge_does_not_look_at_them(task, still):
    hand = task.scene.data_at(task.start).site(task.scene.tool).xpos
    ghost = gp.MovingEntity("ghost", "adult", size=[0.3, 0.3], t=[0.0], position=[hand])
    haunted = task.scene.with_moving(ghost)
    assert gp.verify(still.trajectory, haunted, start=task.start).passed
    result = gp.plan(task.start, task.goal, haunted, w=0.0, iterations=50, seed=0)
    assert result.status is gp.PlanStatus.SOLVED


@pytest.mark.long
def test_every_exposure_and_model_plans(task, crossing):
    for model in ("box_overlap", "mixture"):
        for exposure in ("time", "waypoints"):
            objective = gp.Objective(impact=gp.ImpactCost(model=model), exposure=exposure)
            result = gp.plan(task.start, task.goal, crossing, objective=objective, iterations=4, seed=0)
            assert result.status is gp.PlanStatus.SOLVED


@pytest.mark.parametrize("max_wait", [-1.0, np.nan, np.inf])
def test_waits_of_plans_are_checked(task, crossing, max_wait):
    with pytest.raises(SettingError, match="max_wait"):
        gp.plan(task.start, task.goal, crossing, max_wait=max_wait)


def test_no_plan_waits_without_moving_entities(task):
    with pytest.raises(SettingError, match="where nothing moves"):
        gp.plan(task.start, task.goal, task.scene, max_wait=1.0)
