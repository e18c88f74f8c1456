"""One rollout in a plain Python loop, step by step: to look at, and to check the native rollouts against."""

from __future__ import annotations

import copy
from collections.abc import Iterator

import mujoco

from failbench.recording.records import Job
from failbench.rollouts.execution import Execution
from failbench.rollouts.injection import Injection
from failbench.simulated.rest import PERIOD, let_sleep
from failbench.simulated.states import STATE


def steps(execution: Execution, job: Job, *, horizon: float = 1.0) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData]]:
    """Yield model and data after each step of the rollout that `rollout.run` would do, bit by bit the same.

    Both are changed in place by the next step. As always after mj_step, derived quantities such as contacts belong to
    the state before the step.
    """
    count = execution.steps(horizon)
    model = copy.copy(execution.world.model)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, execution.states[execution.checkpoint(job.onset)], STATE)
    injection = Injection(
        execution,
        job,
        count,
        fields={name: getattr(model, name) for name in job.fault.FIELDS},
        qpos=data.qpos,
        qvel=data.qvel,
        eq_active=data.eq_active,
    )
    for step in range(count):
        if injection.ticks is not None and step % injection.ticks == 0:
            injection.steer(step)
        if injection.next == step:
            injection.act()
        data.ctrl[:] = injection.plant.command[step]
        mujoco.mj_step(model, data)
        if (step + 1) % PERIOD == 0:
            let_sleep(execution.world, data.xpos[None], model.tree_sleep_policy[None])
        yield model, data
