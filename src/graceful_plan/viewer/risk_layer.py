"""The risk map as a layer: what a failure would do at other places, at the speed and height of a moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.analysis.impact_maps import impact_map
from graceful_plan.array_types import Float, UInt8
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.viz.style import HEAT

Array = np.ndarray

_CELL, _FLOOR_CELL = 0.025, 0.1
"""Width of a cell over a table and on a floor [m]."""
_OPACITY, _SEEN, _FAINT = 0.8, 0.3, 0.1
"""Opacity, from which share of the highest impact on, and the share of it that is left where there is no impact."""
_ABOVE = 0.004
"""How far above the surface it is drawn [m]."""
_LEAST = 0.3
"""Impact that has the darkest colour at least: a map on which nothing is at stake is white."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class RiskLayer:
    """A picture that lies in the scene.

    | field   | meaning                                                     | unit | shape  |
    |---------|-------------------------------------------------------------|------|--------|
    | pixels  | red, green, blue, opacity; the first row is that of least y |      | y x 4  |
    | low     | corner with the least x and y, and its height               | m    | 3      |
    | size    | along x and y                                               | m    | 2      |
    | highest | impact of the darkest colour                                |      |        |
    """

    pixels: UInt8[Array, "y x 4"]
    low: Float[Array, " 3"]
    size: Float[Array, " 2"]
    highest: float


def risk_layer(trajectory: Trajectory, scene: Scene, t: float, impact: ImpactCost) -> RiskLayer | None:
    """Return the map for the speed of a moment: of a base, of failing elsewhere; else, of letting the object go there.

    None if nothing is carried, or nothing is in reach that can be hit.

    Args:
        trajectory: The motion.
        scene: Where.
        t: Time after the start [s].
        impact: What a failure costs.
    """
    if scene.base is not None and scene.entities:
        return _of_base(trajectory, scene, t, impact)
    if scene.base is not None or scene.carried is None:
        return None
    state = trajectory.at(trajectory.t[0] + t)
    here, soon = (_centre(scene, q) for q in (state.q, state.q + 1e-4 * state.qd))
    velocity = (soon - here)[:2] / 1e-4
    speed = float(np.linalg.norm(velocity))
    try:
        ground = impact_map(scene, impact, height=0.0, q=state.q, resolution=1.0).surface
        found = impact_map(
            scene,
            impact,
            height=max(0.01, _lowest(scene, state.q) - ground),
            speed=speed,
            direction=float(np.arctan2(velocity[1], velocity[0])) if speed > 1e-3 else None,
            q=state.q,
            resolution=_CELL,
        )
    except GracefulPlanError:  # nothing stands on anything, or in reach: there is no map to be drawn
        return None
    step = np.array([_step(found.x), _step(found.y)])
    low = np.array([found.x[0] - 0.5 * step[0], found.y[0] - 0.5 * step[1], found.surface + _ABOVE])
    return _layer(found.impact, low, step)


def _of_base(trajectory: Trajectory, scene: Scene, t: float, impact: ImpactCost) -> RiskLayer:
    """Return what a failure does with the base at other places, its heading and speed as at this moment."""
    state = trajectory.at(trajectory.t[0] + t)
    places = _places(scene)
    low, high = np.minimum(places.min(axis=0), trajectory.q[:, :2].min(axis=0)), places.max(axis=0)
    low, high = low - 0.5, np.maximum(high, trajectory.q[:, :2].max(axis=0)) + 0.5
    counts = np.maximum(1, np.ceil((high - low) / _FLOOR_CELL).astype(int))
    x, y = (a + _FLOOR_CELL * (np.arange(n) + 0.5) for a, n in zip(low, counts, strict=True))
    q = np.tile(state.q, (len(x) * len(y), 1))
    q[:, :2] = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    speed = float(np.linalg.norm(state.qd))
    direction = state.qd / speed if speed > 0.0 else np.zeros_like(state.qd)
    batch = StateBatch(scene, q, np.tile(direction, (len(q), 1)), np.full(len(q), speed))
    still = np.einsum("nce,ce->n", impact.interaction.probability(batch), impact.severity(scene))
    return _layer(still.reshape(len(y), len(x)), np.array([*low, _ABOVE]), np.full(2, _FLOOR_CELL))


def _places(scene: Scene) -> Float[Array, "entity 2"]:
    data = scene.data_at(scene.model.qpos0[scene.qpos_adr])
    return np.array([data.geom_xpos[list(entity.geoms)].mean(axis=0)[:2] for entity in scene.entities.values()])


def _centre(scene: Scene, q: Float[Array, " nq"]) -> Float[Array, " 3"]:
    assert scene.carried is not None  # checked by the caller
    return Placement(scene).place(q).xipos[scene.model.body(scene.carried.body).id].copy()


def _lowest(scene: Scene, q: Float[Array, " nq"]) -> float:
    """Height in W of the lowest point of the carried object [m]: that of the box around each of its geoms."""
    model, data = scene.model, Placement(scene).place(q)
    bottoms = []
    for geom in scene.components["carried"].geoms:
        R = data.geom_xmat[geom].reshape(3, 3)
        centre = data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3]
        bottoms.append(float(centre[2] - np.abs(R[2]) @ model.geom_aabb[geom, 3:]))
    return min(bottoms)


def _step(centres: Float[Array, " n"]) -> float:
    return float(centres[1] - centres[0]) if len(centres) > 1 else _CELL


def _layer(impact: Float[Array, "y x"], low: Float[Array, " 3"], step: Float[Array, " 2"]) -> RiskLayer:
    highest = max(_LEAST, float(np.nanmax(impact, initial=0.0)))
    known = ~np.isnan(impact)
    pixels = np.zeros((*impact.shape, 4), dtype=np.uint8)
    pixels[..., :3] = heat_colours(np.where(known, impact, 0.0) / highest)
    # Clear where the object cannot be, and nearly so where nothing is at stake: what is underneath is to be seen.
    opacity = _OPACITY * np.clip(np.where(known, impact, 0.0) / (_SEEN * highest), _FAINT, 1.0)
    pixels[..., 3] = np.where(known, np.round(255 * opacity), 0)
    return RiskLayer(pixels=pixels, low=low, size=step * np.array(impact.shape[::-1]), highest=highest)


def heat_colours(share: Float[Array, "*shape"]) -> UInt8[Array, "*shape 3"]:
    """Return the colours of `HEAT` for shares of the greatest impact, in [0, 1]."""
    stops = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in HEAT], dtype=float)
    place = np.clip(share, 0.0, 1.0) * (len(stops) - 1)
    channels = [np.interp(place, np.arange(len(stops)), channel) for channel in stops.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)
