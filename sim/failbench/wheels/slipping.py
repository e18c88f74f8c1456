"""How a base slips, found by driving it: where it has no sideways speed, in place and in bends."""

from __future__ import annotations

import copy

import mujoco
import numpy as np

from failbench.wheels.wheeled import TIMESTEP, Wheeled, on_endless_floor
from graceful_plan import Scene
from graceful_plan.control.diff_drive_controller import Pivot, Tracking
from graceful_plan.scene.per_scene import per_scene

Array = np.ndarray

_RAMP, _MEASURED = 0.6, 0.8
"""How long the base gets faster, and how long it is watched then [s]."""
_BENDS = ((0.25, 0.5), (0.5, 0.3), (0.5, 0.8), (1.0, 0.3), (1.0, 0.8), (-0.5, 0.5))
"""Shares of the greatest speed, and of the rate at which the acceleration across the heading is the greatest."""


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
    across, more = [], []
    for v_share, share in _BENDS:
        v = v_share * base.v_max
        omega = share * min(base.omega_max, base.lateral_max / abs(v))
        across.append(abs(v * omega))
        more.append(np.sign(v) * (_ahead(wheels, v, omega) - still))
    a, x = np.array(across), np.array(more)
    fits = []
    for half in np.geomspace(0.02, 3.0, 40) * base.lateral_max:
        shape = a / (a + half)
        bend = float(shape @ x / (shape @ shape))
        fits.append((float(((bend * shape - x) ** 2).sum()), bend, float(half)))
    _, bend, half = min(fits)
    return Tracking(pivot=Pivot(still=still, bend=bend, acceleration=half))


def _ahead(wheels: Wheeled, v: float, omega: float) -> float:
    """Drive along an arc; return how far ahead of the origin nothing moves sideways [m]."""
    data = wheels.placed(wheels.scene.home_qpos[list(wheels.scene.qpos_adr)], 0.0, 0.0)
    model = copy.copy(wheels.model)
    others = [g for g in range(model.ngeom) if g not in (wheels.robot | wheels.floor | set(wheels.sphere))]
    model.geom_contype[others] = model.geom_conaffinity[others] = 0
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
