"""Default motions of all bundled tasks, executed by a healthy robot that holds the object with its fingers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import failbench as fb
import graceful_plan as gp
from benchmarks import suite
from failbench import ExecutionRefused, ObjectLost

SECONDS = 0.5
"""Time limit of a plan [s]."""
SEEDS, LONG_SEEDS = 4, 20


@dataclass(frozen=True, kw_only=True)
class HeldJob:
    """A task "scene/task" and a seed of the motion to plan at the default weight and execute."""

    task: str
    seed: int


@dataclass(frozen=True, kw_only=True)
class Held:
    """Result for a motion.

    Args:
        job: The job.
        status: Of the plan.
        duration: [s]; NaN where there is no motion.
        slip: Largest displacement of the object in the gripper [m]; NaN if the motion was not executed.
        lost: Message if the object was lost; otherwise "".
        refused: Message if the robot could not follow; otherwise "".
        harm: Total harm of the healthy motion.
        harm_text: The harm in words.
    """

    job: HeldJob
    status: str
    duration: float = float("nan")
    slip: float = float("nan")
    lost: str = ""
    refused: str = ""
    harm: float = 0.0
    harm_text: str = ""


def jobs(options: suite.Options) -> list[HeldJob]:
    """List every motion, seed by seed."""
    names = suite.chosen(list(suite.task_names()), options.tasks)
    return [
        HeldJob(task=name, seed=seed)
        for seed, name in product(
            range(options.pick(SEEDS, quick=1, long=LONG_SEEDS)), options.pick(names, quick=names[:1])
        )
    ]


def examine(job: HeldJob) -> Held:
    """Plan, and carry it out at full speed."""
    task = suite.task(job.task)
    result = gp.plan(task.start, task.goal, task.scene, seed=job.seed, time_limit=SECONDS)
    if result.trajectory is None:
        return Held(job=job, status=result.status.name)
    duration = result.trajectory.duration
    try:
        done = fb.execute(result, fb.build_world(task.scene))
    except ObjectLost as error:
        return Held(job=job, status=result.status.name, duration=duration, lost=str(error), harm=error.healthy.harm)
    except ExecutionRefused as error:
        return Held(job=job, status=result.status.name, duration=duration, refused=str(error))
    return Held(
        job=job,
        status=result.status.name,
        duration=duration,
        slip=done.slip,
        harm=done.healthy.harm,
        harm_text=str(done.healthy),
    )
