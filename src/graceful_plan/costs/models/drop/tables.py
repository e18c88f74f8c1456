"""Scene data of the drop model: the carried object's parts and the surfaces that they can land on.

Frames: W world, L the link of the tool, O the carried object. Targets are boxes rotated about the vertical only. All
colliding geoms are targets, with or without a severity, since obstacles catch falling objects, too.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.compile import PLANE_EXTENT, compile_scene
from graceful_plan.core.frames import reference_data
from graceful_plan.core.kernels import CAPACITY
from graceful_plan.costs.models.drop.crowds import simplified
from graceful_plan.costs.models.drop.parts import groups
from graceful_plan.scene.model_parts import subtree
from graceful_plan.scene.per_scene import per_layout, per_scene
from graceful_plan.scene.scene import Scene

_LOG = logging.getLogger(__name__)

SHAPE_CLASSES = ("box", "cylinder", "plate", "ball")
"""Classes of carried objects, each with its own constants."""
LEVEL = 0.006
"""Largest difference of height at which tops belong to one level, reached at the same time [m]."""
DISC = 0.9
"""Share of a disc's bounding square that supports objects."""
FLAT, ROUND, BALL = 0, 1, 2
"""Kinds of parts: box, cylinder or capsule, sphere."""

_PLANE, _SPHERE, _ELLIPSOID, _CYLINDER, _CAPSULE, _BOX = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "ELLIPSOID", "CYLINDER", "CAPSULE", "BOX")
)  # integers: comparing arrays with enums takes fifty times as long
_PLATE = 0.35  # ratio of the least to the middle half size below which an object is a plate
_UPRIGHT = 0.9  # cosine above which a round target counts as standing
_DOME = 0.2  # share of a rounded or steep top that supports objects
_FRICTION = (0.3, 0.7)  # coefficients of most pairs of household materials: a box this steep holds all or no objects


@final
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DropTables:
    """Tables of the drop model, in the order in which they are read.

    | field          | meaning                                                          | unit | shape      |
    |----------------|------------------------------------------------------------------|------|------------|
    | shape_class    | index into `SHAPE_CLASSES`                                       |      |            |
    | link           | link that carries the object                                     |      |            |
    | moves          | 1 for joints that move the object                                |      | nq         |
    | joint_link     | link of each joint                                               |      | nq         |
    | centre         | centre of mass in the link                                       | m    | 3          |
    | part_offset    | centre of each part from the centre of mass, in the link's axes  | m    | part 3     |
    | part_rotation  | axes of each part in the link                                    |      | part 3 3   |
    | part_half      | half sizes; of round parts radius, radius, half length           | m    | part 3     |
    | part_kind      | FLAT, ROUND or BALL                                              |      | part       |
    | main           | part with the largest volume of its box                          |      |            |
    | size           | root mean square of the object's half sizes                      | m    |            |
    | target_entity  | index of the entity, -1 for an obstacle; by top, highest first   |      | target     |
    | target_centre  | centre in top view                                               | m    | target 2   |
    | target_axis    | unit x axis in top view                                          |      | target 2   |
    | target_half    | half sizes along x and y                                         | m    | target 2   |
    | target_diagonal| reach in the directions halfway between x and y                  | m    | target     |
    | target_carries | half sizes of the supporting part of the top                     | m    | target 2   |
    | target_height  | bottom and top                                                   | m    | target 2   |
    | target_fixed   | 1 for targets that never move                                    |      | target     |
    | level_start    | first target of each level, one more entry at the end            |      | level + 1  |
    """

    shape_class: int
    link: int
    moves: Float[Array, " nq"]
    joint_link: Int[Array, " nq"]
    centre: Float[Array, " 3"]
    part_offset: Float[Array, "part 3"]
    part_rotation: Float[Array, "part 3 3"]
    part_half: Float[Array, "part 3"]
    part_kind: Int[Array, " part"]
    main: int
    size: float
    target_entity: Int[Array, " target"]
    target_centre: Float[Array, "target 2"]
    target_axis: Float[Array, "target 2"]
    target_half: Float[Array, "target 2"]
    target_diagonal: Float[Array, " target"]
    target_carries: Float[Array, "target 2"]
    target_height: Float[Array, "target 2"]
    target_fixed: Float[Array, " target"]
    level_start: Int[Array, " level_end"]


@per_scene
def drop_tables(scene: Scene) -> DropTables:
    """Return the tables of a scene with a carried object; they are cached per scene.

    Raises:
        UnsupportedError: If the scene cannot be compiled.
    """
    return DropTables(**_object(scene), **_targets(scene, reference_data(scene)))


def highest_tops(scene: Scene) -> Float[Array, " entity"]:
    """Return the height of the highest target of each entity of a scene with a carried object [m]; -inf if it has none.

    Raises:
        UnsupportedError: If the scene cannot be compiled.
    """
    tables, tops = drop_tables(scene), np.full(len(scene.entities), -np.inf)
    of_entity = tables.target_entity >= 0
    np.maximum.at(tops, tables.target_entity[of_entity], tables.target_height[of_entity, 1])
    return tops


def _collides(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


# --- the carried object ---------------------------------------------------------------------------------------------


@per_layout
def _object(scene: Scene) -> Mapping[str, Any]:
    assert scene.carried is not None  # tables are only built for a carried object
    model, robot = scene.model, compile_scene(scene).robot
    data = reference_data(scene)
    held = [g for g in scene.components["carried"].geoms if _collides(model, g)]
    body = model.body(scene.carried.body).id
    X_LO = robot.X_LT @ scene.carried.X_TO
    R_WO, p_WO = data.xmat[body].reshape(3, 3), data.xpos[body]
    R_OG = np.array([R_WO.T @ data.geom_xmat[geom].reshape(3, 3) for geom in held])
    # geom_aabb is a box around the geom, in the geom's axes.
    place = np.array([R_WO.T @ (data.geom_xpos[geom] - p_WO) for geom in held])
    place = place + np.einsum("pij,pj->pi", R_OG, model.geom_aabb[held, :3])
    half, kind = model.geom_aabb[held, 3:], np.array([_part_kind(int(model.geom_type[geom])) for geom in held])
    around = np.einsum("pij,pj->pi", np.abs(R_OG), half)
    place, R_OG, half, kind, around = _merged(scene.carried.body, place, R_OG, half, kind, around)
    size = 0.5 * ((place + around).max(axis=0) - (place - around).min(axis=0))
    com = R_WO.T @ (_centre_of_mass(model, data, body) - p_WO)
    main = int(np.argmax(half.prod(axis=1)))
    joint_link = np.array([int(np.flatnonzero(robot.joint == j)[0]) for j in range(len(scene.joints))])
    moves = [float(_moved_by(robot.parent, robot.tool_link, link)) for link in joint_link.tolist()]
    return {
        "shape_class": SHAPE_CLASSES.index(_shape_class(int(kind[main]), np.sort(half[main]))),
        "link": int(robot.tool_link),
        "moves": np.array(moves),
        "joint_link": joint_link,
        "centre": X_LO[:3, :3] @ com + X_LO[:3, 3],
        "part_offset": (place - com) @ X_LO[:3, :3].T,
        "part_rotation": X_LO[:3, :3] @ R_OG,
        "part_half": half.copy(),
        "part_kind": kind,
        "main": main,
        "size": float(np.sqrt(np.mean(size**2))),
    }


def _merged(name: str, place: Array, R_OG: Array, half: Array, kind: Array, around: Array) -> tuple[Any, ...]:
    """Return parts of which no more than the core takes are left; several that become one are a box around them."""
    group, excess = groups(place, around, CAPACITY["carried parts"])
    if len(group) == group.max(initial=-1) + 1:
        return place, R_OG, half, kind, around
    _LOG.warning(
        "%r has %d parts; the drop model joins them to %d boxes, which reach up to %.0f mm beyond the object",
        name,
        len(group),
        group.max() + 1,
        1e3 * excess,
    )
    first = np.array([int(np.argmax(group == k)) for k in range(group.max() + 1)])
    place, R_OG, half, kind, around = place.copy(), R_OG.copy(), half.copy(), kind.copy(), around.copy()
    for k, part in enumerate(first.tolist()):
        mine = group == k
        if mine.sum() > 1:
            low, high = (place - around)[mine].min(axis=0), (place + around)[mine].max(axis=0)
            place[part], half[part], around[part] = 0.5 * (low + high), 0.5 * (high - low), 0.5 * (high - low)
            R_OG[part], kind[part] = np.eye(3), FLAT
    return place[first], R_OG[first], half[first], kind[first], around[first]


def _centre_of_mass(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> Float[Array, " 3"]:
    """Return the centre of mass in W of a body and everything attached to it; the body's origin without mass."""
    bodies = sorted(subtree(model, root))
    mass = model.body_mass[bodies]
    return mass @ data.xipos[bodies] / mass.sum() if mass.sum() > 0.0 else data.xpos[root]


def _moved_by(parent: Int[Array, " link"], link: int, joint_link: int) -> bool:
    while link >= 0 and link != joint_link:
        link = int(parent[link])
    return link == joint_link


def _part_kind(geom_type: int) -> int:
    if geom_type == _SPHERE:
        return BALL
    return ROUND if geom_type in (_CYLINDER, _CAPSULE) else FLAT


def _shape_class(kind: int, half: Float[Array, " 3"]) -> str:
    if kind == BALL:
        return "ball"
    if half[0] < _PLATE * half[1]:
        return "plate"
    return "cylinder" if kind == ROUND else "box"


# --- targets ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class _Surfaces:
    """Colliding geoms outside of robot and object: ids, entity (-1: obstacle), body, and whether it is fixed."""

    geom: Int[Array, " target"]
    entity: Int[Array, " target"]
    body: Int[Array, " target"]
    fixed: Float[Array, " target"]


@per_layout
def _surfaces(scene: Scene) -> _Surfaces:
    assert scene.carried is not None
    model = scene.model
    owner = {geom: k for k, entity in enumerate(scene.entities.values()) for geom in entity.geoms}
    own = scene.robot_bodies | subtree(model, int(model.body(scene.carried.body).id))
    geoms = [g for g in range(model.ngeom) if _collides(model, g) and int(model.geom_bodyid[g]) not in own]
    body = model.geom_bodyid[geoms]
    return _Surfaces(
        geom=np.array(geoms, dtype=int),
        entity=np.array([owner.get(geom, -1) for geom in geoms], dtype=int),
        body=body,
        fixed=(model.body_weldid[body] == 0).astype(float),
    )


def _targets(scene: Scene, data: mujoco.MjData) -> dict[str, Any]:
    found = _surfaces(scene)
    boxes, source = simplified(_turned_boxes(scene.shapes, data, found.geom), found.body)
    order = np.argsort(-boxes[:, 10], kind="stable")
    boxes, source = boxes[order], source[order]
    return {
        "target_entity": found.entity[source],
        "target_centre": boxes[:, 0:2],
        "target_axis": boxes[:, 2:4],
        "target_half": boxes[:, 4:6],
        "target_diagonal": boxes[:, 6],
        "target_carries": boxes[:, 7:9],
        "target_height": boxes[:, 9:11],
        "target_fixed": found.fixed[source],
        "level_start": levels(boxes[:, 10]),
    }


def levels(top: Float[Array, " target"]) -> Int[Array, " level_end"]:
    """Return the first target of each level, and the number of targets; tops are sorted, highest first."""
    start: list[int] = []
    below = np.inf
    for k, height in enumerate(top.tolist()):
        if height < below:
            start.append(k)
            below = height - LEVEL
    return np.array([*start, len(top)], dtype=int)


def _turned_boxes(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: Int[Array, " target"]
) -> Float[Array, "target 11"]:
    """Return rows of centre (2), axis (2), half sizes (2), diagonal reach, supporting half sizes (2), bottom, top."""
    kind, R = model.geom_type[geoms], data.geom_xmat[geoms].reshape(-1, 3, 3)
    size, aabb, each = model.geom_size[geoms], model.geom_aabb[geoms], np.arange(len(geoms))
    # Planes are as wide as in Algorithm 1; their slope is ignored.
    plane = kind == _PLANE
    wide = np.where(size > 0.0, size, PLANE_EXTENT) * [1.0, 1.0, 0.0]
    half = np.where(plane[:, None], wide, aabb[:, 3:])
    p = data.geom_xpos[geoms] + np.einsum("tij,tj->ti", R, np.where(plane[:, None], 0.0, aabb[:, :3]))
    # The geom axis nearest to horizontal defines the direction of the box.
    x = R[each, :2, np.abs(R[:, 2]).argmin(axis=1)]
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    axes = np.stack([x, np.stack([-x[:, 1], x[:, 0]], axis=1)], axis=1)
    ab = np.einsum("taj,tj->ta", np.abs(axes @ R[:, :2]), half)
    height = np.einsum("tj,tj->t", np.abs(R[:, 2]), half)
    diagonal = ab.sum(axis=1) / np.sqrt(2.0)
    round_ = (kind == _CYLINDER) | (kind == _CAPSULE)
    standing = np.abs(R[:, 2, 2]) > _UPRIGHT
    disc = (kind == _SPHERE) | (standing & round_)
    ab = np.where(disc[:, None], half[:, :1], ab)
    diagonal = np.where(disc, half[:, 0], diagonal)
    share = np.ones_like(ab)
    share[disc] = np.where(kind[disc] == _CYLINDER, DISC, _DOME)[:, None]
    share[kind == _ELLIPSOID] = _DOME
    lying = round_ & ~standing  # only its ridge supports objects
    along = np.abs(np.einsum("ti,ti->t", R[:, :2, 2], x)) > np.sqrt(0.5) * np.linalg.norm(R[:, :2, 2], axis=1)
    share[lying & along, 1] = _DOME
    share[lying & ~along, 0] = _DOME
    flat = kind == _BOX
    uphill = np.abs(R[:, 2]).max(axis=1)  # cosine between the vertical and the normal of the face that looks up
    slope = np.sqrt(np.maximum(1.0 - uphill**2, 0.0)) / np.maximum(uphill, 1e-9)
    holds = np.clip((_FRICTION[1] - slope) / (_FRICTION[1] - _FRICTION[0]), _DOME, 1.0)
    share[flat] = holds[flat, None]
    bottom, top = p[:, 2] - height, p[:, 2] + height
    return np.column_stack([p[:, :2], x, ab, diagonal, share * ab, bottom, top])
