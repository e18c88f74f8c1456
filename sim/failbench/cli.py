"""The command line `failbench`. It calls the public API, prints results, and maps outcomes to exit codes.

0: done. 1: no motion, or a part of a sweep failed. 2: misuse. 130: interrupted. With `--json`, errors are also printed
as a document on standard output, with the exit code.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from graceful_plan import GracefulPlanError
from graceful_plan.tools.ending import Interrupts, complain
from graceful_plan.tools.parsing import DONE, FAILED, INTERRUPTED, MISUSE, Parser, UsageError, program

__all__ = ["DONE", "FAILED", "INTERRUPTED", "MISUSE", "main", "parser"]

NAME, ABOUT = "failbench", "Break a simulated robot during a motion, and record its hits and their force."


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    name, as_json, args = NAME, "--json" in words, None
    if words == ["--version"]:  # before the imports of the simulation
        program(NAME, ABOUT).parse_args(words)
    with Interrupts() as interrupts:
        try:
            args = parser().parse_args(words)
            name = f"{NAME} {args.command}"
            print(args.run(args).shown(args.json))
            return DONE
        except BrokenPipeError:
            # The reader closed the pipe, as `head` does; this prevents a second error at shutdown.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        except UsageError as error:
            return complain(name, error, MISUSE, as_json=as_json, before=error.usage)
        except BaseException as error:
            if interrupts.caused(error):
                said = _interrupted(getattr(args, "folder", None))
                return complain(name, KeyboardInterrupt(said), INTERRUPTED, as_json=as_json)
            if isinstance(error, GracefulPlanError | OSError | ImportError):
                return complain(name, error, _code(error), as_json=as_json)
            raise


def _interrupted(folder: Path | None) -> str:
    """Return the message of an interrupted command, which may have begun a sweep in a folder."""
    if folder is None:
        return "interrupted"
    from failbench.sweeps.sweep import JOURNAL

    begun = (folder / JOURNAL).exists()
    return "interrupted" + (f"; to continue: failbench resume {folder}" if begun else "")


def _code(error: BaseException) -> int:
    from failbench.basics.errors import SweepFailed
    from graceful_plan import PlanningFailed

    return FAILED if isinstance(error, SweepFailed | PlanningFailed) else MISUSE


def parser() -> Parser:
    """Return the parser of all commands."""
    from failbench.commands import calibrating, judging, learning, policies, rollouts, sweeping, tracing

    made = program(NAME, ABOUT)
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for group in (rollouts, judging, policies, sweeping, tracing, calibrating, learning):
        group.add(commands)
    return made


if __name__ == "__main__":
    sys.exit(main())
