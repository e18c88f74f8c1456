"""The footprint of a failure at one moment: where what is carried comes down, and how far a base goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.functions import GRAVITY
from graceful_plan.costs.models.drop.landing import land
from graceful_plan.costs.models.drop.release import release
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.objective import trajectory_batch
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_POINTS = 16
_REACHED = (50.0, 95.0)
"""Percentiles of how far a failing base goes."""
_STANDS = 0.01
"""Speed below which a base stands [m/s]."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Fall:
    """What becomes of the carried object if the gripper lets go now, by the drop model.

    | field    | meaning                                                             | unit | shape   |
    |----------|---------------------------------------------------------------------|------|---------|
    | flight   | the way of its centre of mass until it comes down                   | m    | point 3 |
    | centre   | where it comes down, on average, on the height of what it hits      | m    | 3       |
    | radius   | of the object, and one standard deviation of where it comes down    | m    |         |
    | far      | of the object, and two deviations of where it ends after a fall     | m    |         |
    | leaves   | probability that it does not stay where it comes down               |      |         |
    """

    flight: Float[Array, "point 3"]
    centre: Float[Array, " 3"]
    radius: float
    far: float
    leaves: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class GoingOn:
    """How far a base goes on that fails now, by the coast model: its arc, as far as half and nearly all of them go.

    | field | meaning                                                | unit | shape   |
    |-------|--------------------------------------------------------|------|---------|
    | arc   | the way of its middle, up to where 95 % have stopped   | m    | point 3 |
    | half  | length after which half of them have stopped           | m    |         |
    | width | half of it                                             | m    |         |
    """

    arc: Float[Array, "point 3"]
    half: float
    width: float


def fall_at(trajectory: Trajectory, scene: Scene, t: float) -> Fall | None:
    """Return the footprint of a drop at a time after the start [s]; None if nothing is carried or can be hit."""
    if scene.carried is None:
        return None
    tables = drop_tables(scene)
    if not len(tables.target_entity):
        return None
    constants = DropSettings.shipped().of(tables.shape_class)
    state = release(trajectory_batch(scene, trajectory, trajectory.t[0] + np.array([t])), tables)
    landing = land(tables, constants, state)
    height, total = float(landing.height[0, 0]), float(landing.total[0, 0])
    time = np.linspace(0.0, float(landing.time[0, 0]), _POINTS)[:, None]
    flight = state.c[0] + state.v[0] * time
    flight[:, 2] -= 0.5 * GRAVITY * time[:, 0] ** 2
    flight[:, 2] = np.maximum(flight[:, 2], height)
    return Fall(
        flight=flight,
        centre=np.array([*landing.point[0], height]),
        radius=tables.size + float(np.sqrt(landing.blur[0, 0])),
        far=tables.size + 2.0 * float(landing.fall_spread[0, 0]),
        leaves=min(1.0, float(landing.leaving[0].sum()) / total),
    )


def going_on_at(trajectory: Trajectory, scene: Scene, t: float) -> GoingOn | None:
    """Return how far a base goes on that fails at a time after the start [s]; None if it stands or there is none."""
    if scene.base is None:
        return None
    state = trajectory.at(trajectory.t[0] + t)
    x, y, yaw = state.q[:3]
    v = float(state.qd[0] * np.cos(yaw) + state.qd[1] * np.sin(yaw))
    if abs(v) < _STANDS:
        return None
    half, far = _distances(abs(v))
    s = np.linspace(0.0, far, _POINTS)
    turned = yaw + float(state.qd[2]) / abs(v) * s
    middle = 0.5 * (turned[1:] + turned[:-1])
    steps = np.sign(v) * np.diff(s)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
    arc = np.zeros((_POINTS, 3))
    arc[:, :2] = np.array([x, y]) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return GoingOn(arc=arc, half=half, width=0.5 * scene.base.track)


def _distances(v: float) -> tuple[float, float]:
    """How far half and nearly all failing bases go that drive at a speed [m]."""
    probability, a, k, delay = CoastSettings.shipped().stops()[:, :4].T
    drag = np.maximum(k, 1e-9)
    rolls = np.where(k > 0.0, v / drag - a / drag**2 * np.log1p(drag * v / a), v * v / (2.0 * a))
    way = v * delay + rolls
    order = np.argsort(way)
    reached = np.cumsum(probability[order])
    half, far = (float(way[order][np.searchsorted(reached, share * reached[-1] / 100.0)]) for share in _REACHED)
    return half, far
