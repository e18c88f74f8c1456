"""State of the viewer without a browser: the shown motion, requests after changes, and failures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import failbench as fb
import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.viewer.browser import words
from graceful_plan.viewer.failing import Failure, faults_of
from graceful_plan.viewer.fall import coasting_at, fall_at
from graceful_plan.viewer.question import Question, answered
from graceful_plan.viewer.risk_layer import HEAT, scale_colours
from graceful_plan.viewer.shapes import parts
from graceful_plan.viewer.state import MOST_KEPT, ViewerState

_LONG = 60.0
"""Seconds after which a test fails."""


def asked(question):
    """Return a state with the answer to a question."""
    errors = []
    state = ViewerState(question, failed=errors.append)
    state.ask(question)
    assert state.worker.wait(_LONG) and errors == []
    return state


@pytest.fixture(scope="module")
def question():
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    return Question(scene=task.scene, start=task.start, goal=task.goal, w=1.0)


@pytest.fixture(scope="module", autouse=True)
def _planned_by_iterations():
    """Plan with a number of iterations where the viewer gives a time limit."""

    def plan(*args, time_limit, **given):
        return gp.plan(*args, iterations=200, **given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("graceful_plan.viewer.question.plan", plan)
        yield


@pytest.fixture(scope="module")
def state(question):
    state = asked(question)
    yield state
    state.close()


@pytest.fixture
def fresh(question, state):
    """A separate state that already has the answer."""
    own = ViewerState(question, answer=state.answer)
    yield own
    own.close()


@pytest.fixture(scope="module")
def driving():
    """A motion of a base straight past a person."""
    scene = gp.load_scene("apartment").tasks["bring_parcel"].scene
    t = np.linspace(0.0, 2.0, 5)
    q = np.column_stack([6.3 - 0.8 * t, np.full(5, 1.4), np.full(5, np.pi)])
    qd = np.tile([-0.8, 0.0, 0.0], (5, 1))
    return scene, gp.Trajectory(t, q, qd, np.zeros_like(q), scene.joints)


def _planned(monkeypatch, *results):
    """Let the viewer's calls of plan return these results, and return the time limits of the calls."""
    limits, left = [], list(results)

    def plan(*_, time_limit, **__):
        limits.append(time_limit)
        return left.pop(0)

    monkeypatch.setattr("graceful_plan.viewer.question.plan", plan)
    return limits


def test_a_timeout_is_tried_again_with_more_time(question, monkeypatch):
    solved = gp.plan(question.start, question.goal, question.scene, w=0.0, iterations=100)
    limits = _planned(monkeypatch, gp.PlanResult(status=gp.PlanStatus.TIMEOUT), solved)
    assert question.plan(0.0, lambda: False) is solved
    assert limits[0] == question.time_limit < limits[1]


def test_a_motion_worse_than_a_known_one_is_not_shown(question, state, monkeypatch):
    """A call of a second on a busy machine may find less than an earlier one."""
    known = state.answer
    worse = gp.plan(question.start, question.goal, question.scene, w=0.0, iterations=100, speed=0.2)
    _planned(monkeypatch, *[worse] * 4)
    for w, best in ((1.1 * question.w, known.chosen), (1e-6, known.ordinary)):
        shown = answered(dataclasses.replace(question, w=w), known, lambda: False).chosen
        assert shown.trajectory is best.trajectory and shown.label == "chosen w"
    elsewhere = dataclasses.replace(question, w=1e-6, way=question.way + 1)
    assert answered(elsewhere, known, lambda: False).chosen.trajectory is worse.trajectory


# --- the shown motion -------------------------------------------------------------------------------------------------


def test_nothing_is_shown_before_the_first_answer(question):
    state = ViewerState(question)
    assert state.at(0.0) is None and state.motion is None and state.duration == 0.0 and state.layer(0.0) is None
    with pytest.raises(SettingError):
        state.fail(Failure(fault="gripper_failure"))


def test_both_motions_are_shown_and_w_buys_less_impact(state):
    chosen, ordinary = state.answer.chosen, state.answer.ordinary
    assert chosen.label == "chosen w" and ordinary.label == "w = 0"
    assert chosen.cost.impact < 0.5 * ordinary.cost.impact and chosen.cost.motion > ordinary.cost.motion
    assert np.abs(chosen.tool[len(chosen.tool) // 2] - ordinary.tool[len(ordinary.tool) // 2]).max() > 0.02


def test_frames_are_the_motion(state):
    motion = state.motion
    t = 0.37 * motion.duration
    moment, scene = state.at(t), motion.scene
    at = motion.t[motion.frame(t)]
    assert abs(at - t) <= 0.5 / 60.0 + 1e-9
    data = scene.data_at(motion.trajectory.at(motion.trajectory.t[0] + at).q)
    for k, part in enumerate(parts(scene)):
        np.testing.assert_allclose(moment.position[k], data.xpos[part.body], atol=1e-9)
        np.testing.assert_allclose(abs(moment.turned[k] @ data.xquat[part.body]), 1.0, atol=1e-9)
    assert len(moment.beside) == 1 and not moment.failed


def test_motions_are_kept_beside_those_planned_later(fresh):
    first = fresh.motion
    kept = fresh.keep()
    assert kept.label == f"A: w = {fresh.question.w:g}" and kept.cost is first.cost
    with pytest.raises(SettingError, match="not kept already"):
        fresh.keep()
    later = dataclasses.replace(first, trajectory=first.trajectory.sample(0.1))
    fresh.answer = dataclasses.replace(fresh.answer, chosen=later)
    assert fresh.others[1:] == (kept,) and fresh.duration >= kept.duration
    (_, (position, turned)) = fresh.at(0.4 * kept.duration).beside
    frame = kept.frame(0.4 * kept.duration)
    assert (position == kept.poses.position[frame]).all() and (turned == kept.poses.quaternion[frame]).all()
    text = words.plan_words(fresh.answer, fresh.kept, busy=False)
    assert text.count("<th") == 4 and kept.label in text
    fresh.kept = (kept,) * MOST_KEPT
    with pytest.raises(SettingError, match=f"at most {MOST_KEPT}"):
        fresh.keep()
    fresh.let_go()
    assert len(fresh.at(0.0).beside) == 1


def test_impact_at_a_moment_adds_up_to_that_of_the_motion(state):
    motion = state.motion
    total = np.trapezoid(motion.risk, motion.risk_t)
    assert total == pytest.approx(motion.cost.impact, rel=0.05)
    i = len(motion.risk_t) // 2
    shown = state.at(motion.risk_t[i]).impact
    assert sum(shown.values()) == pytest.approx(motion.risk[i]) and list(shown.values()) == sorted(
        shown.values(), reverse=True
    )
    assert set(motion.worst(3)) <= set(motion.entities) and len(motion.worst(3)) <= 3


@pytest.mark.parametrize("t", [-1.0, 1e9])
def test_before_the_start_and_after_the_end_it_stands(state, t):
    frame = 0 if t < 0 else -1
    np.testing.assert_allclose(state.at(t).position, state.motion.poses.position[frame])


def test_the_fall_begins_at_the_object_and_ends_lower(state):
    motion = state.motion
    fall = fall_at(motion.trajectory, motion.scene, 0.5 * motion.duration)
    q = motion.trajectory.at(motion.trajectory.t[0] + 0.5 * motion.duration).q
    data = motion.scene.data_at(q)
    np.testing.assert_allclose(fall.flight[0], data.xipos[data.model.body("green").id], atol=1e-6)
    assert np.all(np.diff(fall.flight[:, 2]) <= 0.05) and fall.centre[2] < fall.flight[0, 2]
    assert 0.0 < fall.radius < fall.far and 0.0 <= fall.leaves <= 1.0


def test_without_an_object_nothing_falls(state):
    motion = state.motion
    assert fall_at(motion.trajectory, motion.scene.detach(), 0.1) is None
    assert coasting_at(motion.trajectory, motion.scene, 0.1) is None


def test_a_base_goes_on_straight_and_a_standing_one_does_not(driving):
    scene, trajectory = driving
    going = coasting_at(trajectory, scene, 1.0)
    np.testing.assert_allclose(going.arc[:, 1], 1.4, atol=1e-9)
    assert going.arc[0, 0] == pytest.approx(5.5) and 0.0 < going.half < 5.5 - going.arc[-1, 0]
    assert coasting_at(trajectory, scene, 9.0) is None


def test_the_risk_map_is_dark_where_it_is_bad(state):
    layer = state.layer(0.5 * state.duration)
    assert layer.pixels.dtype == np.uint8 and layer.highest > 1.0 and (layer.size > 0.3).all()
    clear = layer.pixels[layer.pixels[..., 3] > 0]
    assert clear[:, 2].min() < 60 and clear[:, 2].max() > 200
    np.testing.assert_array_equal(
        scale_colours(np.array([0.0, 1.0, 2.0]), HEAT)[[0, 2]], [[255, 255, 255], [140, 13, 38]]
    )


def test_a_base_has_a_map_of_the_floor(driving):
    scene, trajectory = driving
    q = trajectory.q
    state = ViewerState(Question(scene=scene, start=q[0], goal=q[-1]))
    state.answer = of_motion(state.question, trajectory)
    layer = state.layer(1.0)
    assert layer.low[2] < 0.05 and layer.size[0] > 3.0
    state.close()


def of_motion(question, trajectory):
    from graceful_plan.viewer.question import PlanAnswer
    from graceful_plan.viewer.shown import shown_motion

    cost = gp.evaluate(trajectory, question.scene)
    motion = shown_motion("chosen w", trajectory, question.scene, question.impact, cost)
    return PlanAnswer(question=question, chosen=motion, ordinary=None, said=("", ""))


# --- requests ---------------------------------------------------------------------------------------------------------


def test_the_ordinary_motion_is_planned_once_for_all_weights(state):
    state = ViewerState(state.question, answer=state.answer)
    before = state.answer.ordinary
    state.ask(state.question.weighted(0.1))
    assert state.worker.wait(_LONG)
    assert state.answer.ordinary is before and state.answer.question.w == 0.1
    state.ask(state.question.weighted(0.0))
    assert state.worker.wait(_LONG)
    assert state.answer.chosen.trajectory is before.trajectory
    state.close()


def test_the_latest_weight_wins(fresh):
    for w in (0.2, 0.5, 0.9):
        fresh.ask(fresh.question.weighted(w))
    assert fresh.worker.wait(_LONG)
    assert fresh.answer.question.w == 0.9


def test_an_answer_that_was_overtaken_at_the_last_moment_is_dropped(fresh):
    """The worker may have checked that its answer is wanted just before the next request."""
    late, known = dataclasses.replace(fresh.answer, question=fresh.question.weighted(0.7)), fresh.answer
    fresh._done(late)
    assert fresh.answer is known
    fresh.question = late.question
    fresh._done(late)
    assert fresh.answer is late


def test_a_known_motion_is_shown_among_moved_things_until_there_is_another(fresh):
    before, X = fresh.motion, fresh.question.entity_pose("red1")
    X[0, 3] += 0.03
    fresh.fail(Failure(fault="gripper_failure"))
    fresh.worker.close()
    fresh.ask(fresh.question.with_moved("red1", X))
    assert fresh.motion.trajectory is before.trajectory and fresh.motion.scene is fresh.question.scene
    assert fresh.replay is None and fresh.answer.question is not fresh.question
    red = [part.name for part in parts(fresh.motion.scene)].index("red1")
    np.testing.assert_allclose(fresh.at(0.0).position[red], X[:3, 3], atol=1e-9)


def test_a_dragged_goal_is_reached(fresh):
    question, motion = fresh.question, fresh.motion
    X_WT = question.handle_pose(motion.trajectory.q[-1])
    X_WT[:3, 3] += [0.03, 0.02, 0.04]
    moved = question.going_to(X_WT)
    np.testing.assert_allclose(moved.goal_pose(), X_WT)
    fresh.ask(moved)
    assert fresh.worker.wait(_LONG)
    np.testing.assert_allclose(fresh.motion.tool[-1], X_WT[:3, 3], atol=1e-3)
    assert fresh.answer.ordinary is not motion


def test_a_dragged_start_is_a_free_configuration_of_the_tool_there(question):
    X_WT = question.handle_pose(question.start)
    X_WT[2, 3] += 0.05
    moved = question.starting_at(X_WT)
    np.testing.assert_allclose(question.handle_pose(moved.start)[:3, 3], X_WT[:3, 3], atol=1e-3)
    assert gp.clearance(moved.start, question.scene) > 0.0
    far = X_WT.copy()
    far[0, 3] += 5.0
    with pytest.raises(SettingError, match="out of reach"):
        question.starting_at(far)


def test_a_base_is_dragged_over_the_floor(driving):
    scene, trajectory = driving
    question = Question(scene=scene, start=trajectory.q[0], goal=gp.BasePose(2.0, 1.3, 0.0))
    X = question.handle_pose(np.array([3.0, 1.4, 0.5]))
    goal = question.going_to(X).goal
    assert isinstance(goal, gp.BasePose)
    assert (goal.x, goal.y, goal.yaw) == pytest.approx((3.0, 1.4, 0.5))
    np.testing.assert_allclose(question.starting_at(X).start[:3], [3.0, 1.4, 0.5], atol=1e-9)
    X[:2, 3] = -50.0
    with pytest.raises(SettingError, match="start"):
        question.starting_at(X)


def test_an_entity_is_moved_and_its_severity_changed(question):
    X = question.entity_pose("red1")
    X[0, 3] += 0.02
    moved = question.with_moved("red1", X)
    np.testing.assert_allclose(moved.entity_pose("red1"), X, atol=1e-9)
    assert moved.way != question.way
    harmless = question.with_severity("red1", 0.0)
    assert set(harmless.scene.entities["red1"].severity.values()) == {0.0} and harmless.way == question.way
    for change in (lambda: question.with_severity("nobody", 1.0), lambda: question.with_moved("nobody", X)):
        with pytest.raises(UnknownNameError, match="nobody"):
            change()


def test_other_severities_change_the_impact_of_both_motions(fresh):
    before = fresh.answer.ordinary
    worst = before.worst(1)[0]
    fresh.ask(fresh.question.with_severity(worst, 0.0))
    assert fresh.worker.wait(_LONG)
    after = fresh.answer.ordinary
    assert after.trajectory is before.trajectory and after.cost.impact < before.cost.impact


def test_an_unreachable_goal_is_reported_and_no_motion_shown(question):
    X_WT = question.goal_pose()
    X_WT[0, 3] += 9.0
    state = asked(question.going_to(X_WT))
    assert state.at(0.0) is None and all(said.startswith("INVALID_GOAL") for said in state.answer.said)
    state.close()


# --- failures ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def careless(question, state):
    """A separate state that shows the ordinary motion, with entities below it."""
    ordinary = question.weighted(0.0)
    own = ViewerState(ordinary, answer=answered(ordinary, state.answer, lambda: False))
    yield own
    own.close()


def test_a_gripper_failure_is_replayed_next_to_the_prediction(careless):
    fresh = careless
    replay = fresh.fail(Failure(fault="gripper_failure", moment=0.5))
    assert replay.onset == pytest.approx(0.5 * fresh.motion.duration, abs=0.011)
    assert np.all(np.diff(replay.t) > 0.0) and replay.t[0] == 0.0 and fresh.duration == replay.duration
    assert sum(replay.predicted.values()) == pytest.approx(
        float(fresh.motion.risk_at(np.array([replay.onset]))[0]), rel=0.2
    )
    green = [part.name for part in parts(fresh.motion.scene)].index("green")
    assert replay.poses.position[-1, green, 2] < replay.poses.position[replay.frame(replay.onset), green, 2] - 0.02
    before, after = fresh.at(0.5 * replay.onset), fresh.at(replay.duration)
    assert not before.failed and after.failed and after.impact == {} and after.fall is None
    assert any("left the gripper" in note for note in replay.notes) and replay.hits
    fresh.forget()
    assert fresh.replay is None and not fresh.at(fresh.duration).failed


def test_the_same_failure_is_the_same_again(fresh):
    first, second = (fresh.fail(Failure(fault="loose_joint", moment=0.4, seed=3)) for _ in range(2))
    np.testing.assert_array_equal(first.poses.position, second.poses.position)
    assert first.observed == second.observed


def test_a_new_answer_ends_the_replay(fresh):
    fresh.fail(Failure(fault="gripper_failure"))
    fresh.ask(fresh.question.weighted(0.4))
    assert fresh.worker.wait(_LONG) and fresh.replay is None


def test_faults_are_those_of_the_robot(question, driving):
    assert faults_of(question.scene)[0] == "gripper_failure" and set(faults_of(question.scene)) == set(fb.faults())
    assert "wheels_locked" in faults_of(driving[0])


def test_failures_that_make_no_sense_are_refused(fresh):
    with pytest.raises(UnknownNameError, match="bad_mood"):
        fresh.fail(Failure(fault="bad_mood"))
    with pytest.raises(SettingError, match="moment"):
        Failure(fault="gripper_failure", moment=1.5)
    with pytest.raises(UnknownNameError, match="degree"):
        Failure(fault="gripper_failure", degree="hopeless")


def test_a_base_fails_on_its_wheels(driving):
    scene, trajectory = driving
    state = ViewerState(Question(scene=scene, start=trajectory.q[0], goal=trajectory.q[-1]))
    state.answer = of_motion(state.question, trajectory)
    replay = state.fail(Failure(fault="runaway", moment=0.5))
    base = [part.name for part in parts(scene)].index("jackal/base")
    went = replay.poses.position[-1, base] - replay.poses.position[replay.frame(replay.onset), base]
    assert -1.5 < went[0] < -0.1 and abs(went[1]) < 0.1
    assert any("left out" in note for note in replay.notes)
    state.close()
