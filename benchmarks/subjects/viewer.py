"""How long until the viewer's first picture, and how many frames a second it plays."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite

TITLE = "Viewer: first picture, frames a second"
ADDRESS_WITHIN, PICTURE_WITHIN, PLAN_WITHIN, RATE = 1.0, 2.0, 4.0, 30.0
SCENE = "kitchen_counter"
"""A scene with 22 entities."""
SIZES = ((1300, 900), (700, 500))
MEASURED = """\
"Address": from `graceful-plan view tabletop`, a new process, until it prints where the page is; "first picture":
until a browser that is open already has drawn the scene; "with the plan": until both costs are on the page. "Sent":
frames a second that the page computes and sends while it plays a scene with 22 entities, both robots and the footprint
of a fall; "drawn": frames a second in which the browser, without a window, drew anything, at two sizes of its window.
Without a graphics card WebGL is computed by the processor, of which browser, page and whatever else runs want a part.
"""
_PORT = 8460
_PARTS = 28
"""Parts of `tabletop`, each of which is drawn by itself: a picture with fewer calls is not yet that of the scene."""
_DRAWING = """
window.drawn = 0; window.most = 0; let calls = 0;
for (const name of ['drawElements', 'drawArrays', 'drawElementsInstanced']) {
  const plain = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...all) { calls++; return plain.apply(this, all); };
}
const tick = () => {
  if (calls) { window.drawn++; window.most = Math.max(window.most, calls); calls = 0; }
  requestAnimationFrame(tick);
};
requestAnimationFrame(tick);
"""
_RENDERER = """
const gl = document.createElement('canvas').getContext('webgl2');
const about = gl && gl.getExtension('WEBGL_debug_renderer_info');
return about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : 'unknown';
"""


_BARE = """
import sys, time, viser
server = viser.ViserServer(host="127.0.0.1", port=int(sys.argv[1]), verbose=False)
server.scene.configure_environment_map(None)
server.scene.configure_default_lights(cast_shadow=False)
server.scene.add_box("/box", dimensions=(1.0, 1.0, 1.0))
print("ready", flush=True)
time.sleep(100.0)
"""
_BARE_CALLS = 2


def run(options: suite.Options) -> str:
    """Measure both; what needs a browser is left out where there is none."""
    times, seconds = options.pick((7, 8.0), quick=(1, 2.0))
    if shutil.which("chromium") is None or shutil.which("chromedriver") is None:
        lines = [_rate("sent", *_sent(seconds))]
        return f"{MEASURED}\nThere is no chromium with its driver here.\n\n{report.targets(lines)}"
    lines = [*_first_pictures(times), _of_viser_alone(times), *_playing(seconds)]
    with _browser(*SIZES[0]) as browser:
        renderer = browser.execute_script(_RENDERER)
    return f"{MEASURED}\n{times} processes; medians. WebGL by: {renderer}.\n\n{report.targets(lines)}"


def _first_pictures(times: int) -> Iterator[report.Target]:
    with _browser(*SIZES[0]) as browser:
        found = np.array([_first_picture(browser, _PORT + i) for i in range(times + 1)])[1:]  # the first one warms up
    for what, values in zip(("address", "first picture", "with the plan"), found.T, strict=True):
        median = float(np.median(values))
        told = f"{report.quantity(median, ' s')}, slowest {report.quantity(float(values.max()), ' s')}"
        limit = {"address": ADDRESS_WITHIN, "first picture": PICTURE_WITHIN}.get(what, PLAN_WITHIN)
        yield report.Target(what=what, wanted=f"< {limit:g} s", measured=told, met=median < limit)


def _of_viser_alone(times: int) -> report.Target:
    """Return how long the same takes for a page with nothing but one box, which no viewer made with viser can beat."""
    with _browser(*SIZES[0]) as browser:
        seconds = [_bare_picture(browser, _PORT + 30 + i) for i in range(times + 1)][1:]
    told = f"{report.quantity(float(np.median(seconds)), ' s')}, slowest {report.quantity(max(seconds), ' s')}"
    return report.Target(what="first picture of viser with one box", wanted="-", measured=told, met=None)


def _bare_picture(browser: Any, port: int) -> float:
    browser.get("about:blank")
    started = time.perf_counter()
    with subprocess.Popen([sys.executable, "-c", _BARE, str(port)], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            while "ready" not in process.stdout.readline():
                pass
            browser.get(f"http://localhost:{port}")
            _until(lambda: browser.execute_script("return window.most") >= _BARE_CALLS)
            return time.perf_counter() - started
        finally:
            process.terminate()


def _first_picture(browser: Any, port: int) -> tuple[float, float, float]:
    """Seconds from the command to the address of the page, to the first picture, and to the costs of both motions."""
    browser.get("about:blank")
    started = time.perf_counter()
    command = [sys.executable, "-m", "graceful_plan.tools.cli", "view", "tabletop", "--json", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            text = ""
            while not text.rstrip().endswith("}"):
                text += process.stdout.readline()
            address = time.perf_counter() - started
            browser.get(json.loads(text)["url"])
            _until(lambda: browser.execute_script("return window.most") >= _PARTS)
            picture = time.perf_counter() - started
            _until(lambda: "duration [s]" in browser.find_element("tag name", "body").text)
            return address, picture, time.perf_counter() - started
        finally:
            process.terminate()


def _playing(seconds: float) -> Iterator[report.Target]:
    with gp.view(SCENE, port=_PORT + 50) as viewer:
        page: Any = viewer._page
        page.begin()
        page.state.worker.wait(30.0)
        sent: list[float] = []
        count = _counted(page)
        for width, height in SIZES:
            with _browser(width, height) as browser:
                browser.get(viewer.url)
                _until(lambda browser=browser: browser.execute_script("return window.drawn") > 0)
                time.sleep(3.0)
                page.player.toggle(True)
                time.sleep(1.0)
                first, began, frames = count[0], time.perf_counter(), browser.execute_script("return window.drawn")
                time.sleep(seconds)
                drawn = browser.execute_script("return window.drawn") - frames
                passed = time.perf_counter() - began
                page.player.toggle(False)
                sent.append((count[0] - first) / passed)
                yield _rate(f"drawn, {width} x {height} pixels", drawn / passed)
        yield _rate("sent", *sent)


def _sent(seconds: float) -> tuple[float]:
    """Frames a second that are computed without anybody who looks."""
    with gp.view(SCENE, port=_PORT + 50) as viewer:
        page: Any = viewer._page
        page.begin()
        page.state.worker.wait(30.0)
        count = _counted(page)
        page.player.toggle(True)
        time.sleep(seconds)
        return (count[0] / seconds,)


def _counted(page: Any) -> list[int]:
    """Count the moments that a page asks for."""
    count, plain = [0], page.state.at

    def at(t: float) -> Any:
        count[0] += 1
        return plain(t)

    page.state.at = at
    return count


def _rate(what: str, *rates: float) -> report.Target:
    least = min(rates)
    return report.Target(
        what=f"frames a second, {what}", wanted=f">= {RATE:g}", measured=f"{least:.1f}", met=least >= 0.97 * RATE
    )


def _until(condition: Any) -> None:
    end = time.perf_counter() + 60.0
    while not condition():
        if time.perf_counter() > end:
            raise TimeoutError("the page never came that far")
        time.sleep(0.01)


@contextmanager
def _browser(width: int, height: int) -> Iterator[Any]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        f"--window-size={width},{height}",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--ignore-gpu-blocklist",
    ):
        options.add_argument(argument)
    browser = webdriver.Chrome(options=options, service=Service(str(shutil.which("chromedriver"))))
    try:
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _DRAWING})
        yield browser
    finally:
        browser.quit()
