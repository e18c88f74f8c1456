"""How a base slips, found by driving it: where it has no sideways speed, in place and in bends."""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from failbench.mobile.wheeled import TIMESTEP, Wheeled, on_endless_floor
from graceful_plan import Scene
from graceful_plan.array_types import Float
from graceful_plan.mobile.control.diff_drive_controller import Pivot, Tracking
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState
from graceful_plan.scene.per_scene import per_scene

Array = np.ndarray

_RAMP, _MEASURED = 0.6, 0.8
"""How long the base gets faster, and how long it is watched then [s]."""
_STEADY = 0.8
"""How long a base is driven until it drives steadily [s]."""
_BENDS = ((0.25, 0.5), (0.5, 0.3), (0.5, 0.8), (1.0, 0.3), (1.0, 0.8))
"""Shares of the greatest speed, and of the rate at which the acceleration across the heading is the greatest. They are
driven forwards and backwards."""


class Steady(NamedTuple):
    """How a base drives that keeps its speed and its rate of turning, in its own frame."""

    forwards: float
    """Speed of its origin along the heading [m/s]."""
    sideways: float
    """To the left of it [m/s]."""
    omega: float
    """Rate of turning [rad/s]."""
    wheel: Float[Array, " wheel"]
    """Rates of its wheels [rad/s]."""


@per_scene(most=16)
def steady_drive(scene: Scene, v: float, omega: float) -> Steady:
    """Return how a base drives whose controller has brought it to a speed and a rate of turning.

    It is driven on an empty floor without an end; two wheels on one axle do not slip, and nothing is measured then.

    Args:
        scene: Where it is.
        v: Speed along its way [m/s].
        omega: Rate of turning [rad/s].
    """
    wheels = on_endless_floor(scene)
    nominal = Steady(v, 0.0, omega, wheels.wheel_rates(v, omega))
    if wheels.base.wheel_base == 0.0 or abs(omega) < 1e-6:
        return nominal
    model, data, gains, summed = _alone(wheels), wheels.placed(_home(wheels), v, omega), Tracking(), 0.0
    asked = DriveCommand(v, omega)
    for _ in range(int(_STEADY / TIMESTEP)):
        turning = float(data.qvel[wheels.dof + 5])
        state = DriveState(0.0, 0.0, 0.0, v, turning)
        summed = gains.summed(summed, asked, state, TIMESTEP)
        told = gains.held(asked, state, summed)
        data.ctrl[wheels.motor] = wheels.wheel_rates(told.v, told.omega)
        mujoco.mj_step(model, data)
    _, _, yaw = wheels.pose(data)
    vx, vy = data.qvel[wheels.dof : wheels.dof + 2]
    c, s = np.cos(yaw), np.sin(yaw)
    return Steady(
        float(c * vx + s * vy), float(c * vy - s * vx), float(data.qvel[wheels.dof + 5]), data.qvel[wheels.wheel].copy()
    )


@per_scene
def fitted_tracking(scene: Scene) -> Tracking:
    """Return gains whose pivot is that of a scene's base; it is driven on an empty floor without an end.

    Two wheels on one axle have their pivot there, whatever they carry: nothing is measured then.
    """
    wheels = on_endless_floor(scene)
    base = wheels.base
    if base.wheel_base == 0.0:
        return Tracking()
    turning = 0.5 * base.omega_max
    still = 0.5 * sum(_ahead(wheels, 0.0, side * turning) for side in (-1.0, 1.0))
    bend, half = _bending(wheels, still, 1.0)
    back_bend, back_half = _bending(wheels, still, -1.0) if base.reverse else (bend, half)
    pivot = Pivot(still=still, bend=bend, acceleration=half, back_bend=back_bend, back_acceleration=back_half)
    return Tracking(pivot=pivot)


def _bending(wheels: Wheeled, still: float, gear: float) -> tuple[float, float]:
    """Return what bends add to where nothing moves sideways at most [m], and where half of it is reached [m/s^2]."""
    base, across, more = wheels.base, [], []
    for v_share, share in _BENDS:
        v = v_share * base.v_max
        omega = share * min(base.omega_max, base.lateral_max / v)
        across.append(v * omega)
        more.append(gear * (_ahead(wheels, gear * v, omega) - still))
    a, x = np.array(across), np.array(more)
    fits = []
    for half in np.geomspace(0.02, 3.0, 40) * base.lateral_max:
        shape = a / (a + half)
        bend = float(shape @ x / (shape @ shape))
        fits.append((float(((bend * shape - x) ** 2).sum()), bend, float(half)))
    _, bend, half = min(fits)
    return bend, half


def _ahead(wheels: Wheeled, v: float, omega: float) -> float:
    """Drive along an arc; return how far ahead of the origin nothing moves sideways [m]."""
    model, data = _alone(wheels), wheels.placed(_home(wheels), 0.0, 0.0)
    found = []
    for step in range(int((_RAMP + _MEASURED) / TIMESTEP)):
        part = min(1.0, step * TIMESTEP / _RAMP)
        data.ctrl[wheels.motor] = wheels.wheel_rates(part * v, part * omega)
        mujoco.mj_step(model, data)
        if step * TIMESTEP > _RAMP + 0.3 * _MEASURED:
            _, _, yaw = wheels.pose(data)
            vx, vy = data.qvel[wheels.dof : wheels.dof + 2]
            found.append((np.sin(yaw) * vx - np.cos(yaw) * vy) / data.qvel[wheels.dof + 5])
    return float(np.median(found))


def _home(wheels: Wheeled) -> Float[Array, " nq"]:
    return wheels.scene.home_qpos[list(wheels.scene.qpos_adr)]


def _alone(wheels: Wheeled) -> mujoco.MjModel:
    """Return the model in which the robot touches nothing but the floor."""
    model = copy.copy(wheels.model)
    others = [g for g in range(model.ngeom) if g not in (wheels.robot | wheels.floor | set(wheels.sphere))]
    model.geom_contype[others] = model.geom_conaffinity[others] = 0
    return model
