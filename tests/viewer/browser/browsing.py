"""What somebody does with a page of the viewer, in a browser that is driven by selenium."""

from __future__ import annotations

import base64
import io
import time

_PATIENCE = 90.0
"""Seconds after which a test gives up: the picture is drawn without a graphics card."""


def state(viewer):
    return viewer._page.state


def text(browser):
    return browser.find_element("tag name", "body").text


def until(condition):
    """Wait until something is true, and return what it is."""
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.1)
    raise AssertionError("it never came true")


def press(find):
    """Click on the first element that is found and in sight, as soon as the page lets it be clicked."""
    from selenium.common.exceptions import WebDriverException

    def pressed():
        for one in find():
            try:
                if one.is_displayed():
                    one.click()
                    return True
            except WebDriverException:  # a busy page has drawn it anew, or something lies over it for a moment
                continue
        return False

    until(pressed)


def click(browser, words):
    press(lambda: browser.find_elements("xpath", f"//*[normalize-space(text())='{words}']"))


def tick(browser, label):
    path = f"(//*[normalize-space(text())='{label}']/following::input[@type='checkbox'])[1]"
    browser.find_element("xpath", path).click()


def enter(browser, label, value, number=1):
    """Type a value into a field behind a label."""
    from selenium.webdriver.common.keys import Keys

    path = f"(//*[normalize-space(text())='{label}']/following::input[@type='text'])[{number}]"
    field = browser.find_element("xpath", path)
    field.click()
    field.send_keys(Keys.CONTROL, "a")
    field.send_keys(str(value), Keys.ENTER, Keys.TAB)


def errors(browser):
    return [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def picture(browser):
    """The canvas as an array; not what lies over it."""
    import matplotlib.image

    canvas = browser.find_element("tag name", "canvas")
    return matplotlib.image.imread(io.BytesIO(base64.b64decode(canvas.screenshot_as_base64)), format="png")


def choose(browser, label, option):
    """Choose from the list behind a label that is in sight; the same label may be on tabs that are not."""
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
    """Look with so many pixels across, on light or dark paper."""
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    paper = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [paper]})
