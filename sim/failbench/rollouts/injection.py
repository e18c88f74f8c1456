"""Injection of a fault into a rollout: its schedule, and the reset of all it changed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np

from failbench.fault.drives import close_brakes
from failbench.recording.records import RolloutRequest
from failbench.rollouts.driven import TICK, WheelPlan
from failbench.simulated.simulation import Simulation
from failbench.simulated.states import CHECKPOINT
from failbench.simulated.world import World
from graceful_plan.array_types import Array

_RAMP_STEPS = 5
"""Steps between updates of the level along a ramp."""


@runtime_checkable
class Commanded(Protocol):
    """Source of healthy commands: an `Execution`, or a policy whose later commands are not known yet."""

    @property
    def world(self) -> World:
        """The simulated world."""
        ...

    @property
    def dt(self) -> float:
        """Time step [s]."""
        ...

    @property
    def command(self) -> Array:
        """Commands from the beginning on, [step, actuator]."""
        ...

    @property
    def measured(self) -> Array:
        """Positions and velocities of the joints at past steps, [step, 2, nq]; empty if they are not kept."""
        ...

    @property
    def base(self) -> WheelPlan | None:
        """The motion that a base follows; None for a robot that does not drive."""
        ...

    @property
    def loop(self) -> Array | None:
        """State of a base's loop at each tick; None for a robot that does not drive."""
        ...

    def checkpoint(self, onset: float) -> int:
        """Return the checkpoint nearest to a time [s]."""
        ...

    def planned(self, time: Array) -> Array:
        """Return the planned joint positions at times [s], or the best known ones."""
        ...

    def walk(self, step: int, count: int, seed: int) -> Array:
        """Return the poses of moving entities before each of `count` steps from `step` on, and after the last."""
        ...

    def commands(self, step: int, count: int) -> Array:
        """Return commands of `count` steps from `step` on; call `Injection.renew` if they change later."""
        ...

    def paced(self, time: Array, pace: Array, change: Array) -> Array:
        """Return the joint commands for the motion at another pace."""
        ...

    def stopped(self, every: float, onset: float, time: Array) -> Array:
        """Return the joint commands for the next stop planned ahead after an onset."""
        ...


class Injection:
    """One fault in one simulation.

    Args:
        execution: Source of the healthy commands.
        job: The fault and its onset.
        steps: Number of simulated steps after the onset.
        fields: Live arrays of this simulation's model fields.
        qpos: Live positions.
        qvel: Live velocities.
        eq_active: Live state of the equality constraints.
        xfrc: Live forces and torques on all bodies.
    """

    def __init__(
        self,
        execution: Commanded,
        job: RolloutRequest,
        steps: int,
        *,
        fields: Mapping[str, Array],
        qpos: Array,
        qvel: Array,
        eq_active: Array,
        xfrc: Array | None = None,
    ) -> None:
        fault, robot = job.fault, execution.world.robot
        self.job = job
        self.checkpoint = execution.checkpoint(job.onset)
        onset = self.checkpoint * CHECKPOINT
        rng = np.random.default_rng(job.seed)
        joints, gripper = robot.struck(fault.targets or fault.TARGETS, rng, fault.rates)
        healthy = execution.commands(onset, steps)
        past = execution.command[:onset]
        healthy.flags.writeable = False
        self._walk = execution.walk(onset, steps, job.seed)
        self.plant = Simulation(
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
            measured=execution.measured[: onset + 1],
            world=execution.world,
            walk=self._walk.copy(),
            xfrc=np.zeros((0, 6)) if xfrc is None else xfrc,
            planned=lambda time: execution.planned(onset * execution.dt + time),
            paced=lambda time, pace, change: execution.paced(onset * execution.dt + time, pace, change),
            stopped=lambda every, time: execution.stopped(every, onset * execution.dt, time),
            fields={name: fields[name] for name in fault.FIELDS},
        )
        self._world = execution.world
        self._reset = [(values, getattr(execution.world.model, name)) for name, values in self.plant.fields.items()]
        self._wheels = _Wheels(execution, self.plant, onset, qpos, qvel) if execution.base is not None else None
        self._end = steps if fault.duration is None else max(1, round(fault.duration / execution.dt))
        self._level: float | None = None
        self.brakes: Mapping[str, Array] = {}
        """Live model fields of closed brakes, see `close_brakes`; empty while the brakes are open."""
        self.next = 0
        """Step before which `act` is due next."""

    @property
    def ticks(self) -> int | None:
        """Steps between calls of `steer`; None if the robot does not drive."""
        return None if self._wheels is None else TICK

    def steer(self, step: int) -> None:
        """Write the base controller's commands from a step on; call before `act`."""
        if self._wheels is not None:
            self._wheels.steer(step, self.job.fault.CATEGORY == "sensor")

    def act(self) -> None:
        """Apply or end the fault before step `next`."""
        fault, plant = self.job.fault, self.plant
        plant.step = self.next
        self._restore()
        if self.next >= self._end:
            self.next, self._level = NEVER, None
            self._hold()
            return
        ramp = round(fault.ramp / plant.dt)
        level = 1.0 if ramp == 0 else min(1.0, (self.next + _RAMP_STEPS) / ramp)
        self._level = level
        fault.apply(plant, level)
        self._hold()
        wait = NEVER if fault.period is None else max(1, round(fault.period / plant.dt))
        self.next = min(self.next + min(wait, _RAMP_STEPS if level < 1.0 else NEVER), self._end)

    def told(self, step: int, until: int) -> Array:
        """Return the inputs of the simulation for a range of steps: commands, and poses of moving entities."""
        plant = self.plant
        commands = plant.command[step:until]
        return np.hstack([commands, plant.walk[step:until]]) if plant.walk.shape[1] else commands

    def seen(self, step: int, until: int) -> Array:
        """Return the poses of moving entities before each step of a range, and before the step after it."""
        rows = self.plant.walk[step : until + 1]
        return rows if len(rows) == until + 1 - step else np.vstack([rows, rows[-1:]])

    def restore(self, step: int) -> None:
        """End the fault before this step, whatever its duration."""
        if self.next != NEVER or self._end > step:
            self.next = self._end = step

    def renew(self) -> None:
        """Apply the fault again at its current level, after the healthy commands have changed."""
        self._restore()
        if self._level is not None:
            self.job.fault.apply(self.plant, self._level)
        self._hold()

    @property
    def level(self) -> float:
        """Current level of the fault, from 0 (not begun yet, or over) to 1."""
        return 0.0 if self._level is None else self._level

    def _hold(self) -> None:
        """Keep closed brakes closed, whatever the fault has changed."""
        if self.brakes:
            close_brakes(self.brakes, self._world)

    def _restore(self) -> None:
        plant = self.plant
        for values, healthy in self._reset:
            values[...] = healthy
        for name, values in self.brakes.items():
            values[...] = getattr(self._world.model, name)
        plant.ahead[...] = plant.healthy[plant.step :]
        plant.walk[plant.step :] = self._walk[plant.step :]
        plant.xfrc[...] = 0.0
        plant.eq_active[plant.robot.locks] = 0
        plant.lag = 0
        plant.misreading = None


class _Wheels:
    """Control loop of a base that may be faulty: it continues from the onset, and faults change its commands."""

    def __init__(self, execution: Commanded, plant: Simulation, onset: int, qpos: Array, qvel: Array) -> None:
        assert execution.base is not None and execution.loop is not None
        self._plan, self._plant, self._onset, self._qpos, self._qvel = execution.base, plant, onset, qpos, qvel
        told = execution.loop[min(onset // TICK, len(execution.loop) - 1)]
        self._loop = execution.base.loop(told[:-1], float(told[-1]))
        n = len(execution.base.wheel)
        self._hurt = bool((plant.joints < n).any())
        self._healthy = execution.world.model.actuator_biasprm[execution.base.motor, 1].copy()

    def steer(self, step: int, encoders: bool) -> None:
        plant, motor = self._plant, self._plan.motor
        if encoders and self._hurt and plant.lag == 0:
            self._loop.misread = lambda: self._wrong(step)
        told = self._loop.commands(self._onset + step, self._qpos, self._qvel, plant.lag)
        told = told[: max(0, len(plant.command) - step)]
        part = slice(step, step + len(told))
        before = plant.healthy[part][:, motor]
        plant.healthy.flags.writeable = True
        plant.healthy[part, motor] = told
        plant.healthy.flags.writeable = False
        plant.command[part, motor] += told - before

    def _wrong(self, step: int) -> Array:
        """Return the readings minus the true wheel angles that the servos see [rad]."""
        plant, motor = self._plant, self._plan.motor
        row = min(max(step - 1, 0), len(plant.command) - 1)
        wrong = plant.healthy[row, motor] - plant.command[row, motor]
        bias = plant.fields.get("actuator_biasprm")
        if bias is not None:
            angle = self._qpos[self._plan.wheel]
            wrong = wrong + (bias[motor, 0] + bias[motor, 1] * angle) / self._healthy - angle
        return wrong


NEVER = int(np.iinfo(np.int32).max)
