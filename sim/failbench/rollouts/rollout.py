"""Many rollouts of one execution at once, in MuJoCo's native batch simulation.

Rollouts of a batch start at their own onsets and are stepped together, so that periodic faults act in the same steps.
Simulations are independent, so results do not depend on the batch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from mujoco.batch import Batch

from failbench.recording.recorder import Recorder
from failbench.recording.records import Rollout, RolloutRequest
from failbench.rollouts.execution import Execution
from failbench.rollouts.injection import Injection
from failbench.rollouts.sampling import MOST, MOST_THREADS, check_whole
from failbench.simulated.moving_entities import append_entity_states
from failbench.simulated.rest import PERIOD, let_sleep
from failbench.simulated.states import CHECKPOINT, control_spec, put, warnings_counted_only
from failbench.simulated.world import World
from graceful_plan.array_types import Array

_COUNT = 1
"""Column of a simulation's warnings that counts them."""


def run_rollouts(
    execution: Execution, jobs: Sequence[RolloutRequest], *, horizon: float = 1.0, threads: int = 1, batch: int = 32
) -> list[Rollout]:
    """Simulate one rollout for each job.

    Args:
        execution: The healthy run.
        jobs: Faults and their onsets.
        horizon: Simulated time after the onset [s].
        threads: Number of simulation threads.
        batch: Number of simulations that a thread holds at once. Neither it nor `threads` affects the results.

    Returns:
        A rollout for each job, in the order of the jobs.

    Raises:
        UnknownNameError: If a fault strikes a joint that the robot does not have.
        SettingError: If the horizon is too short or too long, or `threads` or `batch` is out of range.
    """
    steps = execution.steps(horizon)
    check_whole("threads", threads, 1, MOST_THREADS)
    check_whole("batch", batch, 1, MOST)
    for job in jobs:
        execution.world.robot.check_targets(job.fault.targets or job.fault.TARGETS, job.fault.rates)
    if not jobs:
        return []
    size = min(batch * threads, len(jobs))
    groups = [alike[first : first + size] for alike in _by_period(jobs) for first in range(0, len(alike), size)]
    simulations = Batch(execution.world.model, size, nthread=threads, persistent=True)
    fields = {
        name: simulations.expand(name) for name in {"tree_sleep_policy"}.union(*(job.fault.FIELDS for job in jobs))
    }
    rollouts: dict[int, Rollout] = {}
    with warnings_counted_only():
        for group in groups:
            done = _run_group(execution, simulations, fields, [jobs[i] for i in group], steps)
            rollouts.update(zip(group, done, strict=True))
    return [rollouts[i] for i in range(len(jobs))]


def _by_period(jobs: Sequence[RolloutRequest]) -> list[list[int]]:
    """Group jobs whose faults act in the same steps; those that act most often take longest and come first."""
    found: dict[float, list[int]] = {}
    for i in sorted(range(len(jobs)), key=lambda i: (jobs[i].fault.NAME, i)):
        period = jobs[i].fault.period
        found.setdefault(math.inf if period is None else period, []).append(i)
    return [found[period] for period in sorted(found)]


def _run_group(
    execution: Execution,
    simulations: Batch,
    fields: Mapping[str, Array],
    jobs: Sequence[RolloutRequest],
    steps: int,
) -> list[Rollout]:
    model = execution.world.model
    sims = np.arange(len(jobs))
    for name, values in fields.items():
        values[:] = getattr(model, name)
    checkpoints = [execution.checkpoint(job.onset) for job in jobs]
    put(simulations, sims, execution.states[checkpoints])
    qpos, qvel, active, xfrc = (simulations.bind(name) for name in ("qpos", "qvel", "eq_active", "xfrc_applied"))
    injections = [
        Injection(
            execution,
            job,
            steps,
            fields={name: values[i] for name, values in fields.items()},
            qpos=qpos[i],
            qvel=qvel[i],
            eq_active=active[i],
            xfrc=xfrc[i].reshape(-1, 6),
        )
        for i, job in enumerate(jobs)
    ]
    healthy = execution.healthy.kept
    kept = None if healthy is None else healthy[checkpoints]
    begins = np.stack([injection.plant.walk[:2] for injection in injections])
    seen = append_entity_states(qpos[sims, None], qvel[sims, None], begins, execution.dt)
    recorder = Recorder(execution.world, execution.baseline, seen[0][:, 0], seen[1][:, 0], kept)
    diverged = _simulate(execution.world, simulations, injections, recorder, fields["tree_sleep_policy"], steps)
    return [
        Rollout(
            job=job,
            onset=checkpoint * CHECKPOINT * execution.dt,
            status="diverged" if diverged[i] else "completed",
            state=execution.states[checkpoint].copy() if diverged[i] else None,
            # MuJoCo resets a diverged simulation, so records after that are meaningless.
            **({} if diverged[i] else recorder.finish(i)),
        )
        for i, (job, checkpoint) in enumerate(zip(jobs, checkpoints, strict=True))
    ]


def _simulate(
    world: World,
    simulations: Batch,
    injections: Sequence[Injection],
    recorder: Recorder,
    sleep_policy: Array,
    steps: int,
) -> Array:
    """Step all simulations to the end, and return which of them diverged."""
    model, count, step, spec = world.model, len(injections), 0, control_spec(world.model)
    sims, xpos = np.arange(count), simulations.bind("xpos")
    sizes = {"sensordata": model.nsensordata, "qpos": model.nq, "qvel": model.nv}
    room = {name: np.empty(count * PERIOD * size) for name, size in sizes.items()}
    tick = injections[0].ticks
    while step < steps:
        for injection in injections:
            if tick is not None and step % tick == 0:
                injection.steer(step)
            if injection.next == step:
                injection.act()
        until = min(steps, step + PERIOD - step % PERIOD, *(injection.next for injection in injections))
        if tick is not None:
            until = min(until, step + tick - step % tick)
        commands = np.stack([injection.told(step, until) for injection in injections])
        # Reused memory: page faults of fresh arrays cost more than the writes.
        shapes = {name: (count, until - step, size) for name, size in sizes.items()}
        out = {name: room[name][: math.prod(shape)].reshape(shape) for name, shape in shapes.items()}
        simulations.rollout(until - step, commands, spec, record=tuple(sizes), ids=sims, out=out)
        states = out["qpos"], out["qvel"]
        if model.nmocap:
            walk = np.stack([injection.seen(step + 1, until + 1) for injection in injections])
            states = append_entity_states(*states, walk, float(model.opt.timestep))
        recorder.observe(out["sensordata"], *states)
        step = until
        if step % PERIOD == 0:
            let_sleep(world, xpos[:count], sleep_policy[:count])
    return simulations.warning[sims, :, _COUNT].any(axis=1)
