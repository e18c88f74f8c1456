"""Progress of commands, shown only at a terminal."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from graceful_plan.result import TracePoint

_TICK = 0.5
"""Interval between updates [s]."""


class ProgressLine:
    """Status line of a command at a terminal, with the elapsed seconds.

    Args:
        quiet: Whether to show nothing.
        stage: Text of the first stage.
    """

    def __init__(self, quiet: bool, stage: str = "loading") -> None:
        self.shown = sys.stderr.isatty() and not quiet
        self.text = stage
        self.began = time.monotonic()
        self._ended = threading.Event()
        self._writing = threading.Lock()
        self._clock = threading.Thread(target=self._tick, daemon=True)

    def __enter__(self) -> ProgressLine:
        if self.shown:
            self._clock.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.shown:
            self._ended.set()
            self._clock.join()
            _overwrite("")

    @property
    def callback(self) -> Callable[[Any], None] | None:
        """Callback for `plan` and `pareto`; None without a terminal."""
        return self.show if self.shown else None

    def stage(self, text: str) -> None:
        """Set the text of the stage that begins."""
        self.text = text

    def show(self, point: Any) -> None:
        """Show the latest improvement, or the progress of a search for a front."""
        if isinstance(point, TracePoint):
            self.text = f"total {point.total:.4g}  motion {point.motion:.4g}  impact {point.impact:.4g}"
        else:
            self.text = f"{point.stage}, {point.candidates} candidates"
        self._write()

    def _tick(self) -> None:
        while not self._ended.wait(_TICK):
            self._write()

    def _write(self) -> None:
        with self._writing:
            _overwrite(f"{time.monotonic() - self.began:6.1f} s  {self.text}")


class RunCounter:
    """Counter of the finished runs of a comparison, at a terminal."""

    def __init__(self, quiet: bool) -> None:
        self.shown = sys.stderr.isatty() and not quiet
        self.total = 0

    def show(self, done: int, total: int, run: Any) -> None:
        """Overwrite the line with the number of finished runs and the latest run."""
        self.total = total
        if self.shown:
            _overwrite(f"{done}/{total} runs" + (f": {run.problem}, {run.planner}, {run.status}" if run else ""))

    def end(self) -> None:
        """Clear the line."""
        if self.shown:
            _overwrite("")


def _overwrite(text: str) -> None:
    """Overwrite the current line."""
    sys.stderr.write(f"\r\x1b[K{text}")
    sys.stderr.flush()
