"""The simulation of a healthy robot, step by step: the settled start, and the run of a motion's commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch

from failbench.basics.errors import ExecutionRefused
from failbench.rollouts.driven import TICK, WheelPlan
from failbench.rollouts.healthy_commands import joint_commands
from failbench.simulated.moving_entities import EntityPoses, set_entity_poses
from failbench.simulated.rolling import lifted
from failbench.simulated.states import STATE, control_spec
from failbench.simulated.stiction import EVERY, Stiction
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float

_SETTLE = 0.4
"""Time for the fingers to close and the scene to come to rest before the motion begins [s]."""
_REST = 0.2
"""Last part of `_SETTLE` during which the fingers hold the object without the weld [s]."""


class HealthyRun(NamedTuple):
    """A simulation, step by step."""

    qpos: Float[Array, "step qpos"]
    sensordata: Float[Array, "step sensordata"]
    xpos: Float[Array, "step body xyz"]
    xquat: Float[Array, "step body wxyz"]
    states: Float[Array, "state_and_step state"]
    """States at the beginning and after each step."""


def simulate(
    world: World,
    batch: Batch,
    command: Float[Array, "step actuator"],
    start: Float[Array, "1 state"],
    stiction: Stiction,
) -> HealthyRun:
    """Continue the only simulation of a batch with commands."""
    parts = []
    for first in range(0, len(command), EVERY):
        parts.append(_stretch(world, batch, command[first : first + EVERY], parts[-1].states[-1:] if parts else start))
        if len(parts[-1].qpos) == EVERY:
            stiction.update(np.zeros(1, dtype=int))
    return joined(parts)


def _stretch(
    world: World, batch: Batch, command: Float[Array, "step actuator"], start: Float[Array, "1 state"]
) -> HealthyRun:
    record = ("qpos", "sensordata", "xpos", "xquat", int(STATE))
    if world.model.nmocap:
        time = start[0, 0] + world.settings.timestep * np.arange(len(command))
        command = np.hstack([command, EntityPoses(world.model, world.walkers).rows(time)])
    out = batch.rollout(len(command), command[None], control_spec(world.model), record=record)
    qpos, sensordata, xpos, xquat, states = (out[name][0] for name in record)
    return HealthyRun(qpos, sensordata, xpos, xquat, np.vstack([start, states]))


def drive(
    world: World,
    batch: Batch,
    command: Float[Array, "step actuator"],
    start: Float[Array, "1 state"],
    stiction: Stiction,
    base: WheelPlan,
) -> tuple[HealthyRun, Float[Array, "tick wheel_and_1"]]:
    """Drive a base: its loop is closed at each tick, and the loop's commands are written into `command`."""
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    loop, runs, ticks = base.loop(qpos[0, base.wheel]), [], []
    steps = len(command) - 1
    for step in range(0, steps, TICK):
        if loop.arrived(qpos[0], qvel[0]):
            break
        ticks.append([*loop.angles, loop.summed])
        rows = loop.commands(step, qpos[0], qvel[0])
        until = min(step + TICK, steps)
        command[step:, base.motor] = rows[-1]  # held unless the next tick overwrites it
        command[step:until, base.motor] = rows[: until - step]
        runs.append(_stretch(world, batch, command[step:until], runs[-1].states[-1:] if runs else start))
        if until % EVERY == 0:
            stiction.update(np.zeros(1, dtype=int))
    else:
        if not base.in_time:
            raise ExecutionRefused(
                "the base", steps * base.dt, "its controller did not bring it to the end of the path"
            )
    return joined(runs), np.array(ticks)


def joined(runs: Sequence[HealthyRun]) -> HealthyRun:
    """Return consecutive simulations as one."""
    parts = [run._replace(states=run.states[min(i, 1) :]) for i, run in enumerate(runs)]
    return HealthyRun._make(map(np.concatenate, zip(*parts, strict=True)))


def settled(
    q: Float[Array, " nq"], world: World, command: Float[Array, " actuator"], *, time: float = 0.0
) -> Float[Array, " state"]:
    """Return the state at the start of a motion from `q`: the object in the fingers, everything at rest.

    Args:
        q: Configuration of the robot.
        world: The simulated world.
        command: Commands of all actuators; those of the arm's joints are ignored.
        time: Start time, on the clock of the moving entities [s].
    """
    model, scene = world.model, world.scene
    data = mujoco.MjData(model)
    data.qpos[:] = lifted(scene, model, scene.data_at(q).qpos)
    hold, still = command.copy(), np.zeros((1, len(scene.joints)))
    hold[world.robot.actuators] = joint_commands(world, q[None], still, still)[0]
    if model.nmocap:
        set_entity_poses(model, data, EntityPoses(model, world.walkers).rows(np.array([time]))[0])
    steps = round(_SETTLE / model.opt.timestep)
    for step in range(steps):
        if world.hold >= 0 and world.robot.weld < 0 and step * model.opt.timestep >= _SETTLE - _REST:
            data.eq_active[world.hold] = 0
        data.ctrl[:] = hold
        mujoco.mj_step(model, data)
    data.time = time  # the clock of the moving entities
    state = np.zeros(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state
