"""Read problem files of other planners: `load_problems`.

`problem_formats` describes the three supported formats of problems for the Panda among primitives. Lengths are in m,
angles in rad, and the robot's base is at the origin.

Pickled files are never loaded, because unpickling runs their author's code.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from graceful_plan.compare.problems.motion_problem import Obstacle, ProblemFile
from graceful_plan.compare.problems.plain_values import Value
from graceful_plan.compare.problems.problem_formats import moveit_problem, robometrics_problems, vamp_problems
from graceful_plan.exceptions import (
    READ_ERRORS,
    FormatError,
    SettingError,
    UnknownNameError,
    names_file,
    read_error_reason,
)
from graceful_plan.path import is_real
from graceful_plan.regular_file import path_of, read_content
from graceful_plan.untrusted_json import parse_json
from graceful_plan.untrusted_yaml import MOST_BYTES, parse_yaml_values

__all__ = ["Obstacle", "ProblemFile", "load_problems"]

MAX_BYTES = 200_000_000
"""Largest size of a JSON file [bytes]."""
MAX_FILES = 20_000
_WIDEST = 0.04
"""Greatest opening of each finger [m]."""
_REQUEST = re.compile(r"request_?(\d+)\.ya?ml")


@names_file
def load_problems(
    path: str | Path, *, groups: Sequence[str] | None = None, fingers: float = _WIDEST
) -> tuple[ProblemFile, ...]:
    """Read all problems of a file or folder, in the order of the file.

    Args:
        path: A robometrics file (.yaml), a VAMP file (.json), or a folder of MotionBenchMaker, whose name becomes the
            group. A folder of such folders is read as a whole.
        groups: Groups of problems to keep; all by default.
        fingers: Position of both finger joints [m]; positions in the files are ignored. Open by default, because
            goals of the MotionBenchMaker type reach around the object to grasp.

    Raises:
        FormatError: If a file is malformed; with file and key.
        UnknownNameError: If there is no such group.
        SettingError: If `fingers` is not in [0, 0.04].
    """
    if not (is_real(fingers) and 0.0 <= fingers <= _WIDEST):
        raise SettingError("fingers", fingers, f"a number in [0, {_WIDEST}] [m]")
    place = path_of(path)
    found = tuple(_folder(place, fingers) if place.is_dir() else _file(place, fingers))
    if not found:
        raise FormatError(str(place), "holds no problem")
    if groups is None:
        return found
    known = {problem.group for problem in found}
    for group in groups:
        if group not in known:
            raise UnknownNameError("group of problems", group, known)
    return tuple(problem for problem in found if problem.group in groups)


def _file(file: Path, fingers: float) -> list[ProblemFile]:
    suffix = file.suffix.lower()
    if suffix in (".yaml", ".yml"):
        return robometrics_problems(_read_yaml(file), fingers)
    if suffix == ".json":
        return vamp_problems(_read_json(file), fingers)
    if suffix in (".pkl", ".pickle"):
        raise FormatError(str(file), "pickled files are not loaded, since they can run code; give the JSON or the YAML")
    raise FormatError(str(file), "has to be a .yaml or .json file or a folder")


def _folder(folder: Path, fingers: float) -> list[ProblemFile]:
    """Read pairs of scene and request from a folder or its subfolders."""
    requests = sorted(file for file in folder.iterdir() if _REQUEST.fullmatch(file.name))
    if not requests:
        below = sorted(child for child in folder.iterdir() if child.is_dir())
        return [problem for child in below if _has_requests(child) for problem in _folder(child, fingers)]
    if len(requests) > MAX_FILES:
        raise FormatError(str(folder), f"holds {len(requests)} requests, at most {MAX_FILES} are read")
    found = []
    for file in requests:
        scene = file.with_name(file.name.replace("request", "scene", 1))
        if not scene.is_file():
            raise FormatError(str(file), f"there is no {scene.name} beside it")
        name = f"{folder.resolve().name}/{int(_REQUEST.fullmatch(file.name)[1])}"  # type: ignore[index]
        found.append(moveit_problem(_read_yaml(scene), _read_yaml(file), name, folder.resolve().name, fingers))
    return found


def _has_requests(folder: Path) -> bool:
    return any(_REQUEST.fullmatch(file.name) for file in folder.iterdir())


def _read_text(file: Path, most: int) -> str:
    try:
        text = read_content(file, most).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(str(file), f"is not UTF-8: {error.reason}") from None
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    if text.startswith("version https://git-lfs"):
        raise FormatError(str(file), "is a pointer of git-lfs, not the file itself; fetch it with `git lfs pull`")
    return text


def _read_yaml(file: Path) -> Value:
    return Value(str(file), "", parse_yaml_values(_read_text(file, MOST_BYTES), str(file)))


def _read_json(file: Path) -> Value:
    return Value(str(file), "", parse_json(_read_text(file, MAX_BYTES), str(file)))
