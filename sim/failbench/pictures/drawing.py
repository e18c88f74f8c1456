"""Drawings for pictures of a failure: hit entities, contact points and forces, and the healthy robot's outline."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from failbench.simulated.world import World
from graceful_plan.array_types import Array, Bool, Float, Int, UInt8

_LINGER = 0.12
"""Time for which a touch is drawn [s]; most touches last a few milliseconds."""
_LENGTH = 0.01
"""Length of an arrow for 1 N [m]; it grows with the root of the force, so that weights and hits are both visible."""
_LONGEST = 0.2
_WIDTH = 0.007
_POINT = 0.007
_FORCE = np.array([0.93, 0.0, 0.55, 1.0], dtype=np.float32)
_STRUCK = (1.0, 0.88, 0.1)
_FURNITURE = ("floor", "table")
"""Categories too large to be coloured; only their contact points are drawn."""
_HEALTHY = np.array([21, 101, 216])
_LINE = 2
"""Width of an outline [pixels]."""
_FILL = 0.12
"""Opacity inside an outline."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Touch:
    """Touch of one entity by one component in one step. Positions in W [m], force on the entity [N]."""

    time: float
    points: Float[Array, "contact xyz"]
    position: Float[Array, " xyz"]
    force: Float[Array, " xyz"]

    @property
    def strength(self) -> float:
        return float(np.linalg.norm(self.force))


class TouchPaint:
    """Collects the hits of the robot and the carried object, and draws them.

    Touches of the healthy run, and touches between entities, are not drawn.

    Args:
        world: The simulated world.
        baseline: Components and entities that touch in the healthy run.
    """

    def __init__(self, world: World, baseline: frozenset[tuple[str, str]]) -> None:
        self._components, self._entities = tuple(world.striker_bodies), tuple(world.scene.entities)
        self._component = np.full(world.model.ngeom, -1)
        self._entity = np.full(world.model.ngeom, -1)
        for i, name in enumerate(self._components):
            self._component[list(world.scene.components[name].geoms)] = i
        for i, entity in enumerate(world.scene.entities.values()):
            self._entity[list(entity.geoms)] = i
        self._furniture = {entity.name for entity in world.scene.entities.values() if entity.category in _FURNITURE}
        self._baseline = baseline
        self._colours = world.model.geom_rgba.copy(), world.model.geom_matid.copy()
        self._recent: dict[tuple[str, str], list[_Touch]] = {}
        self.struck: set[str] = set()
        """The entities that have been hit."""

    def observe(self, model: mujoco.MjModel, data: mujoco.MjData, time: float) -> None:
        """Process the contacts of one step, at `time` [s]."""
        self._recent = {
            pair: kept
            for pair, touches in self._recent.items()
            if (kept := [touch for touch in touches if touch.time > time - _LINGER])
        }
        for pair, (contacts, signs) in self._pairs(data.contact.geom).items():
            if pair in self._baseline:
                continue
            forces = np.array([sign * _force(model, data, i) for i, sign in zip(contacts, signs, strict=True)])
            points = data.contact.pos[contacts].copy()
            touch = _Touch(time=time, points=points, position=points.mean(axis=0), force=forces.sum(axis=0))
            self._recent.setdefault(pair, []).append(touch)
            self.struck.add(pair[1])

    def _pairs(self, geoms: Int[Array, "contact 2"]) -> dict[tuple[str, str], tuple[list[int], list[float]]]:
        """Group contacts by component and entity, with the signs that turn each force into the one on the entity."""
        found: dict[tuple[str, str], tuple[list[int], list[float]]] = {}
        for striker, struck, sign in ((0, 1, 1.0), (1, 0, -1.0)):
            component, entity = self._component[geoms[:, striker]], self._entity[geoms[:, struck]]
            for i in np.flatnonzero((component >= 0) & (entity >= 0)):
                pair = self._components[component[i]], self._entities[entity[i]]
                contacts, signs = found.setdefault(pair, ([], []))
                contacts.append(int(i))
                signs.append(sign)
        return found

    def paint(self, model: mujoco.MjModel) -> None:
        """Colour exactly the entities that were hit, in a model used only for rendering."""
        model.geom_rgba[:], model.geom_matid[:] = self._colours
        for entity in self.struck - self._furniture:
            geoms = self._entity == self._entities.index(entity)
            model.geom_rgba[geoms, :3], model.geom_matid[geoms] = _STRUCK, -1

    def draw(self, view: Any) -> None:
        """Draw the strongest recent touch of each pair into an MjvScene."""
        for touches in self._recent.values():
            touch = max(touches, key=lambda touch: touch.strength)
            for point in touch.points:
                _add(view, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, _POINT), point)
            if touch.strength > 0.0:
                _add_arrow(view, touch)


def add_geoms(view: Any, model: mujoco.MjModel, data: mujoco.MjData, bodies: Collection[int]) -> None:
    """Add the geoms of moving bodies to an MjvScene, at their poses in `data`."""
    first = view.ngeom
    dynamic = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
    mujoco.mjv_addGeoms(model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), dynamic, view)
    for geom in view.geoms[first : view.ngeom]:
        if geom.objtype != mujoco.mjtObj.mjOBJ_GEOM or model.geom_bodyid[geom.objid] not in bodies:
            geom.rgba[3] = 0.0


def outlined(
    pixels: UInt8[Array, "height width 3"], silhouette: Bool[Array, "height width"]
) -> UInt8[Array, "height width 3"]:
    """Return a picture with a silhouette drawn over it: a solid outline and a light fill."""
    padded = np.pad(silhouette, _LINE)
    inside = silhouette.copy()
    for axis in (0, 1):
        for shift in (-_LINE, _LINE):
            inside &= np.roll(padded, shift, axis)[_LINE:-_LINE, _LINE:-_LINE]
    opacity = np.where(inside, _FILL, np.where(silhouette, 1.0, 0.0))[..., None]
    return (opacity * _HEALTHY + (1.0 - opacity) * pixels).astype(np.uint8)


def _force(model: mujoco.MjModel, data: mujoco.MjData, contact: int) -> Float[Array, " xyz"]:
    """Return the force of a contact on the second of its geoms, in W [N]."""
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, contact, force)
    return data.contact.frame[contact].reshape(3, 3).T @ force[:3]


def _add_arrow(view: Any, touch: _Touch) -> None:
    """Add an arrow that points at the hit entity, along the force on it."""
    length = min(_LENGTH * np.sqrt(touch.strength), _LONGEST)
    tail = touch.position - touch.force / touch.strength * length
    geom = _add(view, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), touch.position)
    if geom is not None:
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, _WIDTH, tail, touch.position)


def _add(view: Any, kind: mujoco.mjtGeom, size: Float[Array, " 3"], position: Float[Array, " xyz"]) -> Any:
    """Append a geom to an MjvScene and return it; return None if the scene is full."""
    if view.ngeom >= view.maxgeom:
        return None
    geom = view.geoms[view.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, position, np.eye(3).ravel(), _FORCE)
    geom.emission = 0.5
    view.ngeom += 1
    return geom
