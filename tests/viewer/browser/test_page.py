"""The page without browser and viser: its messages, their times, and the reaction of a browser."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
import stub_viser
from browsing import until

import graceful_plan as gp
from graceful_plan.viewer import state as state_module
from graceful_plan.viewer.browser import handles
from graceful_plan.viewer.browser import page as page_module
from graceful_plan.viewer.browser.page import Page
from graceful_plan.viewer.question import CHOSEN, ORDINARY, PlanAnswer, Question
from graceful_plan.viewer.shapes import parts
from graceful_plan.viewer.shown import shown_motion

_LONG = 60.0
"""Seconds after which a test fails."""


@pytest.fixture(scope="module")
def question():
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    goal = np.atleast_2d(np.asarray(task.goal, dtype=float))[0]
    return Question(scene=task.scene, start=task.start, goal=goal)


def moving(question, label, bend):
    """Return a motion from start to goal without planning."""
    middle = 0.5 * (question.start + question.goal) + bend
    scene = question.scene
    trajectory = gp.retime(gp.Path(np.stack([question.start, middle, question.goal])), scene.limits, scene.joints)
    return shown_motion(label, trajectory, scene, question.impact, gp.evaluate(trajectory, scene))


@pytest.fixture(scope="module")
def motions(question):
    """Two answers to every weight below 1."""
    ordinary = moving(question, ORDINARY, 0.0)
    return [
        PlanAnswer(question=question, chosen=moving(question, CHOSEN, bend), ordinary=ordinary, said=("", ""))
        for bend in (0.1, 0.2)
    ]


class Desk:
    """A page without a planner: prepared answers arrive when the test allows it."""

    def __init__(self, question, motions):
        self.go, self.found, self.motions = threading.Event(), True, motions
        self.go.set()
        self.page = Page(question, None, host="127.0.0.1", port=8080)
        self.server, self.c = self.page.server, self.page.controls

    def answered(self, question, known, cancelled):
        while not self.go.wait(0.001):
            if cancelled():
                break
        if not self.found:
            return PlanAnswer(question=question, chosen=None, ordinary=None, said=("INVALID_GOAL", "INVALID_GOAL"))
        answer = self.motions[question.w >= 1.0]
        return replace(answer.among(question), question=question)

    def type(self, which, *places):
        """Type places into the field of "start" or "goal", and wait until the last one is requested."""
        before = self.page.state.question
        for place in places:
            getattr(self.c, which).enter(place)
        until(lambda: self.page.state.question is not before)
        self.wait()

    def wait(self):
        assert self.page.state.worker.wait(_LONG)

    def place(self, name):
        """Return the pose at which a part of the scene is drawn."""
        k = [part.name for part in parts(self.page.state.question.scene)].index(name)
        return self.server.only("scene", f"/scene/{k}").position


@contextmanager
def opened(question, motions):
    """A page with its first answer; viser is the stub."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page_module, "guarded_server", stub_viser.ViserServer)
        desk = Desk(question, motions)
        patch.setattr(state_module, "answered", desk.answered)
        patch.setattr(handles, "_PAUSE", 0.05)
        desk.page.begin()
        desk.wait()
        yield desk
        desk.go.set()
        desk.page.close()


@pytest.fixture
def desk(question, motions):
    with opened(question, motions) as desk:
        yield desk


def session(desk):
    """Use every control while the motion plays."""
    c, question = desk.c, desk.page.state.question
    c.play.click()
    for w in (0.1, 1.2, 1.3, 0.0, 1.0):
        c.w.enter(w)
    desk.wait()
    c.keep.click()
    c.entity.enter("red1")
    c.severity.enter(7.0)
    c.move.enter(True)
    desk.server.only("scene", "/entity").drag(question.entity_pose("red1")[:3, 3] + [0.02, 0.0, 0.0])
    c.w.enter(0.2)
    time.sleep(0.1)
    c.risk_map.enter(True)
    c.names.enter(True)
    desk.wait()
    desk.found = False
    desk.type("goal", (0.5, 0.0, 9.0))
    desk.found = True
    desk.type("goal", (0.5, 0.0, 0.5))
    c.other.enter("hidden")
    desk.wait()
    c.fault.enter("gripper_failure")
    c.let_go.click()
    time.sleep(0.1)


class Watched(NamedTuple):
    """Records of a session."""

    server: Any
    alone: list[tuple[str, Any, str]]
    """Messages sent without the lock."""
    shapes: set[tuple[int, ...]]
    """Of the chart after each change: series, data, and lengths of the data."""


@pytest.fixture(scope="module")
def watched(question, motions):
    with opened(question, motions) as desk:
        alone, shapes = [], set()

        def look(what, handle, name):
            if not desk.page.lock._is_owned():
                alone.append((what, handle, name))
            if handle._name == "chart" and what == "update":
                shapes.add((len(handle.series), len(handle.data), len({len(values) for values in handle.data})))

        desk.server.watch = look
        session(desk)
        desk.server.watch = lambda *_: None
        yield Watched(desk.server, alone, shapes)


def test_no_message_refers_to_a_removed_element(watched):
    """Also for a slow browser that receives all messages at once, as one did while it was drawing."""
    assert watched.server.errors() == [] and watched.server.complaints == []
    assert sum(handle._name == "chart" for handle in watched.server.handles) == 1


def test_every_writer_holds_the_lock(watched):
    """Threads of player, planner and browsers: none writes while another one replaces elements."""
    assert watched.alone == []


def test_the_chart_has_as_many_series_as_data_at_any_time(watched):
    ((series, data, lengths),) = watched.shapes
    assert series == data and lengths == 1


def test_a_chart_that_is_replaced_while_it_plays_would_be_noticed(desk):
    """The page used to do that once: the browser reported 'Tried to update non-existent component'."""
    desk.page.stage.set_chart(desk.page.state.motion)
    chart = desk.server.only("gui", "chart")
    chart.remove()
    assert "chart.data" in desk.server.errors()
    with pytest.raises(RuntimeError, match="removed"):
        desk.page.player.seek(0.1)


def test_the_chart_is_of_the_motion_that_is_shown(desk):
    chart, motion = desk.server.only("gui", "chart"), desk.page.state.motion
    assert chart.visible
    names = [series["label"] for series in chart.series]
    assert names[1] == motion.worst(1)[0] and "all others" in names and "now" in names
    k = motion.entities.index(names[1])
    np.testing.assert_allclose(
        np.interp(motion.risk_t, chart.data[0], chart.data[1]), motion.by_entity[:, k], atol=1e-9
    )
    top = 1.05 * max(motion.by_entity.max(), 1e-3)
    assert chart.scales["y"]["range"][1] == pytest.approx(top)
    desk.c.time.enter(0.5 * motion.duration)
    line = chart.data[names.index("now")]
    drawn = chart.data[0][np.isfinite(line)]
    np.testing.assert_allclose(drawn, 0.5 * motion.duration, atol=1e-5)


def test_a_moved_entity_stays_in_place_until_the_answer(desk):
    """The previous motion keeps playing; it used to move the object back."""
    desk.c.entity.enter("red1")
    desk.c.move.enter(True)
    there = desk.page.state.question.entity_pose("red1")[:3, 3] + [0.02, 0.01, 0.0]
    before = desk.page.state.motion
    desk.go.clear()
    desk.server.only("scene", "/entity").drag(there)
    desk.page.player.seek(0.3 * before.duration)
    np.testing.assert_allclose(desk.place("red1"), there, atol=1e-6)
    meanwhile = desk.page.state.motion
    assert meanwhile.trajectory is before.trajectory and meanwhile.risk.max() != before.risk.max()
    desk.go.set()
    desk.wait()
    np.testing.assert_allclose(desk.place("red1"), there, atol=1e-6)


def test_without_a_motion_there_is_no_text_about_it(desk):
    desk.page.player.seek(0.5 * desk.page.state.duration)
    far = desk.server.only("scene", "/footprint/near")
    assert far.visible and "Impact of a failure now" in desk.c.now_text.content
    begun = desk.place("green").copy()
    desk.found = False
    desk.type("goal", (0.5, 0.0, 9.0))
    assert not far.visible and desk.c.now_text.content == "" and not desk.server.only("gui", "chart").visible
    assert "INVALID_GOAL" in desk.c.plan_text.content
    start = desk.page.state.question.scene.data_at(desk.page.state.question.start).body("green").xpos
    np.testing.assert_allclose(desk.place("green"), start, atol=1e-6)
    assert np.abs(begun - start).max() > 0.01


def test_a_refused_move_resets_the_handle(desk, monkeypatch):
    def refuse(*_):
        raise gp.GracefulPlanError("it hangs on something else")

    monkeypatch.setattr(Question, "with_moved", refuse)
    desk.c.entity.enter("red1")
    desk.c.move.enter(True)
    handle, there = desk.server.only("scene", "/entity"), desk.page.state.question.entity_pose("red1")[:3, 3]
    handle.drag(there + 1.0)
    assert desk.server.complaints == ["it hangs on something else"]
    np.testing.assert_allclose(handle.position, there, atol=1e-9)


def test_half_of_a_number_is_no_start(desk):
    """Such input used to be refused, and the field was reset while the user was typing."""
    x, y, z = desk.page.state.question.handle_pose(desk.page.state.question.start)[:3, 3].tolist()
    desk.type("start", (x, y, 0.0), (x, y, z + 0.04))
    found = desk.page.state.question
    np.testing.assert_allclose(found.handle_pose(found.start)[:3, 3], [x, y, z + 0.04], atol=1e-3)
    assert desk.server.complaints == []
    desk.c.start.enter((x, y, -9.0))
    until(lambda: desk.c.start.value == pytest.approx((x, y, z + 0.04), abs=1e-3))
    (said,) = desk.server.complaints
    assert "out of reach" in said


def test_a_new_browser_sees_both_scenes_side_by_side(desk):
    alone = np.array(desk.server.initial_camera.look_at)
    desk.server.client.camera.position, desk.server.client.camera.look_at = np.ones(3), np.zeros(3)
    desk.c.other.enter("beside it")
    beside = np.array(desk.server.initial_camera.look_at)
    assert np.abs(beside - alone).max() > 0.2
    desk.c.other.enter("as a ghost")
    np.testing.assert_allclose(desk.server.initial_camera.look_at, alone, atol=1e-9)
