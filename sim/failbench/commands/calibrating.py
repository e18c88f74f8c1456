"""The command that fits a model's constants to failures."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from failbench.calibrations import body_fit, drop_fit, effects_fit, spill_fit
from failbench.calibrations.calibrate import Recipe, calibrate, write
from failbench.calibrations.failure_jobs import FailureSettings
from failbench.calibrations.varied import VARIED
from failbench.commands.output import Answer, Bar
from graceful_plan.tools.console import add_command, check_file

_RECIPES: Mapping[str, Recipe] = {
    "drop": drop_fit.RECIPE,
    "spill": spill_fit.RECIPE,
    "body": body_fit.RECIPE,
    "effects": effects_fit.RECIPE,
}


def add(commands: Any) -> None:
    """Add the command to the parser."""
    fit = add_command(commands, "calibrate", _calibrate, "fit a model's constants to failures in bundled scenes")
    fit.add_argument("output", type=FilePath, help="YAML file for the constants and their provenance")
    fit.add_argument("--model", choices=tuple(_RECIPES), default="drop", help="model to fit (default footprint)")
    fit.add_argument("--scenes", nargs="+", metavar="SCENE", help="bundled scenes, two or more (default: all)")
    fit.add_argument("-n", type=int, default=30, help="drops along each motion (default 30)")
    fit.add_argument("--repeats", type=int, default=2, help="motions of each kind for each task (default 2)")
    fit.add_argument("--seed", type=int, default=0, help="seed of all random numbers (default 0)")
    fit.add_argument(
        "--varied",
        action="store_true",
        help="along every second motion, objects bounce (restitution up to 0.6) and spin at their release",
    )
    fit.add_argument("--drops", type=FilePath, metavar="FILE", help="store the drops here, or read them if it exists")
    fit.add_argument("--workers", type=int, default=0, help="processes (default: one per core)")


def _calibrate(args: argparse.Namespace) -> Answer:
    check_file(args.output, (".yaml", ".yml"))  # fail before hours of work
    workers = args.workers or os.cpu_count() or 1
    settings = FailureSettings(
        n=args.n,
        repeats=args.repeats,
        seed=args.seed,
        processes=workers,
        variation=VARIED if args.varied else None,
    )
    with Bar(args, "motions") as bar:
        found = calibrate(
            _RECIPES[args.model], args.scenes or gp.scenes(), settings, kept=args.drops, progress=bar.show
        )
    write(found, args.output)
    return Answer(found.to_document(), str(found))
