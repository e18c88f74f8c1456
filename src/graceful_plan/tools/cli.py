"""The command line, `graceful-plan`. Thin: it calls the public API, prints, and turns outcomes into exit codes.

0: done. 1: no verified trajectory, or a check failed. 2: misuse. 130: interrupted. With `--json`, what goes wrong is a
document on standard output as well, with the exit code in it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import graceful_plan as gp
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.tools import (
    bench_command,
    impact_commands,
    listing_commands,
    motion_commands,
    tune_command,
    view_command,
)
from graceful_plan.tools.completion import command
from graceful_plan.tools.console import DONE, FAILED, INTERRUPTED, MISUSE, complain
from graceful_plan.tools.parsing import Parser, UsageError

__all__ = ["DONE", "FAILED", "INTERRUPTED", "MISUSE", "main", "parser"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    name, as_json = "graceful-plan", "--json" in words
    try:
        args = parser().parse_args(words)
        name = f"graceful-plan {args.command}"
        return args.run(args)
    except UsageError as error:
        return complain(name, error, MISUSE, as_json=as_json, before=error.usage)
    except BrokenPipeError:
        # The reader went away, as `head` does; a second complaint at shutdown is kept from it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except (GracefulPlanError, OSError) as error:
        return complain(name, error, MISUSE, as_json=as_json)
    except KeyboardInterrupt:
        return complain(name, KeyboardInterrupt("interrupted"), INTERRUPTED, as_json=as_json)


def parser() -> Parser:
    """Return the parser of all commands."""
    made = Parser(
        prog="graceful-plan", description="Plan motions along which a failure at any moment does little harm."
    )
    made.add_argument("--version", action="version", version=gp.__version__)
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND")
    groups = (motion_commands, tune_command, impact_commands, view_command, bench_command, listing_commands)
    for group in groups:
        group.add_to(commands)
    command.add_to(commands, made)
    return made


if __name__ == "__main__":
    sys.exit(main())
