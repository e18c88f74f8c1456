"""Suites: sets of problems for the comparison of planners, as data.

A suite file is YAML:

    version: 1
    description: one line for the report                     # optional
    seconds: 1.0          # time limit of every run, w, seeds: defaults, which a caller may replace
    w: 1.0
    seeds: 3              # their number (0, 1, 2), or a list
    problems:
      - scene: tabletop   # bundled scene or scene file beside this file; "*" stands for every bundled scene
        tasks: [right_to_left]                  # default: all; a number n selects the first n
      - scene: kitchen.yaml
        start: home       # keyframe or joint values; no carried object
        goal: [0.0, 0.5, 0.0, -1.2, 0.0, 1.6, 0.7]
        name: kitchen/home_to_sink
      - analytic: [disc, catenary]              # problems of compare.problems.analytic; "*" stands for all
      - file: bookshelf.yaml                    # problem file or folder (see problem_files)
        groups: [bookshelf_small_panda]         # default: all
        limit: 20                               # only the first 20; default: all
    best_known: {tabletop/right_to_left: 3.21}  # best-known total costs, at the suite's w
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from graceful_plan.compare.problems.analytic import analytic_problems
from graceful_plan.compare.problems.problem_files import load_problems
from graceful_plan.exceptions import (
    READ_ERRORS,
    FormatError,
    SettingError,
    UnknownNameError,
    names_file,
    read_error_reason,
)
from graceful_plan.path import plain_numbers
from graceful_plan.regular_file import open_regular, path_of, read_content
from graceful_plan.scene.loading.bundled import load_scene, scenes
from graceful_plan.yaml_file import Block, read_yaml

VERSION = 1
MOST = 1_000_000
"""Maximum number of seeds, problems and tasks in a suite."""
_FOLDER = Path(__file__).parent / "suites"
_ALL = "*"
_KEYS = ("version", "description", "seconds", "w", "seeds", "problems", "best_known")

End = str | tuple[float, ...]
"""A keyframe or joint values."""


@dataclass(frozen=True, kw_only=True)
class ProblemSpec:
    """Source of a problem, as plain data that can be sent to another process.

    Args:
        name: Name in reports, unique in the suite.
        kind: "task" or "motion" of a scene, "analytic" or "file".
        source: Bundled scene, or path of the scene or problem file; empty for an analytic problem.
        item: Task, analytic problem, or name in the problem file.
        group: Kind of the problem: its scene, or its group in a problem file.
        start: Start of a motion.
        goal: Goal of a motion.
        digest: Checksum of the source, if it is a file.
    """

    name: str
    kind: str
    source: str = ""
    item: str = ""
    group: str = ""
    start: End | None = None
    goal: End | None = None
    digest: str = ""

    def to_document(self) -> dict[str, Any]:
        """Return a dictionary that identifies the problem, without the location of its file."""
        source = Path(self.source).name if self.digest else self.source
        ends = [list(end) if isinstance(end, tuple) else end for end in (self.start, self.goal)]
        named = {"name": self.name, "kind": self.kind, "source": source, "item": self.item, "group": self.group}
        return {**named, "ends": ends, **({"digest": self.digest} if self.digest else {})}


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Problems, with default settings of their runs.

    Args:
        name: Name of the suite.
        problems: Problems with unique names, at least one.
        description: One line for the report.
        seconds: Time limit of a run [s].
        w: Safety weight.
        seeds: Seeds of the runs.
        best_known: Best-known total cost at `w`, by problem.
    """

    name: str
    problems: tuple[ProblemSpec, ...]
    description: str = ""
    seconds: float = 1.0
    w: float = 1.0
    seeds: tuple[int, ...] = (0, 1, 2)
    best_known: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        plain_numbers(self)
        names = [problem.name for problem in self.problems]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise SettingError("name", twice, f"a unique name for every problem of suite {self.name!r}")
        if not self.problems:
            raise SettingError("problems", [], f"at least one problem in suite {self.name!r}")
        for name in self.best_known:
            if name not in names:
                raise UnknownNameError("problem in best_known", name, names)


def suites() -> tuple[str, ...]:
    """Return the names of the bundled suites."""
    return tuple(sorted(file.stem for file in _FOLDER.glob("*.yaml")))


@names_file
def load_suite(source: str | Path) -> Suite:
    """Load a suite: a bundled one by name, a suite file (.yaml with `problems` and `version`), or problem files.

    Args:
        source: Name, or path of a suite file, of a problem file or of a folder of problem files.

    Raises:
        UnknownNameError: If there is neither a bundled suite nor a file of that name.
        SceneError: If the suite file is malformed; with file and line.
        FormatError: If a problem file is malformed.
    """
    if str(source) in suites():
        return _read_suite(_FOLDER / f"{source}.yaml")
    path = path_of(source)
    if not path.exists():
        raise UnknownNameError("suite", str(source), (*suites(), "a suite file", "a problem file or folder"))
    if path.suffix in (".yaml", ".yml") and _is_suite(path):
        return _read_suite(path)
    return Suite(name=path.stem, problems=tuple(_of_problem_file(path)), w=0.0, description=f"problems of {path.name}")


def _is_suite(file: Path) -> bool:
    """Return whether a file is a suite, from its head: problem files may be too large to read twice."""
    try:
        with open_regular(file) as stream:
            head = stream.read(65536).decode("utf-8", errors="replace")
    except READ_ERRORS as error:
        raise FormatError(str(file), read_error_reason(error)) from None
    return any(line.startswith(("problems:", "version:")) for line in head.splitlines())


def _read_suite(file: Path) -> Suite:
    top = read_yaml(file)
    top.only(*_KEYS)
    if top["version"].number() != VERSION:
        raise top["version"].error(f"version {top['version'].value} of a suite; this version reads {VERSION}")
    given: dict[str, Any] = {}
    for key in ("seconds", "w"):
        if (block := top.get(key)) is not None:
            given[key] = _number(block, above=key == "seconds")
    if (block := top.get("description")) is not None:
        given["description"] = block.string()
    if (block := top.get("seeds")) is not None:
        given["seeds"] = _seeds(block)
    if (block := top.get("best_known")) is not None:
        given["best_known"] = {name: _number(child, above=False) for name, child in block.items()}
    problems = [problem for block in top["problems"].entries() for problem in _problems(block, file.parent)]
    try:
        return Suite(name=file.stem, problems=tuple(problems), **given)
    except (SettingError, UnknownNameError) as error:
        raise top.error(str(error)) from None


def _number(block: Block, *, above: bool) -> float:
    value = block.number()
    if value < 0.0 or (above and value == 0.0):
        raise block.error(f"{block.name} = {value:g}, expected a number {'> 0' if above else '>= 0'}")
    return value


def _whole(block: Block, least: int, most: int = MOST) -> int:
    value = block.number()
    if value != int(value) or not least <= value <= most:
        raise block.error(f"{block.name} = {value:g}, expected a whole number in [{least}, {most}]")
    return int(value)


def _seeds(block: Block) -> tuple[int, ...]:
    if block.is_list:
        seeds = tuple(_whole(child, 0, 2**32 - 1) for child in block.entries())
        if not seeds or len(set(seeds)) < len(seeds):
            raise block.error(f"{block.name}: expected at least one seed, none twice")
        return seeds
    return tuple(range(_whole(block, 1)))


def _problems(block: Block, folder: Path) -> Iterator[ProblemSpec]:
    """Read an entry of the list of problems; it may expand to many."""
    if block.get("scene") is not None:
        yield from _of_scene(block, folder)
    elif block.get("analytic") is not None:
        block.only("analytic")
        yield from _analytic(block["analytic"])
    elif block.get("file") is not None:
        block.only("file", "groups", "limit")
        groups, limit = block.get("groups"), block.get("limit")
        path = folder / block["file"].string()
        if not path.exists():
            raise block["file"].error(f"there is no {path}")
        yield from _of_problem_file(
            path,
            groups=None if groups is None else groups.strings(),
            limit=None if limit is None else _whole(limit, 1),
        )
    else:
        raise block.error(f"{block.name} needs one of the keys 'scene', 'analytic' and 'file'")


def _of_scene(block: Block, folder: Path) -> Iterator[ProblemSpec]:
    given = block["scene"].string()
    if given == _ALL:
        block.only("scene", "tasks")
        for name in scenes():
            yield from _tasks(name, name, "", block.get("tasks"))
        return
    block.only("scene", "tasks", "start", "goal", "name")
    source, digest = given, ""
    if Path(given).suffix in (".yaml", ".yml"):
        source = str((folder / given).resolve())
        digest = _digest(folder / given) if (folder / given).exists() else ""
    elif given not in scenes():
        raise block["scene"].error(str(UnknownNameError("scene", given, scenes())))
    label = Path(given).stem
    if block.get("start") is None and block.get("goal") is None:
        yield from _tasks(label, source, digest, block.get("tasks"))
        return
    if block.get("tasks") is not None:
        raise block.error(f"{block.name} has both tasks and a start or goal; expected one or the other")
    ends = [_end(block[key]) for key in ("start", "goal")]
    scene = load_scene(source)
    for end, key in zip(ends, ("start", "goal"), strict=True):
        if isinstance(end, str) and end not in scene.keyframes:
            raise block[key].error(str(UnknownNameError("keyframe", end, scene.keyframes)))
        if not isinstance(end, str) and len(end) != len(scene.joints):
            raise block[key].error(f"{block[key].name} has {len(end)} numbers, expected {len(scene.joints)}")
    named = block.get("name")
    words = [end if isinstance(end, str) else "q" for end in ends]
    name = f"{label}/{words[0]}_to_{words[1]}" if named is None else named.string()
    yield ProblemSpec(name=name, kind="motion", source=source, group=label, start=ends[0], goal=ends[1], digest=digest)


def _end(block: Block) -> End:
    return block.numbers() if block.is_list else block.string()


def _tasks(label: str, source: str, digest: str, wanted: Block | None) -> Iterator[ProblemSpec]:
    """Yield tasks of a scene: all, the first few, or those listed."""
    known = list(load_scene(source).tasks)
    if wanted is None:
        chosen = known
    elif wanted.is_list:
        chosen = list(wanted.strings())
        for name in chosen:
            if name not in known:
                raise wanted.error(str(UnknownNameError(f"task of {label}", name, known)))
    else:
        chosen = known[: _whole(wanted, 1)]
    for name in chosen:
        yield ProblemSpec(name=f"{label}/{name}", kind="task", source=source, item=name, group=label, digest=digest)


def _analytic(block: Block) -> Iterator[ProblemSpec]:
    known = analytic_problems()
    chosen = tuple(known) if not block.is_list and block.string() == _ALL else block.strings()
    for name in chosen:
        if name not in known:
            raise block.error(str(UnknownNameError("analytic problem", name, known)))
        yield ProblemSpec(name=f"analytic/{name}", kind="analytic", item=name, group="analytic")


def _of_problem_file(
    path: Path, groups: tuple[str, ...] | None = None, limit: int | None = None
) -> Iterator[ProblemSpec]:
    digest = _digest(path)
    for problem in load_problems(path, groups=groups)[:limit]:
        yield ProblemSpec(
            name=problem.name,
            kind="file",
            source=str(path.resolve()),
            item=problem.name,
            group=problem.group,
            digest=digest,
        )


def _digest(path: Path) -> str:
    """Return the checksum of a file, or of all files in a folder."""
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    total = hashlib.sha256()
    for file in files:
        total.update(file.name.encode() + b"\0" + read_content(file))
    return total.hexdigest()[:16]
