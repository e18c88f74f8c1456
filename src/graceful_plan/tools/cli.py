"""The command line `graceful-plan`: calls the public API, prints results and returns exit codes.

0: done. 1: no verified trajectory, or a check failed. 2: misuse. 130: interrupted. With `--json`, an error is also
printed as a document on standard output, with the exit code.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.tools.ending import Interrupts, complain
from graceful_plan.tools.parsing import DONE, FAILED, INTERRUPTED, MISUSE, Parser, UsageError, program

__all__ = ["DONE", "FAILED", "INTERRUPTED", "MISUSE", "main", "parser"]

NAME, ABOUT = "graceful-plan", "Plan motions along which a failure at any moment does little harm."


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    name, as_json = NAME, "--json" in words
    if words == ["--version"]:  # before the slow imports of the planners
        program(NAME, ABOUT).parse_args(words)
    with Interrupts() as interrupts:
        try:
            args = parser().parse_args(words)
            name = f"{NAME} {args.command}"
            return args.run(args)
        except UsageError as error:
            return complain(name, error, MISUSE, as_json=as_json, before=error.usage)
        except BrokenPipeError:
            # The reader closed the pipe, as `head` does. This avoids a second error at shutdown.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        except BaseException as error:
            if interrupts.caused(error):
                return complain(name, KeyboardInterrupt("interrupted"), INTERRUPTED, as_json=as_json)
            if isinstance(error, GracefulPlanError | OSError):
                return complain(name, error, MISUSE, as_json=as_json)
            raise


def parser() -> Parser:
    """Return the parser of all commands."""
    from graceful_plan.tools import (
        bench_command,
        impact_commands,
        job_command,
        listing_commands,
        motion_commands,
        tune_command,
        view_command,
    )
    from graceful_plan.tools.completion import command

    made = program(NAME, ABOUT)
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND")
    groups = (
        motion_commands,
        job_command,
        tune_command,
        impact_commands,
        view_command,
        bench_command,
        listing_commands,
    )
    for group in groups:
        group.add_to(commands)
    command.add_to(commands, made)
    return made


if __name__ == "__main__":
    sys.exit(main())
