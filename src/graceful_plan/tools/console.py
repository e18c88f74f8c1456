"""Shared code of all commands: options, the selected task, output and exit codes."""

from __future__ import annotations

import argparse
import errno
import os
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path as FilePath
from typing import Any

import graceful_plan as gp
from graceful_plan import documents
from graceful_plan.exceptions import FormatError, SettingError, ShapeError, UnknownNameError
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.tasks import named_configuration

DEFAULT_SCENE = "tabletop"


# --- options ----------------------------------------------------------------------------------------------------------


def add_command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], object], text: str
) -> argparse.ArgumentParser:
    """Add a command implemented by `run`."""
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.set_defaults(run=run)
    return parser


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a scene and a task."""
    parser.add_argument("--scene", default=DEFAULT_SCENE, help=f"bundled scene or scene file (default {DEFAULT_SCENE})")
    parser.add_argument("--task", help="task of the scene; default: its first, unless start and goal are given")


def add_model(parser: argparse.ArgumentParser, default: Any) -> None:
    """Add the option that names an interaction model."""
    parser.add_argument("--model", default=default, help=f"interaction model (default {default})")


def add_time_limit(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the option that limits the time."""
    parser.add_argument("--time-limit", "--seconds", type=float, metavar="S", help=f"seconds {what}")


def add_budget(parser: argparse.ArgumentParser, seconds: float) -> None:
    """Add the options that limit a search."""
    add_time_limit(parser, f"of search (default {seconds:g}, none with --iterations)")
    parser.add_argument("--iterations", type=int, help="planner iterations: reproducible, unlike a time limit")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random numbers (default 0)")


def budget(args: argparse.Namespace) -> dict[str, Any]:
    """Return the budget as arguments of `plan`, which has the defaults."""
    return {"time_limit": args.time_limit, "iterations": args.iterations, "seed": args.seed}


def add_planner(parser: argparse.ArgumentParser, text: str) -> None:
    """Add the option that names a planner."""
    parser.add_argument(
        "--planner",
        default="auto",
        metavar="NAME[:KEY=VALUE,..]",
        help=f"{text} (default auto); see `graceful-plan planners`",
    )


def chosen_planner(args: argparse.Namespace) -> gp.Planner:
    """Create the selected planner with its settings."""
    from graceful_plan.compare.runs.planner_specs import read_planners

    return read_planners([args.planner])[0].make()


def add_speed(parser: argparse.ArgumentParser) -> None:
    """Add the option that limits the speed."""
    parser.add_argument("--speed", type=float, default=1.0, help="fraction of the velocity limits (default 1)")


def add_validation(parser: argparse.ArgumentParser, text: str) -> None:
    """Add the options for the number of simulated failures, and for the grasp."""
    parser.add_argument("--validate", type=int, default=0, metavar="N", help=text)
    parser.add_argument(
        "--grasp",
        choices=("fingers", "weld"),
        default="fingers",
        help="how FailBench holds the object (default fingers)",
    )


# --- values of options ------------------------------------------------------------------------------------------------


def chosen_task(args: argparse.Namespace) -> tuple[Scene, gp.Task | None]:
    """Return the selected scene and task; no task if start and goal are given without one."""
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
    """Return scene, start and goal from the options, else from the task."""
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
    """Parse a configuration: joint values, or a keyframe of the scene."""
    given = _configuration(option, words)
    return named_configuration(given, scene) if isinstance(given, str) else given


def _configuration(option: str, words: Sequence[str]) -> str | list[float]:
    """Parse the name of a keyframe, or one number per joint."""
    try:
        return [float(word) for word in words]
    except ValueError:
        if len(words) == 1:
            return words[0]
        raise SettingError(option, " ".join(words), "the name of a keyframe, or numbers only") from None


def check_file(file: FilePath | None, endings: Sequence[str]) -> None:
    """Check before any work that a file can be written.

    Raises:
        SettingError: If its extension is unknown.
        OSError: If its folder does not exist or is not writable, or it is a folder itself.
    """
    if file is None:
        return
    if file.suffix not in endings:
        *others, last = endings
        raise SettingError(
            "output", str(file), f"a file name that ends in {', '.join(others)}{' or ' if others else ''}{last}"
        )
    if file.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    if file.parent.exists() and not file.parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(file.parent))
    _check_writable(file if file.exists() else file.parent)


def check_folder(folder: FilePath) -> None:
    """Check before any work that a folder can be created or written to.

    Raises:
        OSError: If it cannot.
    """
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(there))
    _check_writable(there)


def _check_writable(place: FilePath) -> None:
    if not os.access(place, os.W_OK):
        code = errno.EACCES if place.exists() else errno.ENOENT
        raise OSError(code, os.strerror(code), str(place))


def motion_in(file: FilePath, scene: Scene) -> gp.Path | gp.Trajectory:
    """Read a motion of a scene's robot.

    Raises:
        FormatError: If the file contains no motion, or one of other joints; with the name of the file.
    """
    motion = documents.read_motion(file)
    if isinstance(motion, gp.Trajectory) and motion.joints != scene.joints:
        problem = f"its joints are {', '.join(motion.joints)}; those of the scene are {', '.join(scene.joints)}"
        raise FormatError(str(file), problem)
    given = (motion.path if isinstance(motion, gp.Trajectory) else motion).q.shape[1]
    if given != len(scene.joints):
        raise FormatError(str(file), f"it moves {given} joints, the scene has {len(scene.joints)}")
    return motion


@contextmanager
def blamed_on(file: FilePath) -> Generator[None]:
    """Add the name of a file to errors about its motion.

    Raises:
        FormatError: In place of an error about the motion.
    """
    try:
        yield
    except (ShapeError, SettingError) as error:
        if error.name not in ("path", "trajectory", "states of the path"):
            raise
        raise FormatError(str(file), str(error)) from None


# --- output -----------------------------------------------------------------------------------------------------------


def sentence(result: gp.PlanResult) -> str:
    """Return a sentence with the outcome of planning."""
    text = f"{result.status.name}: {result.status.value}" + (f" ({result.detail})" if result.detail else "")
    if result.trajectory is not None:
        text += f" {result.trajectory.duration:.2f} s long."
    return text


def show(args: argparse.Namespace, document: Any, text: str) -> None:
    """Print the document with `--json`, else the text."""
    print(documents.to_json(document) if args.json else text, flush=True)
