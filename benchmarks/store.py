"""Finished jobs of a long benchmark, one line of JSON each, so that an interrupted run can resume."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks import suite


def tasks_left(file: Path, tasks: Sequence[str], options: suite.Options) -> list[str]:
    """Return the chosen tasks without a line in a file; only the first task in a quick run."""
    have = {line["task"] for line in read_lines(file)}
    chosen = suite.chosen(tasks[:1] if options.quick else tasks, options.tasks)
    return [name for name in chosen if name not in have]


def read_lines(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the documents of a file; nothing if it does not exist, and no incomplete last line."""
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True) if file.exists() else []
    yield from (json.loads(line) for line in lines if line.endswith("\n"))


def line(done: Any) -> str:
    """Return the line of a dataclass."""
    return json.dumps(asdict(done), default=dict) + "\n"


def fill(
    file: Path, jobs: Sequence[Any], do: Callable[[Any], Any], *, processes: int, label: str, until: float
) -> None:
    """Do jobs in processes and append a line for each to the file.

    Args:
        file: The file; its folder is created if necessary.
        jobs: Jobs to do.
        do: Does one job and returns a dataclass of JSON types.
        processes: Number of processes.
        label: Name of the work, for progress messages.
        until: Deadline on the monotonic clock [s]; the run ends with the first job that finishes later.
    """
    if time.monotonic() >= until:
        return
    file.parent.mkdir(exist_ok=True)
    with file.open("a", encoding="utf-8") as out:
        for done in suite.spread(do, jobs, processes, label):
            out.write(line(done))
            out.flush()
            if time.monotonic() > until:
                break


@contextmanager
def folder_of(options: suite.Options, store: Path) -> Generator[Path]:
    """Return the folder of the lines; a quick run uses a temporary one."""
    if options.quick:
        with tempfile.TemporaryDirectory() as scratch:
            yield Path(scratch)
    else:
        yield store
