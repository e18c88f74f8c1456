"""Command `completion`, which prints scripts for shell completion."""

from __future__ import annotations

import argparse
from typing import Any

import graceful_plan as gp
from graceful_plan.tools.completion.scripts import SHELLS, Offer
from graceful_plan.tools.console import add_command, show
from graceful_plan.tools.parsing import DONE, Parser


def add_to(commands: Any, program: Parser) -> None:
    """Add the command to the parser of a program."""

    def run(args: argparse.Namespace) -> int:
        script = SHELLS[args.shell](program, _values())
        show(args, {"shell": args.shell, "script": script}, script.rstrip("\n"))
        return DONE

    text = "print a completion script for a shell"
    made = add_command(commands, "completion", run, text)
    made.add_argument("shell", choices=tuple(SHELLS), help="which shell")


def _values() -> dict[str, Offer]:
    """Return the completions of values by name of the option."""
    from graceful_plan.compare.problems.suite import suites

    planners = Offer(tuple(sorted(gp.PLANNERS)))
    return {
        "scene": Offer((*gp.scenes(), *gp.mobile_scenes()), files=True),
        "suite": Offer(suites(), files=True),
        "planner": planners,
        "planners": planners,
    }
