"""What commands answer, and how they show how far they have come."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any, NamedTuple

from failbench.sweeps.sweep import SweepProgress
from graceful_plan import documents


class Answer(NamedTuple):
    """What a command found out."""

    document: Any
    text: str | None = None
    """The same for people; None if the document is what was asked for."""

    def shown(self, as_json: bool) -> str:
        """Return it as it is to be printed."""
        return documents.to_json(self.document) if as_json or self.text is None else self.text


class Bar:
    """Shows how much is done, if somebody sits at a terminal."""

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
        """Overwrite the line with how far a sweep has come."""
        failed = f", {progress.failed} chunks FAILED" if progress.failed else ""
        self.show(progress.rollouts_done, progress.rollouts, failed)

    def show(self, done: int, total: int, note: str = "") -> None:
        """Overwrite the line with how many are done."""
        if self.shown:
            bar = "#" * (30 * done // total)
            seconds = time.monotonic() - self.started
            _write(f"[{bar:<30}] {done}/{total} {self.unit}, {seconds:.0f} s{note}")


def _write(line: str) -> None:
    """Overwrite the line that the cursor is in."""
    sys.stderr.write(f"\r\x1b[K{line}")
    sys.stderr.flush()
