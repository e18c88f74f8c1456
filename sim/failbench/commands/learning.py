"""The command that learns a drop network from rollouts in generated scenes."""

from __future__ import annotations

import argparse
import os
from pathlib import Path as FilePath
from typing import Any

from failbench.commands.output import Answer, Bar
from graceful_plan.tools.console import add_command, check_file

_SCENES, _ROLLOUTS = 180, 15000


def add(commands: Any) -> None:
    """Add the command to the parser."""
    text = "simulate drops in generated scenes, and train a network that corrects the drop model"
    learn = add_command(commands, "learn", _learn, text)
    learn.add_argument("--output", type=FilePath, required=True, metavar="FILE", help="the network, .npz")
    learn.add_argument("--scenes", type=int, default=_SCENES, help=f"generated scenes (default {_SCENES})")
    learn.add_argument(
        "--rollouts", type=int, default=_ROLLOUTS, help=f"approximate number of drops (default {_ROLLOUTS})"
    )
    learn.add_argument("--seed", type=int, default=0, help="seed of all random numbers (default 0)")
    learn.add_argument("--drops", type=FilePath, metavar="FILE", help="store the drops here, or read them if it exists")
    learn.add_argument("--workers", type=int, default=0, help="processes (default: one per core)")


def _learn(args: argparse.Namespace) -> Answer:
    from failbench.learning.learn import learn, table
    from failbench.learning.rollouts import DropData
    from failbench.learning.training import Training

    check_file(args.output, (".npz",))  # fail before the work
    workers = args.workers or os.cpu_count() or 1
    data = DropData(scenes=args.scenes, rollouts=args.rollouts, seed=args.seed, processes=workers)
    with Bar(args, "motions") as bar:
        found = learn(data, Training(seed=args.seed), kept=args.drops, progress=bar.show)
    found.network.write(args.output)
    return Answer(dict(found.network.about), table(found))
