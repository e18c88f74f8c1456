"""Work without a simulator, for tests of those who hand it out and write it down. Workers import it."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from failbench.chunks import Chunk, Rows


def chunks(count: int, size: int = 3) -> list[Chunk]:
    return [
        Chunk(index=i, motion=0, fault=i, first=0, last=size, name=f"motion / fault {i} / 0-{size - 1}")
        for i in range(count)
    ]


def rows(chunk: Chunk) -> Rows:
    numbers = range(chunk.index * 3 + chunk.first, chunk.index * 3 + chunk.last)
    return {"rollouts": [{"rollout": i, "impact": i / 7.0} for i in numbers], "contacts": [{"rollout": chunk.index}]}


@dataclass(frozen=True)
class Fake:
    """Rows after some seconds of work, except for the chunks that are said to go wrong."""

    seconds: float = 0.0
    raising: int = -1
    deadly: int = -1
    deadly_times: int = 1
    notes: Path | None = None
    """Folder in which deaths are counted."""
    exits: bool = False

    def __call__(self, chunk: Chunk) -> Rows:
        time.sleep(self.seconds)
        if chunk.index == self.raising:
            raise ArithmeticError("no such luck")
        if chunk.index == self.deadly and self._deaths() < self.deadly_times:
            (self.notes / f"death{self._deaths()}").touch()
            sys.stdout.flush()
            os._exit(7) if self.exits else os.kill(os.getpid(), signal.SIGKILL)
        return rows(chunk)

    def _deaths(self) -> int:
        return len(list(self.notes.glob("death*")))


class Stillborn:
    """Work that no worker can even receive."""

    def __reduce__(self):
        return os._exit, (9,)

    def __call__(self, chunk: Chunk) -> Rows:
        raise AssertionError
