"""How a command ends: its errors and interrupts. Importing this module imports neither planners nor NumPy."""

from __future__ import annotations

import json
import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any, final


@final
class Interrupts:
    """Records Ctrl-C inside a `with` statement, where it raises KeyboardInterrupt as usual.

    Extension modules that are interrupted while they are imported raise an ImportError instead, which does not tell.
    """

    def __init__(self) -> None:
        self.seen = False
        self._before: Any = None

    def __enter__(self) -> Interrupts:
        is_main = threading.current_thread() is threading.main_thread()
        if is_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def caused(self, error: BaseException) -> bool:
        """Return whether an error comes from Ctrl-C."""
        return isinstance(error, KeyboardInterrupt) or (self.seen and not isinstance(error, SystemExit))

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.seen = True
        signal.default_int_handler(number, frame)


def complain(command: str, error: BaseException, code: int, *, as_json: bool, before: str = "") -> int:
    """Print an error on standard error, and with `--json` as a document on standard output.

    Args:
        command: Program and command.
        error: The error.
        code: Exit code, which is returned.
        as_json: Whether `--json` was given.
        before: Text to print first.
    """
    if before:
        note(before)
    note(f"{command}: {error}")
    if as_json:
        document = {
            "schema": "graceful_plan.error",
            "version": 1,
            "command": command,
            "error": type(error).__name__,
            "message": str(error),
            "exit_code": code,
        }
        sys.stdout.write(json.dumps(document, indent=2) + "\n")
    return code


def note(text: str) -> None:
    """Print a line on standard error."""
    sys.stderr.write(text + "\n")
