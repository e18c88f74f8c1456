"""Rollouts of a base from failure onset, with randomly drawn parameters, and the entities it hits."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from failbench.mobile.following import within_reach
from failbench.mobile.slipping import steady_drive
from failbench.mobile.wheeled import TIMESTEP, Wheeled
from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.mobile.coast.constants import ONE_SIDE, WHEELS
from graceful_plan.mobile.coast.steering import FASTER, MOTORS, TICK, reference_motion
from graceful_plan.mobile.control.diff_drive_controller import Tracking
from graceful_plan.mobile.control.drive_state import DriveState

_STILL = 0.02
"""Speed of the base below which it counts as stopped [m/s], checked every `_LOOK` seconds."""
_LOOK = 0.05
_SKEWS = 0.1
"""Speed below which the slip angle of a turning base is not applied to its initial heading [m/s]."""


@dataclass(frozen=True)
class BaseFailure:
    """One failure of a base.

    Args:
        wheels: Behaviour of the wheels, from `WHEELS` in the coast settings: "released" wheels turn freely, "locked"
            wheels are held, "driven" wheels go on as commanded for a while and then stop by their controllers.
            "side_locked" and "side_dead": the wheels of one side are held or turn freely while the other side goes on
            and then stops.
        deceleration: Deceleration by drive friction while rolling, or while stopping [m/s^2]. With held wheels, the
            friction coefficient of the tyres is this value over gravity.
        drag: Additional deceleration per speed while rolling [1/s].
        delay: Time for which driven wheels go on before they stop [s].
        aside: Offset to the left of the planned position at the failure [m].
        askew: Heading error at the failure [rad].
        bend: Curvature added to the commanded one [1/m].
        left: Whether the left side fails, for one-sided failures.
        steered: Whether a controller unaware of the failure steers the working side until the delay is over.
        friction: Friction coefficient of the tyres, if the wheels of one side turn freely.
        brakes: Deceleration of the rims of the working side after the delay [m/s^2].
    """

    wheels: str
    deceleration: float
    drag: float
    delay: float
    aside: float = 0.0
    askew: float = 0.0
    bend: float = 0.0
    left: bool = True
    friction: float = 0.6
    brakes: float = 1.5
    steered: bool = False

    def __post_init__(self) -> None:
        if self.wheels not in WHEELS:
            raise UnknownNameError("what wheels do", self.wheels, WHEELS)


@dataclass(frozen=True)
class BaseHit:
    """First contact of the base with an entity.

    Args:
        entity: Index of the entity in the scene.
        speed: Speed of the contact point along the normal [m/s].
        time: Time after the failure [s].
    """

    entity: int
    speed: float
    time: float


def coasted(
    wheels: Wheeled, q: Float[Array, " nq"], qd: Float[Array, " nq"], failure: BaseFailure, seconds: float = 4.0
) -> Sequence[BaseHit]:
    """Simulate a base that fails while driving; return its hits in order of time.

    Args:
        wheels: Scene with the base on wheels.
        q: Planned configuration at the failure.
        qd: Planned velocity at the failure [m/s, rad/s].
        failure: Failure to simulate.
        seconds: Longest duration of the rollout; it ends earlier if the base comes to rest [s].
    """
    hits: dict[int, BaseHit] = {}
    for data, before in coasting(wheels, q, qd, failure, seconds):
        _note(wheels, data, hits, before)
    return sorted(hits.values(), key=lambda hit: hit.time)


def coasting(
    wheels: Wheeled, q: Float[Array, " nq"], qd: Float[Array, " nq"], failure: BaseFailure, seconds: float = 4.0
) -> Iterator[tuple[mujoco.MjData, Float[Array, " 3"]]]:
    """Yield, for each step of `coasted`, the data after it and the base's planar velocity before it.

    The velocity is in W [m/s], with the turning rate as third entry [rad/s]. The yielded data are reused and modified.

    The rollout starts from the steady state that a tracking controller reaches: a skid-steer drives at an angle to its
    heading.
    """
    v = float(qd[0] * np.cos(q[2]) + qd[1] * np.sin(q[2]))
    omega = float(qd[2])
    steady = steady_drive(wheels.scene, v, omega)
    off = failure.aside * np.array([-np.sin(q[2]), np.cos(q[2])])
    begin = np.array([q[0] + off[0], q[1] + off[1], q[2] + failure.askew, *q[3:]])
    if abs(v) > _SKEWS:
        begin[2] -= np.arctan2(np.sign(v) * steady.sideways, np.sign(v) * steady.forwards)
    model, data = _failing(wheels, failure), wheels.placed(begin, v, omega)
    c, s = np.cos(begin[2]), np.sin(begin[2])
    x, y = steady.forwards, steady.sideways
    data.qvel[wheels.dof : wheels.dof + 2] = c * x - s * y, s * x + c * y
    data.qvel[wheels.dof + 5] = steady.omega
    data.qvel[wheels.wheel] = data.ctrl[wheels.motor] = steady.wheel
    data, rates = _moved(model, data), steady.wheel
    steers = _Steers(wheels, (float(q[0]), float(q[1]), float(q[2])), v, omega) if failure.steered else None
    for step in range(int(seconds / TIMESTEP)):
        if steers is not None and step % round(TICK / TIMESTEP) == 0 and step * TIMESTEP <= failure.delay:
            rates = steers.rates(data, step * TIMESTEP)
        _command(wheels, data, failure, (v, rates), step * TIMESTEP)
        before = data.qvel[[wheels.dof, wheels.dof + 1, wheels.dof + 5]]
        mujoco.mj_step(model, data)
        yield data, before
        waited = step * TIMESTEP > failure.delay or failure.wheels in ("released", "locked")
        if waited and step % int(_LOOK / TIMESTEP) == 0 and np.hypot(*before[:2]) < _STILL and abs(before[2]) < _STILL:
            return


@dataclass(eq=False)
class _Steers:
    """Controller that follows the motion a healthy base would have continued; it does not know of the failure."""

    wheels: Wheeled
    begin: tuple[float, float, float]
    v: float
    omega: float
    follows: Tracking = field(default_factory=Tracking)
    summed: float = 0.0
    told: Float[Array, " wheel"] | None = None

    def rates(self, data: mujoco.MjData, time: float) -> Float[Array, " wheel"]:
        """Return the commanded wheel rates [rad/s] at a time after the failure [s]."""
        (x0, y0, yaw0), wheels = self.begin, self.wheels
        x, y, yaw = wheels.pose(data)
        ahead = data.qvel[wheels.dof] * np.cos(yaw) + data.qvel[wheels.dof + 1] * np.sin(yaw)
        state = DriveState(x, y, yaw, float(ahead), float(data.qvel[wheels.dof + 5]))
        turned, ((far,), (v,)) = self.omega * time, reference_motion(wheels.base, np.array([self.v]), time)
        chord, middle = far * np.sinc(0.5 * turned / np.pi), yaw0 + 0.5 * turned
        there = x0 + chord * np.cos(middle), y0 + chord * np.sin(middle)
        wanted = DriveState(*there, yaw0 + turned, float(v), self.omega)
        command = self.follows.command(state, wanted)
        self.summed = self.follows.summed(self.summed, command, state, TICK)
        told = self.follows.held(command, state, self.summed)
        base, turning = wheels.base, data.qvel[wheels.wheel]
        reach = MOTORS * base.a_max * TICK
        told = within_reach(told, turning if self.told is None else self.told, turning, base, reach)
        most = FASTER * base.rim_max / base.radius
        self.told = np.clip(wheels.wheel_rates(told.v, told.omega), -most, most)
        return self.told


def _failing(wheels: Wheeled, failure: BaseFailure) -> mujoco.MjModel:
    """Return a copy of the model with the friction and actuators of the failed base."""
    model, broken = copy.copy(wheels.model), _broken(wheels, failure)
    if failure.wheels in ("locked", "side_locked"):
        model.geom_friction[list(wheels.sphere), 0] = failure.deceleration / 9.81
    if failure.wheels in ("released", "side_dead"):
        n, r = len(wheels.wheel), wheels.base.radius
        mass = float(model.body_subtreemass[wheels.body])
        effective = mass + n * float(model.dof_M0[wheels.wheel[0]]) / r**2
        model.dof_frictionloss[wheels.wheel[broken]] = failure.deceleration * effective * r / n
        model.dof_damping[wheels.wheel[broken]] = failure.drag * effective * r**2 / n
        motors = wheels.motor[broken]
        model.actuator_gainprm[motors, 0] = model.actuator_biasprm[motors, 2] = 0.0
    if failure.wheels == "side_dead":
        model.geom_friction[list(wheels.sphere), 0] = failure.friction
    return model


def _broken(wheels: Wheeled, failure: BaseFailure) -> Bool[Array, " wheel"]:
    """Return a mask of the failed wheels."""
    if failure.wheels in ONE_SIDE:
        return (wheels.sides < 0.0) == failure.left
    return np.full(len(wheels.wheel), failure.wheels != "driven")


def _moved(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """Return data for `model` with the state of `data`; both models have the same size."""
    found = mujoco.MjData(model)
    found.qpos[:], found.qvel[:], found.ctrl[:] = data.qpos, data.qvel, data.ctrl
    mujoco.mj_forward(model, found)
    return found


def _command(
    wheels: Wheeled, data: mujoco.MjData, failure: BaseFailure, driven: tuple[float, Array], time: float
) -> None:
    v, rates = driven
    late = max(0.0, time - failure.delay)
    if failure.wheels in ONE_SIDE:
        rims = wheels.base.radius * rates
        going = np.sign(rims) * np.maximum(0.0, np.abs(rims) - failure.brakes * late)
        data.ctrl[wheels.motor] = np.where(_broken(wheels, failure), 0.0, going / wheels.base.radius)
    elif failure.wheels == "locked":
        data.ctrl[wheels.motor] = 0.0
    elif failure.wheels == "driven":
        left = max(0.0, 1.0 - failure.deceleration * late / max(abs(v), 1e-9))
        data.ctrl[wheels.motor] = left * (rates + wheels.wheel_rates(0.0, failure.bend * abs(v)))


def _note(wheels: Wheeled, data: mujoco.MjData, hits: dict[int, BaseHit], before: Float[Array, " 3"]) -> None:
    for k in range(data.ncon):
        first, second = int(data.contact.geom1[k]), int(data.contact.geom2[k])
        if data.contact.dist[k] > 0.0 or (first in wheels.robot) == (second in wheels.robot):
            continue
        entity = int(wheels.entity[second if first in wheels.robot else first])
        if entity >= 0 and entity not in hits:
            x, y = data.contact.pos[k, :2] - data.qpos[wheels.qpos : wheels.qpos + 2]
            there = before[:2] + before[2] * np.array([-y, x])
            hits[entity] = BaseHit(entity, abs(float(data.contact.frame[k, :2] @ there)), float(data.time))
