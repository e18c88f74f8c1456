"""Cover the geoms of links with spheres, once for each shape, and cache the covers.

Covers depend on the robot only, so they stay valid when obstacles change. Their key is the shape they cover. They are
cached in this process and, if they took long to compute, in a folder of the user; see `kept`.
"""

from __future__ import annotations

import hashlib
import time
from collections import OrderedDict
from dataclasses import dataclass
from threading import Lock

import mujoco
import numpy as np

from graceful_plan import disk_cache
from graceful_plan.array_types import Array, Float
from graceful_plan.core import greedy_cover, sphere_cover
from graceful_plan.core.kernels import CAPACITY
from graceful_plan.exceptions import UnsupportedError

_GEOM = mujoco.mjtGeom
GEOM_KINDS = {
    _GEOM.mjGEOM_PLANE: "plane",
    _GEOM.mjGEOM_SPHERE: "sphere",
    _GEOM.mjGEOM_CAPSULE: "capsule",
    _GEOM.mjGEOM_ELLIPSOID: "ellipsoid",
    _GEOM.mjGEOM_CYLINDER: "cylinder",
    _GEOM.mjGEOM_BOX: "box",
    _GEOM.mjGEOM_MESH: "mesh",
}
"""Names of the supported geom types."""
BASE_PROTRUSION = 0.03
"""Largest protrusion of spheres of large geoms of the base [m]; these only keep the arm away from its own base."""
_MANY, _LIKELY_MANY = 200, 1000
"""Numbers of spheres above which a base gets larger ones: as counted, and as estimated from its sizes."""
_MOST_KEPT = 512
"""Largest number of links' covers in memory; the least recently used are dropped first."""
_SLOW = 0.05
"""Covers that took longer to compute are written to the folder [s]; reading one takes a millisecond."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupCover:
    """Spheres that cover the geoms of a link.

    | field      | meaning                                          | unit | shape    |
    |------------|--------------------------------------------------|------|----------|
    | spheres    | centre in the link frame, radius                 | m    | sphere 4 |
    | bound      | a sphere around all spheres                      | m    | 4        |
    | protrusion | largest protrusion of the spheres from the geoms | m    |          |
    """

    spheres: Float[Array, "sphere 4"]
    bound: Float[Array, " 4"]
    protrusion: float


_covers: OrderedDict[bytes, GroupCover] = OrderedDict()
_covers_lock = Lock()


def group_cover(
    model: mujoco.MjModel,
    geoms: tuple[int, ...],
    X_LG: Float[Array, "geom 4 4"],
    *,
    base: bool,
    protrusion: float = sphere_cover.MAX_PROTRUSION,
) -> GroupCover:
    """Return spheres that contain the given geoms of one link.

    Args:
        model: The model.
        geoms: The geoms.
        X_LG: Poses of the geoms in the link.
        base: Whether the link is the base.
        protrusion: Largest protrusion of the spheres [m]. A base that needs many spheres may use `BASE_PROTRUSION`.

    Raises:
        UnsupportedError: If a geom cannot be covered; names it.
    """
    key = hashlib.sha256(X_LG.tobytes() + bytes([base]) + repr(protrusion).encode())
    for geom in geoms:
        key.update(_shape(model, geom))
    digest = key.digest()
    with _covers_lock:
        if digest in _covers:
            _covers.move_to_end(digest)
            return _covers[digest]
    cover = _group_cover(model, geoms, X_LG, base=base, protrusion=protrusion)
    with _covers_lock:
        _covers[digest] = cover
        if len(_covers) > _MOST_KEPT:
            _covers.popitem(last=False)
    return cover


def forget() -> None:
    """Drop the covers in memory; those in the folder stay."""
    with _covers_lock:
        _covers.clear()


def _shape(model: mujoco.MjModel, geom: int) -> bytes:
    """Return the data of a geom that its cover depends on, as bytes."""
    kind = int(model.geom_type[geom])
    shape = bytes([kind]) + model.geom_size[geom].tobytes()
    return shape + _mesh_bytes(model, int(model.geom_dataid[geom])) if kind == _GEOM.mjGEOM_MESH else shape


def _mesh_bytes(model: mujoco.MjModel, mesh: int) -> bytes:
    first, graph = int(model.mesh_vertadr[mesh]), int(model.mesh_graphadr[mesh])
    n_vertex, n_face = (int(n) for n in model.mesh_graph[graph : graph + 2]) if graph >= 0 else (0, 0)
    vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
    return vertices.tobytes() + model.mesh_graph[max(graph, 0) : graph + 2 + 3 * n_vertex + 6 * n_face].tobytes()


def _group_cover(
    model: mujoco.MjModel, geoms: tuple[int, ...], X_LG: Float[Array, "geom 4 4"], *, base: bool, protrusion: float
) -> GroupCover:
    halves = [_half_sizes(model, geom) for geom in geoms]
    reach = [sphere_cover.roomy(half, protrusion) for half in halves]
    # A mobile base with many spheres is not covered finely first just to count them.
    likely = sum(map(sphere_cover.likely_count, halves, reach)) if base else 0.0
    covers = [] if likely > _LIKELY_MANY else _link_covers(model, geoms, X_LG, reach)
    if base and (not covers or sum(len(radii) for _, radii in covers) > _MANY):
        covers = _link_covers(model, geoms, X_LG, [max(BASE_PROTRUSION, far) for far in reach])
    inexact = [far for g, far in zip(geoms, reach, strict=True) if model.geom_type[g] != _GEOM.mjGEOM_SPHERE]
    sticks_out = 0.0 if base else max(inexact, default=0.0)
    all_centres, all_radii = (np.concatenate(of) for of in zip(*covers, strict=True))
    if len(all_radii) <= CAPACITY["spheres"]:  # more are refused anyway, so skip the comparison of all pairs
        keep = _not_inside_others(all_centres, all_radii)
        all_centres, all_radii = all_centres[keep], all_radii[keep]
    spheres = np.column_stack([all_centres, all_radii])
    bound = sphere_cover.enclosing_sphere(all_centres, all_radii)
    spheres.flags.writeable = bound.flags.writeable = False
    return GroupCover(spheres=spheres, bound=bound, protrusion=sticks_out)


def _link_covers(
    model: mujoco.MjModel, geoms: tuple[int, ...], X_LG: Float[Array, "geom 4 4"], reach: list[float]
) -> list[sphere_cover.Cover]:
    """Return covers in the link's frame: one for all hulls with the same protrusion, one for each other geom.

    Hulls are placed relative to the first, so that links with one hull of the same mesh share a cover.
    """
    hulls: dict[float, list[int]] = {}
    found = []
    for k, (geom, far) in enumerate(zip(geoms, reach, strict=True)):
        if model.geom_type[geom] == _GEOM.mjGEOM_MESH:
            hulls.setdefault(far, []).append(k)
        else:
            found.append(_placed(_geom_cover(model, geom, far), X_LG[k]))
    for far, (first, *others) in hulls.items():
        bodies = [hull_triangles(model, int(model.geom_dataid[geoms[first]]))]
        for k in others:
            X = np.linalg.inv(X_LG[first]) @ X_LG[k]
            bodies.append(hull_triangles(model, int(model.geom_dataid[geoms[k]])) @ X[:3, :3].T + X[:3, 3])
        found.append(_placed(_mesh_cover(bodies, far), X_LG[first]))
    return found


def _placed(cover: sphere_cover.Cover, X: Float[Array, "4 4"]) -> sphere_cover.Cover:
    centres, radii = cover
    return centres @ X[:3, :3].T + X[:3, 3], radii


def _not_inside_others(centres: Float[Array, "sphere 3"], radii: Float[Array, " sphere"]) -> Array:
    squared = np.zeros((len(radii), len(radii)))
    for axis in centres.T:
        squared += np.square(axis[:, None] - axis)
    room = radii - radii[:, None] + 1e-9
    contains = (room >= 0.0) & (squared <= np.square(room))  # [i, j]: j contains i
    inner, outer = np.nonzero(contains)
    twins = contains[outer, inner] & (inner <= outer)  # of two equal spheres the first stays, and each contains itself
    keep = np.ones(len(radii), dtype=bool)
    keep[inner[~twins]] = False
    return keep


def _half_sizes(model: mujoco.MjModel, geom: int) -> tuple[float, float, float]:
    a, b, c = (float(x) for x in model.geom_aabb[geom, 3:])
    return a, b, c


def _geom_cover(
    model: mujoco.MjModel, geom: int, protrusion: float = sphere_cover.MAX_PROTRUSION
) -> sphere_cover.Cover:
    size = (float(model.geom_size[geom, 0]), float(model.geom_size[geom, 1]), float(model.geom_size[geom, 2]))
    kind = GEOM_KINDS.get(_GEOM(int(model.geom_type[geom])))
    if kind == "sphere":
        return sphere_cover.sphere_cover(size[0])
    if kind == "capsule":
        return sphere_cover.capsule_cover(size[0], size[1], protrusion)
    if kind == "box":
        return sphere_cover.box_cover(size, protrusion)
    if kind == "cylinder":
        return sphere_cover.cylinder_cover(size[0], size[1], protrusion)
    if kind == "ellipsoid":
        return greedy_cover.ellipsoid_cover(size, protrusion)
    raise UnsupportedError(
        f"geom {geom_name(model, geom)!r} of the robot or the carried object is a {kind or 'geom of unknown type'}; "
        "use spheres, capsules, boxes, cylinders, ellipsoids or convex meshes"
    )


def _mesh_cover(hulls: list[Float[Array, "triangle 3 3"]], protrusion: float) -> sphere_cover.Cover:
    """Cover convex hulls, or read their cover from the folder and check it: a cover with a hole hides collisions."""
    vertices = [np.unique(triangles.reshape(-1, 3), axis=0) for triangles in hulls]
    key = hashlib.sha256(repr((sphere_cover.METHOD, protrusion, [len(triangles) for triangles in hulls])).encode())
    for triangles in hulls:
        key.update(triangles.tobytes())
    digest = key.hexdigest()
    found = disk_cache.read(digest)
    if found is not None and found.ndim == 2 and found.shape[1:] == (4,) and _contains(found, np.concatenate(vertices)):
        return found[:, :3], found[:, 3]
    started = time.perf_counter()
    bodies = [(corners, _planes(triangles)) for corners, triangles in zip(vertices, hulls, strict=True)]
    cover = greedy_cover.hull_cover(bodies, protrusion)
    if time.perf_counter() - started > _SLOW:
        disk_cache.write(digest, np.column_stack(cover))
    return cover


def _contains(spheres: Float[Array, "sphere 4"], points: Float[Array, "n 3"]) -> bool:
    apart = np.linalg.norm(points[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3]
    return bool(np.isfinite(spheres).all() and (apart.min(axis=1, initial=np.inf) <= 1e-9).all())


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or its id and body if it has none."""
    return model.geom(geom).name or f"#{geom} of body {model.body(int(model.geom_bodyid[geom])).name}"


def hull_triangles(model: mujoco.MjModel, mesh: int) -> Float[Array, "triangle 3 3"]:
    """Return the convex hull of a mesh as MuJoCo computed it: triangles, counter-clockwise from outside, mesh frame."""
    first, graph = model.mesh_vertadr[mesh], model.mesh_graphadr[mesh]
    vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(float)
    if graph < 0:
        raise UnsupportedError(f"mesh {model.mesh(mesh).name!r} has no convex hull; use it in a geom that collides")
    n_vertex, n_face = (int(n) for n in model.mesh_graph[graph : graph + 2])
    # The graph holds two counts, an edge address and an id per vertex, the edges, and the vertex ids of the faces.
    faces = graph + 2 + 2 * n_vertex + n_vertex + 3 * n_face
    corners = vertices[model.mesh_graph[faces : faces + 3 * n_face].reshape(-1, 3)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ti,ti->t", normal, corners[:, 0] - corners.mean(axis=(0, 1))) < 0.0
    corners[inward] = corners[inward][:, [0, 2, 1]]
    return corners[np.linalg.norm(normal, axis=1) > 1e-10]


def _planes(triangles: Float[Array, "triangle 3 3"]) -> Float[Array, "triangle 4"]:
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.column_stack([normal, np.einsum("ti,ti->t", normal, triangles[:, 0])])
