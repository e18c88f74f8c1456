"""The time that is shown: moved by somebody, or by itself while it plays."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import final

from graceful_plan.viewer.browser.controls import Controls
from graceful_plan.viewer.state import ViewerState

RATE = 30.0
"""Frames per second while it plays."""
_WORDS_RATE = 6.0
"""Times per second that text and chart change meanwhile: they cost the browser more than poses."""


@final
class Player:
    """Shows one moment after the other.

    Args:
        state: How long what is shown takes.
        controls: Where the time and the button are.
        show: Shows a time [s], and says whether words are to change, too.
        lock: Held while something is shown.
    """

    def __init__(
        self, state: ViewerState, controls: Controls, show: Callable[[float, bool], None], lock: threading.RLock
    ) -> None:
        self._state, self._controls, self._show, self._lock = state, controls, show, lock
        self.t, self.playing = 0.0, False
        self._said_at, self._closed = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._play, name="viewer-player", daemon=True)

    def start(self) -> None:
        """Begin to play whenever that is asked for."""
        self._thread.start()

    def close(self) -> None:
        """End it."""
        self._closed.set()
        self._thread.join(timeout=5.0)

    def toggle(self, playing: bool | None = None) -> None:
        """Play if it does not, or as is said."""
        self.playing = not self.playing if playing is None else playing
        self._controls.play.label = "Pause" if self.playing else "Play"

    def seek(self, t: float) -> None:
        """Show a time [s], or the end if that comes before it."""
        c = self._controls
        c.time.max = max(0.01, round(self._state.duration, 2))
        self.t = min(max(t, 0.0), self._state.duration)
        c.time.value = min(round(self.t, 2), c.time.max)
        self._show(self.t, True)

    def _play(self) -> None:
        last = time.perf_counter()
        while not self._closed.wait(max(0.0, last + 1.0 / RATE - time.perf_counter())):
            now = time.perf_counter()
            passed, last = now - last, now
            if not self.playing:
                continue
            with self._lock:
                self._step(passed, now)

    def _step(self, passed: float, now: float) -> None:
        duration, c = self._state.duration, self._controls
        self.t += passed * float(c.speed.value)
        if self.t > duration:
            # A failure stops where it ends, a motion begins again.
            self.t = duration if self._state.replay is not None else 0.0
            if self._state.replay is not None:
                self.toggle(False)
        due = now - self._said_at >= 1.0 / _WORDS_RATE or not self.playing
        if due:
            self._said_at = now
            c.time.value = min(round(self.t, 2), c.time.max)
        self._show(self.t, due)
