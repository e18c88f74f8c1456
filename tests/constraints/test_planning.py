"""Plans with constraints: kept according to the judge, refused where impossible, unchanged where inactive."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.array_types import Float
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.path import Path
from graceful_plan.scene.elements import Liquid
from sizes import first_quick

Array = np.ndarray
ENOUGH = 200
"""Iterations."""


@pytest.fixture(scope="module")
def coffee() -> gp.Task:
    return gp.load_scene("desk").tasks["bring_coffee"]


def planned(task: gp.Task, **asked: object) -> gp.PlanResult:
    given: dict[str, object] = {"w": 0.3, "iterations": ENOUGH, **asked}
    return gp.plan(task.start, task.goal, task.scene, **given)  # pyright: ignore[reportArgumentType]


@pytest.mark.long
def test_contents_are_kept_by_default_and_spilt_where_that_is_switched_off(coffee: gp.Task) -> None:
    kept, free = planned(coffee), planned(coffee, constraints=[])
    assert kept.status is free.status is gp.PlanStatus.SOLVED
    assert kept.verdict is not None and kept.verdict.checks["contents"].passed
    assert kept.verdict.checks["contents"].worst < 0.01
    assert "contents" not in free.verdict.checks and "KeepContents" in free.detail
    refused = gp.verify(free.trajectory, coffee.scene)
    assert refused.failures == ("contents",) and refused.checks["contents"].worst > 0.1
    assert gp.verify(free.trajectory, coffee.scene, constraints=[]).passed


def test_a_vessel_tilted_too_far_at_an_end_is_reported_with_its_angle(coffee: gp.Task) -> None:
    tilted = np.array(coffee.start)
    tilted[5] -= np.deg2rad(40.0)
    start = gp.plan(tilted, coffee.goal, coffee.scene)
    assert start.status is gp.PlanStatus.INVALID_START and "KeepContents" in start.detail and "degrees" in start.detail
    goal = gp.plan(coffee.start, tilted, coffee.scene)
    assert goal.status is gp.PlanStatus.INVALID_GOAL and "KeepContents" in goal.detail


def test_the_fuller_the_slower(coffee: gp.Task) -> None:
    """A law of a single path that is timed; planners may choose other paths."""
    scene = gp.load_scene("desk")
    durations = []
    for volume in (0.15, 0.25, 0.29):
        full = scene.attach("mug", contents=Liquid(volume, 85.0))
        held = SceneConstraints(full, [gp.KeepContents()])
        path = Path(np.stack([coffee.start, np.atleast_2d(coffee.goal)[0]]))
        durations.append(held.retimed(path, deviation=0.05).duration)
    assert durations[0] < durations[1] < durations[2]


@pytest.mark.parametrize("w", [0.0, 0.3])
def test_upright_objects_stay_upright(task: gp.Task, w: float) -> None:
    result = planned(task, w=w, constraints=[gp.Upright(0.1)])
    assert result.status is gp.PlanStatus.SOLVED and result.verdict is not None
    assert result.verdict.checks["upright"].passed and 0.0 < result.verdict.checks["upright"].worst <= 0.1001


def test_a_constraint_that_is_never_active_changes_nothing_to_the_byte(task: gp.Task) -> None:
    free = planned(task)
    never = [gp.Upright(np.pi), gp.ToolWithin((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))]
    held = planned(task, constraints=never)
    assert held.trajectory.q.tobytes() == free.trajectory.q.tobytes()
    assert held.trajectory.t.tobytes() == free.trajectory.t.tobytes()


def test_distance_box_and_speed_hold_at_once(task: gp.Task) -> None:
    entity = max(task.scene.entities, key=lambda name: name == "floor")
    others = [name for name in task.scene.entities if name not in (entity, "table")]
    asked = [gp.ToolWithin((-0.5, -0.9, 0.0), (0.9, 0.9, 2.0)), gp.ToolSpeed(0.4), gp.KeepDistance(others[0], 0.03)]
    result = planned(task, constraints=asked, iterations=2 * ENOUGH)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    checks = result.verdict.checks
    assert checks["tool_within"].passed and checks["tool_speed"].passed and checks["keep_distance"].passed
    assert 0.3 < checks["tool_speed"].worst <= 0.4004
    free = planned(task)
    assert not gp.verify(free.trajectory, task.scene, constraints=asked).checks["tool_speed"].passed


def test_two_of_a_kind_are_checked_both(task: gp.Task) -> None:
    result = planned(task, constraints=[gp.Upright(0.3), gp.Upright(0.2)])
    assert {"upright", "upright_2"} <= set(result.verdict.checks)


@dataclass(frozen=True)
class Below(gp.Constraint):
    """The tool stays below a height: a custom constraint."""

    height: float

    def residual(self, batch: gp.StateBatch) -> Float[Array, " n"]:
        return batch.tool_poses[:, 2, 3] - self.height


@pytest.mark.parametrize("planner", first_quick(["rrt_connect", "auto", "rrt_star"]))
def test_custom_constraints_are_kept_by_planners_of_all_kinds(task: gp.Task, planner: str) -> None:
    free = planned(task, planner=planner, w=0.0)
    highest = gp.verify(free.trajectory, task.scene, constraints=[Below(0.0)]).checks["below"].worst
    ends = gp.verify(
        Path(np.stack([task.start, np.atleast_2d(task.goal)[0]])), task.scene, constraints=[Below(0.0)]
    ).checks["below"]
    limit = ends.worst + 0.3 * max(highest - ends.worst, 0.05)
    result = planned(task, planner=planner, w=0.0, constraints=[Below(limit)])
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert result.verdict.checks["below"].passed


def test_impossible_plans_have_their_status(task: gp.Task) -> None:
    """A wall between start and goal, as a custom constraint."""
    X = np.stack([task.start, np.atleast_2d(task.goal)[0]])
    result = planned(task, constraints=[Below(-1.0)])
    assert result.status is gp.PlanStatus.INVALID_START and "Below" in result.detail
    path = gp.verify(Path(X), task.scene, constraints=[Below(-1.0)])
    assert not path.checks["below"].passed and path.checks["below"].first == 0.0


@pytest.mark.long
def test_straight_motions_and_poses_on_the_way_keep_contents(coffee: gp.Task) -> None:
    middle = planned(coffee).trajectory
    on_the_way = middle.at(np.array(0.5 * middle.duration)).q
    result = gp.plan(coffee.start, coffee.goal, coffee.scene, via=[on_the_way], iterations=ENOUGH)
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.checks["contents"].passed
    lifted = gp.PoseGoal.from_tool(coffee.start, coffee.scene, translation=np.array([0.0, 0.0, 0.1]))
    straight = gp.plan_cartesian(coffee.start, lifted, coffee.scene)
    assert straight.status is gp.PlanStatus.SOLVED, straight.detail
    assert straight.verdict.checks["contents"].passed


@pytest.mark.long
def test_half_speed_allows_more_of_the_cup(coffee: gp.Task) -> None:
    half = replace(planned(coffee, speed=0.5), stats={})
    assert half.status is gp.PlanStatus.SOLVED and half.verdict.checks["contents"].passed


def test_a_scene_keeps_its_own_constraints(scene: gp.Scene) -> None:
    asking = scene.with_constraints(gp.Upright(0.12))
    task = asking.tasks["green_to_blue"]
    result = planned(task)
    assert result.status is gp.PlanStatus.SOLVED and "upright" in result.verdict.checks
    assert "Upright" in planned(task, constraints=[]).detail
    assert "upright" in gp.verify(result.trajectory, task.scene).checks
    with pytest.raises(gp.GracefulPlanError, match="Constraint"):
        scene.with_constraints(0.3)
    desk = gp.load_scene("desk").with_constraints(gp.KeepContents(0.4), gp.Upright(0.5))
    declared = gp.KeepContents(0.4), gp.Upright(0.5)
    assert default_constraints(desk.tasks["bring_coffee"].scene) == (*declared, gp.GraspHolds())


def test_a_start_at_the_goal_needs_no_timing(coffee: gp.Task) -> None:
    goal = np.atleast_2d(coffee.goal)[0]
    found = gp.plan(goal, goal, coffee.scene, iterations=20)
    assert found.status is gp.PlanStatus.SOLVED and found.unwrap().duration == 0.0
