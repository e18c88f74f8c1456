"""When a browser has drawn its first picture: until then the processor is for that."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

_ANSWERS = 3
"""A browser answers at the beginning of a frame; the scene is in the second one at the latest."""
_PATIENCE = 2.5
"""Who has not answered by then [s], such as a page that nobody looks at, is not waited for."""
_CHANGE = 1e-4
"""Of the angle of view, so that the browser has something to answer [rad]; it is taken back."""


def when_drawn(client: Any, act: Callable[[], None]) -> None:
    """Call a function once a browser that has just come has drawn something, in a thread of its own.

    Args:
        client: viser's handle of the browser.
        act: What is done then, once.
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
