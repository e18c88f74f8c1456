"""Failures that the robot notices: `FaultPrior(noticed_after=...)` against episodes in which it stops."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.prevention.bound_record import SECONDS, SPEED
from benchmarks.prevention.runs import SEED
from benchmarks.store import read_lines, tasks_left
from failbench.basics.statistics import cluster_bootstrap
from failbench.policies import OpenLoop, PolicySettings, StopOnFailure, evaluate, policy_task
from failbench.validation import predicted_impact

AFTER = 0.1
"""Time after which the robot notices the failure and brakes [s]."""
TASKS = ("bedside/bring_pills", "workbench/move_parts", "desk/bring_coffee", "tabletop_l3/corner_to_blue")
ARM = (
    "power_loss",
    "complete_shutdown",
    "loose_joint",
    "stuck_position",
    "partial_degradation",
    "dropout",
    "noise",
    "battery_degradation",
)
GRIPPER = ("gripper_failure",)
EPISODES, MOMENTS = 12, 40
PERIOD = 0.01
MEASURED = f"""\
## Failures that are noticed

`FaultPrior(noticed_after={AFTER:g})` against FailBench, along the fastest motions (w = 0), which do the most harm. The
robot follows the motion; {AFTER:g} s after the onset of a severe fault, all joints brake with their acceleration limit,
and the brakes close (`StopOnFailure()`). {EPISODES} episodes of each fault and task with the stop and without.
Predicted: the mean over {MOMENTS} onsets for a prior with this fault alone.
"""


@dataclass(frozen=True, kw_only=True)
class NoticedJob:
    """A task, and the number of episodes of each fault."""

    task: str
    episodes: int = EPISODES


@dataclass(frozen=True, kw_only=True)
class Noticed:
    """Harm per failure in a task, by fault: without the stop and with it."""

    task: str
    observed: Mapping[str, Sequence[float]]
    predicted: Mapping[str, Sequence[float]]


def do_noticed(job: NoticedJob) -> Noticed:
    """Let a task fail with each fault, with a stop and without, and predict both."""
    task = suite.task(job.task)
    motion = gp.plan(task.start, task.goal, task.scene, w=0.0, time_limit=SECONDS, seed=SEED, speed=SPEED).unwrap()
    horizon = motion.duration + 1.0
    settings = PolicySettings(noise=0.0, period=PERIOD, limit=horizon, horizon=1.0)
    path = job.task if job.task.split("/")[0] in gp.scenes() else str(suite.UNSEEN / job.task.replace("/", ".yaml/"))
    episodes = policy_task(path, settings)
    faults = [*ARM, *GRIPPER]
    observed: dict[str, list[float]] = {fault: [] for fault in faults}
    predicted: dict[str, list[float]] = {fault: [] for fault in faults}
    times = motion.duration * (np.arange(MOMENTS) + 0.5) / MOMENTS
    for after in (None, AFTER):
        found = evaluate(
            episodes,
            lambda task, seed: OpenLoop(motion, task.settings.period),
            [f"*/{fault}/severe" for fault in faults],
            n=job.episodes,
            seed=SEED,
            recovery=None if after is None else StopOnFailure(),
            delay=AFTER,
            threads=1,
        )
        for name, rollouts in found.rollouts.items():
            harms = [rollout.harm(episodes.scene) for rollout in rollouts]
            observed[name.split("/")[0]].append(float(np.nanmean(harms)))
        for fault in faults:
            prior = gp.FaultPrior({fault: 1.0}, noticed_after=after)
            cost = gp.ImpactCost(model=gp.FailureMixture(faults=prior))
            predicted[fault].append(float(predicted_impact(motion, task.scene, times, cost).sum(axis=1).mean()))
    return Noticed(task=job.task, observed=observed, predicted=predicted)


def noticed_jobs(file: Path, options: suite.Options) -> list[NoticedJob]:
    """Return the jobs that are left."""
    return [
        NoticedJob(task=name, episodes=options.pick(EPISODES, quick=1)) for name in tasks_left(file, TASKS, options)
    ]


def read_noticed(file: Path) -> list[Noticed]:
    """Return the finished tasks."""
    return [Noticed(**line) for line in read_lines(file)]


def noticed_section(found: Sequence[Noticed]) -> Iterator[str]:
    """Yield the section about noticed failures."""
    yield MEASURED
    if not found:
        yield "No task is finished yet.\n"
        return
    header = (
        "faults",
        "observed, no stop",
        "predicted",
        "observed, stop",
        "predicted, noticed",
        "predicted / observed",
    )
    rows = [_row(name, faults, found) for name, faults in (("arm", ARM), ("gripper", GRIPPER))]
    yield report.table(header, [*rows, *(_row(fault, (fault,), found) for fault in ARM)])
    yield f"Faults of the arm, task by task, {len(found)} of {len(TASKS)} tasks:\n"
    yield report.table(header, [_row(one.task, ARM, [one]) for one in found])


def _row(name: str, faults: Sequence[str], found: Sequence[Noticed]) -> Sequence[object]:
    both = np.array(
        [[(one.observed[fault], one.predicted[fault]) for fault in faults] for one in found]
    )  # task, fault, kind, stop
    per_task = both.mean(axis=1)
    (plain, stopped), (plain_predicted, noticed) = per_task.mean(axis=0)

    def ratio(rows: np.ndarray) -> float:
        return float(rows[:, 1, 1].sum() / max(rows[:, 0, 1].sum(), 1e-9))

    shown = cluster_bootstrap(per_task, np.arange(len(found)), ratio)
    told = f"{shown}" if len(found) > 1 and stopped > 0.0 else f"{noticed / stopped:.2f}" if stopped > 0.0 else "-"
    return name, f"{plain:.2f}", f"{plain_predicted:.2f}", f"{stopped:.2f}", f"{noticed:.2f}", told
