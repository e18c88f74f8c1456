"""What is done of a long benchmark, a line of JSON each, so that an interrupted run goes on where it was."""

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


def read_lines(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the documents of a file, if there is one; a last line that was cut off does not count."""
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True) if file.exists() else []
    yield from (json.loads(line) for line in lines if line.endswith("\n"))


def line(done: Any) -> str:
    """Return a line for a dataclass."""
    return json.dumps(asdict(done), default=dict) + "\n"


def fill(
    file: Path, jobs: Sequence[Any], do: Callable[[Any], Any], *, processes: int, label: str, until: float
) -> None:
    """Do jobs in processes and add a line for each to the file.

    Args:
        file: Where; its folder is made if need be.
        jobs: What is left to do.
        do: Does one; what it returns is a dataclass, of what JSON knows.
        processes: How many.
        label: What is done, for people.
        until: On the monotonic clock: nothing begins after it, and what is done then ends the run [s].
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
    """Give the folder for lines; a quick run has nothing to keep."""
    if options.quick:
        with tempfile.TemporaryDirectory() as scratch:
            yield Path(scratch)
    else:
        yield store
