"""Risk map: the impact of a failure at other places, at the speed and height of a moment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.analysis.impact_maps import impact_map
from graceful_plan.array_types import Array, Float, UInt8
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.exceptions import GracefulPlanError
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.viz.style import HEAT

_CELL, _FLOOR_CELL = 0.025, 0.1
"""Cell width over a table and on a floor [m]."""
_OPACITY, _SEEN, _FAINT = 0.8, 0.3, 0.1
"""Opacity, the fraction of the highest impact from which it applies, and its factor at zero impact."""
_ABOVE = 0.004
"""Height of the layer above the surface [m]."""
_LEAST = 0.3
"""Minimum impact of the darkest colour, so that a map without impact is white."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class RiskLayer:
    """A horizontal picture in the scene.

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
    """Return the map of the impact of a failing base, or of releasing the object, at the speed of a moment.

    None without a carried object, or without entities in reach.

    Args:
        trajectory: The motion.
        scene: Scene of the motion.
        t: Time after the start [s].
        impact: Impact cost.
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
    except GracefulPlanError:  # no surface or no entity in reach, so no map
        return None
    step = np.array([_step(found.x), _step(found.y)])
    low = np.array([found.x[0] - 0.5 * step[0], found.y[0] - 0.5 * step[1], found.surface + _ABOVE])
    return _layer(found.impact, low, step)


def _of_base(trajectory: Trajectory, scene: Scene, t: float, impact: ImpactCost) -> RiskLayer:
    """Return the map of the impact of a failing base, at its present heading and speed."""
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
    """Return the lowest height in W of the boxes around the geoms of the carried object [m]."""
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
    pixels[..., :3] = scale_colours(np.where(known, impact, 0.0) / highest, HEAT)
    # Transparent where the object cannot be, and nearly so without impact, to keep the scene below visible.
    opacity = _OPACITY * np.clip(np.where(known, impact, 0.0) / (_SEEN * highest), _FAINT, 1.0)
    pixels[..., 3] = np.where(known, np.round(255 * opacity), 0)
    return RiskLayer(pixels=pixels, low=low, size=step * np.array(impact.shape[::-1]), highest=highest)


def scale_colours(share: Float[Array, "*shape"], scale: tuple[str, ...]) -> UInt8[Array, "*shape 3"]:
    """Return the colours of a scale, such as `HEAT`, for fractions of the maximum impact, in [0, 1]."""
    stops = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in scale], dtype=float)
    place = np.clip(share, 0.0, 1.0) * (len(stops) - 1)
    channels = [np.interp(place, np.arange(len(stops)), channel) for channel in stops.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)
