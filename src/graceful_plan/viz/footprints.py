"""A scene from above: outlines of geoms, and the path of the carried object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.scene.scene import Scene

_GEOM = mujoco.mjtGeom
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(len(_ANGLES))])
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def surface_points(scene: Scene, data: mujoco.MjData, geom: int) -> Float[Array, "point 3"]:
    """Return points in W [m] whose convex hull approximates a geom; none for a plane."""
    model, kind = scene.model, _GEOM(int(scene.model.geom_type[geom]))
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
    """Compute the convex outline of points from above, counter-clockwise (Andrew's monotone chain)."""
    flat = [tuple(p) for p in np.unique(points[:, :2], axis=0)]

    def half(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for p in ordered:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0.0:
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return np.array(half(flat) + half(flat[::-1]) or flat)


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Return twice the signed area of a triangle, positive for a left turn."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def object_positions(scene: Scene, path: Path) -> Float[Array, "n 3"]:
    """Return the position in W of the carried object, or else of the tool, at each vertex [m]."""
    positions = []
    for q in path.q:
        data = scene.data_at(q)
        here = data.site(scene.tool) if scene.carried is None else data.body(scene.carried.body)
        positions.append(here.xpos.copy())
    return np.array(positions)


def entity_outlines(scene: Scene, names: Sequence[str]) -> Mapping[str, list[Float[Array, "_ 2"]]]:
    """Return the outlines from above of the geoms of each named entity."""
    data = scene.data_at(np.zeros(len(scene.joints)))
    points = {name: [surface_points(scene, data, geom) for geom in scene.entities[name].geoms] for name in names}
    return {name: [outline(p) for p in parts if len(p)] for name, parts in points.items()}
