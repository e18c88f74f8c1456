"""Simple costs as a user may write them without a model of failures: keep away, do not pass above, carry low.

Each is a `gp.Cost` of a few lines over the boxes around the objects of a scene, as in `docs/extending.md`, and runs in
Python. Severity is that of the table, summed over the carried object and its contents.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import mujoco
import numpy as np

import graceful_plan as gp

Array = np.ndarray

NEAR = 0.15
"""Distance over which the cost decays to 1/e [m], a little more than the width of a hand."""
MARGIN = 0.05
"""Distance beside an object at which the carried object no longer counts as above [m], half its width."""
_WORLD = 100.0
"""Half the width of a plane [m]."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Axis-aligned boxes around geoms, in W.

    Args:
        low: Lower corners [m].
        high: Upper corners [m].
        owner: Index of the object of each geom, ascending, without gaps.
    """

    low: Array
    high: Array
    owner: Array

    def distance(self, p_WQ: Array) -> Array:
        """Return distances of points [n, 3] from the nearest box of each object [m], 0 inside: [n, object]."""
        away = np.maximum(np.maximum(self.low - p_WQ[:, None], p_WQ[:, None] - self.high), 0.0)
        return self._each(np.minimum, np.sqrt(np.square(away).sum(axis=2)))

    def above(self, p_WQ: Array) -> Array:
        """Return 1 for points [n, 3] above an object, decaying to 0 within `MARGIN` beside it: [n, object]."""
        flat, low, high = p_WQ[:, None, :2], self.low[:, :2], self.high[:, :2]
        away = np.maximum(np.maximum(low - flat, flat - high), 0.0)
        share = np.clip(1.0 - np.sqrt(np.square(away).sum(axis=2)) / MARGIN, 0.0, 1.0)
        return self._each(np.maximum, np.where(p_WQ[:, None, 2] > self.high[:, 2], share, 0.0))

    def drop(self, p_WQ: Array) -> Array:
        """Return heights of points [n, 3] above the highest surface below them [m], at most 2: [n]."""
        flat = p_WQ[:, None, :2]
        over = np.all((self.low[:, :2] <= flat) & (flat <= self.high[:, :2]), axis=2)
        below = p_WQ[:, None, 2] - self.high[:, 2]
        return np.where(over & (below >= 0.0), below, 2.0).min(axis=1, initial=2.0)

    def _each(self, reduce: np.ufunc, values: Array) -> Array:
        first = np.flatnonzero(np.diff(self.owner, prepend=-1))
        return reduce.reduceat(values, first, axis=1)


def entity_boxes(scene: gp.Scene) -> Boxes:
    """Return the boxes of the entities of a scene, in their order."""
    return _boxes(scene, [entity.geoms for entity in scene.entities.values()])


def support_boxes(scene: gp.Scene) -> Boxes:
    """Return the boxes of all fixed geoms outside the robot, each as its own object."""
    model = scene.model
    still = (model.body_weldid[model.geom_bodyid] == 0) & ((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    geoms = [g for g in np.flatnonzero(still).tolist() if int(model.geom_bodyid[g]) not in scene.robot_bodies]
    return _boxes(scene, [(g,) for g in geoms])


def _boxes(scene: gp.Scene, things: list[tuple[int, ...]]) -> Boxes:
    data, model = scene.data_at(next(iter(scene.keyframes.values()))), scene.model
    geoms = [g for thing in things for g in thing]
    centre = np.array([data.geom_xpos[g] + data.geom_xmat[g].reshape(3, 3) @ model.geom_aabb[g, :3] for g in geoms])
    half = np.array([np.abs(data.geom_xmat[g].reshape(3, 3)) @ model.geom_aabb[g, 3:] for g in geoms])
    for i, g in enumerate(geoms):
        if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE:  # a floor: its top is at its position
            centre[i], half[i] = data.geom_xpos[g] - [0.0, 0.0, _WORLD], _WORLD
    return Boxes(centre - half, centre + half, np.repeat(np.arange(len(things)), [len(thing) for thing in things]))


def severities(scene: gp.Scene) -> Array:
    """Return the severity of hits by the carried object and its contents: [entity]."""
    parts = [name for name in ("carried", "contents") if name in scene.components] or ["body"]
    return np.array([sum(entity.severity[part] for part in parts) for entity in scene.entities.values()])


@dataclass(frozen=True, eq=False)
class CarriedCost(gp.Cost):
    """A cost of the centre of the carried object, or of the tool without one.

    Args:
        boxes: Boxes of the objects in the cost.
        severity: Severity of each object.
        p_OQ: Centre of the carried object, in its frame [m].
    """

    boxes: Boxes
    severity: Array
    p_OQ: Array

    def state(self, batch: gp.StateBatch) -> Array:
        """Return the density at each state."""
        poses = batch.tool_poses if batch.scene.carried is None else batch.object_poses
        return self.density(poses[:, :3, 3] + poses[:, :3, :3] @ self.p_OQ)

    @abstractmethod
    def density(self, p_WQ: Array) -> Array:
        """Return the density for centres at these points [n, 3]."""


class KeepAway(CarriedCost):
    """Keep away: severity that decays with the distance."""

    def density(self, p_WQ: Array) -> Array:
        """Return the sum of severities, each times exp(- distance / NEAR)."""
        return np.exp(-self.boxes.distance(p_WQ) / NEAR) @ self.severity


class NotAbove(CarriedCost):
    """Do not pass above objects: severity of everything straight below."""

    def density(self, p_WQ: Array) -> Array:
        """Return the sum of the severities below."""
        return self.boxes.above(p_WQ) @ self.severity


class CarryLow(CarriedCost):
    """Carry low: height above the surface below."""

    def density(self, p_WQ: Array) -> Array:
        """Return the height [m]."""
        return self.boxes.drop(p_WQ)


def keep_away(scene: gp.Scene) -> KeepAway:
    """Make the cost for a scene."""
    return KeepAway(entity_boxes(scene), severities(scene), _middle(scene))


def not_above(scene: gp.Scene) -> NotAbove:
    """Make the cost for a scene."""
    return NotAbove(entity_boxes(scene), severities(scene), _middle(scene))


def carry_low(scene: gp.Scene) -> CarryLow:
    """Make the cost for a scene."""
    return CarryLow(support_boxes(scene), np.zeros(0), _middle(scene))


COSTS: Mapping[str, Callable[[gp.Scene], CarriedCost]] = MappingProxyType(
    {"keep away": keep_away, "not above": not_above, "carry low": carry_low}
)
"""Functions that make the costs, by name."""


def _middle(scene: gp.Scene) -> Array:
    """Return the centre of the box around the carried object, in its frame [m]."""
    if scene.carried is None:
        return np.zeros(3)
    model, geoms = scene.model, scene.components["carried"].geoms
    corners = []
    for g in geoms:
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, model.geom_quat[g])
        centre = model.geom_pos[g] + R.reshape(3, 3) @ model.geom_aabb[g, :3]
        half = np.abs(R.reshape(3, 3)) @ model.geom_aabb[g, 3:]
        corners += [centre - half, centre + half]
    return 0.5 * (np.min(corners, axis=0) + np.max(corners, axis=0))
