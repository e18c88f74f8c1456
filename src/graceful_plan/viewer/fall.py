"""Footprint of a failure at one moment: landing place of the carried object, and coasting distance of a base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost_samples import trajectory_batch
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.functions import GRAVITY
from graceful_plan.costs.models.drop.landing import land
from graceful_plan.costs.models.drop.release import release
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

_POINTS = 16
_REACHED = (50.0, 95.0)
"""Percentiles of the coasting distance."""
_STANDS = 0.01
"""Speed below which a base counts as standing [m/s]."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Fall:
    """Fall of the carried object after a release, by the drop model.

    | field    | meaning                                                             | unit | shape   |
    |----------|---------------------------------------------------------------------|------|---------|
    | flight   | path of its centre of mass until landing                            | m    | point 3 |
    | centre   | mean landing place, at the height of the surface                    | m    | 3       |
    | radius   | of the object plus one standard deviation of the landing place      | m    |         |
    | far      | of the object plus two deviations of the final place after a fall   | m    |         |
    | leaves   | probability that it does not stay at the landing place              |      |         |
    """

    flight: Float[Array, "point 3"]
    centre: Float[Array, " 3"]
    radius: float
    far: float
    leaves: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Coasting:
    """Coasting of a base that fails now, by the coast model: its arc, with the median and 95 % distance.

    | field | meaning                                                | unit | shape   |
    |-------|--------------------------------------------------------|------|---------|
    | arc   | path of its middle, up to the 95 % distance            | m    | point 3 |
    | half  | median distance                                        | m    |         |
    | width | half of its width                                      | m    |         |
    """

    arc: Float[Array, "point 3"]
    half: float
    width: float


def fall_at(trajectory: Trajectory, scene: Scene, t: float) -> Fall | None:
    """Return the footprint of a drop at a time after the start [s]; None without a carried object or surfaces."""
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


def coasting_at(trajectory: Trajectory, scene: Scene, t: float) -> Coasting | None:
    """Return the coasting of a base that fails at a time after the start [s]; None if it stands or there is none."""
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
    return Coasting(arc=arc, half=half, width=0.5 * scene.base.track)


def _distances(v: float) -> tuple[float, float]:
    """Return the median and 95 % coasting distance from a speed [m]."""
    probability, a, k, delay = CoastSettings.shipped().stops()[:, :4].T
    drag = np.maximum(k, 1e-9)
    rolls = np.where(k > 0.0, v / drag - a / drag**2 * np.log1p(drag * v / a), v * v / (2.0 * a))
    way = v * delay + rolls
    order = np.argsort(way)
    reached = np.cumsum(probability[order])
    half, far = (float(way[order][np.searchsorted(reached, share * reached[-1] / 100.0)]) for share in _REACHED)
    return half, far
