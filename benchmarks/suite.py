"""Tasks of the benchmarks (bundled scenes, `unseen/`, `vessels/`), their options, and jobs in processes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import TypeVar

import graceful_plan as gp
from graceful_plan.compare.runs import workers

UNSEEN = Path(__file__).with_name("unseen")
"""Scenes that no constant was fitted on, with other furniture and objects than the bundled ones."""
VESSELS = Path(__file__).with_name("vessels")
"""Scenes in which open vessels are carried."""

PLANNING = tuple(
    f"src/graceful_plan/{name}"
    for name in ("core", "scene", "costs", "constraints", "planners", "query", "timing", "judge", "plan.py")
)
"""Paths that every planned motion depends on."""
SIMULATION = tuple(
    f"sim/failbench/{name}"
    for name in ("basics", "fault", "recording", "rollouts", "simulated", "surroundings", "validation.py")
)
"""Paths that every simulated failure depends on."""

J = TypeVar("J")
R = TypeVar("R")
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to run a subject."""

    quick: bool = False
    """Sizes that only check that the benchmark runs; the figures mean little."""
    long: bool = False
    """Sizes that take too long for a run of all benchmarks."""
    processes: int = 1
    """Processes for planning jobs; at most one per core, otherwise times mean nothing."""
    seconds: float | None = None
    """Time limit of a run [s], for subjects that have one."""
    calls: int | None = None
    """Calls per time limit in `first_motion`; None for its default."""
    tasks: tuple[str, ...] = ("*",)
    """Patterns of "scene/task" with * and ?. This and the fields below are for `prevention`."""
    drops: int | None = None
    """Drops per motion; None for the default, as below."""
    mixed: int | None = None
    """Mixed failures per motion."""
    weights: tuple[float, ...] | None = None
    """Weights of the impact models over which harm is measured."""
    bound: bool = False
    """For `prevention` and `mobile_prevention`: measure the harm that the best of many motions prevents."""

    def pick(self, normal: T, *, quick: T, long: T | None = None) -> T:
        """Return the sizes for a normal, quick or long run; a long run without its own sizes uses the normal ones."""
        if self.long and long is not None:
            return long
        return quick if self.quick else normal


@cache
def scene(name: str) -> gp.Scene:
    """Load a bundled scene, or a scene of `unseen/` or `vessels/`, once per process."""
    own = [folder / f"{name}.yaml" for folder in (UNSEEN, VESSELS) if (folder / f"{name}.yaml").exists()]
    return gp.load_scene(own[0] if own else name)


def unseen_scenes() -> tuple[str, ...]:
    """Names of the scenes in `unseen/`."""
    return tuple(sorted(file.stem for file in UNSEEN.glob("*.yaml")))


def vessel_scenes() -> tuple[str, ...]:
    """Names of the scenes in `vessels/`."""
    return tuple(sorted(file.stem for file in VESSELS.glob("*.yaml")))


def is_tabletop(task_name: str) -> bool:
    """Whether a task is a table task (small objects on a crowded table); otherwise it is a household task."""
    scene_name = task_name.split("/")[0]
    return scene_name.startswith("tabletop") or scene_name in ("play_table", "lab_bench")


def task(name: str) -> gp.Task:
    """Return a task by "scene/task"."""
    scene_name, task_name = name.split("/")
    return scene(scene_name).tasks[task_name]


def task_names(options: Options | None = None) -> list[str]:
    """Names "scene/task" of all tasks of the bundled scenes; one task per scene in a quick run."""
    return _tasks_of(gp.scenes(), options)


def unseen_task_names(options: Options | None = None) -> list[str]:
    """Names "scene/task" of all tasks in `unseen/`; one task per scene in a quick run."""
    return _tasks_of(unseen_scenes(), options)


def vessel_task_names(options: Options | None = None) -> list[str]:
    """Names "scene/task" of all tasks in `vessels/`; one task per scene in a quick run."""
    return _tasks_of(vessel_scenes(), options)


def chosen(names: Sequence[str], patterns: Sequence[str]) -> list[str]:
    """Return the names that match one of the patterns, in their order."""
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)]


def _tasks_of(scenes: Sequence[str], options: Options | None) -> list[str]:
    per_scene = [[f"{name}/{task}" for task in scene(name).tasks] for name in scenes]
    return [task for tasks in per_scene for task in (tasks[:1] if options and options.quick else tasks)]


def spread(do: Callable[[J], R], jobs: Sequence[J], processes: int, label: str) -> Iterator[R]:
    """Do jobs in worker processes, or in this process if there is only one, and yield results as they come."""
    return with_progress(workers.spread(workers.Work(do=do), jobs, processes if processes > 1 else 0), len(jobs), label)


def with_progress(results: Iterator[R], count: int, label: str) -> Iterator[R]:
    """Yield results and print progress on standard error."""
    started, terminal = time.perf_counter(), sys.stderr.isatty()
    for done, result in enumerate(results, 1):
        if terminal or done == count or done % max(1, count // 10) == 0:
            words = f"{label}: {done}/{count}, {time.perf_counter() - started:.0f} s"
            print(words, end="\r" if terminal and done < count else "\n", file=sys.stderr, flush=True)
        yield result
