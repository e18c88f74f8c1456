"""The page against stored pictures: no visible content is missing, for any font and rendering.

Motions are given, not planned, so the pictures are the same on every machine. If a page changes for a good reason,
inspect the picture that the failing test names and put it into the folder `stored`.
"""

from __future__ import annotations

import base64
import io
import time

import numpy as np
import pytest
from browsing import errors, media, text, until
from pictures import STORED, UNLIKE, compared

import graceful_plan as gp
from graceful_plan.viewer.failing import Failure

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]
_STILL = 1e-3
"""Mean difference of two successive pictures of a page at rest."""


def given(scene, *configurations):
    """Return a motion through configurations."""
    path = gp.Path(np.stack([np.asarray(q, dtype=float) for q in configurations]))
    return gp.retime(path, scene.limits, scene.joints)


@pytest.fixture(scope="module")
def arm(browser_parts):
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    goal = np.atleast_2d(np.asarray(task.goal, dtype=float))[0]
    motion = given(task.scene, task.start, 0.5 * (task.start + goal) + 0.1, goal)
    with gp.view(motion, task, port=8440) as viewer:
        viewer._page._asked_first = True  # nothing is planned
        viewer._page.player.seek(0.5 * motion.duration)
        yield viewer._page


@pytest.fixture(scope="module")
def base(browser_parts):
    task = gp.load_scene("apartment").tasks["bring_parcel"]
    scene, tucked = task.scene, np.asarray(task.start, dtype=float)[3:]
    motion = given(scene, *([x, 1.4, 0.0, *tucked] for x in (5.5, 7.3)))
    with gp.view(motion, scene, port=8450, dark=True) as viewer:
        viewer._page._asked_first = True
        viewer._page.player.seek(0.5 * motion.duration)
        yield viewer._page


def page_of(browser, shown):
    """Return a picture of the whole page at rest."""
    media(browser, width=1100, dark=False)
    size = {"width": 1100, "height": 720, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    if browser.current_url.rstrip("/") != shown.url:
        browser.get(shown.url)
        until(lambda: "Impact by entity" in text(browser))
        time.sleep(2.0)
    for button in browser.find_elements("css selector", "[class*=Notification-closeButton]"):
        button.click()  # notice about the missing graphics card
    last = [taken(browser)]

    def still():
        time.sleep(0.5)
        last.append(taken(browser))
        return np.abs(last[-1] - last[-2]).mean() < _STILL

    until(still)
    return last[-1]


def taken(browser):
    import matplotlib.image

    data = browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"]
    return matplotlib.image.imread(io.BytesIO(base64.b64decode(data)), format="png")


def check(name, browser, shown, folder):
    found, file = compared(name, page_of(browser, shown), folder)
    assert found < UNLIKE, f"{found:.3f} unlike {STORED / name}.png; what was seen is {file}"
    assert errors(browser) == []


def test_an_arm_with_its_path_chart_and_footprint(arm, browser, tmp_path):
    check("arm", browser, arm, tmp_path)


@pytest.mark.parametrize("what", ["robot", "chart"])
def test_a_page_without_it_is_noticed(arm, browser, tmp_path, what):
    hidden = [arm.stage._chart._handle] if what == "chart" else list(robot_of(arm))
    assert hidden
    for one in hidden:
        one.visible = False
    found, _ = compared("arm", page_of(browser, arm), tmp_path)
    for one in hidden:
        one.visible = True
    assert found > 1.5 * UNLIKE


def robot_of(shown):
    """Return the nodes of the robot's parts."""
    scene = shown.stage._scene
    for part, frame in zip(scene._drawn, scene._frames, strict=True):
        if any(name in part.name for name in ("link", "hand", "finger")):
            yield frame


def test_a_failure_with_its_hits(arm, browser, tmp_path):
    with arm.lock:
        replay = arm.state.fail(Failure(fault="gripper_failure", moment=0.5))
        arm._draw()
        arm._say(busy=False)
        arm.player.seek(replay.duration)
    check("arm_failed", browser, arm, tmp_path)


def test_a_base_with_the_stretch_on_which_it_goes_on(base, browser, tmp_path):
    check("base_dark", browser, base, tmp_path)
