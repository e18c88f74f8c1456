"""Arguments of `view` and of its command, before a page exists."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.tools.cli import main
from graceful_plan.viewer import opening
from graceful_plan.viewer.browser import words
from graceful_plan.viewer.opening import asked
from graceful_plan.viewer.question import answered


@pytest.fixture(scope="module")
def task():
    return gp.load_scene("tabletop").tasks["lift_to_goal"]


@pytest.fixture(scope="module")
def result(task):
    return gp.plan(task.start, task.goal, task.scene, iterations=50)


def test_without_viser_the_extra_is_named(monkeypatch, capsys):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(gp.GracefulPlanError, match=r"\.\[viz\]"):
        gp.view("tabletop")
    assert main(["view", "tabletop"]) == 2
    assert ".[viz]" in capsys.readouterr().err


@pytest.mark.parametrize("what", ["tabletop", "scene", "task"])
def test_scenes_and_tasks_are_taken(what, task):
    given = {"tabletop": "tabletop", "scene": task.world, "task": task}[what]
    question, answer = asked(given, task=None if what == "task" else "lift_to_goal", w=0.7)
    assert answer is None and question.w == 0.7 and question.scene.carried.body == "green"
    np.testing.assert_allclose(question.start, task.start)


def test_robots_that_drive_are_given_more_time():
    assert asked("apartment")[0].time_limit > asked("tabletop")[0].time_limit
    assert asked("apartment", time_limit=2.0)[0].time_limit == 2.0


@pytest.mark.parametrize("kind", ["result", "trajectory", "path"])
def test_motions_are_shown_as_they_are(kind, result, task):
    motion = {"result": result, "trajectory": result.trajectory, "path": gp.Path(result.trajectory.q)}[kind]
    question, answer = asked(motion, task if kind == "result" else task.scene)
    assert answer.chosen is not None and answer.ordinary is None
    np.testing.assert_allclose(answer.chosen.trajectory.q[-1], result.trajectory.q[-1], atol=1e-9)
    if kind != "path":
        assert answer.chosen.trajectory is result.trajectory
        beside = answered(question, answer, lambda: False)
        assert beside.chosen is answer.chosen and beside.ordinary is not None


def test_misuse_is_refused(result, task):
    with pytest.raises(SettingError, match="scene"):
        asked(result)
    with pytest.raises(UnknownNameError, match="lift_to_goal"):
        asked("tabletop", task="juggle")
    with pytest.raises(UnknownNameError, match="keyframe"):
        asked("tabletop", start="nowhere", goal=task.goal)
    with pytest.raises(SettingError, match="ImpactCost"):
        asked("tabletop", objective=gp.Objective(impact=gp.JointLength()))
    robot = gp.Scene.from_mjcf(
        '<mujoco><worldbody><body name="a/b"><joint name="a/j" type="hinge" range="-1 1"/><geom size=".1"/></body>'
        "</worldbody></mujoco>",
        robot="a/",
        tool="a/b",
        velocity=[1.0],
        acceleration=[1.0],
    )
    with pytest.raises(SettingError, match="tasks"):
        asked(robot)


def test_names_from_scenes_are_no_markup(task):
    text = words.now_words({"<script>x</script>": 1.0}, failed=False)
    assert "<script>" not in text and "&lt;script&gt;" in text


def test_the_text_gives_the_reason_for_no_plan(task):
    question, _ = asked(task)
    X_WT = question.goal_pose()
    X_WT[0, 3] += 9.0
    nothing = answered(question.going_to(X_WT), None, lambda: False)
    assert "INVALID_GOAL" in words.plan_words(nothing, busy=False)
    assert "planning" in words.plan_words(None, busy=True) and "no plan yet" in words.plan_words(None, busy=False)


def test_the_text_explains_costs_and_colours(result, task):
    question, answer = asked(result, task, w=0.5)
    both = answered(question, answer, lambda: False)
    text = words.plan_words(both, busy=False)
    assert "w = 0.5" in text and f"{both.chosen.cost.impact:.3g}" in text and f"{both.ordinary.cost.impact:.3g}" in text
    assert "impact along the paths" in text and f"{max(m.risk.max() for m in both.motions):.3g}" in text
    alone = words.plan_words(answer, busy=True)
    assert "not planned yet" in alone and "planning" in alone


def test_the_defaults_are_seen_by_this_machine_alone():
    assert opening.HOST == "127.0.0.1"


def test_unplannable_queries_are_refused_before_the_page_opens(task):
    for wrong in ({"time_limit": float("nan")}, {"time_limit": -1.0}, {"w": float("nan")}):
        with pytest.raises(gp.GracefulPlanError, match=next(iter(wrong))):
            asked(task, **wrong)
    for goal in ("nowhere", [1.0, 2.0], [float("nan")] * 7):
        with pytest.raises(gp.GracefulPlanError):
            asked(task, goal=goal)
    assert asked(task, goal="ready")[0].goal == "ready"
