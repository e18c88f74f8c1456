"""What a scene looks like from above: outlines of geoms, and where a dropped object would do harm.

Worked out from MuJoCo's geoms with NumPy alone, so a picture does not depend on the kernels that it may have to explain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float, Int

from graceful_plan.path import Path
from graceful_plan.scene import Scene

Array = np.ndarray

_GEOM = mujoco.mjtGeom
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(len(_ANGLES))])
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def surface_points(scene: Scene, data: mujoco.MjData, geom: int) -> Float[Array, "point 3"]:
    """Return points in W whose convex hull looks like the geom; none for a plane."""
    model, kind = scene.model, scene.model.geom_type[geom]
    size = model.geom_size[geom]
    R, p = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    if kind == _GEOM.mjGEOM_PLANE:
        return np.zeros((0, 3))
    if kind in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CAPSULE):
        ends = [p] if kind == _GEOM.mjGEOM_SPHERE else [p + R[:, 2] * size[1], p - R[:, 2] * size[1]]
        poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        return np.concatenate([end + size[0] * np.concatenate([_CIRCLE, poles]) for end in ends])
    if kind == _GEOM.mjGEOM_CYLINDER:
        rims = [_CIRCLE * size[0] + [0.0, 0.0, z] for z in (-size[1], size[1])]
        return p + np.concatenate(rims) @ R.T
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        rings = [_CIRCLE * np.cos(a) + [0.0, 0.0, np.sin(a)] for a in np.linspace(-1.5, 1.5, 11)]
        return p + (np.concatenate(rings) * size) @ R.T
    if kind == _GEOM.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        return p + model.mesh_vert[first : first + count].astype(float) @ R.T
    return p + (_CORNERS * size) @ R.T


def outline(points: Float[Array, "point 3"]) -> Float[Array, "corner 2"]:
    """Return the convex outline of points as seen from above, counter-clockwise."""
    from scipy.spatial import ConvexHull

    flat = points[:, :2]
    return flat[ConvexHull(flat).vertices]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Boxes:
    """Axis-aligned boxes in W, with the row or column of the severity table that each belongs to."""

    lower: Float[Array, "*batch box 3"]
    upper: Float[Array, "*batch box 3"]
    owner: Int[Array, " box"]

    @cached_property
    def membership(self) -> Float[Array, "owner box"]:
        return (self.owner == np.arange(self.owner.max() + 1)[:, None]).astype(float)


def _boxes(scene: Scene, data: mujoco.MjData, owners: Sequence[Sequence[int]]) -> _Boxes:
    geoms = [geom for group in owners for geom in group]
    R = data.geom_xmat[geoms].reshape(-1, 3, 3)
    local = scene.model.geom_aabb[geoms]
    centre = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", R, local[:, :3])
    half = np.einsum("gij,gj->gi", np.abs(R), local[:, 3:])
    owner = np.repeat(np.arange(len(owners)), [len(group) for group in owners])
    return _Boxes(lower=centre - half, upper=centre + half, owner=owner)


@dataclass(frozen=True, kw_only=True, eq=False)
class DropImpact:
    """Algorithm 1 of the paper for what the gripper holds: severity times covered area, over all entities."""

    scene: Scene

    @cached_property
    def components(self) -> tuple[str, ...]:
        """Names of the components that fall when the gripper opens."""
        return tuple(name for name in ("carried", "contents") if name in self.scene.components)

    @cached_property
    def severity(self) -> Float[Array, "component entity"]:
        """Severity of each component for each entity."""
        entities = self.scene.entities.values()
        return np.array([[entity.severity[name] for entity in entities] for name in self.components])

    @cached_property
    def _targets(self) -> _Boxes:
        data = self.scene.data_at(np.zeros(len(self.scene.joints)))
        return _boxes(self.scene, data, [entity.geoms for entity in self.scene.entities.values()])

    def _parts(self, q: Float[Array, " nq"]) -> _Boxes:
        return _boxes(self.scene, self.scene.data_at(q), [self.scene.components[name].geoms for name in self.components])

    def along(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Impact of a drop at each configuration."""
        parts = [self._parts(row) for row in q]
        stacked = _Boxes(
            lower=np.stack([p.lower for p in parts]), upper=np.stack([p.upper for p in parts]), owner=parts[0].owner
        )
        return self._impact(stacked)

    def over_plane(
        self, q: Float[Array, " nq"], x: Float[Array, " nx"], y: Float[Array, " ny"]
    ) -> Float[Array, "ny nx"]:
        """Impact of a drop with the object's body at every (x, y), turned and as high as it is at `q`."""
        assert self.scene.carried is not None
        data = self.scene.data_at(q)
        here = data.body(self.scene.carried.body).xpos[:2]
        shift = np.zeros((len(y), len(x), 1, 3))
        shift[..., 0, 0], shift[..., 0, 1] = x[None, :] - here[0], y[:, None] - here[1]
        parts = self._parts(q)
        return self._impact(_Boxes(lower=parts.lower + shift, upper=parts.upper + shift, owner=parts.owner))

    def _impact(self, parts: _Boxes) -> Float[Array, "*batch"]:
        targets = self._targets
        lower = np.maximum(parts.lower[..., :, None, :2], targets.lower[:, :2])
        upper = np.minimum(parts.upper[..., :, None, :2], targets.upper[:, :2])
        overlap = np.prod(np.maximum(upper - lower, 0.0), axis=-1)
        overlap *= parts.lower[..., :, None, 2] > targets.upper[:, 2]
        overlap = np.einsum("cp,...pt,et->...ce", parts.membership, overlap, targets.membership)
        area_part = np.prod((parts.upper - parts.lower)[..., :2], axis=-1) @ parts.membership.T
        area_target = targets.membership @ np.prod((targets.upper - targets.lower)[:, :2], axis=-1)
        probability = np.minimum(overlap / np.minimum(area_part[..., :, None], area_target), 1.0)
        return np.einsum("...ce,ce->...", probability, self.severity)


def object_positions(scene: Scene, path: Path) -> Float[Array, "n 3"]:
    """Where the carried object's body is in W at each vertex; the tool, if nothing is carried [m]."""
    positions = []
    for q in path.q:
        data = scene.data_at(q)
        here = data.site(scene.tool) if scene.carried is None else data.body(scene.carried.body)
        positions.append(here.xpos.copy())
    return np.array(positions)


def entity_outlines(scene: Scene, names: Sequence[str]) -> Mapping[str, list[Float[Array, "corner 2"]]]:
    """Return the outline of each geom of each named entity, seen from above."""
    data = scene.data_at(np.zeros(len(scene.joints)))
    points = {name: [surface_points(scene, data, geom) for geom in scene.entities[name].geoms] for name in names}
    return {name: [outline(p) for p in parts if len(p)] for name, parts in points.items()}
