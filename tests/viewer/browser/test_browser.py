"""The page in a real browser: it opens, replans when w moves and the goal is dragged, and shows failures."""

from __future__ import annotations

import functools
import re
import time

import numpy as np
import pytest
from browsing import click, enter, errors, picture, state, text, tick, until
from places import ROOT

import graceful_plan as gp

pytestmark = [
    pytest.mark.long,
    # Sockets of driver and server that the garbage collector closes are harmless.
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def viewer(browser_parts):
    with gp.view("tabletop", task="lift_to_goal", port=8370, time_limit=3.0) as viewer:
        yield viewer


@pytest.mark.usefixtures("browser_parts")
def test_the_guide_runs(capsys, monkeypatch):
    # Iterations instead of a second, which may be too short on a busy machine.
    monkeypatch.setattr(gp, "plan", functools.partial(gp.plan, iterations=300))
    (snippet,) = re.findall(
        r"^```python\n(.*?)^```", (ROOT / "docs" / "viewer.md").read_text(), re.MULTILINE | re.DOTALL
    )
    exec(compile(snippet, "viewer.md", "exec"), {})
    assert capsys.readouterr().out.startswith("http://localhost:")


def test_the_page_opens_with_a_picture_and_both_costs(page):
    assert page.title.lower().startswith(("viser", "graceful"))
    shown = text(page)
    for words in ("w = 0.3", "w = 0", "duration [s]", "Impact by entity, over time", "Failure"):
        assert words in shown
    until(lambda: picture(page)[..., :3].std() > 0.03)
    assert "Share" not in shown
    assert errors(page) == []


def test_moving_w_from_0_to_1_gives_another_path(page, viewer):
    enter(page, "w", 0)
    until(lambda: state(viewer).worker.idle and state(viewer).answer.question.w == 0.0)
    before = state(viewer).motion.tool.copy()
    until(lambda: "w = 0" in text(page))
    enter(page, "w", 1)
    until(lambda: state(viewer).worker.idle and state(viewer).answer.question.w == 1.0)
    after = state(viewer).motion.tool
    middle = len(before) // 2
    assert np.linalg.norm(after[len(after) // 2] - before[middle]) > 0.02
    until(lambda: "w = 1" in text(page))
    motion = state(viewer).motion
    assert motion.cost.impact < 0.5 * state(viewer).answer.ordinary.cost.impact
    until(lambda: re.search(rf"impact\s+{motion.cost.impact:.3g}\b", text(page)))
    assert errors(page) == []


def test_a_typed_goal_is_reached(page, viewer):
    goal = state(viewer).motion.tool[-1] + [0.03, 0.0, 0.05]
    enter(page, "Goal [m]", round(float(goal[2]), 3), number=3)
    until(lambda: abs(state(viewer).question.goal_pose()[2, 3] - goal[2]) < 2e-3 and state(viewer).worker.idle)
    assert abs(state(viewer).motion.tool[-1, 2] - goal[2]) < 2e-3
    assert errors(page) == []


def seen_at(viewer, point):
    """Return the pixel of the canvas at which a point in W is drawn."""
    (client,) = viewer._page.server.get_clients().values()
    camera = client.camera
    w, x, y, z = camera.wxyz
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    right, down, ahead = R.T @ (np.asarray(point) - camera.position)
    height = camera.image_height
    scale = 0.5 * height / np.tan(0.5 * camera.fov)
    return np.array([0.5 * camera.image_width + scale * right / ahead, 0.5 * height + scale * down / ahead])


def test_the_goal_is_dragged_by_its_handle(page, viewer):
    from selenium.webdriver import ActionChains

    before = state(viewer).question
    X = before.goal_pose()
    size = viewer._page.handles.goal.scale
    canvas = page.find_element("tag name", "canvas")
    rect = canvas.rect
    arrows = [(seen_at(viewer, X[:3, 3] + 0.75 * size * X[:3, k]), k) for k in range(3)]
    middle = seen_at(viewer, X[:3, 3])
    tip, axis = max(arrows, key=lambda arrow: np.linalg.norm(arrow[0] - middle))
    along = (tip - middle) / np.linalg.norm(tip - middle)
    start = tip - 0.5 * np.array([rect["width"], rect["height"]])
    chain = ActionChains(page, duration=400)
    chain.move_to_element_with_offset(canvas, *start.round().astype(int).tolist()).pause(0.8).click_and_hold()
    for _ in range(4):
        chain.move_by_offset(*(-10 * along).round().astype(int).tolist()).pause(0.4)
    chain.release().perform()
    until(lambda: state(viewer).question is not before)
    moved = X[:3, :3].T @ (state(viewer).question.goal_pose()[:3, 3] - X[:3, 3])
    assert abs(moved[axis]) > 0.005 and np.abs(np.delete(moved, axis)).max() < 2e-3
    until(lambda: state(viewer).worker.idle)
    assert errors(page) == []


def test_a_gripper_failure_at_half_time_shows_predicted_and_observed_harm(page, viewer):
    if state(viewer).motion is None:  # the handle was dragged to an unreachable place
        state(viewer).ask(state(viewer).question.weighted(1.0))
        until(lambda: state(viewer).worker.idle)
    click(page, "Failure")
    until(lambda: "Let it fail" in text(page))
    click(page, "Let it fail")
    found = until(lambda: re.search(r"all\s+([\d.]+)\s+([\d.]+)", text(page)))
    replay = state(viewer).replay
    assert replay.failure.fault == "gripper_failure" and replay.failure.moment == 0.5
    assert float(found[1]) == pytest.approx(sum(replay.predicted.values()), abs=0.006)
    assert float(found[2]) == pytest.approx(sum(replay.observed.values()), abs=0.006)
    shown = text(page)
    assert "predicted" in shown and "observed" in shown and "gripper_failure, severe, at 50%" in shown
    until(lambda: viewer._page.player.t > replay.onset)
    click(page, "Healthy motion again")
    until(lambda: state(viewer).replay is None)
    assert errors(page) == []


def test_the_ordinary_motion_is_shown_beside_the_other_one(page, viewer):
    shown = viewer._page
    (client,) = shown.server.get_clients().values()
    before, picture_before = np.array(client.camera.look_at), picture(page)
    for how, moves in (("beside it", True), ("as a ghost", False)):
        with shown.lock:
            shown.controls.other.value = how
            shown.draw_plans()
        until(lambda moves=moves: (np.abs(client.camera.look_at - before).max() > 0.2) == moves)
        if moves:
            until(lambda: np.abs(picture(page) - picture_before).mean() > 1e-2)
    assert errors(page) == []


def test_motions_are_kept_in_sight(page, viewer):
    click(page, "Plan")
    until(lambda: "Keep this motion" in text(page))
    label = f"A: w = {state(viewer).question.w:g}"
    click(page, "Keep this motion")
    until(lambda: label in text(page))
    (kept,) = state(viewer).kept
    until(lambda: re.search(rf"impact\s+.*{kept.cost.impact:.3g}\b", text(page)))
    click(page, "Keep this motion")
    until(lambda: "not kept already" in text(page))
    click(page, "Let go of those kept")
    until(lambda: not state(viewer).kept and label not in text(page))
    assert errors(page) == []


def test_the_page_plays_and_pauses(page, viewer):
    if viewer._page.player.playing:
        click(page, "Pause")
        until(lambda: not viewer._page.player.playing)
    t = viewer._page.player.t
    click(page, "Play")
    until(lambda: viewer._page.player.t != t)
    click(page, "Pause")
    until(lambda: not viewer._page.player.playing)
    assert errors(page) == []


def test_layers_and_darkness_change_the_picture(page, viewer):
    click(page, "View")
    until(lambda: "Risk map" in text(page))
    time.sleep(1.0)
    before = picture(page)
    page.find_element(
        "xpath", "(//*[normalize-space(text())='Risk map']/following::input[@type='checkbox'])[1]"
    ).click()
    until(lambda: viewer._page.stage.layer is not None)
    until(lambda: np.abs(picture(page) - before).mean() > 1e-3)
    tick(page, "Dark")
    until(lambda: picture(page)[:60, :60, :3].mean() < 0.3)
    assert errors(page) == []


def test_a_base_that_drives_is_shown_and_fails(browser):
    with gp.view("apartment", port=8380, time_limit=4.0) as viewer:
        browser.get(viewer.url)
        until(lambda: re.search(r"impact\s+[\d.]+", text(browser)))
        times = np.linspace(0.0, state(viewer).duration, 20).round(2).tolist()
        moving = next(t for t in times if state(viewer).at(t).going_on is not None)  # it may rest at some times
        enter(browser, "Time [s]", moving)
        until(lambda: state(viewer).at(viewer._page.player.t).going_on is not None)
        click(browser, "Failure")
        click(browser, "Let it fail")
        until(lambda: "power_lost" in text(browser) and re.search(r"all\s+[\d.]+\s+[\d.]+", text(browser)))
        assert "left out of the simulation" in text(browser)
        X = state(viewer).question.goal_pose()
        click(browser, "Plan")
        enter(browser, "Goal [m]", round(float(X[0, 3]) + 0.2, 2))
        asked = X[0, 3] + 0.2
        until(lambda: abs(state(viewer).question.goal_pose()[0, 3] - asked) < 5e-3 and state(viewer).worker.idle)
        assert abs(state(viewer).motion.trajectory.q[-1, 0] - X[0, 3] - 0.2) < 0.02
        assert errors(browser) == []
