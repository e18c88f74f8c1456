"""Commands for sweeps: start one, resume one."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path as FilePath
from typing import Any

from failbench.commands.options import add_motion, motion_of, plan_settings, sim_settings
from failbench.commands.output import Answer, Bar
from failbench.sweeps.definition import Sweep
from failbench.sweeps.executors import Executor, LocalExecutor
from failbench.sweeps.sweep import Generated, generate_dataset, resume, sweep_of
from graceful_plan.exceptions import SettingError
from graceful_plan.tools.console import add_command


def add(commands: Any) -> None:
    """Add the commands to the parser."""
    make = add_command(commands, "generate", _generate, "run a sweep over scenarios and write its dataset")
    make.add_argument("folder", type=FilePath, help="folder for journal and dataset")
    make.add_argument(
        "patterns", nargs="*", help="patterns of scenarios, such as 'drop/*'; all tasks must have the same faults"
    )
    make.add_argument("--sweep", type=FilePath, metavar="FILE", help="sweep as JSON, instead of patterns and options")
    make.add_argument("--dry-run", action="store_true", help="print the sweep as JSON and stop")
    make.add_argument("-n", type=int, default=32, help="rollouts of each fault on each task (default 32)")
    add_motion(make)
    _add_executor(make)

    again = add_command(commands, "resume", _resume, "continue a sweep that was killed, interrupted or failed in part")
    again.add_argument("folder", type=FilePath, help="folder of the sweep")
    _add_executor(again)


def _add_executor(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--workers", type=int, default=0, help="processes (default: one per core)")
    parser.add_argument(
        "--executor", choices=("local", "ray"), default="local", help="executor of the chunks (default local)"
    )
    parser.add_argument("--address", help="address of a running Ray cluster, or auto (default: start a local Ray)")


def _generate(args: argparse.Namespace) -> Answer:
    sweep = _sweep(args)
    if args.dry_run:
        return Answer(sweep.to_document())
    with Bar(args) as bar:
        made = generate_dataset(sweep, args.folder, executor=_executor(args), callback=bar.sweep)
    return _made(made)


def _resume(args: argparse.Namespace) -> Answer:
    with Bar(args) as bar:
        made = resume(args.folder, executor=_executor(args), callback=bar.sweep)
    return _made(made)


def _made(made: Generated) -> Answer:
    rows = made.manifest["rows"]
    healthy = {name: {"harm": harm, "spilled": spilled} for name, (harm, spilled) in made.healthy.items()}
    document = {
        "folder": str(made.folder),
        "healthy": healthy,
        "rows": rows,
        "content": made.manifest["content"],
    }
    loud = [
        f"HARM WITHOUT FAILURE: {name}: harm {harm:.3g} with probability 1, {100.0 * spilled:.3g} % of contents"
        for name, (harm, spilled) in made.healthy.items()
    ]
    done = f"{rows['rollouts']} rollouts with {rows['contacts']} contacts in {made.folder}"
    return Answer(document, "\n".join([*loud, done]))


def _sweep(args: argparse.Namespace) -> Sweep:
    if (args.sweep is None) != bool(args.patterns):
        raise SettingError("patterns", " ".join(args.patterns), "patterns of scenarios, or --sweep FILE, but not both")
    if args.sweep is not None:
        return Sweep.from_json(args.sweep)
    sweep = sweep_of(
        args.patterns,
        args.n,
        plans=(plan_settings(args),),
        horizon=args.horizon,
        seed=args.seed,
        settings=sim_settings(args),
    )
    if args.trajectory is None:
        return sweep
    motion, *others = sweep.motions
    if others:
        raise SettingError("--trajectory", str(args.trajectory), f"patterns of one task, not {1 + len(others)}")
    return dataclasses.replace(sweep, motions=(motion_of(args, motion.scene, motion.task),))


def _executor(args: argparse.Namespace) -> Executor:
    if args.executor == "local":
        if args.address is not None:
            raise SettingError("--address", args.address, "nothing without --executor ray")
        return LocalExecutor(workers=args.workers)
    from failbench.sweeps.ray_executor import RayExecutor

    return RayExecutor(workers=args.workers, address=args.address)
