"""The parser of command lines, and the codes that programs end with. Importing it imports nothing that plans.

Its complaints are raised, so that whoever asked for JSON gets them as JSON; and it can be asked what it takes.
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
    """A command line that cannot be understood.

    Args:
        problem: What is wrong with it.
        usage: How the command is used.
    """

    def __init__(self, problem: str, usage: str) -> None:
        self.problem, self.usage = problem, usage
        super().__init__(problem)


@final
class Parser(argparse.ArgumentParser):
    """A parser that raises `UsageError` where others end the program, and that knows what was added to it."""

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
        self.commands = made.choices  # type: ignore[assignment]  # a view of all that will be added
        return made

    def error(self, message: str) -> NoReturn:
        """Complain."""
        raise UsageError(message, self.format_usage().rstrip())


def program(name: str, description: str) -> Parser:
    """Return the parser of a program that has no commands yet and can only say its version."""
    made = Parser(prog=name, description=description)
    made.add_argument("--version", action="version", version=__version__)
    return made
