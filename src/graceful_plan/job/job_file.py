"""Job files: a scene, goals and allowed actions in YAML. Every error names file and line.

version: 1
scene: dining_table                # bundled scene, or a scene file in the folder of this file
goals:
  bottle: {onto: table, n: 4}        # or in_region: [lower corner, upper corner]
  teapot: {at: [0.5, 0.3, 0.74]}   # position in W [m], or a 4 x 4 pose
allow:
  - {clear: laptop, onto: side_table}
  - {close_lid: lid, vessel: kettle}
  - {load: tray, onto: side_table}
  - {open: drawer, handle: drawer_handle, to: 0.25}
  - {close: drawer, handle: drawer_handle, required: true}
  - {pour: kettle, into: pot, fill: 0.2}
  - {wait: 8}                      # longest wait at a time [s]; price: per second
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from graceful_plan.exceptions import GracefulPlanError, SceneError, names_file
from graceful_plan.job.actions import Action, Clear, CloseLid, Load, Wait
from graceful_plan.job.jobs import Job
from graceful_plan.job.opening import Close, Open
from graceful_plan.job.pouring import Pour
from graceful_plan.regular_file import path_of
from graceful_plan.scene.loading.bundled import load_scene
from graceful_plan.yaml_file import Block, read_yaml


@names_file
def load_job(file: str | Path) -> Job:
    """Read a job from a YAML file; docs/jobs.md describes the format.

    Raises:
        SceneError: If the file is malformed, or asks for something that the scene does not have; it names the line.
        GracefulPlanError: If the scene cannot be loaded.
    """
    path = path_of(file)
    root = read_yaml(path)
    root.only("version", "scene", "goals", "allow")
    root.check_version("job files")
    with _at(root["scene"]):
        job = Job(load_scene(_scene(root["scene"], path)))
    for name, goal in root["goals"].items():
        goal.only("onto", "at", "in_region", "n")
        with _at(goal):
            job.place(name, **_given(goal, onto=Block.string, at=_pose, in_region=_rows, n=_whole))
    for action in root["allow"].entries() if root.get("allow") else ():
        with _at(action):
            job.allow(_action(action))
    return job


def _scene(block: Block, file: Path) -> str | Path:
    """Return a scene file in the folder of the job file, or the name of a bundled scene."""
    name = Path(block.string())
    if name.suffix not in (".yaml", ".yml"):
        return block.string()
    if name.is_absolute() or ".." in name.parts:
        raise block.error(f"{block.string()!r} is outside of the folder of the job file")
    return file.parent / name


def _action(block: Block) -> Clear | CloseLid | Load | Action:
    kinds = {
        "clear": _clear,
        "close_lid": _close_lid,
        "load": _load,
        "open": _open,
        "close": _close,
        "pour": _pour,
        "wait": _wait,
    }
    named = [kind for kind in kinds if block.get(kind) is not None]
    if len(named) != 1:
        raise block.error(f"{block.name} needs one of the keys {', '.join(kinds)}")
    return kinds[named[0]](block)


def _clear(block: Block) -> Clear:
    block.only("clear", "onto", "in_region", "n")
    return Clear(block["clear"].string(), **_given(block, onto=Block.string, in_region=_rows, n=_whole))


def _load(block: Block) -> Load:
    block.only("load", "onto", "in_region", "n")
    return Load(block["load"].string(), **_given(block, onto=Block.string, in_region=_rows, n=_whole))


def _close_lid(block: Block) -> CloseLid:
    block.only("close_lid", "vessel", "X_VL")
    return CloseLid(block["vessel"].string(), block["close_lid"].string(), **_given(block, X_VL=_rows))


def _open(block: Block) -> Open:
    return Open(block["open"].string(), block["handle"].string(), **_of_joint(block, "open"))


def _close(block: Block) -> Close:
    return Close(block["close"].string(), block["handle"].string(), **_of_joint(block, "close"))


def _of_joint(block: Block, kind: str) -> dict[str, Any]:
    block.only(kind, "handle", "to", "required")
    return _given(block, to=Block.number, required=Block.flag)


def _pour(block: Block) -> Pour:
    block.only("pour", "into", "fill")
    return Pour(block["pour"].string(), block["into"].string(), **_given(block, fill=Block.number))


def _wait(block: Block) -> Wait:
    block.only("wait", "price")
    return Wait(max_seconds=block["wait"].number(), **_given(block, price=Block.number))


def _given(block: Block, **readers: Callable[[Block], Any]) -> dict[str, Any]:
    """Return the values of the keys that are there. `onto` means `on`, which YAML reads as "true"."""
    given = {key: read(child) for key, read in readers.items() if (child := block.get(key)) is not None}
    return {"on" if key == "onto" else key: value for key, value in given.items()}


def _pose(block: Block) -> list[Any]:
    return _rows(block) if block.entries() and block.entries()[0].is_list else list(block.numbers(3))


def _rows(block: Block) -> list[list[float]]:
    rows = [list(row.numbers()) for row in block.entries()]
    if len({len(row) for row in rows}) > 1:
        raise block.error(f"the rows of {block.name} differ in length")
    return rows


def _whole(block: Block) -> int:
    number = block.number()
    if number != int(number) or number < 1:
        raise block.error(f"{block.name} has to be a whole number, at least 1")
    return int(number)


@contextmanager
def _at(block: Block) -> Generator[None]:
    """Add file and line to errors about a value."""
    try:
        yield
    except SceneError as error:
        if error.file is None:
            raise block.error(str(error)) from None
        raise
    except GracefulPlanError as error:
        raise block.error(str(error)) from None
