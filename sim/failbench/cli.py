"""The command line `failbench`. It calls the public API, prints results, and maps outcomes to exit codes.

0: done. 1: no motion, or a part of a sweep failed. 2: misuse. 130: interrupted. With `--json`, errors are also printed
as a document on standard output, with the exit code.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from graceful_plan import GracefulPlanError
from graceful_plan.tools.parsing import DONE, FAILED, INTERRUPTED, MISUSE, Parser, UsageError, program

__all__ = ["DONE", "FAILED", "INTERRUPTED", "MISUSE", "main", "parser"]

NAME, ABOUT = "failbench", "Break a simulated robot during a motion, and record its hits and their force."


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    name, as_json, args = NAME, "--json" in words, None
    if words == ["--version"]:  # before the imports of the simulation
        program(NAME, ABOUT).parse_args(words)
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
        print(error.usage, file=sys.stderr)
        return _complain(name, error, MISUSE, as_json)
    except (GracefulPlanError, OSError, ImportError) as error:
        return _complain(name, error, _code(error), as_json)
    except KeyboardInterrupt:
        from failbench.sweeps.sweep import JOURNAL

        folder = getattr(args, "folder", None)
        begun = folder is not None and (folder / JOURNAL).exists()
        said = "interrupted" + (f"; to continue: failbench resume {folder}" if begun else "")
        return _complain(name, KeyboardInterrupt(said), INTERRUPTED, as_json)


def _code(error: BaseException) -> int:
    from failbench.basics.errors import SweepFailed
    from graceful_plan import PlanningFailed

    return FAILED if isinstance(error, SweepFailed | PlanningFailed) else MISUSE


def _complain(name: str, error: BaseException, code: int, as_json: bool) -> int:
    """Print an error on standard error, and with JSON output also as a document on standard output."""
    print(f"{name}: {error}", file=sys.stderr)
    if as_json:
        from graceful_plan import documents

        print(documents.to_json(documents.error_document(name, error, code)))
    return code


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
