"""Displayed time: set by the user, or advanced during playback."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import final

from graceful_plan.viewer.browser.controls import Controls
from graceful_plan.viewer.state import ViewerState

RATE = 30.0
"""Frames per second during playback."""
_WORDS_RATE = 6.0
"""Updates of text and chart per second during playback, fewer because they cost the browser more than poses."""


@final
class Player:
    """Plays the displayed motion or failure.

    Args:
        state: State with the duration.
        controls: Controls with time slider and play button.
        show: Shows a time [s]; the second argument says whether to update text and chart.
        lock: Held while drawing.
    """

    def __init__(
        self, state: ViewerState, controls: Controls, show: Callable[[float, bool], None], lock: threading.RLock
    ) -> None:
        self._state, self._controls, self._show, self._lock = state, controls, show, lock
        self.t, self.playing = 0.0, False
        self._said_at, self._closed = 0.0, threading.Event()
        self._thread = threading.Thread(target=self._play, name="viewer-player", daemon=True)

    def start(self) -> None:
        """Start the playback thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop the playback thread."""
        self._closed.set()
        self._thread.join(timeout=5.0)

    def toggle(self, playing: bool | None = None) -> None:
        """Toggle playback, or set it."""
        self.playing = not self.playing if playing is None else playing
        self._controls.play.label = "Pause" if self.playing else "Play"

    def seek(self, t: float) -> None:
        """Show a time [s], at most the end."""
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
            # A failure stops at its end; a motion restarts.
            self.t = duration if self._state.replay is not None else 0.0
            if self._state.replay is not None:
                self.toggle(False)
        due = now - self._said_at >= 1.0 / _WORDS_RATE or not self.playing
        if due:
            self._said_at = now
            c.time.value = min(round(self.t, 2), c.time.max)
        self._show(self.t, due)
