"""What the benchmarks run on: every task of every bundled scene, and helpers to run jobs in processes."""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import graceful_plan as gp

Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to run a subject."""

    quick: bool = False
    """Sizes small enough to see in a minute that it works; its figures mean little."""
    processes: int = 1
    """Processes for planning jobs; never more than there are cores, or times mean nothing."""
    seconds: float | None = None
    """Time limit of a run [s], where the subject lets it be chosen."""


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


def spread(run: Callable[[Job], Result], jobs: Sequence[Job], processes: int, label: str) -> Iterator[Result]:
    """Run jobs in processes of their own and yield results as they come; progress goes to standard error."""
    started = time.perf_counter()
    if processes <= 1:
        results: Iterator[Result] = map(run, jobs)
        yield from _told(results, len(jobs), label, started)
        return
    # Spawned, not forked: libraries below have threads.
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from _told(pool.imap_unordered(run, jobs), len(jobs), label, started)


def _told(results: Iterator[Result], count: int, label: str, started: float) -> Iterator[Result]:
    terminal = sys.stderr.isatty()
    for done, result in enumerate(results, 1):
        if terminal or done == count or done % max(1, count // 10) == 0:
            told = f"{label}: {done}/{count}, {time.perf_counter() - started:.0f} s"
            print(told, end="\r" if terminal and done < count else "\n", file=sys.stderr, flush=True)
        yield result
