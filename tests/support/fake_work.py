"""Work without a simulator, for tests of executors and journals. Workers import it."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from failbench.basics.chunks import Chunk, Rows


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
    """Rows after some seconds of work, except for chunks that are set to fail."""

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
    """Work that cannot be sent to a worker."""

    def __reduce__(self):
        return os._exit, (9,)

    def __call__(self, chunk: Chunk) -> Rows:
        raise AssertionError


def rollout_row(number: int) -> dict:
    """Return a row with every column of the table of rollouts."""
    return {
        "rollout": number,
        "motion": "tabletop/lift_to_goal",
        "scene": "tabletop",
        "task": "lift_to_goal" if number % 2 else None,
        "fault": "gripper_failure",
        "category": "end_effector",
        "degree": "severe",
        "fault_settings": '{"fault": "gripper_failure"}',
        "onset": number / 7.0,
        "duration": 3.0,
        "seed": 2**53 - 1 - number,
        "weight": 1.0,
        "status": "diverged" if number == 3 else "completed",
        "healthy_harm": 0.2,
        "healthy_spilled": 0.3,
        "observed_impact": 0.1 * number,
        "whole_impact": 0.1 * number + 0.2,
        "own_loss": 0.05 * number,
        "energy_impact": 0.01 * number,
        "secondary_impact": None if number == 3 else 0.0,
        "contacts": 1,
        "dropped": True,
        "spilled": 0.25,
        "fell": ["vase", "cup"][: number % 3],
        "tipped": [],
        "left_support": ["vase"],
        "poses": [{"name": "vase", "wxyz_xyz": [1.0, 0.0, 0.0, 0.0, 0.1 * number, 0.2, 0.3]}],
        "state": [0.1, 0.2] if number == 3 else None,
    }


def contact_row(number: int) -> dict:
    """Return a row with every column of the table of contacts."""
    numbers = dict.fromkeys(("time", "x", "y", "z", "peak_force", "impulse", "speed", "energy"), 0.5 * number)
    return {"rollout": number, "striker": "carried", "entity": "vase", "secondary": False, **numbers}


def full_rows(first: int, last: int) -> Rows:
    numbers = range(first, last)
    return {"rollouts": [rollout_row(i) for i in numbers], "contacts": [contact_row(i) for i in numbers]}
