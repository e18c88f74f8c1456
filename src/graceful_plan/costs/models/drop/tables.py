"""What the drop model knows about a scene: the carried object's parts and the surfaces that they can land on.

Frames: W world, L the link that the tool rides on, O the carried object. Targets are boxes turned about the vertical
only; everything that can be hit is one, whether somebody minds or not, since obstacles catch things too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import mujoco
import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.core.compile import PLANE_EXTENT, compile_scene
from graceful_plan.costs.models.drop.crowds import simplified
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

Array = np.ndarray

SHAPE_CLASSES = ("box", "cylinder", "plate", "ball")
"""Classes of carried objects, each with constants of its own."""
LEVEL = 0.006
"""Tops that differ by less [m] are met at the same time."""
DISC = 0.9
"""Share of the square around a disc that carries."""
FLAT, ROUND, BALL = 0, 1, 2
"""Kinds of parts: box, cylinder or capsule, sphere."""

_GEOM = mujoco.mjtGeom
_PLATE = 0.35  # least over middle half size below which an object lies flat
_UPRIGHT = 0.9  # cosine above which a round target counts as standing
_DOME = 0.2  # share of a rounded top that carries


@final
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DropTables:
    """Tables of the drop model, in the order in which they are read.

    | field          | meaning                                                          | unit | shape      |
    |----------------|------------------------------------------------------------------|------|------------|
    | shape_class    | index into `SHAPE_CLASSES`                                       |      |            |
    | link           | link that the object rides on                                    |      |            |
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
    | target_centre  | centre seen from above                                           | m    | target 2   |
    | target_axis    | unit x axis seen from above                                      |      | target 2   |
    | target_half    | half sizes along x and y                                         | m    | target 2   |
    | target_diagonal| reach in the directions halfway between x and y                  | m    | target     |
    | target_carries | half sizes of what of the top carries                            | m    | target 2   |
    | target_height  | bottom and top                                                   | m    | target 2   |
    | target_fixed   | 1 for what never moves                                           |      | target     |
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
    """Return the tables of a scene in which something is carried; they are made once.

    Raises:
        UnsupportedError: If the scene cannot be compiled.
    """
    assert scene.carried is not None  # the model asks for tables only then
    model = scene.model
    data = scene.data_at(model.qpos0[scene.qpos_adr])
    mujoco.mj_kinematics(model, data)
    held = [g for g in scene.components["carried"].geoms if _collides(model, g)]
    return DropTables(**_object(scene, data, held), **_targets(scene, data))


def _collides(model: mujoco.MjModel, geom: int) -> bool:
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


# --- the carried object ---------------------------------------------------------------------------------------------


def _object(scene: Scene, data: mujoco.MjData, held: Sequence[int]) -> dict[str, Any]:
    assert scene.carried is not None
    model, robot = scene.model, compile_scene(scene).robot
    body = model.body(scene.carried.body).id
    X_LO = robot.X_LT @ scene.carried.X_TO
    R_WO, p_WO = data.xmat[body].reshape(3, 3), data.xpos[body]
    R_OG = np.array([R_WO.T @ data.geom_xmat[geom].reshape(3, 3) for geom in held])
    # geom_aabb is a box around the geom in the geom's own axes.
    place = np.array([R_WO.T @ (data.geom_xpos[geom] - p_WO) for geom in held])
    place = place + np.einsum("pij,pj->pi", R_OG, model.geom_aabb[held, :3])
    half, kind = model.geom_aabb[held, 3:], [_part_kind(int(model.geom_type[geom])) for geom in held]
    around = np.einsum("pij,pj->pi", np.abs(R_OG), half)
    size = 0.5 * ((place + around).max(axis=0) - (place - around).min(axis=0))
    com = R_WO.T @ (_centre_of_mass(model, data, body) - p_WO)
    main = int(np.argmax(half.prod(axis=1)))
    joint_link = np.array([int(np.flatnonzero(robot.joint == j)[0]) for j in range(len(scene.joints))])
    moves = [float(_moved_by(robot.parent, robot.tool_link, link)) for link in joint_link.tolist()]
    return {
        "shape_class": SHAPE_CLASSES.index(_shape_class(kind[main], np.sort(half[main]))),
        "link": int(robot.tool_link),
        "moves": np.array(moves),
        "joint_link": joint_link,
        "centre": X_LO[:3, :3] @ com + X_LO[:3, 3],
        "part_offset": (place - com) @ X_LO[:3, :3].T,
        "part_rotation": X_LO[:3, :3] @ R_OG,
        "part_half": half.copy(),
        "part_kind": np.array(kind),
        "main": main,
        "size": float(np.sqrt(np.mean(size**2))),
    }


def _centre_of_mass(model: mujoco.MjModel, data: mujoco.MjData, root: int) -> Float[Array, " 3"]:
    """Centre of mass in W of a body with everything that rides on it; the body's origin if it has no mass."""
    bodies = [body for body in range(model.nbody) if _below(model, body, root)]
    mass = model.body_mass[bodies]
    return mass @ data.xipos[bodies] / mass.sum() if mass.sum() > 0.0 else data.xpos[root]


def _below(model: mujoco.MjModel, body: int, root: int) -> bool:
    while body > 0 and body != root:
        body = int(model.body_parentid[body])
    return body == root


def _moved_by(parent: Int[Array, " link"], link: int, joint_link: int) -> bool:
    while link >= 0 and link != joint_link:
        link = int(parent[link])
    return link == joint_link


def _part_kind(geom_type: int) -> int:
    if geom_type == _GEOM.mjGEOM_SPHERE:
        return BALL
    return ROUND if geom_type in (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE) else FLAT


def _shape_class(kind: int, half: Float[Array, " 3"]) -> str:
    if kind == BALL:
        return "ball"
    if half[0] < _PLATE * half[1]:
        return "plate"
    return "cylinder" if kind == ROUND else "box"


# --- what it can land on --------------------------------------------------------------------------------------------


def _targets(scene: Scene, data: mujoco.MjData) -> dict[str, Any]:
    assert scene.carried is not None
    model = scene.model
    owner = {geom: k for k, entity in enumerate(scene.entities.values()) for geom in entity.geoms}
    carried = model.body(scene.carried.body).id
    geoms = [
        geom
        for geom in range(model.ngeom)
        if _collides(model, geom)
        and int(model.geom_bodyid[geom]) not in scene.robot_bodies
        and not _below(model, int(model.geom_bodyid[geom]), carried)
    ]
    boxes = np.array([_turned_box(model, data, geom) for geom in geoms]).reshape(-1, 11)
    fixed = (model.body_weldid[model.geom_bodyid[geoms]] == 0).astype(float)
    boxes, source = simplified(boxes, model.geom_bodyid[geoms])
    order = np.argsort(-boxes[:, 10], kind="stable")
    boxes = boxes[order]
    return {
        "target_entity": np.array([owner.get(geoms[k], -1) for k in source[order].tolist()], dtype=int),
        "target_centre": boxes[:, 0:2],
        "target_axis": boxes[:, 2:4],
        "target_half": boxes[:, 4:6],
        "target_diagonal": boxes[:, 6],
        "target_carries": boxes[:, 7:9],
        "target_height": boxes[:, 9:11],
        "target_fixed": fixed[source[order]],
        "level_start": levels(boxes[:, 10]),
    }


def levels(top: Float[Array, " target"]) -> Int[Array, " level_end"]:
    """Return the first target of each level, and the number of targets; tops are sorted, highest first."""
    start: list[int] = []
    for k, height in enumerate(top):
        if not start or height < top[start[-1]] - LEVEL:
            start.append(k)
    return np.array([*start, len(top)], dtype=int)


def _turned_box(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Float[Array, " 11"]:
    """Return a geom's centre (2), axis (2), half sizes (2), diagonal reach, carrying half sizes (2), bottom and top."""
    kind, R = int(model.geom_type[geom]), data.geom_xmat[geom].reshape(3, 3)
    if kind == _GEOM.mjGEOM_PLANE:  # as wide as in Algorithm 1; its slope is not seen
        half = np.where(model.geom_size[geom] > 0.0, model.geom_size[geom], PLANE_EXTENT) * [1.0, 1.0, 0.0]
        p = data.geom_xpos[geom]
    else:
        half, p = model.geom_aabb[geom, 3:], data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3]
    # The geom's axis that is nearest to horizontal gives the box its direction.
    x = R[:2, int(np.argmin(np.abs(R[2])))]
    x = x / np.linalg.norm(x)
    y = np.array([-x[1], x[0]])
    a, b = np.abs(x @ R[:2]) @ half, np.abs(y @ R[:2]) @ half
    height = np.abs(R[2]) @ half
    diagonal = (a + b) / np.sqrt(2.0)
    standing = abs(R[2, 2]) > _UPRIGHT
    carries = np.array([a, b])
    if kind == _GEOM.mjGEOM_SPHERE or (standing and kind in (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE)):
        a = b = diagonal = half[0]
        carries = np.full(2, a * (DISC if kind == _GEOM.mjGEOM_CYLINDER else _DOME))
    elif kind == _GEOM.mjGEOM_ELLIPSOID:
        carries = _DOME * carries
    elif kind in (_GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE):  # lying: its ridge carries
        along = R[:2, 2] / np.linalg.norm(R[:2, 2])
        carries = carries * ([1.0, _DOME] if abs(along @ x) > np.sqrt(0.5) else [_DOME, 1.0])
    return np.array([*p[:2], *x, a, b, diagonal, *carries, p[2] - height, p[2] + height])
