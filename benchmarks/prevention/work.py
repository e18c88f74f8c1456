"""Tasks of `prevention`, groups of tasks, jobs in processes, and stored lines."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import store, suite
from benchmarks.prevention.figures import Found, Group, spilt_on_the_way
from benchmarks.prevention.runs import (
    CURVES,
    MODELS,
    NONE,
    OURS,
    CurveJob,
    HeadlineJob,
    read_curves,
    read_headlines,
)
from benchmarks.prevention.tables import Sizes

STORE = Path(__file__).resolve().parents[1] / "prevented"
"""One line per finished job, so an interrupted run can resume. Remove the folder to measure again."""
BUNDLED, UNSEEN = "bundled", "unseen"


def task_names(options: suite.Options) -> dict[str, list[str]]:
    """Return the chosen tasks, bundled and unseen; one of each kind in a quick run."""
    names = {BUNDLED: suite.task_names(options), UNSEEN: suite.unseen_task_names(options)}
    if options.quick:
        names = {
            key: list({suite.is_tabletop(name): name for name in all_of}.values()) for key, all_of in names.items()
        }
    return {key: suite.chosen(all_of, options.tasks) for key, all_of in names.items()}


def headline_jobs(names: Mapping[str, Sequence[str]], file: Path, job: HeadlineJob) -> list[HeadlineJob]:
    """Return the job of each task that is left to do, as `job` describes it."""
    have = {done.task for done in read_headlines(file)}
    return [replace(job, task=name) for all_of in names.values() for name in all_of if name not in have]


def curve_jobs(names: Mapping[str, Sequence[str]], heads: Path, file: Path, sizes: Sizes) -> list[CurveJob]:
    """Return the jobs of curves that are left, in tasks whose motion at w = 0 was executed."""
    grasps = {done.task: done.grasp for done in read_headlines(heads) if done.motions[NONE].harm}
    have = {(done.task, done.cost): set(done.points) for done in read_curves(file)}
    jobs = []
    for name in (name for all_of in names.values() for name in all_of if name in grasps):
        for cost in CURVES:
            wanted = sizes.weights if cost in MODELS else sizes.relative
            left = tuple(w for w in wanted if f"{w:g}" not in have.get((name, cost), ()))
            if left:
                jobs.append(CurveJob(task=name, cost=cost, weights=left, grasp=grasps[name], drops=sizes.drops))
    return jobs


def fill(file: Path, jobs: Sequence[Any], do: Callable[[Any], object], options: suite.Options, what: str) -> None:
    """Do jobs in processes and append a line for each to the file, until the time limit."""
    until = math.inf if options.seconds is None else time.monotonic() + options.seconds
    store.fill(file, jobs, do, processes=options.processes, label=what, until=until)


def kept(options: suite.Options) -> AbstractContextManager[Path]:
    """Return the folder of the lines; a quick run uses a temporary one."""
    return store.folder_of(options, STORE)


def found(names: Mapping[str, Sequence[str]], heads: Path, curves: Path | None = None) -> Found:
    """Read the finished jobs of some tasks."""
    order = [name for all_of in names.values() for name in all_of]
    done = sorted((x for x in read_headlines(heads) if x.task in order), key=lambda x: order.index(x.task))
    groups = []
    for key, all_of in names.items():
        for kind, wanted in (("", (True, False)), (", household", (False,)), (", tabletop", (True,))):
            tasks = frozenset(name for name in all_of if suite.is_tabletop(name) in wanted)
            if tasks:
                groups.append(Group(f"{key}{kind}", tasks))
        spilt = set(spilt_on_the_way(done, NONE) + spilt_on_the_way(done, OURS)) & set(all_of)
        if spilt and set(all_of) - spilt:
            groups.append(Group(f"{key}, nothing spilt on the way", frozenset(all_of) - spilt))
    lines = () if curves is None else read_curves(curves)
    return Found(done, {(x.task, x.cost): x for x in lines if x.task in order}, groups)
