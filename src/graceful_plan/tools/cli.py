"""The command line, `graceful-plan`. Thin: it calls the public API, prints, and turns outcomes into exit codes.

0: done. 1: no verified trajectory, or a check failed. 2: misuse. 130: interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

import graceful_plan as gp
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.tools import bench_command, impact_commands, listing_commands, motion_commands, view_command
from graceful_plan.tools.console import DONE, FAILED, INTERRUPTED, MISUSE, complain

__all__ = ["DONE", "FAILED", "INTERRUPTED", "MISUSE", "main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    args = _parser().parse_args(argv)
    try:
        return args.run(args)
    except GracefulPlanError as error:
        complain(f"graceful-plan {args.command}: {error}")
        return MISUSE
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            # The reader went away, as `head` does; a second complaint at shutdown is kept from it.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        complain(f"graceful-plan {args.command}: {error}")
        return MISUSE
    except KeyboardInterrupt:
        complain("interrupted")
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="graceful-plan", description="Plan motions along which a failure at any moment does little harm."
    )
    parser.add_argument("--version", action="version", version=gp.__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for group in (motion_commands, impact_commands, view_command, bench_command, listing_commands):
        group.add_to(commands)
    return parser


if __name__ == "__main__":
    sys.exit(main())
