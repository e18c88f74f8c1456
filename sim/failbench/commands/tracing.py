"""The command that writes what happens in rollouts, step by step."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

from failbench.commands.options import add_command
from failbench.commands.output import Answer
from failbench.traces.folder import write_traces
from failbench.traces.lerobot import write_lerobot
from failbench.traces.trace import Sampling


def add(commands: Any) -> None:
    """Add it to the command line."""
    made = add_command(commands, "trace", _trace, "write states, contact points and pictures of a dataset's rollouts")
    made.add_argument("folder", type=FilePath, help="of a dataset that `generate` made")
    made.add_argument("output", type=FilePath, help="folder to write to")
    made.add_argument("--rollouts", type=int, nargs="+", metavar="N", help="their numbers (default: all)")
    made.add_argument("--every", type=int, default=5, help="steps from one row to the next (default 5)")
    made.add_argument("--images", type=int, default=0, help="steps from one picture to the next (default: none)")
    made.add_argument("--camera", help="name of a camera of the scene")
    made.add_argument("--form", choices=("tables", "lerobot"), default="tables", help="of the folder (default tables)")


def _trace(args: argparse.Namespace) -> Answer:
    if args.form == "lerobot":
        rows = {"frames": write_lerobot(args.folder, args.output, rollouts=args.rollouts, every=args.every)}
    else:
        sampling = Sampling(every=args.every, images=args.images, camera=args.camera)
        rows = write_traces(args.folder, args.output, rollouts=args.rollouts, sampling=sampling)
    said = ", ".join(f"{count} {table}" for table, count in rows.items())
    return Answer({"folder": str(args.output), "rows": rows}, f"{said} in {args.output}")
