"""Commands that compare observed harm of failures with the prediction, for a motion or a front of motions."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from failbench.commands.options import add_grasp, add_motion, motion_of, sim_settings
from failbench.commands.output import Answer, Bar
from failbench.front_validation import validate_front
from failbench.report import FAILURES_PER_HOUR
from failbench.simulated.world import SimSettings
from failbench.sweeps.definition import scene_of
from failbench.validation import validate
from graceful_plan.tools.console import add_command


def add(commands: Any) -> None:
    """Add the commands to the parser."""
    judge = add_command(
        commands, "validate", _validate, "compare observed harm of a motion's failures with its prediction"
    )
    judge.add_argument(
        "patterns",
        nargs="*",
        default=["drop/*/severe"],
        help="patterns of scenarios, of which the faults are used (default drop/*/severe)",
    )
    judge.add_argument("--scene", default="tabletop", help="bundled scene or scene file (default tabletop)")
    judge.add_argument("--task", help="task of the scene (default: its first)")
    judge.add_argument("-n", type=int, default=400, help="number of failures (default 400)")
    _add_rate(judge)
    judge.add_argument("--importance", action="store_true", help="sample onsets more densely where harm is predicted")
    add_motion(judge)

    front = add_command(
        commands,
        "validate-front",
        _validate_front,
        "compare observed and predicted harm of the motions of a Pareto front",
    )
    front.add_argument("front", type=FilePath, help="file of `graceful-plan tune` or of ParetoFront.save")
    front.add_argument(
        "patterns", nargs="*", default=["drop/*/severe"], help="patterns of scenarios (default drop/*/severe)"
    )
    front.add_argument("--scene", default="tabletop", help="bundled scene or scene file (default tabletop)")
    front.add_argument("--task", help="task of the scene (default: its first)")
    front.add_argument("-n", type=int, default=200, help="number of failures along each motion (default 200)")
    _add_rate(front)
    front.add_argument("--seed", type=int, default=0, help="seed of all random numbers (default 0)")
    front.add_argument("--horizon", type=float, default=1.0, metavar="S", help="seconds after the onset (default 1)")
    add_grasp(front)


def _add_rate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rate",
        type=float,
        default=FAILURES_PER_HOUR,
        help=f"failures per hour of motion, for the harm per executed task (default {FAILURES_PER_HOUR:g})",
    )


def _validate(args: argparse.Namespace) -> Answer:
    tasks = gp.load_scene(args.scene).tasks
    motion = motion_of(args, args.scene, args.task or next(iter(tasks), None))
    trajectory = motion.planned().trajectory
    assert trajectory is not None
    with Bar(args) as bar:
        report = validate(
            trajectory,
            scene_of(motion.scene, motion.task),
            args.patterns,
            n=args.n,
            horizon=args.horizon,
            seed=args.seed,
            importance=args.importance,
            rate=args.rate,
            settings=sim_settings(args),
            progress=bar.show,
        )
    return Answer(report.to_document(), str(report))


def _validate_front(args: argparse.Namespace) -> Answer:
    task = args.task or next(iter(gp.load_scene(args.scene).tasks), None)
    with Bar(args, "motions") as bar:
        found = validate_front(
            args.front,
            scene_of(args.scene, task),
            args.patterns,
            n=args.n,
            horizon=args.horizon,
            seed=args.seed,
            rate=args.rate,
            settings=SimSettings(grasp=args.grasp),
            progress=bar.show,
        )
    return Answer(found.to_document(), str(found))
