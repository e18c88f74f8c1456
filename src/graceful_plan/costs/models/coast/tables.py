"""What the coast model sees of a scene: discs of the base, and what stands at its height, both from above."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.costs.models.coast.four_wheel import BaseBody
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.model_parts import colliding_geoms, rigid_group, subtree
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_GEOM = mujoco.mjtGeom
_OVER_THE_FLOOR = 0.03
"""What is lower than this over the lowest point of the base is rolled over or under [m]."""
_ROUND = (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE)
_UPRIGHT = 0.99
_CORNER = 0.25
"""Radius of the discs in the corners, by half of the shorter side."""


@dataclass(frozen=True, eq=False)
class CoastTables:
    """The base and what it may meet.

    | field  | meaning                                                                          | unit | shape   |
    |--------|----------------------------------------------------------------------------------|------|---------|
    | disc   | of the base: centre in the frame of its joints, and radius                       | m    | disc 3  |
    | entity | which entity a shape is of; -1 for obstacles                                     |      | shape   |
    | shape  | rectangles from above: centre, direction, half sizes, and by how much rounded    | m    | shape 7 |
    | body   | its mass, and where it is                                                        |      |         |
    | height | from what it rolls over to its highest point                                     | m    | 2       |
    """

    disc: Float[Array, "disc 3"]
    entity: Int[Array, " shape"]
    shape: Float[Array, "shape 7"]
    body: BaseBody
    height: tuple[float, float]


@per_scene
def coast_tables(scene: Scene) -> CoastTables:
    """Collect them, everything that stands in its initial pose."""
    assert scene.base is not None
    model, data = scene.model, scene.data_at(np.clip(np.zeros(len(scene.joints)), *scene.limits.position.T))
    body = int(model.jnt_bodyid[model.joint(scene.base.joints[2]).id])
    mine = [g for g in colliding_geoms(model, rigid_group(model, body)) if model.geom_type[g] != _GEOM.mjGEOM_PLANE]
    box, low, high = _footprint(model, data, mine, data.qpos[scene.qpos_adr[:3]])
    owner = {geom: k for k, entity in enumerate(scene.entities.values()) for geom in entity.geoms}
    robot = scene.robot_bodies | ({model.body(scene.carried.body).id} if scene.carried is not None else set())
    entity, shape = [], []
    for geom in range(model.ngeom):
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if int(model.geom_bodyid[geom]) in robot or not collides or model.geom_type[geom] == _GEOM.mjGEOM_PLANE:
            continue
        row, bottom, top = _from_above(model, data, geom)
        if bottom < high and top > low + _OVER_THE_FLOOR:
            entity.append(owner.get(geom, -1))
            shape.append(row)
    return CoastTables(
        disc=_discs(*box),
        entity=np.array(entity, dtype=np.int32),
        shape=np.array(shape).reshape(-1, 7),
        body=_body(scene.base, model, data, body),
        height=(low + _OVER_THE_FLOOR, high),
    )


def _body(base: DiffDrive, model: mujoco.MjModel, data: mujoco.MjData, body: int) -> BaseBody:
    """Add up the masses that move with the base, the arm where it is."""
    bodies = sorted(subtree(model, body))
    mass, x = model.body_mass[bodies], data.xipos[bodies][:, :2]
    total = float(mass.sum())
    centre = mass @ x / max(total, 1e-9)
    R = data.ximat[bodies].reshape(-1, 3, 3)
    about = (R[:, 2] ** 2 * model.body_inertia[bodies]).sum(axis=1) + mass * ((x - centre) ** 2).sum(axis=1)
    turned = data.xmat[body].reshape(3, 3)[:2, :2].T @ (centre - data.xpos[body][:2])
    gyration = float(np.sqrt(about.sum() / total)) if total > 0.0 else base.track
    return BaseBody(base=base, mass=max(total, 1e-9), gyration=max(gyration, 1e-3), centre=(turned[0], turned[1]))


def _footprint(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: list[int], pose: Float[Array, " 3"]
) -> tuple[tuple[Float[Array, " 2"], Float[Array, " 2"]], float, float]:
    """Return the box around geoms in the frame of the base: lower and upper corner; and their heights."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    to_base = np.array([[c, s], [-s, c]])
    lower, upper, heights = [], [], []
    for geom in geoms:
        R = data.geom_xmat[geom].reshape(3, 3)
        centre = data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3]
        place = to_base @ (centre[:2] - pose[:2])
        half = np.abs(to_base @ R[:2]) @ model.geom_aabb[geom, 3:]
        lower.append(place - half)
        upper.append(place + half)
        reach = np.abs(R[2]) @ model.geom_aabb[geom, 3:]
        heights += [centre[2] - reach, centre[2] + reach]
    return (np.min(lower, axis=0), np.max(upper, axis=0)), min(heights), max(heights)


def _discs(lower: Float[Array, " 2"], upper: Float[Array, " 2"]) -> Float[Array, "disc 3"]:
    """Cover a rectangle with discs along its longer side, as wide as its shorter one, and a small one in each corner.

    The corners stick out by a tenth of the shorter half side.
    """
    half, centre = 0.5 * (upper - lower), 0.5 * (upper + lower)
    longer = int(np.argmax(half))
    radius, room = float(half[1 - longer]), float(half[longer] - half[1 - longer])
    n = 1 + int(np.ceil(room / max(radius, 1e-9)))
    discs = np.tile([*centre, radius], (n, 1))
    discs[:, longer] += np.linspace(-room, room, n) if n > 1 else 0.0
    small = _CORNER * radius
    corners = [[*(centre + (half - small) * [a, b]), small] for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    return np.concatenate([discs, corners])


def _from_above(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Float[Array, " 7"], float, float]:
    """Return centre, direction, half sizes and rounding of a geom from above, its bottom and its top."""
    kind, R = int(model.geom_type[geom]), data.geom_xmat[geom].reshape(3, 3)
    half, p = model.geom_aabb[geom, 3:], data.geom_xpos[geom] + R @ model.geom_aabb[geom, :3]
    x = R[:2, int(np.argmin(np.abs(R[2])))]
    x = x / np.linalg.norm(x)
    y = np.array([-x[1], x[0]])
    size = np.array([np.abs(x @ R[:2]) @ half, np.abs(y @ R[:2]) @ half])
    reach = float(np.abs(R[2]) @ half)
    rounding = 0.0
    if kind == _GEOM.mjGEOM_SPHERE or (kind in _ROUND and abs(R[2, 2]) > _UPRIGHT):
        rounding = float(model.geom_size[geom, 0])
        size = np.zeros(2)
    return np.array([*p[:2], *x, *size, rounding]), float(p[2] - reach), float(p[2] + reach)
