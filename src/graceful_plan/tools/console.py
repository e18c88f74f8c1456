"""What all commands of the command line share: options, the task they name, output and exit codes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.result import TracePoint
from graceful_plan.scene.scene import Scene

DONE, FAILED, MISUSE, INTERRUPTED = 0, 1, 2, 130


# --- options ----------------------------------------------------------------------------------------------------------


def add_command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], text: str
) -> argparse.ArgumentParser:
    """Add a command that `run` carries out."""
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)
    return parser


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a scene and a task."""
    parser.add_argument("--scene", default="tabletop", help="bundled scene or scene file (default tabletop)")
    parser.add_argument("--task", help="task of the scene; default: its first, unless start and goal are given")


def add_model(parser: argparse.ArgumentParser, default: Any) -> None:
    """Add the option that names an interaction model."""
    parser.add_argument("--model", default=default, help=f"interaction model (default {default})")


def add_budget(parser: argparse.ArgumentParser) -> None:
    """Add the options that limit a search."""
    parser.add_argument("--time-limit", type=float, metavar="S", help="seconds of search (default 1)")
    parser.add_argument("--iterations", type=int, help="planner iterations: reproducible, unlike a time limit")
    parser.add_argument("--seed", type=int, default=0, help="of the random numbers (default 0)")


def budget(args: argparse.Namespace) -> dict[str, Any]:
    """Return these as arguments of `plan`."""
    limit = args.time_limit if args.time_limit is not None or args.iterations is not None else 1.0
    return {"time_limit": limit, "iterations": args.iterations, "seed": args.seed}


# --- what they name ---------------------------------------------------------------------------------------------------


def chosen_task(args: argparse.Namespace) -> tuple[Scene, gp.Task | None]:
    """Return the scene to plan in and the task whose object it holds, if one was asked for."""
    scene = gp.load_scene(args.scene)
    own_ends = getattr(args, "start", None) is not None and getattr(args, "goal", None) is not None
    name = args.task
    if name is None and (own_ends or not scene.tasks):
        return scene, None
    if name is None:
        name = next(iter(scene.tasks))
    if name not in scene.tasks:
        raise UnknownNameError("task", name, scene.tasks)
    task = scene.tasks[name]
    return task.scene, task


def chosen_problem(args: argparse.Namespace) -> tuple[Scene, Any, Any]:
    """Return scene, start and goal: those that were given, else those of the task."""
    scene, task = chosen_task(args)
    ends = []
    for option, words, default in (
        ("--start", args.start, task and task.start),
        ("--goal", args.goal, task and task.goal),
    ):
        if words is None and task is None:
            raise SettingError(
                option, None, f"a keyframe ({', '.join(scene.keyframes) or 'none here'}) or joint values"
            )
        ends.append(default if words is None else _configuration(option, words))
    return scene, ends[0], ends[1]


def joint_values(scene: Scene, option: str, words: Sequence[str]) -> Any:
    """Read a configuration; a keyframe is looked up in the scene."""
    given = _configuration(option, words)
    if isinstance(given, str) and given not in scene.keyframes:
        raise UnknownNameError("keyframe", given, scene.keyframes)
    return scene.keyframes[given] if isinstance(given, str) else given


def _configuration(option: str, words: Sequence[str]) -> str | list[float]:
    """Read a keyframe's name, or one number a joint."""
    try:
        return [float(word) for word in words]
    except ValueError:
        if len(words) == 1:
            return words[0]
        raise SettingError(option, " ".join(words), "the name of a keyframe, or numbers only") from None


def check_picture(args: argparse.Namespace) -> None:
    """Refuse a picture of no known format before any work is done."""
    if args.output is not None and args.output.suffix not in (".png", ".pdf", ".svg"):
        raise SettingError("--output", str(args.output), "a file name that ends in .png, .pdf or .svg")


# --- output -----------------------------------------------------------------------------------------------------------


def sentence(result: gp.PlanResult) -> str:
    """Say how planning ended."""
    text = f"{result.status.name}: {result.status.value}" + (f" ({result.detail})" if result.detail else "")
    if result.trajectory is not None:
        text += f" {result.trajectory.duration:.2f} s long."
    return text


def show(args: argparse.Namespace, document: Any, text: str) -> None:
    """Print the document if JSON was asked for, else the text."""
    print(documents.to_json(document) if args.json else text, flush=True)


def complain(text: str) -> None:
    """Print a line that is no part of what was asked for."""
    print(text, file=sys.stderr)


class ProgressLine:
    """Shows the best cost so far while planning, if somebody sits at a terminal."""

    def __init__(self, quiet: bool) -> None:
        self.shown = sys.stderr.isatty() and not quiet

    def __enter__(self) -> Callable[[Any], None] | None:
        return self.show if self.shown else None

    def __exit__(self, *_: object) -> None:
        if self.shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def show(self, point: Any) -> None:
        """Overwrite the line with the newest improvement, or with how far a search for a front has come."""
        text = f"{point.time:6.2f} s  "
        if isinstance(point, TracePoint):
            text += f"total {point.total:.4g}  motion {point.motion:.4g}  impact {point.impact:.4g}"
        else:
            text += f"{point.stage}, {point.candidates} candidates"
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)


class RunCounter:
    """Shows how many runs are done: on one line at a terminal, else ten times in all."""

    def __init__(self) -> None:
        self.total = 0

    def show(self, done: int, total: int, run: Any) -> None:
        """Show it."""
        self.total = total
        text = f"{done}/{total} runs" + (f": {run.problem}, {run.planner}, {run.status}" if run else "")
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text}", end="\n" if done == total else "", file=sys.stderr, flush=True)
        elif run is None or done == total or done % max(1, total // 10) == 0:
            print(text, file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the line."""
        if sys.stderr.isatty():
            print(file=sys.stderr)
