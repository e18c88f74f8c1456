"""Does memory grow, and does any simulation blow up, over ten thousand rollouts?"""

from __future__ import annotations

import gc
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

import failbench
from benchmarks import report, suite
from benchmarks.subjects.failbench_speed import prepared
from failbench.fault.registry import DEGREES, faults
from failbench.rollouts.sampling import make_jobs
from graceful_plan.compare.runs.machine import resident_megabytes

TITLE = "FailBench: ten thousand rollouts"
MEASURED = """\
Scene `tabletop`, task `lift_to_goal`, all 19 faults at all four degrees, at times spread over the motion, one second
simulated after each, two threads, in one process; rollouts are looked at and thrown away. "Memory": what the process
holds after each call of `failbench.run_rollouts`, above what it held after the first calls, whose rollouts count as warm-up.
"Not finite": rollouts that are said to be complete but hold a number that is NaN or infinite. "Diverged": rollouts that
MuJoCo warned about; they have to be recorded, with their state, not dropped.
"""
GROWTH_BELOW = 20.0
"""[MB]"""
_CALL = 152
"""Rollouts in a call: two of every fault at every degree."""
ROLLOUTS = 10_000
_WARM_UP = 4
"""Calls before memory is looked at."""


@dataclass(kw_only=True)
class Census:
    """What came of all rollouts."""

    asked: int = 0
    returned: int = 0
    not_finite: int = 0
    diverged: Counter[str] = field(default_factory=Counter)
    without_state: int = 0
    """Diverged rollouts that cannot be replayed."""
    events: int = 0

    def add(self, asked: int, rollouts: Sequence[failbench.Rollout]) -> None:
        """Look at the rollouts of one call."""
        self.asked += asked
        self.returned += len(rollouts)
        for rollout in rollouts:
            self.events += len(rollout.events)
            if rollout.status == "diverged":
                self.diverged[rollout.job.fault.NAME] += 1
                self.without_state += rollout.state is None
            elif not finite(rollout):
                self.not_finite += 1


def finite(rollout: failbench.Rollout) -> bool:
    """Tell whether every number of a rollout is finite."""
    of_events = [(e.time, *e.position, e.peak_force, e.impulse, e.speed, e.energy) for e in rollout.events]
    numbers = [np.array(rollout.spilled), np.array(of_events), *rollout.poses.values()]
    return all(bool(np.isfinite(array).all()) for array in numbers)


def run(options: suite.Options) -> str:
    """Do all rollouts and judge them."""
    rollouts = options.pick(ROLLOUTS, quick=_CALL)
    execution = prepared()
    kinds = [fault(degree=degree) for fault in faults().values() for degree in DEGREES]
    census, memory, started = Census(), [], time.perf_counter()
    while census.asked < rollouts:
        count = min(_CALL, -(-(rollouts - census.asked) // len(kinds)) * len(kinds))
        jobs = make_jobs(kinds, execution.duration, n=count, seed=len(memory))
        census.add(len(jobs), failbench.run_rollouts(execution, jobs, threads=2))
        gc.collect()
        memory.append(resident_megabytes())
    seconds = time.perf_counter() - started
    told = f"{census.returned} rollouts with {census.events} contact events in {seconds:.0f} s."
    return f"{MEASURED}\n{told}\n\n{report.targets(_targets(census, memory))}"


def _targets(census: Census, memory: Sequence[float]) -> Iterator[report.Target]:
    yield report.Target(
        what="rollouts returned of those asked for",
        wanted=f"all, >= {ROLLOUTS}",
        measured=f"{census.returned} of {census.asked}",
        met=census.returned == census.asked >= ROLLOUTS,
    )
    warm = min(_WARM_UP, len(memory)) - 1
    growth, most = memory[-1] - memory[warm], max(memory[warm:]) - memory[warm]
    yield report.Target(
        what=f"memory growth after the first {(warm + 1) * _CALL}",
        wanted=f"< {GROWTH_BELOW:g} MB",
        measured=f"{growth:.1f} MB, at most {most:.1f} MB, of {memory[-1]:.0f} MB",
        met=most < GROWTH_BELOW if len(memory) > _WARM_UP else None,
    )
    yield report.Target(
        what="complete rollouts that are not finite",
        wanted="0",
        measured=str(census.not_finite),
        met=census.not_finite == 0,
    )
    which = ", ".join(f"{name} {count}" for name, count in census.diverged.most_common())
    yield report.Target(
        what="diverged rollouts without their state",
        wanted="0",
        measured=f"{census.without_state} of {census.diverged.total()} diverged" + (f" ({which})" if which else ""),
        met=census.without_state == 0,
    )
