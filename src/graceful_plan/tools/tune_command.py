"""Command `tune`, which shows the trade-off of motion against impact."""

from __future__ import annotations

import argparse
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.tools.console import (
    DEFAULT_SCENE,
    add_budget,
    add_command,
    add_planner,
    add_scene,
    add_speed,
    add_validation,
    budget,
    check_folder,
    chosen_planner,
    chosen_task,
    show,
)
from graceful_plan.tools.parsing import DONE, FAILED
from graceful_plan.tools.progress import ProgressLine
from graceful_plan.tuning.fronts import ChoiceStatus


def add_to(commands: Any) -> None:
    """Add the command to the parser."""
    tune = add_command(commands, "tune", _tune, "find the front of motion against impact, to choose a safety weight")
    add_scene(tune)
    tune.add_argument("place", nargs="*", metavar="SCENE TASK", help="scene and task without option names")
    tune.add_argument("--points", type=int, default=30, help="maximum number of motions on the front (default 30)")
    add_budget(tune, 10.0)
    add_planner(tune, "planner for single weights")
    add_speed(tune)
    tune.add_argument("--target-impact", type=float, metavar="S", help="choose the shortest with at most this impact")
    tune.add_argument("--max-detour", type=float, metavar="R", help="choose among detours up to this; 0.05 is 5 %%")
    add_validation(tune, "simulate N failures along each motion in FailBench")
    tune.add_argument(
        "--output",
        "--out",
        type=FilePath,
        default=FilePath("graceful_plan_front"),
        help="folder for front.html and the other files",
    )


def _tune(args: argparse.Namespace) -> int:
    from graceful_plan.tools import tune_report

    _take_place(args)
    check_folder(args.output)
    planner = chosen_planner(args)
    task = chosen_task(args)[1]
    if task is None:
        raise SettingError("task", None, "a scene with a task")
    with ProgressLine(args.json, "preparing the scene") as progress:
        outcome = tune_report.run(
            args.scene,
            task,
            args.output,
            target_impact=args.target_impact,
            max_detour=args.max_detour,
            failures=args.validate,
            grasp=args.grasp,
            callback=progress.callback,
            told=progress.stage,
            points=args.points,
            speed=args.speed,
            planner=planner,
            **budget(args),
        )
    show(args, outcome.to_document(), str(outcome))
    chosen = outcome.choice.status is ChoiceStatus.MET
    return DONE if chosen and outcome.front.status is gp.PlanStatus.SOLVED else FAILED


def _take_place(args: argparse.Namespace) -> None:
    """Read scene and task from the positional arguments."""
    named = args.task is not None or args.scene != DEFAULT_SCENE
    if len(args.place) > 2 or (args.place and named):
        raise SettingError("SCENE TASK", " ".join(args.place), "a scene and a task of it, once: --scene, --task")
    for name, word in zip(("scene", "task"), args.place, strict=False):
        setattr(args, name, word)
