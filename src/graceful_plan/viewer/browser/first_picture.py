"""Detection of the first picture in a browser; heavy work waits for it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

_ANSWERS = 3
"""Number of replies to wait for: a browser replies at the start of a frame, and draws the scene by the second."""
_PATIENCE = 2.5
"""Maximum waiting time [s], for browsers that do not reply, such as pages in the background."""
_CHANGE = 1e-4
"""Temporary change of the field of view that makes the browser reply [rad]."""


def when_drawn(client: Any, act: Callable[[], None]) -> None:
    """Call a function in a separate thread once a new browser has drawn its first picture.

    Args:
        client: viser's handle of the browser.
        act: Function, called once.
    """
    done, left, angle = threading.Lock(), [_ANSWERS], float(client.camera.fov)

    def finish() -> None:
        if done.acquire(blocking=False):
            act()

    def answered(_: Any) -> None:
        left[0] -= 1
        if left[0] > 0:
            client.camera.fov = angle + (_CHANGE if left[0] % 2 else 0.0)
        elif left[0] == 0:
            finish()

    client.camera.on_update(answered)
    client.camera.fov = angle + _CHANGE
    late = threading.Timer(_PATIENCE, finish)
    late.daemon = True
    late.start()
