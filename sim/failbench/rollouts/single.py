"""One rollout in a plain Python loop, step by step: to look at, and to check the native rollouts against."""

from __future__ import annotations

import copy

import mujoco

from failbench.recording.records import Job
from failbench.rollouts.execution import Execution
from failbench.rollouts.injection import Injection
from failbench.simulated.rest import PERIOD, let_sleep
from failbench.simulated.states import STATE
from failbench.simulated.walkers import put_walkers


class Steps:
    """A rollout that is under way: an iterator of model and data after each step. Made by `steps`.

    Both are changed in place by the next step. As always after mj_step, derived quantities such as contacts belong to
    the state before the step.
    """

    def __init__(self, execution: Execution, job: Job, count: int) -> None:
        self._world = execution.world
        self._model, self._count, self._step = copy.copy(execution.world.model), count, 0
        self._data = mujoco.MjData(self._model)
        mujoco.mj_setState(self._model, self._data, execution.states[execution.checkpoint(job.onset)], STATE)
        self._injection = Injection(
            execution,
            job,
            count,
            fields={name: getattr(self._model, name) for name in job.fault.FIELDS},
            qpos=self._data.qpos,
            qvel=self._data.qvel,
            eq_active=self._data.eq_active,
            xfrc=self._data.xfrc_applied,
        )

    def __iter__(self) -> Steps:
        """Return itself."""
        return self

    def __next__(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Do a step."""
        if self._step == self._count:
            raise StopIteration
        model, data, injection = self._model, self._data, self._injection
        if injection.ticks is not None and self._step % injection.ticks == 0:
            injection.steer(self._step)
        if injection.next == self._step:
            injection.act()
        data.ctrl[:] = injection.plant.command[self._step]
        put_walkers(model, data, injection.plant.walk[self._step])
        mujoco.mj_step(model, data)
        self._step += 1
        if self._step % PERIOD == 0:
            let_sleep(self._world, data.xpos[None], model.tree_sleep_policy[None])
        return model, data

    def state(self) -> mujoco.MjData:
        """Return a copy of everything as it is now."""
        return copy.copy(self._data)

    def restore(self) -> None:
        """Repair what is broken, from the next step on, as at the end of a fault's duration.

        Model and commands are as in a healthy robot then, to the last bit. What the robot lost is still lost, and the
        motion has gone on meanwhile. After the fault's duration this changes nothing.
        """
        self._injection.restore(self._step)


def steps(execution: Execution, job: Job, *, horizon: float = 1.0) -> Steps:
    """Return the rollout that `rollout.run` would do, bit by bit the same, to be done step by step."""
    return Steps(execution, job, execution.steps(horizon))
