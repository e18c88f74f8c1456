"""What `prevention` and `harm_curves` share: which tasks, groups of them, jobs in processes, lines that are kept."""

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
    NONE,
    OURS,
    Curve,
    Headline,
    HeadlineJob,
    read_curves,
    read_headlines,
)

STORE = Path(__file__).resolve().parents[1] / "prevented"
"""A line for each job that is done; an interrupted run goes on where it was. To measure anew, take the folder away."""
BUNDLED, UNSEEN = "bundled", "unseen"


def task_names(options: suite.Options) -> dict[str, list[str]]:
    """Return the names of the tasks that were asked for, bundled and unseen; of a quick run one of each kind."""
    names = {BUNDLED: suite.task_names(options), UNSEEN: suite.unseen_task_names(options)}
    if options.quick:
        names = {
            key: list({suite.is_tabletop(name): name for name in all_of}.values()) for key, all_of in names.items()
        }
    return {key: suite.chosen(all_of, options.tasks) for key, all_of in names.items()}


def headline_jobs(names: Mapping[str, Sequence[str]], file: Path, job: HeadlineJob) -> list[HeadlineJob]:
    """List what is left to do of one motion a model and task; `job` says what is done for each task."""
    have = {done.task for done in read_headlines(file)}
    return [replace(job, task=name) for all_of in names.values() for name in all_of if name not in have]


def fill(
    file: Path, jobs: Sequence[Any], do: Callable[[Any], Headline | Curve], options: suite.Options, what: str
) -> None:
    """Do jobs in processes and keep a line of each in the file, until the time is over that was given."""
    until = math.inf if options.seconds is None else time.monotonic() + options.seconds
    store.fill(file, jobs, do, processes=options.processes, label=what, until=until)


def kept(options: suite.Options) -> AbstractContextManager[Path]:
    """Give the folder for lines; a quick run has nothing to keep."""
    return store.folder_of(options, STORE)


def found(names: Mapping[str, Sequence[str]], heads: Path, curves: Path | None = None) -> Found:
    """Read what is done of some tasks."""
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
