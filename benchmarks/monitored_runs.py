"""Episodes of one condition on one unseen task: with the default motion or the fastest, with a monitor or without."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import graceful_plan as gp
from benchmarks import suite
from failbench.policies import (
    OpenLoop,
    PolicyFactory,
    PolicyRollout,
    PolicySettings,
    PolicyTask,
    SensorErrors,
    StopOnFailure,
    Watch,
    evaluate,
    healthy_records,
    monitored,
    planned,
    policy_task,
    roll_out,
    varied_task,
)

PERIOD, SEED = 0.01, 4100
SENSORS = SensorErrors()
RATE = 1.0
"""Allowed false alarms [1/h]."""
HEALTHY = ("tabletop", "tabletop_l1", "tabletop_l3", "desk", "dining_table", "kitchen_counter")
"""Bundled scenes of the healthy runs from which the limits come."""
ROBOTS = 3
"""Robots with other masses and frictions for each task of these scenes."""
MORE_ROBOTS = 4
"""Further healthy robots of each task, for the rate of false alarms."""
ITERATIONS = (300, 3000)
"""Iterations of the planner, and of a second try for tasks that are not solved in these."""
CONDITIONS: Mapping[str, tuple[float | None, bool]] = {
    "w = 0": (0.0, False),
    "w = 0, monitor": (0.0, True),
    "plan": (None, False),
    "plan, monitor": (None, True),
}
"""Safety weight (None: default) and whether a monitor watches."""


@dataclass(frozen=True, kw_only=True)
class MonitorJob:
    """Episodes of one condition on one task with one robot; faults of one degree."""

    task: str
    condition: str
    robot: int
    degree: str = "severe"


@dataclass(frozen=True, kw_only=True)
class Episodes:
    """Result of a job: harm, time to the notice (NaN: none) and kind by fault; healthy harm, and false alarms.

    Without a motion, the mappings are empty.
    """

    task: str
    condition: str
    robot: int
    harm: Mapping[str, float]
    delay: Mapping[str, float]
    kind: Mapping[str, str]
    healthy: float
    stopped: Sequence[bool]
    duration: float
    seconds: float
    degree: str = "severe"


@cache
def watch() -> Watch:
    """Return a monitor's limits from healthy runs, once per process."""
    records: list[gp.MonitorRecord] = []
    for scene in HEALTHY:
        for name in list(gp.load_scene(scene).tasks)[:2]:
            task = policy_task(f"{scene}/{name}", PolicySettings(noise=0.0, period=PERIOD))
            for robot in range(ROBOTS):
                policy = planned(0.0 if robot == 0 else None, iterations=100)
                records += healthy_records(varied_task(task, robot), policy, [robot], sensors=SENSORS)
    return Watch(limits=gp.MonitorLimits.fit(records, false_alarms=RATE), sensors=SENSORS)


def prepared(task: str, robot: int) -> PolicyTask:
    """Return a task of `unseen/` with a robot that differs from its model."""
    scene, _, name = task.partition("/")
    path = f"{suite.UNSEEN / scene}.yaml/{name}"
    limit = 1.3 * policy_task(path).straight.duration + 1.0
    settings = PolicySettings(noise=0.0, period=PERIOD, limit=limit, horizon=limit)
    return varied_task(policy_task(path, settings), robot)


def do(job: MonitorJob) -> Episodes:
    """Do one job."""
    began = time.process_time()
    w, monitor = CONDITIONS[job.condition]
    task = prepared(job.task, SEED + job.robot)
    motion = _motion(task, w)
    if motion is None:
        return Episodes(
            task=job.task,
            condition=job.condition,
            robot=job.robot,
            harm={},
            delay={},
            kind={},
            healthy=math.nan,
            stopped=[],
            duration=math.nan,
            seconds=time.process_time() - began,
            degree=job.degree,
        )

    def policy(task: PolicyTask, seed: int) -> OpenLoop:
        return OpenLoop(motion, task.settings.period)

    found = evaluate(
        task,
        policy,
        f"*/*/{job.degree}",
        n=1,
        seed=SEED + job.robot,
        recovery=StopOnFailure() if monitor else None,
        watch=watch() if monitor else None,
        threads=1,
    )
    rows = {name: rollouts[0] for name, rollouts in found.rollouts.items()}
    healthy = found.healthy_rollouts[0]
    return Episodes(
        task=job.task,
        condition=job.condition,
        robot=job.robot,
        harm={name: row.harm(task.scene) for name, row in rows.items()},
        delay={name: _delay(row) for name, row in rows.items()},
        kind={name: "" if row.notice is None else row.notice.kind for name, row in rows.items()},
        healthy=healthy.harm(task.scene),
        stopped=[healthy.notice is not None, *_false_alarms(job, policy)] if monitor else [],
        duration=motion.duration,
        seconds=time.process_time() - began,
        degree=job.degree,
    )


def _motion(task: PolicyTask, w: float | None) -> gp.Trajectory | None:
    """Return the motion of the planner; None if it finds none."""
    for iterations in ITERATIONS:
        try:
            policy = planned(w, iterations=iterations)(task, 0)
        except gp.PlanningFailed:
            continue
        assert isinstance(policy, OpenLoop)
        return policy.motion
    return None


def _false_alarms(job: MonitorJob, policy: PolicyFactory) -> Iterator[bool]:
    """Yield whether a monitor stops further healthy robots; they are counted once, with severe faults."""
    if job.degree != "severe":
        return
    for robot in range(1, MORE_ROBOTS + 1):
        task = prepared(job.task, SEED + 1000 * robot + job.robot)
        seen = roll_out(task, monitored(policy, StopOnFailure(), watch()), [SEED + 1000 * robot + job.robot])
        yield seen[0].notice is not None


def _delay(row: PolicyRollout) -> float:
    """Return the time from the onset until the monitor noticed something, with the delay of its sensors [s]."""
    if row.notice is None or row.onset is None:
        return math.nan
    return row.notice.time + SENSORS.delay - row.onset
