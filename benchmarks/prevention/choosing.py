"""Candidates of one call that race in simulation, against the planner's own choice, on failures that did not choose."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.prevention.bound_record import SECONDS, SPEED, TASKS
from benchmarks.prevention.runs import SEED
from benchmarks.store import read_lines, tasks_left
from failbench import ExecutionRefused, SimSettings
from failbench.basics.statistics import cluster_bootstrap

CANDIDATES, ROUNDS, CHOICE_SECONDS = 8, 3, 120.0
FAULTS = "*/*/severe"
HELD_OUT = 380
"""Mixed failures of both motions, with other random numbers than those that choose."""
LESS = 1.1
MEASURED = f"""\
## Rollouts that choose

`plan(..., candidates={CANDIDATES})` at the default w in {SECONDS:g} s, then `choose` with {ROUNDS} rounds of mixed
failures on one thread, up to 456 of them; on a quiet core this takes about 10 s. The chosen motion and the planner's
own fail in the same {HELD_OUT} ways, which did not choose. "x less": harm per executed task of the planner's own motion
over that of the chosen one, with the 95 % interval of the paired failures; 1 if they are the same motion. Processor
time is that of `choose`.
"""


@dataclass(frozen=True, kw_only=True)
class ChoiceJob:
    """A task, and the number of failures that judge."""

    task: str
    held_out: int = HELD_OUT


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The choice in a task.

    Args:
        task: "scene/task".
        candidates: Number of candidates that raced.
        best: Index of the chosen one; 0 is the planner's own.
        sure: Whether `choose` was sure.
        failures: Simulated failures that chose.
        seconds: Processor time of the choice [s].
        less: Ratio of harm per executed task, with its interval.
        longer: Ratio of the durations.
        refused: Reason why the planner's own motion cannot be executed; otherwise "".
    """

    task: str
    candidates: int = 0
    best: int = 0
    sure: bool = False
    failures: int = 0
    seconds: float = 0.0
    less: Sequence[float] = (1.0, 1.0, 1.0)
    longer: float = 1.0
    refused: str = ""


def do_choice(job: ChoiceJob) -> Choice:
    """Plan, choose, and judge the choice."""
    task = suite.task(job.task)
    gp.prepare(task.scene)
    result = gp.plan(
        task.start, task.goal, task.scene, time_limit=SECONDS, seed=SEED, speed=SPEED, candidates=CANDIDATES
    )
    settings, refused = None, ""
    for grasp in ("fingers", "weld"):
        settings, refused = SimSettings(grasp=grasp), ""
        try:
            fb.execute(result, fb.build_world(task.scene, settings))
            break
        except (ExecutionRefused, gp.PlanningFailed) as error:
            refused = str(error)
    if refused:
        return Choice(task=job.task, refused=refused)
    began = time.process_time()
    found = fb.choose(
        result, task.scene, FAULTS, seconds=CHOICE_SECONDS, rounds=ROUNDS, threads=1, seed=SEED + 3, settings=settings
    )
    took = time.process_time() - began
    motions = (result.candidates[0], result.candidates[found.best])
    own, chosen = (
        fb.validate(motion, task.scene, FAULTS, n=job.held_out, seed=SEED + 4, threads=1, settings=settings)
        for motion in motions
    )
    less = fb.harm_ratio(own, chosen)
    return Choice(
        task=job.task,
        candidates=len(result.candidates) - len(found.refused),
        best=found.best,
        sure=found.sure,
        failures=sum(found.n),
        seconds=took,
        less=(less.mean, less.low, less.high) if found.best else (1.0, 1.0, 1.0),
        longer=chosen.duration / own.duration,
    )


def choice_jobs(file: Path, options: suite.Options) -> list[ChoiceJob]:
    """Return the jobs that are left."""
    return [
        ChoiceJob(task=name, held_out=options.pick(HELD_OUT, quick=19)) for name in tasks_left(file, TASKS, options)
    ]


def read_choices(file: Path) -> list[Choice]:
    """Return the finished tasks."""
    return [Choice(**line) for line in read_lines(file)]


def choice_section(found: Sequence[Choice]) -> Iterator[str]:
    """Yield the section of the choices."""
    yield MEASURED
    done = [one for one in found if not one.refused]
    if not done:
        yield "No task is finished yet.\n"
        return
    gains = np.array([one.less[0] for one in done])
    geometric = cluster_bootstrap(np.log(gains), np.arange(len(gains)), np.mean)
    worse = [one.task for one in done if one.less[2] < 1.0]
    yield report.targets(
        [
            report.Target(
                what="choose: x less harm per task than the planner's own motion, median",
                wanted=f">= {LESS:g}",
                measured=f"{np.median(gains):.3g}",
                met=bool(np.median(gains) >= LESS),
            ),
            report.none_of("choose: tasks with more harm beyond their interval", len(worse), "none"),
        ]
    )
    low, mean, high = np.exp([geometric.low, geometric.mean, geometric.high])
    yield (
        f"{len(done)} of {len(TASKS)} tasks; geometric mean {mean:.2f} [{low:.2f}, {high:.2f}]; processor time of a"
        f" choice: {np.median([one.seconds for one in done]):.1f} s in the median.\n"
    )
    header = ("task", "candidates", "failures", "chosen", "sure", "x less", "95 %", "duration", "processor time")
    yield report.table(header, [_row(one) for one in found])


def _row(one: Choice) -> Sequence[object]:
    if one.refused:
        return one.task, one.refused, *[""] * 7
    ratio, low, high = one.less
    interval = f"{low:.2f} to {high:.2f}" if one.best else ""
    chosen = f"candidate {one.best}" if one.best else "the planner's"
    longer = f"{100.0 * (one.longer - 1.0):+.0f} %"
    sure = "yes" if one.sure else ""
    return (
        one.task,
        one.candidates,
        one.failures,
        chosen,
        sure,
        f"{ratio:.2f}",
        interval,
        longer,
        f"{one.seconds:.1f} s",
    )
