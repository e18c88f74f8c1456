"""The simplest drop model: a Gaussian around the ballistic landing point, and the sizes of objects."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.special import ndtr

from failbench.calibrations.fitting import Constant, Family
from graceful_plan import Scene
from graceful_plan.scene.placement import Placement

Array = np.ndarray

GRAVITY = 9.81


class Prepared(NamedTuple):
    """Landing point at the height of each entity, and half sizes of both [m]."""

    offset: Array
    """n entity 2"""
    time: Array
    """n entity"""
    half: Array
    """n entity 2"""


class GaussianFamily(Family):
    """P = product over x and y of the probability that the landing point is within both halves."""

    constants = (
        Constant(name="width", prior=0.02, spread=1.0, low=1e-3, high=0.5, unit="m", meaning="spread at no height"),
        Constant(name="speed", prior=0.05, spread=1.0, low=1e-3, high=2.0, unit="m/s", meaning="spread over time"),
        Constant(name="reach", prior=1.0, spread=0.5, low=-1.0, high=4.0, meaning="share of the object's size"),
    )

    def shape(self, scene: Scene) -> str:
        """Return "round" for an object with a cylinder."""
        assert scene.carried is not None
        geoms = scene.model.geom_bodyid == scene.model.body(scene.carried.body).id
        round_ = (scene.model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_CYLINDER).any()
        return "round" if round_ else "box"

    def prepare(self, scene: Scene, q: Array, qd: Array) -> Prepared:
        """Return the ballistic landing point."""
        model, placement = scene.model, Placement(scene)
        own = list(scene.components["carried"].geoms)
        aabb = [_boxes(model, placement.place(x), own) for x in q]
        ahead = [_boxes(model, placement.place(x + 1e-4 * v), own) for x, v in zip(q, qd, strict=True)]
        centre, half = (np.array([box[i] for box in aabb]) for i in (0, 1))
        velocity = (np.array([box[0] for box in ahead]) - centre) / 1e-4
        still = [_boxes(model, placement.place(q[0]), list(entity.geoms)) for entity in scene.entities.values()]
        there, size = (np.array([box[i] for box in still]) for i in (0, 1))
        drop = np.maximum(0.0, (centre - half)[:, None, 2] - (there + size)[None, :, 2])
        up = velocity[:, None, 2]
        time = (up + np.sqrt(up**2 + 2.0 * GRAVITY * drop)) / GRAVITY
        lands = centre[:, None, :2] + velocity[:, None, :2] * time[..., None]
        return Prepared(lands - there[:, :2], time, np.stack(np.broadcast_arrays(half[:, None, :2], size[:, :2])))

    def probability(self, values: Mapping[str, float], prepared: Prepared) -> Array:
        """Return P."""
        spread = np.hypot(values["width"], values["speed"] * prepared.time)[..., None]
        own, other = prepared.half
        reach = np.maximum(other + values["reach"] * own, 0.0)
        return np.prod(ndtr((reach - prepared.offset) / spread) - ndtr((-reach - prepared.offset) / spread), axis=-1)


def _boxes(model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int]) -> tuple[Array, Array]:
    """Return centre and half size of the axis-aligned box around some geoms [m]."""
    turned = data.geom_xmat[geoms].reshape(-1, 3, 3)
    centre = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", turned, model.geom_aabb[geoms, :3])
    half = np.einsum("gij,gj->gi", np.abs(turned), model.geom_aabb[geoms, 3:])
    low, high = (centre - half).min(axis=0), (centre + half).max(axis=0)
    return 0.5 * (low + high), 0.5 * (high - low)
