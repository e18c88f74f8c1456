"""Pages of `tune` and `bench` in a browser: the 3-D view is drawn, the layout fits, light and dark mode, no errors."""

from __future__ import annotations

import numpy as np
import pytest
from browsing import errors, media, until

import graceful_plan as gp
from graceful_plan.tools import cli

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def pages(browser_parts, tmp_path_factory):
    """Write both reports."""
    folder = tmp_path_factory.mktemp("reports")
    tune = ["tune", "tabletop", "lift_to_goal", "--iterations", "300", "--validate", "2", "--out", str(folder / "tune")]
    suite = folder / "suite.yaml"
    suite.write_text("version: 1\nproblems: [{scene: tabletop, tasks: [lift_to_goal]}]\n")
    bench = ["bench", "--suite", str(suite), "--planners", *gp.PLANNERS, "--seeds", "1", "--processes", "0"]
    assert cli.main(tune) in (cli.DONE, cli.FAILED)
    # On a busy machine no planner may solve a problem in 0.05 s, and then no motion can be shown.
    limits = (limit for limit in ("0.05", "0.5", "5") if compared(bench, limit, folder) == cli.DONE)
    return {"tune": folder / "tune" / "front.html", "bench": folder / next(limits) / "report.html"}


def compared(bench, limit, folder):
    return cli.main([*bench, "--time-limit", limit, "--out", str(folder / limit)])


@pytest.mark.parametrize("name", ["tune", "bench"])
@pytest.mark.parametrize(("width", "dark"), [(1300, False), (700, True)])
def test_a_report_is_drawn_and_fits(pages, browser, name, width, dark):
    media(browser, width=width, dark=dark)
    browser.get(pages[name].as_uri())
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert (np.mean([int(x) for x in paper.strip("rgb()").split(",")]) < 60) == dark
    if width == 1300:
        wider = "return [...document.querySelectorAll('table')].filter(t => t.scrollWidth > t.parentNode.clientWidth)"
        assert browser.execute_script(f"{wider}.length") == 0
    frame = browser.find_element("id", "space")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", frame)
    browser.switch_to.frame(frame)
    until(lambda: browser.find_elements("tag name", "canvas"))
    browser.switch_to.default_content()
    assert errors(browser) == []
