"""Geometry of bodies: triangles of their geoms, merged by colour, in the body frame B."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.scene.scene import Scene

_GEOM = mujoco.mjtGeom
_SEEN = 3
"""First geom group that is not drawn, as in MuJoCo's viewer: contents, keep-out spaces."""
_AROUND, _ACROSS = 20, 6
"""Number of corners around a round shape, and of rings from a pole of a ball to its equator."""
_ENDLESS = 3.0
"""Half size for drawing an infinite plane [m]."""
_ROBOT, _FLOOR = (0.80, 0.82, 0.85, 1.0), (0.90, 0.91, 0.93, 1.0)
"""Default colours of a robot's geoms and of planes."""
_HARMLESS, _PRECIOUS, _GREATEST = np.array([0.62, 0.70, 0.62]), np.array([0.72, 0.10, 0.12]), 20.0
"""Default colours of entities for severity 0 and from `_GREATEST` on, interpolated by the logarithm."""
_UNCOLOURED = np.full(4, 0.5)
_UNCOLOURED[3] = 1.0
_MOVING = (0.78, 0.35, 0.55, 0.8)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """Triangles of one colour; corners are duplicated for each face at an edge, so that edges look sharp.

    | field    | meaning                            | unit | shape      |
    |----------|------------------------------------|------|------------|
    | vertices | corners in the frame of the part   | m    | vertex 3   |
    | faces    | indices of three corners           |      | face 3     |
    | colour   | red, green, blue, from 0 to 255    |      |            |
    | opacity  | 1 for opaque                       |      |            |
    """

    vertices: Float[Array, "vertex 3"]
    faces: Int[Array, "face 3"]
    colour: tuple[int, int, int]
    opacity: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A rigid drawn part: a body of the scene, or a moving entity."""

    name: str
    meshes: tuple[Mesh, ...]
    body: int
    """Body id in the model of the scene; -1 for a moving entity."""
    entity: str | None
    """Name of its entity, if any."""


def parts(scene: Scene) -> tuple[Part, ...]:
    """Return all drawn parts of a scene, bodies first."""
    model = scene.model
    owner = {int(geom): name for name, entity in scene.entities.items() for geom in entity.geoms}
    found: list[Part] = []
    for body in range(model.nbody):
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        geoms = [g for g in range(first, first + count) if model.geom_group[g] < _SEEN and model.geom_rgba[g, 3] > 0.0]
        entity = next((owner[g] for g in geoms if g in owner), None)
        meshes = _merged(scene, geoms, _plain_colour(scene, body, entity))
        if meshes:
            found.append(Part(name=model.body(body).name, meshes=meshes, body=body, entity=entity))
    found += [
        Part(name=name, meshes=(_moving_mesh(entity),), body=-1, entity=name) for name, entity in scene.moving.items()
    ]
    return tuple(found)


def _plain_colour(scene: Scene, body: int, entity: str | None) -> tuple[float, ...] | None:
    """Return the default colour of the geoms of a body; None for that of MuJoCo."""
    if body in scene.robot_bodies:
        return _ROBOT
    if entity is None:
        return None
    severity = max(scene.entities[entity].severity.values(), default=0.0)
    share = min(1.0, math.log1p(severity) / math.log1p(_GREATEST))
    return (*((1.0 - share) * _HARMLESS + share * _PRECIOUS).tolist(), 1.0)


def _merged(scene: Scene, geoms: list[int], plain: tuple[float, ...] | None) -> tuple[Mesh, ...]:
    """Return the geoms of one body as one mesh per colour."""
    by_colour: dict[tuple[float, ...], list[tuple[Array, Array]]] = defaultdict(list)
    for geom in geoms:
        rgba = tuple(scene.model.geom_rgba[geom].tolist())
        if np.allclose(rgba, _UNCOLOURED):
            rgba = _FLOOR if scene.model.geom_type[geom] == _GEOM.mjGEOM_PLANE else plain or rgba
        triangles = geom_triangles(scene.model, geom)
        if len(triangles[1]):
            by_colour[rgba].append(triangles)
    return tuple(_mesh(shapes, rgba) for rgba, shapes in by_colour.items())


def _mesh(shapes: list[tuple[Array, Array]], rgba: tuple[float, ...]) -> Mesh:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in shapes)])
    red, green, blue = (round(255.0 * min(max(x, 0.0), 1.0)) for x in rgba[:3])
    return Mesh(
        vertices=np.concatenate([vertices for vertices, _ in shapes]),
        faces=np.concatenate([faces + start for (_, faces), start in zip(shapes, starts[:-1], strict=True)]),
        colour=(red, green, blue),
        opacity=float(rgba[3]),
    )


def _moving_mesh(entity: MovingEntity) -> Mesh:
    if entity.is_round:
        shape = _turned(_cylinder_profile(float(entity.size[0]), float(entity.size[1])))
    else:
        shape = _box(entity.half_size)
    return _mesh([shape], _MOVING)


# --- triangles of geoms -----------------------------------------------------------------------------------------------


def geom_triangles(model: mujoco.MjModel, geom: int) -> tuple[Float[Array, "vertex 3"], Int[Array, "face 3"]]:
    """Return the triangles of a geom in the frame of its body; none for unsupported types."""
    kind, size = _GEOM(int(model.geom_type[geom])), model.geom_size[geom]
    if kind == _GEOM.mjGEOM_BOX:
        vertices, faces = _box(size)
    elif kind == _GEOM.mjGEOM_PLANE:
        vertices, faces = _rectangle(*np.where(size[:2] > 0.0, size[:2], _ENDLESS).tolist())
    elif kind == _GEOM.mjGEOM_CYLINDER:
        vertices, faces = _turned(_cylinder_profile(size[0], size[1]))
    elif kind in (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_ELLIPSOID, _GEOM.mjGEOM_CAPSULE):
        vertices, faces = _turned(_ball_profile(half=size[1] / size[0] if kind == _GEOM.mjGEOM_CAPSULE else 0.0))
        vertices = vertices * (size if kind == _GEOM.mjGEOM_ELLIPSOID else size[0])
    elif kind == _GEOM.mjGEOM_MESH:
        vertices, faces = _of_mesh(model, int(model.geom_dataid[geom]))
    elif kind == _GEOM.mjGEOM_HFIELD:
        vertices, faces = _of_heights(model, int(model.geom_dataid[geom]))
    else:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=int)
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    return vertices @ R.reshape(3, 3).T + model.geom_pos[geom], faces


def _box(half: Float[Array, " 3"]) -> tuple[Array, Array]:
    """Return six sides with separate corners."""
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    sides = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (1.0, -1.0):
            side = np.zeros((4, 3))
            side[:, axis] = sign
            side[:, u], side[:, v] = square[:, 0] * sign, square[:, 1]  # reversed, so that it faces outwards
            sides.append(side)
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(6)])
    return np.concatenate(sides) * half, faces


def _rectangle(a: float, b: float) -> tuple[Array, Array]:
    corners = np.array([[-a, -b, 0.0], [a, -b, 0.0], [a, b, 0.0], [-a, b, 0.0]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _cylinder_profile(radius: float, half: float) -> list[Array]:
    """Return bottom, wall and top as lines of radius and height."""
    return [
        np.array([[0.0, -half], [radius, -half]]),
        np.array([[radius, -half], [radius, half]]),
        np.array([[radius, half], [0.0, half]]),
    ]


def _ball_profile(half: float) -> list[Array]:
    """Return the profile of a capsule of radius 1 along z."""
    low = np.linspace(-0.5 * np.pi, 0.0, _ACROSS + 1)
    angle = np.concatenate([low, -low[::-1]]) if half else np.concatenate([low, -low[-2::-1]])
    shift = np.where(np.arange(len(angle)) <= _ACROSS, -half, half)
    return [np.column_stack([np.cos(angle), np.sin(angle) + shift])]


def _turned(profile: list[Array]) -> tuple[Array, Array]:
    """Revolve lines of (radius, height) about z; each line is smooth, with an edge between two."""
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    vertices, faces, start = [], [], 0
    for line in profile:
        rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(_AROUND, z)]) for r, z in line]
        vertices += rings
        i = np.arange(_AROUND)
        j = (i + 1) % _AROUND
        for k in range(len(line) - 1):
            a, b = start + k * _AROUND, start + (k + 1) * _AROUND
            faces += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
        start += len(line) * _AROUND
    points, triangles = np.concatenate(vertices), np.concatenate(faces)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return points, triangles[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12]  # none with zero area


def _of_mesh(model: mujoco.MjModel, mesh: int) -> tuple[Array, Array]:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners = model.mesh_vert[first : first + count].astype(float)[model.mesh_face[start : start + number]]
    return corners.reshape(-1, 3), np.arange(3 * number).reshape(-1, 3)


def _of_heights(model: mujoco.MjModel, field: int) -> tuple[Array, Array]:
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    a, b, top, _ = model.hfield_size[field]
    start = int(model.hfield_adr[field])
    z = model.hfield_data[start : start + rows * columns] * top
    x, y = np.meshgrid(np.linspace(-a, a, columns), np.linspace(-b, b, rows))
    i = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate(
        [np.column_stack([i, i + 1, i + columns + 1]), np.column_stack([i, i + columns + 1, i + columns])]
    )
    return np.column_stack([x.ravel(), y.ravel(), z]), faces
