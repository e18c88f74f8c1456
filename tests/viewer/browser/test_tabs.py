"""Several browsers at the same page, used while the motion plays: nothing is lost, and there are no errors."""

from __future__ import annotations

import numpy as np
import pytest
from browsing import click, enter, errors, state, text, until

import graceful_plan as gp

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def viewer(browser_parts):
    with gp.view("tabletop", task="lift_to_goal", port=8410, time_limit=1.0) as viewer:
        yield viewer


def settled(viewer, w):
    until(lambda: state(viewer).question.w == w and state(viewer).worker.idle)
    assert state(viewer).answer.question.w == w


def test_w_is_changed_again_and_again_while_it_plays(page, viewer):
    click(page, "Play")
    for w in (0, 0.5, 1.5, 0.7):
        enter(page, "w", w)
    settled(viewer, 0.7)
    until(lambda: "w = 0.7" in text(page))
    assert viewer._page.player.playing and errors(page) == []


def test_a_thing_is_moved_while_it_plays(page, viewer):
    shown, X = viewer._page, state(viewer).question.entity_pose("red1")
    X[0, 3] += 0.02
    shown._guarded(shown._changed, lambda question, pose: question.with_moved("red1", pose), X)
    until(lambda: state(viewer).worker.idle)
    np.testing.assert_allclose(state(viewer).question.entity_pose("red1"), X, atol=1e-9)
    assert state(viewer).answer.question is state(viewer).question and errors(page) == []


def test_a_kept_motion_stays_when_the_scene_is_another(page, viewer):
    click(page, "Keep this motion")
    until(lambda: len(state(viewer).kept) == 1)
    before = viewer._page.stage.drawn
    click(page, "Things")
    until(lambda: "Severity" in text(page))
    enter(page, "Severity", 40)
    until(lambda: viewer._page.stage.drawn is not before and state(viewer).worker.idle)
    assert "A: w = 0.7" in text(page) and errors(page) == []
    click(page, "Plan")
    click(page, "Let go of those kept")
    until(lambda: not state(viewer).kept)


def test_two_tabs_show_the_same_and_one_is_closed_while_a_plan_runs(page, viewer, recwarn):
    first = page.current_window_handle
    page.switch_to.new_window("window")
    second = page.current_window_handle
    page.get(viewer.url)
    until(lambda: "w = 0.7" in text(page))
    enter(page, "w", 1.1)
    settled(viewer, 1.1)
    assert errors(page) == []
    page.switch_to.window(first)
    until(lambda: "w = 1.1" in text(page))
    page.switch_to.window(second)
    viewer._page._guarded(viewer._page._ask, state(viewer).question.weighted(0.4))
    page.close()
    page.switch_to.window(first)
    settled(viewer, 0.4)
    until(lambda: "w = 0.4" in text(page) and len(viewer._page.server.get_clients()) == 1)
    assert errors(page) == [] and [str(one.message) for one in recwarn if one.category is UserWarning] == []
    t = viewer._page.player.t
    until(lambda: viewer._page.player.t != t)


def test_a_start_is_typed_digit_by_digit(page, viewer):
    """A partly typed number may be unreachable: the field must not be reset."""
    before = state(viewer).question
    there = before.handle_pose(before.start)[:3, 3] + [0.0, 0.0, 0.04]
    enter(page, "Start [m]", round(float(there[2]), 3), number=3)
    until(lambda: state(viewer).question is not before and state(viewer).worker.idle)
    found = state(viewer).question
    assert abs(found.handle_pose(found.start)[2, 3] - there[2]) < 2e-3
    assert errors(page) == []
