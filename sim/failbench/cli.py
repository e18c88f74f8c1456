"""The command line, `failbench`. Thin: it calls the public API, prints, and turns outcomes into exit codes.

0: done. 1: no motion, or a part of a sweep failed. 2: misuse. 130: interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

import graceful_plan as gp
from failbench.basics.errors import SweepFailed
from failbench.commands import calibrating, judging, rollouts, sweeping
from failbench.sweeps.sweep import JOURNAL
from graceful_plan import GracefulPlanError, PlanningFailed

DONE, FAILED, MISUSE, INTERRUPTED = 0, 1, 2, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    args = _parser().parse_args(argv)
    try:
        print(args.run(args).shown(args.json))
        return DONE
    except (GracefulPlanError, OSError, ImportError) as error:
        if isinstance(error, BrokenPipeError):
            # The reader went away, as `head` does; a second complaint at shutdown is kept from it.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        print(f"failbench {args.command}: {error}", file=sys.stderr)
        return FAILED if isinstance(error, SweepFailed | PlanningFailed) else MISUSE
    except KeyboardInterrupt:
        folder = getattr(args, "folder", None)
        begun = folder is not None and (folder / JOURNAL).exists()
        print("interrupted" + (f"; to go on: failbench resume {folder}" if begun else ""), file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="failbench", description="Break a simulated robot on its way and see what it hits, and how hard."
    )
    parser.add_argument("--version", action="version", version=gp.__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for group in (rollouts, judging, sweeping, calibrating):
        group.add(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
