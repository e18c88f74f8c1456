"""Plans of bases among entities that move."""

import pytest

import graceful_plan as gp
from hall import hall

SCENE = hall(extra="").edit(remove=["person", "pillar"])
CROSSING = gp.MovingEntity(
    "ann", "adult", size=[0.25, 0.85], t=[0.0, 4.0], position=[[0.0, -1.6, 0.85], [0.0, 1.6, 0.85]], spread=0.05
)
"""A pedestrian who is in the middle of the hall when a base that starts at once gets there."""


def planned(scene, **given):
    given.setdefault("iterations", 300)
    return gp.plan("west", "east", scene, **given)


@pytest.mark.long
def test_the_planner_over_cells_and_time_without_moving_entities():
    result = planned(SCENE, planner="floor_in_time")
    assert result.status is gp.PlanStatus.SOLVED


@pytest.mark.long
def test_pedestrians_are_avoided_with_less_harm_than_without_times():
    scene = SCENE.with_moving(CROSSING)
    unaware, aware = planned(SCENE), planned(scene)
    assert unaware.status is aware.status is gp.PlanStatus.SOLVED
    ran_over = gp.verify(unaware.trajectory, scene)
    assert ran_over.warnings == ("passing_by",) and ran_over.passed
    assert aware.verdict.checks["passing_by"].passed and "ann" in aware.verdict.checks["passing_by"].detail
    harm = gp.evaluate(unaware.trajectory, scene).impact_by_entity["ann"]
    assert aware.cost.impact_by_entity["ann"] < 0.2 * harm
    assert aware.trajectory.duration < unaware.trajectory.duration + 4.0
    assert gp.evaluate(aware.trajectory, scene).total == pytest.approx(aware.cost.total)


@pytest.mark.long
def test_distant_entities_change_nothing_and_plans_at_w_0_avoid_entities():
    far = gp.MovingEntity("ann", "adult", size=[0.25, 0.85], t=[0.0], position=[[30.0, 30.0, 0.85]])
    # Searches divide the 300 iterations differently, and one uses cells, so the motion may be slightly better.
    alone, haunted = planned(SCENE), planned(SCENE.with_moving(far))
    assert haunted.trajectory.duration == pytest.approx(alone.trajectory.duration, rel=0.02)
    assert haunted.cost.total <= 1.01 * alone.cost.total
    ordinary = planned(SCENE.with_moving(CROSSING), w=0.0)
    assert ordinary.status is gp.PlanStatus.SOLVED and ordinary.verdict.checks["passing_by"].passed


@pytest.mark.long
def test_the_planner_over_cells_and_time_alone():
    result = planned(SCENE.with_moving(CROSSING), planner="floor_in_time")
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["passing_by"].passed


@pytest.mark.long
def test_entities_that_cannot_be_passed_are_named_in_a_warning():
    wall = gp.MovingEntity("crowd", "adult", size=[0.3, 9.0, 0.85], t=[0.0], position=[[0.0, 0.0, 0.85]])
    result = planned(SCENE.with_moving(wall), iterations=1000)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.warnings == ("passing_by",)
    assert "passing_by: drives into 'crowd'" in result.detail
