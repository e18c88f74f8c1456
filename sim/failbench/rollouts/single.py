"""One rollout in a plain Python loop, for inspection and as a reference for the native rollouts."""

from __future__ import annotations

import copy

import mujoco

from failbench.recording.records import RolloutRequest
from failbench.rollouts.execution import Execution
from failbench.rollouts.injection import Injection
from failbench.simulated.moving_entities import set_entity_poses
from failbench.simulated.rest import PERIOD, let_sleep
from failbench.simulated.states import STATE


class Steps:
    """A rollout in progress: an iterator over model and data after each step. Made by `steps`.

    The next step changes both in place. As always after mj_step, derived quantities such as contacts belong to the
    state before the step.
    """

    def __init__(self, execution: Execution, job: RolloutRequest, count: int) -> None:
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
        """Simulate a step."""
        if self._step == self._count:
            raise StopIteration
        model, data, injection = self._model, self._data, self._injection
        if injection.ticks is not None and self._step % injection.ticks == 0:
            injection.steer(self._step)
        if injection.next == self._step:
            injection.act()
        data.ctrl[:] = injection.plant.command[self._step]
        set_entity_poses(model, data, injection.plant.walk[self._step])
        mujoco.mj_step(model, data)
        self._step += 1
        if self._step % PERIOD == 0:
            let_sleep(self._world, data.xpos[None], model.tree_sleep_policy[None])
        return model, data

    def state(self) -> mujoco.MjData:
        """Return a copy of the current data."""
        return copy.copy(self._data)

    def restore(self) -> None:
        """Repair the fault from the next step on, as at the end of its duration.

        Model and commands become exactly those of a healthy robot. Lost objects stay lost, and the motion has continued
        in the meantime. After the fault's duration the call has no effect.
        """
        self._injection.restore(self._step)


def rollout_steps(execution: Execution, job: RolloutRequest, *, horizon: float = 1.0) -> Steps:
    """Return the rollout that `rollout.run` would simulate, bit-identical, as an iterator over its steps."""
    return Steps(execution, job, execution.steps(horizon))
