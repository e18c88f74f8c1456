"""Parser of command lines, and exit codes. Importing this module does not import the planners.

Errors are raised instead of printed, so that `--json` can report them as JSON. The parser records its arguments.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any, NoReturn, final

from graceful_plan._version import __version__
from graceful_plan.exceptions import GracefulPlanError

DONE, FAILED, MISUSE, INTERRUPTED = 0, 1, 2, 130


@final
class UsageError(GracefulPlanError, ValueError):
    """An invalid command line.

    Args:
        problem: Description of the error.
        usage: Usage of the command.
    """

    def __init__(self, problem: str, usage: str) -> None:
        self.problem, self.usage = problem, usage
        super().__init__(problem)


@final
class Parser(argparse.ArgumentParser):
    """A parser that raises `UsageError` instead of ending the program, and records its arguments and commands."""

    def __init__(self, **settings: Any) -> None:
        self.arguments: list[argparse.Action] = []
        self.commands: Mapping[str, Parser] = {}
        super().__init__(**settings)

    def add_argument(self, *names: Any, **settings: Any) -> argparse.Action:
        """Add an argument."""
        self.arguments.append(super().add_argument(*names, **settings))
        return self.arguments[-1]

    def add_subparsers(self, **settings: Any) -> Any:
        """Add commands."""
        made = super().add_subparsers(**settings)
        self.commands = made.choices  # type: ignore[assignment]  # a live view of all commands
        return made

    def error(self, message: str) -> NoReturn:
        """Raise the error."""
        raise UsageError(message, self.format_usage().rstrip())


def program(name: str, description: str) -> Parser:
    """Return the parser of a program without commands, with the option `--version`."""
    made = Parser(prog=name, description=description)
    made.add_argument("--version", action="version", version=__version__)
    return made
