"""The command that learns from rollouts in generated scenes."""

from __future__ import annotations

import argparse
import os
from pathlib import Path as FilePath
from typing import Any

from failbench.commands.options import add_command
from failbench.commands.output import Answer, Bar
from graceful_plan.tools.console import check_file

_SCENES, _ROLLOUTS = 180, 15000


def add(commands: Any) -> None:
    """Add it to the command line."""
    text = "let things fall in generated scenes, and train a network that corrects the drop model"
    learn = add_command(commands, "learn", _learn, text)
    learn.add_argument("--output", type=FilePath, required=True, metavar="FILE", help="the network, .npz")
    learn.add_argument("--scenes", type=int, default=_SCENES, help=f"generated scenes (default {_SCENES})")
    learn.add_argument("--rollouts", type=int, default=_ROLLOUTS, help=f"drops, about (default {_ROLLOUTS})")
    learn.add_argument("--seed", type=int, default=0, help="of everything random (default 0)")
    learn.add_argument(
        "--drops", type=FilePath, metavar="FILE", help="keep the drops here, or take them if it is there"
    )
    learn.add_argument("--workers", type=int, default=0, help="processes (default: one for each core)")


def _learn(args: argparse.Namespace) -> Answer:
    from failbench.learning.learn import learn, table
    from failbench.learning.rollouts import DropData
    from failbench.learning.training import Training

    check_file(args.output, (".npz",))  # before the work, not after
    workers = args.workers or os.cpu_count() or 1
    data = DropData(scenes=args.scenes, rollouts=args.rollouts, seed=args.seed, processes=workers)
    with Bar(args, "motions") as bar:
        found = learn(data, Training(seed=args.seed), kept=args.drops, progress=bar.show)
    found.network.write(args.output)
    return Answer(dict(found.network.about), table(found))
