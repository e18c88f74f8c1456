"""What a base hits after it failed: rollouts from the very moment of the failure, with parameters drawn at random."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from failbench.wheels.wheeled import TIMESTEP, Wheeled
from graceful_plan.array_types import Float
from graceful_plan.costs.models.coast.constants import CoastSettings

Array = np.ndarray

LOCKED = "wheels_locked"
FREE = "power_lost"
_STILL = 0.02
"""Speed of the base below which it has come to rest [m/s]; it is looked at every `_LOOK` seconds."""
_LOOK = 0.05


@dataclass(frozen=True)
class BaseFailure:
    """One failure of a base.

    Args:
        way: Its name in the coast settings: "power_lost" lets the wheels roll, "wheels_locked" holds them; any other
            goes on as commanded for a while and then stops by the wheels' controllers.
        deceleration: While it rolls, by friction in the drive, or while it stops [m/s^2]; with locked wheels the
            friction of tyres is this over gravity.
        drag: What is added while it rolls, per speed [1/s].
        delay: How long it goes on before [s].
        aside: How far to the left of where it was planned to be it fails [m].
        askew: By how much its heading is off there [rad].
    """

    way: str
    deceleration: float
    drag: float
    delay: float
    aside: float = 0.0
    askew: float = 0.0


@dataclass(frozen=True)
class BaseHit:
    """The first touch of an entity.

    Args:
        entity: Its number in the scene.
        speed: Of the base at that moment [m/s].
        time: After the failure [s].
    """

    entity: int
    speed: float
    time: float


def drawn(settings: CoastSettings, rng: np.random.Generator) -> BaseFailure:
    """Draw a failure as the settings of the coast model say."""
    names = list(settings.ways)
    weights = np.array([settings.ways[name].weight for name in names])
    name = names[int(rng.choice(len(names), p=weights / weights.sum()))]
    way = settings.ways[name]
    aside, askew = settings.position_spread * rng.normal(), settings.drift * rng.normal()
    stops = float(rng.choice(way.deceleration)), way.drag, float(rng.choice(way.delay))
    return BaseFailure(name, *stops, float(aside), float(askew))


def coasted(
    wheels: Wheeled, q: Float[Array, " nq"], qd: Float[Array, " nq"], failure: BaseFailure, seconds: float = 4.0
) -> Sequence[BaseHit]:
    """Let a base fail while it drives; return whom it hits, in the order of time.

    Args:
        wheels: The scene on wheels.
        q: Where it was planned to be when it fails.
        qd: How fast it drives there [m/s, rad/s].
        failure: How it fails.
        seconds: How long it is watched, unless it comes to rest before [s].
    """
    hits: dict[int, BaseHit] = {}
    for data, speed in coasting(wheels, q, qd, failure, seconds):
        _note(wheels, data, hits, speed)
    return sorted(hits.values(), key=lambda hit: hit.time)


def coasting(
    wheels: Wheeled, q: Float[Array, " nq"], qd: Float[Array, " nq"], failure: BaseFailure, seconds: float = 4.0
) -> Iterator[tuple[mujoco.MjData, float]]:
    """Yield the data after each step of `coasted`, and the speed of the base before it [m/s]. The data are changed."""
    v = float(qd[0] * np.cos(q[2]) + qd[1] * np.sin(q[2]))
    omega = float(qd[2])
    off = failure.aside * np.array([-np.sin(q[2]), np.cos(q[2])])
    begin = np.array([q[0] + off[0], q[1] + off[1], q[2] + failure.askew, *q[3:]])
    model, data = _failing(wheels, failure), wheels.placed(begin, v, omega)
    data = _moved(model, data)
    for step in range(int(seconds / TIMESTEP)):
        _command(wheels, data, failure, (v, omega), step * TIMESTEP)
        speed = float(np.hypot(*data.qvel[wheels.dof : wheels.dof + 2]))
        mujoco.mj_step(model, data)
        yield data, speed
        waited = step * TIMESTEP > failure.delay
        if waited and step % int(_LOOK / TIMESTEP) == 0 and speed < _STILL and abs(data.qvel[wheels.dof + 5]) < _STILL:
            return


def _failing(wheels: Wheeled, failure: BaseFailure) -> mujoco.MjModel:
    """Return the model with friction and actuators as they are after the failure."""
    model = copy.copy(wheels.model)
    if failure.way == LOCKED:
        model.geom_friction[list(wheels.sphere), 0] = failure.deceleration / 9.81
    if failure.way == FREE:
        n, r = len(wheels.wheel), wheels.base.radius
        mass = float(model.body_subtreemass[wheels.body])
        effective = mass + n * float(model.dof_M0[wheels.wheel[0]]) / r**2
        model.dof_frictionloss[wheels.wheel] = failure.deceleration * effective * r / n
        model.dof_damping[wheels.wheel] = failure.drag * effective * r**2 / n
        model.actuator_gainprm[wheels.motor, 0] = model.actuator_biasprm[wheels.motor, 2] = 0.0
    return model


def _moved(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Return the state of data of another model of the same size."""
    found = mujoco.MjData(model)
    found.qpos[:], found.qvel[:], found.ctrl[:] = data.qpos, data.qvel, data.ctrl
    mujoco.mj_forward(model, found)
    return found


def _command(
    wheels: Wheeled, data: mujoco.MjData, failure: BaseFailure, driven: tuple[float, float], time: float
) -> None:
    v, omega = driven
    if failure.way == LOCKED:
        data.ctrl[wheels.motor] = 0.0
    elif failure.way != FREE and time >= failure.delay:
        left = max(0.0, 1.0 - failure.deceleration * (time - failure.delay) / max(abs(v), 1e-9))
        data.ctrl[wheels.motor] = wheels.wheel_rates(left * v, left * omega)


def _note(wheels: Wheeled, data: mujoco.MjData, hits: dict[int, BaseHit], speed: float) -> None:
    for k in range(data.ncon):
        first, second = int(data.contact.geom1[k]), int(data.contact.geom2[k])
        if data.contact.dist[k] > 0.0 or (first in wheels.robot) == (second in wheels.robot):
            continue
        entity = int(wheels.entity[second if first in wheels.robot else first])
        if entity >= 0 and entity not in hits:
            hits[entity] = BaseHit(entity, speed, float(data.time))
