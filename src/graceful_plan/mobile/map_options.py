"""Command-line options for planning on a floor map: the map, its robot and its entities."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.scene.edit import StaticBody
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.scene import Scene

PICTURES = (".png", ".pdf", ".svg")
_HEIGHT, _RADIUS = 1.7, 0.25
"""Height and radius of entities given by class and place alone [m]."""


def add_map(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a map in place of a scene."""
    parser.add_argument(
        "--map",
        type=FilePath,
        metavar="FILE",
        help="plan on a floor map: YAML of map_server, or .map of MovingAI",
    )
    parser.add_argument("--robot", default="jackal", help="robot on the map: jackal or fetch (default jackal)")
    parser.add_argument(
        "--cell", type=float, default=0.05, metavar="M", help="width of a cell of a .map [m] (default 0.05)"
    )
    parser.add_argument(
        "--entity", nargs=3, action="append", default=[], metavar=("CLASS", "X", "Y"), help="entity that stands there"
    )
    parser.add_argument(
        "--walker",
        nargs=6,
        action="append",
        default=[],
        metavar=("CLASS", "X", "Y", "TO_X", "TO_Y", "SPEED"),
        help="entity that walks from one place to another [m, m/s]",
    )
    parser.add_argument(
        "--picture", type=FilePath, metavar="FILE", help=f"draw map, risk and motion; ends in {', '.join(PICTURES)}"
    )


def map_problem(args: argparse.Namespace) -> tuple[Scene, Any, Any]:
    """Return scene, start and goal of a planning problem on a map.

    Raises:
        SettingError: If start or goal are missing or not poses, or a task is given as well.
        FormatError: If the map cannot be read.
    """
    if args.task is not None:
        raise SettingError("--task", args.task, "none: a map has no tasks")
    start = _numbers("--start", args.start, (3,))
    goal = _numbers("--goal", args.goal, (2, 3))
    floor = chosen_map(args)
    scene = floor.to_scene(args.robot)
    for k, words in enumerate(args.walker):
        scene = scene.with_moving(_walker(f"{words[0]}_walking_{k + 1}", words))
    rest = np.clip(np.zeros(len(scene.joints)), *scene.limits.position.T)
    return scene, [*start, *rest[3:].tolist()], BasePose(*goal)


def chosen_map(args: argparse.Namespace) -> OccupancyGrid:
    """Read the given map and add its standing entities."""
    if args.map.suffix == ".map":
        floor = OccupancyGrid.from_moving_ai(args.map, args.cell)
    else:
        floor = OccupancyGrid.from_map_server(args.map)
    solids = []
    for k, (category, *place) in enumerate(args.entity):
        x, y = _numbers("--entity", place, (2,))
        pose = np.array([x, y, 0.5 * _HEIGHT])
        size = [_RADIUS, 0.5 * _HEIGHT]
        solids.append(StaticBody(name=f"{category}_{k + 1}", kind="cylinder", size=size, pose=pose, entity=category))
    return floor.with_entities(*solids)


def _walker(name: str, words: Sequence[str]) -> MovingEntity:
    x, y, to_x, to_y, speed = _numbers("--walker", words[1:], (5,))
    length = float(np.hypot(to_x - x, to_y - y))
    if not (speed > 0.0 and length > 0.0):
        raise SettingError("--walker", " ".join(words), "two places and a speed above 0; --entity adds standing ones")
    half = 0.5 * _HEIGHT
    ends = [[x, y, half], [to_x, to_y, half]]
    return MovingEntity(
        name, words[0], size=[_RADIUS, half], t=[0.0, length / speed], position=ends, spread=0.05, growth=0.05
    )


def _numbers(option: str, words: Sequence[str] | None, counts: tuple[int, ...]) -> list[float]:
    """Parse numbers separated by spaces or commas."""
    parts = [part for word in words or () for part in word.split(",") if part]
    wanted = " or ".join(str(n) for n in counts) + " numbers"
    try:
        values = [float(part) for part in parts]
    except ValueError:
        raise SettingError(option, " ".join(parts), wanted) from None
    if len(values) not in counts or not np.isfinite(values).all():
        raise SettingError(option, " ".join(parts) or None, wanted)
    return values
