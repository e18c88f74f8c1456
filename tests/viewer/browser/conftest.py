"""A headless browser, if installed; otherwise the tests that need it are skipped."""

from __future__ import annotations

import importlib.util
import re
import shutil

import pytest
from browsing import text, until

_BROWSERS, _DRIVERS = ("chromium", "chromium-browser", "google-chrome"), ("chromedriver", "chromium.chromedriver")
_ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--window-size=1100,720",
    # WebGL in software, if there is no graphics card.
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)


@pytest.fixture(scope="session")
def browser_parts():
    """Return the paths of a browser and its driver."""
    for module in ("viser", "selenium"):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    browser, driver = (next(filter(None, map(shutil.which, names)), None) for names in (_BROWSERS, _DRIVERS))
    if browser is None or driver is None:
        pytest.skip(f"there is no {_BROWSERS[0]} with its driver on this machine: apt-get install chromium-driver")
    return browser, driver


@pytest.fixture(scope="module")
def browser(browser_parts):
    """Yield a browser driven by selenium."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = browser_parts[0]
    for argument in _ARGUMENTS:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(browser_parts[1]))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def page(viewer, browser):
    """Return the browser at the page of the file's `viewer`, with a motion on it."""
    browser.get(viewer.url)
    until(lambda: re.search(r"impact\s+[\d.]+", text(browser)))
    return browser
