"""The registry of scenarios: faults by degree, task and scene. Listing it simulates nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import NamedTuple

import graceful_plan as gp
from failbench.fault.fault import DEGREES, SURROUNDINGS, Fault
from failbench.fault.registry import faults
from failbench.simulated.gripper import find_gripper
from failbench.surroundings.registry import disturbances
from graceful_plan.exceptions import UnknownNameError, names_file
from graceful_plan.yaml_file import Block, read_yaml

_FILE = Path(__file__).parent / "scenarios.yaml"
_NEEDS = ("carried", "contents")
MOBILE = "mobile"
"""Family of scenarios with driving robots."""


@dataclass(frozen=True)
class Scenario:
    """A fault of some degree in a task of a bundled scene.

    Args:
        name: "SCENE/TASK/FAULT/DEGREE".
        scene: Name of the bundled scene.
        task: Name of its task.
        fault: The fault.
        tags: "FAMILY/FAULT/DEGREE" for each of its families, the fault's category first.
    """

    name: str
    scene: str
    task: str
    fault: Fault
    tags: tuple[str, ...]

    def matches(self, pattern: str) -> bool:
        """Return whether the name or a tag matches a pattern with the wildcards * and ?."""
        return any(fnmatchcase(label, pattern) for label in (self.name, *self.tags))


def scenarios(pattern: str = "*") -> tuple[Scenario, ...]:
    """Return the scenarios with a name or tag that matches a pattern such as "drop/*" or "desk/*/severe".

    Patterns that begin with "surroundings/" select faults of the surroundings. Patterns that begin with "mobile/" or
    the name of a mobile scene select driving robots. Full names select both as well. All other patterns select
    scenarios of fixed arms.

    Raises:
        UnknownNameError: If nothing matches; the message lists valid first parts of a pattern.
    """
    found = tuple(scenario for scenario in _registry() if scenario.matches(pattern))
    first = pattern.split("/")[0]
    if first == SURROUNDINGS or not found:
        found += tuple(s for s in _around() if s.name == pattern or (first == SURROUNDINGS and s.matches(pattern)))
    if first in (MOBILE, *gp.mobile_scenes()):
        found += tuple(s for s in _driving() if s.matches(pattern))
    if not found:
        labels = {label for scenario in _registry() for label in (scenario.scene, *_families(scenario))}
        labels |= {SURROUNDINGS, MOBILE, *gp.mobile_scenes()}
        raise UnknownNameError("scenarios", pattern, {f"{label}/*" for label in labels})
    return found


def _families(scenario: Scenario) -> tuple[str, ...]:
    return tuple(tag.split("/")[0] for tag in scenario.tags)


class _Family(NamedTuple):
    """A family of scenarios; None in a field matches everything."""

    faults: tuple[str, ...] | None
    scenes: tuple[str, ...] | None
    tasks: tuple[str, ...] | None
    needs: str | None

    def has(self, fault: str, scene: str, task: str, holds: frozenset[str]) -> bool:
        fits = zip((self.faults, self.scenes, self.tasks), (fault, scene, task), strict=True)
        return all(names is None or name in names for names, name in fits) and (
            self.needs is None or self.needs in holds
        )


@cache
def _registry() -> tuple[Scenario, ...]:
    families = read_file(_FILE)
    return tuple(
        scenario
        for scene_name in gp.scenes()
        for task, holds in _tasks(scene_name).items()
        for scenario in _of_task(scene_name, task, holds, families)
    )


@cache
def _around() -> tuple[Scenario, ...]:
    """Return all faults of the surroundings, in every degree, on every task."""
    return tuple(
        Scenario(
            f"{scene}/{task}/{name}/{degree}", scene, task, kind(degree=degree), (f"{SURROUNDINGS}/{name}/{degree}",)
        )
        for scene in gp.scenes()
        for task, holds in _tasks(scene).items()
        for name, kind in disturbances().items()
        for degree in DEGREES
        if "carried" in holds or name != "heavier_object"
    )


@cache
def _driving() -> tuple[Scenario, ...]:
    """Return the scenarios of driving robots in the mobile scenes; without a gripper, faults of it are left out."""
    found = []
    for scene in gp.mobile_scenes():
        loaded = gp.load_scene(scene)
        has_gripper = bool(len(find_gripper(loaded).joints))
        kinds = {name: kind for name, kind in faults().items() if has_gripper or set(kind.TARGETS) != {"gripper"}}
        found += [
            Scenario(
                f"{scene}/{task}/{name}/{degree}",
                scene,
                task,
                kind(degree=degree),
                (f"{MOBILE}/{name}/{degree}", f"{kind.CATEGORY}/{name}/{degree}"),
            )
            for task in loaded.tasks
            for name, kind in kinds.items()
            for degree in DEGREES
        ]
    return tuple(found)


def _of_task(scene: str, task: str, holds: frozenset[str], families: Mapping[str, _Family]) -> tuple[Scenario, ...]:
    found = []
    for name, kind in faults().items():
        belongs = [kind.CATEGORY, *(key for key, family in families.items() if family.has(name, scene, task, holds))]
        for degree in DEGREES:
            tags = tuple(f"{family}/{name}/{degree}" for family in belongs)
            label = f"{scene}/{task}/{name}/{degree}"
            found.append(Scenario(label, scene, task, kind(degree=degree), tags))
    return tuple(found)


def _tasks(scene_name: str) -> dict[str, frozenset[str]]:
    """Return the tasks of a bundled scene, with which of the components "carried" and "contents" each has."""
    scene = gp.load_scene(scene_name)
    found = {}
    for name, task in scene.tasks.items():
        note = None if task.object_name is None else scene.notes.objects[task.object_name]
        holds = {"carried": note is not None, "contents": note is not None and note.contents is not None}
        found[name] = frozenset(component for component, there in holds.items() if there)
    return found


@names_file
def read_file(file: Path) -> Mapping[str, _Family]:
    """Read families from a YAML file laid out like `scenarios.yaml`.

    Raises:
        SceneError: If the file is malformed, or names an unknown fault or scene; the message has the line.
    """
    root = read_yaml(file)
    root.only("version", "families")
    if root["version"].number() != 1:
        raise root["version"].error("only version 1 of scenario files is known")
    return {name: _family(block) for name, block in root["families"].items()}


def _family(block: Block) -> _Family:
    block.only("faults", "scenes", "tasks", "needs")
    names, scenes, tasks = (
        None if (child := block.get(key)) is None else child.strings() for key in ("faults", "scenes", "tasks")
    )
    for key, given, valid in (("faults", names, faults()), ("scenes", scenes, gp.scenes())):
        for name in given or ():
            if name not in valid:
                raise block[key].error(f"unknown name {name!r} in {block.name}.{key}; valid: {', '.join(valid)}")
    needs = block.get("needs")
    if needs is not None and needs.string() not in _NEEDS:
        raise needs.error(f"needs is {needs.string()!r}, expected {' or '.join(_NEEDS)}")
    return _Family(names, scenes, tasks, None if needs is None else needs.string())
