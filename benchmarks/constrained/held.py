"""Motions of all bundled tasks as they are planned by default, carried out by a healthy robot with its fingers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import failbench as fb
import graceful_plan as gp
from benchmarks import suite
from failbench import ExecutionRefused, ObjectLost

SECONDS = 0.5
"""Time limit of a plan [s]."""
SEEDS = 20


@dataclass(frozen=True, kw_only=True)
class HeldJob:
    """A motion to plan, at the default weight, and to carry out: of a task "scene/task" with a seed."""

    task: str
    seed: int


@dataclass(frozen=True, kw_only=True)
class Held:
    """What came of a motion.

    Args:
        job: What was asked for.
        status: Of the plan.
        duration: [s]; NaN where there is no motion.
        slip: How far the object moved in the gripper at most [m]; NaN where nothing was carried out.
        lost: What was said if the object was lost; "" else.
        refused: What was said if the robot could not follow; "" else.
        harm: What the healthy robot does harm to, added up.
        told: The same in words.
    """

    job: HeldJob
    status: str
    duration: float = float("nan")
    slip: float = float("nan")
    lost: str = ""
    refused: str = ""
    harm: float = 0.0
    told: str = ""


def jobs(options: suite.Options) -> list[HeldJob]:
    """List every motion, seed by seed."""
    names = suite.chosen(list(suite.task_names()), options.tasks)
    return [
        HeldJob(task=name, seed=seed)
        for seed, name in product(range(options.pick(SEEDS, quick=1)), options.pick(names, quick=names[:1]))
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
        told=str(done.healthy),
    )
