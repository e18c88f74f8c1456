"""What the benchmarks run on: every task of every bundled scene, and jobs in processes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import graceful_plan as gp
from graceful_plan.compare.runs import workers

J = TypeVar("J")
R = TypeVar("R")
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to run a subject."""

    quick: bool = False
    """Sizes small enough to see in a minute that it works; its figures mean little."""
    processes: int = 1
    """Processes for planning jobs; never more than there are cores, or times mean nothing."""
    seconds: float | None = None
    """Time limit of a run [s], where the subject lets it be chosen."""

    def pick(self, full: T, *, quick: T) -> T:
        """Return sizes for a full or for a quick run."""
        return quick if self.quick else full


@cache
def scene(name: str) -> gp.Scene:
    """Load a bundled scene once per process."""
    return gp.load_scene(name)


def task(name: str) -> gp.Task:
    """Return a task by "scene/task"."""
    scene_name, task_name = name.split("/")
    return scene(scene_name).tasks[task_name]


def task_names(options: Options | None = None) -> list[str]:
    """Names "scene/task" of all tasks; of one task per scene if it is to be quick."""
    per_scene = [[f"{name}/{task}" for task in scene(name).tasks] for name in gp.scenes()]
    return [task for tasks in per_scene for task in (tasks[:1] if options and options.quick else tasks)]


def spread(do: Callable[[J], R], jobs: Sequence[J], processes: int, label: str) -> Iterator[R]:
    """Do jobs in processes of their own, with one in this very one, and yield results as they come."""
    return told(workers.spread(workers.Work(do=do), jobs, processes if processes > 1 else 0), len(jobs), label)


def told(results: Iterator[R], count: int, label: str) -> Iterator[R]:
    """Yield results and tell on standard error how many there are."""
    started, terminal = time.perf_counter(), sys.stderr.isatty()
    for done, result in enumerate(results, 1):
        if terminal or done == count or done % max(1, count // 10) == 0:
            words = f"{label}: {done}/{count}, {time.perf_counter() - started:.0f} s"
            print(words, end="\r" if terminal and done < count else "\n", file=sys.stderr, flush=True)
        yield result
