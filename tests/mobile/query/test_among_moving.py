"""Plans of bases among entities that move."""

import sys

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.mobile.motions import drive_source
from graceful_plan.mobile.motions.legs import RollingLeg
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


def test_legs_through_poses_meet_moving_entities_where_they_then_are(monkeypatch):
    legs, plan = [], gp.plan

    def told(*args, **given):
        result = plan(*args, **given)
        legs.append((given["scene"].moving["ann"], result.trajectory.duration))
        return result

    monkeypatch.setattr(sys.modules["graceful_plan.plan"], "plan", told)
    result = plan("west", "east", SCENE.with_moving(CROSSING), via=[[-1.0, -0.5, 0.0]], iterations=20)
    assert result.status is gp.PlanStatus.SOLVED
    (first, seconds), (second, _) = legs
    np.testing.assert_allclose(first.t, CROSSING.t)
    np.testing.assert_allclose(second.t, CROSSING.t - seconds)


def test_legs_in_another_gear_meet_moving_entities_where_they_then_are(monkeypatch):
    spied, starts = drive_source.motion_descents, []

    def told(request, *given):
        starts.append(request.objective.scene.moving["ann"].t[0])
        return spied(request, *given)

    class Told(drive_source.DriveSource):
        def search_first(self, budget):
            east = np.array([[-4.0, 0.0, 0.0], [2.0, -0.5, 0.0]])
            back = np.array([[2.0, -0.5, 0.0], [-2.0, -1.0, 0.0]])
            starts.clear()
            motions.append(self._descended((RollingLeg(east, True), RollingLeg(back, False)), 0, budget))
            return super().search_first(budget)

    motions = []
    monkeypatch.setattr(drive_source, "motion_descents", told)
    monkeypatch.setattr(sys.modules["graceful_plan.mobile.query.driving"], "DriveSource", Told)
    gp.plan("west", [-2.0, -1.0, 0.0], SCENE.with_moving(CROSSING), w=0.0, iterations=1)
    (motion,), (begins,) = motions, starts
    turns = np.abs(np.diff(np.sign(motion.trajectory.qd[1:-1, 0]))) > 0  # it changes gear
    assert begins == pytest.approx(-motion.trajectory.t[1:-1][:-1][turns][0], abs=0.2)
