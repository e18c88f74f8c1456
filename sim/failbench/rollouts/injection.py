"""When a fault acts during a rollout, and how the robot is as before in between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np

from failbench.recording.records import Job
from failbench.simulated.plant import Plant
from failbench.simulated.states import CHECKPOINT
from failbench.simulated.world import World

Array = np.ndarray

_RAMP_STEPS = 5
"""Steps between two levels of a ramp."""


@runtime_checkable
class Commanded(Protocol):
    """What a healthy controller sends: an `Execution`, or a policy of which nobody knows yet what it will send."""

    @property
    def world(self) -> World:
        """Where."""
        ...

    @property
    def dt(self) -> float:
        """Time step [s]."""
        ...

    @property
    def command(self) -> Array:
        """Commands from the beginning on, [step, actuator]."""
        ...

    def checkpoint(self, onset: float) -> int:
        """Return the checkpoint nearest to a time [s]."""
        ...

    def commands(self, step: int, count: int) -> Array:
        """Return commands of `count` steps from a step on; if they change later, `Injection.renew` has to be called."""
        ...

    def paced(self, time: Array, pace: Array, change: Array) -> Array:
        """Return what is sent to the joints where the motion goes on at another pace."""
        ...


class Injection:
    """One fault in one simulation.

    Args:
        execution: What a healthy robot is told.
        job: The fault and its onset.
        steps: How many steps are going to be simulated after the onset.
        fields: Live arrays of this simulation's model fields.
        qpos: Live positions.
        qvel: Live velocities.
        eq_active: Live state of the equality constraints.
    """

    def __init__(
        self,
        execution: Commanded,
        job: Job,
        steps: int,
        *,
        fields: Mapping[str, Array],
        qpos: Array,
        qvel: Array,
        eq_active: Array,
    ) -> None:
        fault, robot = job.fault, execution.world.robot
        self.job = job
        self.checkpoint = execution.checkpoint(job.onset)
        onset = self.checkpoint * CHECKPOINT
        rng = np.random.default_rng(job.seed)
        joints, gripper = robot.struck(fault.targets or fault.TARGETS, rng)
        healthy = execution.commands(onset, steps)
        past = execution.command[:onset]
        healthy.flags.writeable = False
        self.plant = Plant(
            robot=robot,
            joints=joints,
            gripper=gripper,
            dt=execution.dt,
            rng=rng,
            qpos=qpos,
            qvel=qvel,
            eq_active=eq_active,
            command=healthy.copy(),
            healthy=healthy,
            past=past,
            paced=lambda time, pace, change: execution.paced(onset * execution.dt + time, pace, change),
            fields={name: fields[name] for name in fault.FIELDS},
        )
        self._model = execution.world.model
        self._end = steps if fault.duration is None else max(1, round(fault.duration / execution.dt))
        self._level: float | None = None
        self.next = 0
        """The step before which the fault acts next."""

    def act(self) -> None:
        """Let the fault act, or end it, before step `next`."""
        fault, plant = self.job.fault, self.plant
        plant.step = self.next
        self._restore()
        if self.next >= self._end:
            self.next, self._level = NEVER, None
            return
        ramp = round(fault.ramp / plant.dt)
        level = 1.0 if ramp == 0 else min(1.0, (self.next + _RAMP_STEPS) / ramp)
        self._level = level
        fault.apply(plant, level)
        if level < 1.0:
            wait = _RAMP_STEPS
        elif fault.PERIOD is not None:
            wait = max(1, round(fault.PERIOD / plant.dt))
        else:
            wait = NEVER
        self.next = min(self.next + wait, self._end)

    def renew(self) -> None:
        """Let the fault do once more what it did last: the commands that it does it to have changed."""
        self._restore()
        if self._level is not None:
            self.job.fault.apply(self.plant, self._level)

    @property
    def acting(self) -> bool:
        """Whether the fault has begun and is not over."""
        return self._level is not None

    def _restore(self) -> None:
        plant = self.plant
        for name, values in plant.fields.items():
            values[...] = getattr(self._model, name)
        plant.ahead[...] = plant.healthy[plant.step :]
        plant.eq_active[plant.robot.locks] = 0
        plant.misreading = None


NEVER = int(np.iinfo(np.int32).max)

CTRL = int(mujoco.mjtState.mjSTATE_CTRL)
