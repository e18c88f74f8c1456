"""Measure the slip of a base in simulation: its point without sideways velocity, in place and along arcs."""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from failbench.mobile.wheeled import TIMESTEP, Wheeled, on_endless_floor
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.mobile.control.diff_drive_controller import Pivot, Tracking
from graceful_plan.mobile.control.drive_state import DriveCommand, DriveState
from graceful_plan.scene.per_scene import per_scene

_RAMP, _MEASURED = 0.6, 0.8
"""Durations of the acceleration ramp and of the measurement after it [s]."""
_STEADY = 0.8
"""Driving time until the motion is taken as steady [s]."""
_BENDS = ((0.25, 0.5), (0.5, 0.3), (0.5, 0.8), (1.0, 0.3), (1.0, 0.8))
"""Measured arcs: shares of the greatest speed, and of the turning rate that the limits on turning rate and lateral
acceleration allow at that speed. Each arc is driven forwards and backwards."""


class Steady(NamedTuple):
    """Steady motion of a base at constant speed and turning rate, in its own frame."""

    forwards: float
    """Speed of its origin along the heading [m/s]."""
    sideways: float
    """Speed of its origin to the left of the heading [m/s]."""
    omega: float
    """Turning rate [rad/s]."""
    wheel: Float[Array, " wheel"]
    """Wheel rates [rad/s]."""


@per_scene(most=16)
def steady_drive(scene: Scene, v: float, omega: float) -> Steady:
    """Return the steady motion of a base whose controller holds a speed and a turning rate.

    The base is simulated on an empty, unbounded floor. A base with two wheels on one axle has no slip, so the nominal
    motion is returned without simulation.

    Args:
        scene: Scene with the base.
        v: Speed along the direction of travel [m/s].
        omega: Turning rate [rad/s].
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
    """Return tracking gains with the pivot fitted to a scene's base on an empty, unbounded floor.

    A base with two wheels on one axle pivots about the axle under any load, so nothing is measured for it.
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
    """Fit a saturating pivot shift along arcs: its maximum [m], and the lateral acceleration at half of it [m/s^2]."""
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
    """Drive along an arc; return the distance of the point without sideways velocity ahead of the origin [m]."""
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
    """Return a copy of the model in which the robot collides with the floor only."""
    model = copy.copy(wheels.model)
    others = [g for g in range(model.ngeom) if g not in (wheels.robot | wheels.floor | set(wheels.sphere))]
    model.geom_contype[others] = model.geom_conaffinity[others] = 0
    return model
