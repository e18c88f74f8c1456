"""The command that writes step-by-step traces of rollouts."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

from failbench.commands.output import Answer
from failbench.traces.folder import write_traces
from failbench.traces.lerobot import write_lerobot
from failbench.traces.trace import Sampling
from graceful_plan.tools.console import add_command


def add(commands: Any) -> None:
    """Add the command to the parser."""
    made = add_command(commands, "trace", _trace, "write states, contact points and pictures of a dataset's rollouts")
    made.add_argument("folder", type=FilePath, help="folder of a dataset made by `generate`")
    made.add_argument("output", type=FilePath, help="folder to write to")
    made.add_argument("--rollouts", type=int, nargs="+", metavar="N", help="numbers of the rollouts (default: all)")
    made.add_argument("--every", type=int, default=5, help="steps per row (default 5)")
    made.add_argument("--images", type=int, default=0, help="steps per picture (default: no pictures)")
    made.add_argument("--camera", help="name of a camera of the scene")
    made.add_argument(
        "--form", choices=("tables", "lerobot"), default="tables", help="format of the folder (default tables)"
    )


def _trace(args: argparse.Namespace) -> Answer:
    if args.form == "lerobot":
        rows = {"frames": write_lerobot(args.folder, args.output, rollouts=args.rollouts, every=args.every)}
    else:
        sampling = Sampling(every=args.every, images=args.images, camera=args.camera)
        rows = write_traces(args.folder, args.output, rollouts=args.rollouts, sampling=sampling)
    said = ", ".join(f"{count} {table}" for table, count in rows.items())
    return Answer({"folder": str(args.output), "rows": rows}, f"{said} in {args.output}")
