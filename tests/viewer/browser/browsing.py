"""Actions on a page of the viewer, in a browser driven by selenium."""

from __future__ import annotations

import base64
import io
import time

_PATIENCE = 90.0
"""Seconds after which a test fails. Rendering is slow without a graphics card."""


def state(viewer):
    return viewer._page.state


def text(browser):
    return browser.find_element("tag name", "body").text


def until(condition):
    """Wait until a condition is truthy, and return its value."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.1)
    raise AssertionError("it never came true")


def press(find):
    """Click on the first matching visible element as soon as the page allows it."""
    from selenium.common.exceptions import WebDriverException

    def pressed():
        for one in find():
            try:
                if one.is_displayed():
                    one.click()
                    return True
            except WebDriverException:  # the page has redrawn the element, or another one covers it briefly
                continue
        return False

    until(pressed)


def click(browser, words):
    press(lambda: browser.find_elements("xpath", f"//*[normalize-space(text())='{words}']"))


def tick(browser, label):
    path = f"(//*[normalize-space(text())='{label}']/following::input[@type='checkbox'])[1]"
    browser.find_element("xpath", path).click()


def enter(browser, label, value, number=1):
    """Type a value into the field after a label."""
    from selenium.webdriver.common.keys import Keys

    path = f"(//*[normalize-space(text())='{label}']/following::input[@type='text'])[{number}]"
    field = browser.find_element("xpath", path)
    field.click()
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys(str(value), Keys.ENTER, Keys.TAB)


def errors(browser):
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def picture(browser):
    """Return the canvas as an array, without overlays."""
    import matplotlib.image

    canvas = browser.find_element("tag name", "canvas")
    return matplotlib.image.imread(io.BytesIO(base64.b64decode(canvas.screenshot_as_base64)), format="png")


def choose(browser, label, option):
    """Choose an option from the visible list after a label; hidden tabs may have the same label."""
    path = f"//*[normalize-space(text())='{label}']/following::input[1]"
    listed = f"//*[@role='option' and normalize-space(.)='{option}']"

    def fields():
        return [one for one in browser.find_elements("xpath", path) if one.is_displayed()]

    def options():
        return [one for one in browser.find_elements("xpath", listed) if one.is_displayed()]

    press(fields)
    until(options)
    press(options)
    until(lambda: fields() and fields()[0].get_attribute("value") == option)


def media(browser, *, width, dark):
    """Set the width in pixels, and light or dark mode."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    paper = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [paper]})
