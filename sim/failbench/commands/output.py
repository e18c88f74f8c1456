"""Output of commands, and their progress bar."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, NamedTuple

from failbench.sweeps.sweep import SweepProgress
from graceful_plan import documents


class Answer(NamedTuple):
    """Result of a command."""

    document: Any
    text: str | None = None
    """Readable text; None prints the document instead."""

    def shown(self, as_json: bool) -> str:
        """Return the text to print."""
        return documents.to_json(self.document) if as_json or self.text is None else self.text


class Bar:
    """Progress bar, shown on a terminal only."""

    def __init__(self, args: argparse.Namespace, unit: str = "rollouts") -> None:
        self.unit = unit
        self.shown = sys.stderr.isatty() and not args.json
        self.started = time.monotonic()

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *_: object) -> None:
        if self.shown:
            _write("")

    def sweep(self, progress: SweepProgress) -> None:
        """Update the progress of a sweep."""
        failed = f", {progress.failed} chunks FAILED" if progress.failed else ""
        self.show(progress.rollouts_done, progress.rollouts, failed)

    def show(self, done: int, total: int, note: str = "") -> None:
        """Update the numbers of finished and of all units."""
        if self.shown:
            bar = "#" * (30 * done // total)
            seconds = time.monotonic() - self.started
            _write(f"[{bar:<30}] {done}/{total} {self.unit}, {seconds:.0f} s{note}")


def _write(line: str) -> None:
    """Overwrite the current line of the terminal."""
    sys.stderr.write(f"\r\x1b[K{line}")
    sys.stderr.flush()
