"""Stops planned ahead along a motion, and warnings where there are none."""

from __future__ import annotations

import pickle
from itertools import count
from typing import Any

import numpy as np
import pytest
from planned_tasks import planned

import graceful_plan as gp
from graceful_plan.exceptions import SettingError

EVERY = 0.15


@pytest.fixture(scope="module")
def book() -> tuple[gp.Task, gp.Trajectory]:
    return planned("desk", "put_book_away", w=0.0, iterations=40)


@pytest.fixture(scope="module")
def coffee() -> tuple[gp.Task, gp.Trajectory, gp.PreparedStops]:
    task, motion = planned("desk", "bring_coffee", w=0.0, iterations=40)
    return task, motion, gp.plan_stops(motion, task.scene, every=EVERY)


def test_there_is_a_stop_at_each_moment_and_it_is_the_one_of_plan_stop(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = book
    stops = gp.plan_stops(motion, task.scene, every=EVERY)
    assert len(stops.stops) == int(np.ceil(motion.duration / EVERY)) and stops.gaps == ()
    for k, stop in enumerate(stops.stops):
        alone = gp.plan_stop(motion, task.scene, at=EVERY * k).unwrap()
        assert stop is not None and stop.t[0] == alone.t[0] and stop.duration == pytest.approx(alone.duration)


def test_the_stop_taken_begins_later_continues_the_motion_and_none_of_the_later_ones_ends_earlier(
    coffee: tuple[gp.Task, gp.Trajectory, gp.PreparedStops],
) -> None:
    _, motion, stops = coffee
    found = [stop for stop in stops.stops if stop is not None]
    for t in np.linspace(motion.t[0], found[-1].t[0], 12).tolist():
        stop = stops.after(t)
        ideal = motion.at(float(stop.t[0]))
        np.testing.assert_allclose(stop.q[0], ideal.q, atol=1e-9)
        np.testing.assert_allclose(stop.qd[0], ideal.qd, atol=1e-6)
        assert stop.t[0] >= t - 1e-9 and not stop.qd[-1].any()
        assert stop.t[-1] <= min(one.t[-1] for one in found if one.t[0] >= t)
    assert stops.after(float(motion.t[-1])) is motion


def test_gaps_are_the_moments_at_which_braking_would_end_earlier_than_a_stop_that_keeps_the_contents(
    coffee: tuple[gp.Task, gp.Trajectory, gp.PreparedStops],
) -> None:
    task, motion, stops = coffee
    latest = motion.t[-1] - EVERY
    assert stops.gaps
    for k, stop in enumerate(stops.stops):
        t = EVERY * k
        assert stop is not None
        braking = (np.abs(motion.at(t).qd) / task.scene.limits.acceleration).max()
        missing = stop.t[-1] > latest and t + 2.0 * braking < latest
        assert missing == any(first - 1e-9 <= t <= last + 1e-9 for first, last in stops.gaps)


@pytest.mark.parametrize("name", ["kitchen_counter/bring_knife", "tabletop_l3/corner_to_blue"])
def test_curves_at_the_limits_of_the_robot_are_no_gaps(name: str) -> None:
    """There, no stop within the limits ends much before the motion does, although straight braking would."""
    scene, _, task = name.partition("/")
    found, motion = planned(scene, task, iterations=60)
    assert gp.plan_stops(motion, found.scene).gaps == ()


def test_without_constraints_there_are_no_gaps(coffee: tuple[gp.Task, gp.Trajectory, gp.PreparedStops]) -> None:
    task, motion, _ = coffee
    assert gp.plan_stops(motion, task.scene, every=0.3, constraints=[]).gaps == ()


def test_in_a_scene_that_has_changed_moments_before_the_obstacle_have_no_stop_if_it_is_too_near(
    book: tuple[gp.Task, gp.Trajectory],
) -> None:
    task, motion = book
    at = 0.3 * motion.duration
    tool = gp.StateBatch(task.scene, motion.at(at + 0.05).q[None]).object_poses[0, :3, 3]
    blocked = task.scene.edit(add=[gp.StaticBody(name="post", kind="box", size=(0.02, 0.02, 0.02), pose=tool)])
    stops = gp.plan_stops(motion, blocked, every=at)
    assert stops.stops[0] is not None and stops.stops[1] is None  # at rest, and at speed just before it
    assert stops.gaps[0][0] == pytest.approx(at)


def test_once_cancelled_no_further_stops_are_planned(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = book
    asked = count()
    stops = gp.plan_stops(motion, task.scene, every=EVERY, cancelled=lambda: next(asked) >= 2)
    assert [stop is not None for stop in stops.stops] == [k < 2 for k in range(len(stops.stops))]
    assert stops.gaps == ((pytest.approx(2 * EVERY), pytest.approx(EVERY * (len(stops.stops) - 1))),)


@pytest.mark.parametrize("every", [0.0, -1.0, np.nan, np.inf])
def test_times_that_are_none_are_refused(book: tuple[gp.Task, gp.Trajectory], every: float) -> None:
    with pytest.raises(SettingError, match="every"):
        gp.plan_stops(book[1], book[0].scene, every=every)


# --- plan(stoppable=True) ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("speed", "stops_everywhere"), [(1.0, False), (0.3, True)])
def test_a_plan_warns_where_a_full_cup_allows_no_stop(speed: float, stops_everywhere: bool) -> None:
    task = gp.load_scene("desk").tasks["bring_coffee"]
    asked: dict[str, Any] = {"w": 0.0, "iterations": 40, "speed": speed}
    result = gp.plan(task.start, task.goal, task.scene, stoppable=True, **asked)
    without = gp.plan(task.start, task.goal, task.scene, **asked)
    np.testing.assert_array_equal(result.unwrap().q, without.unwrap().q)  # the motion is not changed
    check = result.verdict.checks["stops"]
    assert result.status is gp.PlanStatus.SOLVED and result.verdict.passed
    assert result.stops is not None and result.stops.motion is result.trajectory
    assert check.passed == stops_everywhere == (not result.stops.gaps)
    assert ("stops" in result.verdict.warnings) == (check.detail in result.detail) == (not stops_everywhere)
    assert check.first == (None if stops_everywhere else result.stops.gaps[0][0])
    assert without.stops is None and "stops" not in without.verdict.checks
    assert pickle.loads(pickle.dumps(result)).stops.gaps == result.stops.gaps


def test_stops_keep_the_constraints_of_the_call(coffee: tuple[gp.Task, gp.Trajectory, gp.PreparedStops]) -> None:
    task = coffee[0]
    result = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=10, stoppable=True, constraints=[])
    assert result.verdict.checks["stops"].passed


def test_motions_through_poses_and_from_moving_starts_have_stops_too(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task, motion = book
    through = gp.plan(task.start, task.goal, task.scene, via=[motion.at(0.4).q], w=0.0, iterations=20, stoppable=True)
    moving = gp.plan(motion.at(0.4), task.goal, task.scene, w=0.0, iterations=20, stoppable=True)
    for result in (through, moving):
        assert result.stops is not None and "stops" in result.verdict.checks
    assert moving.stops is not None and moving.stops.stops[0] is not None
    assert moving.stops.stops[0].duration < moving.unwrap().duration


def test_without_a_motion_there_are_no_stops(book: tuple[gp.Task, gp.Trajectory]) -> None:
    task = book[0]
    result = gp.plan(task.start + 100.0, task.goal, task.scene, stoppable=True)
    assert result.status is gp.PlanStatus.INVALID_START and result.stops is None
