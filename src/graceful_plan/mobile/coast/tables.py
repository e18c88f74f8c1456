"""Planar view of a scene for the coast model: the footprint of the base and the shapes around it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.mobile.coast.four_wheel import BaseBody
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.model_parts import colliding_geoms, rigid_group, subtree
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

_GEOM = mujoco.mjtGeom
_OVER_THE_FLOOR = 0.03
"""Height above the lowest point of the base below which it rolls over geoms [m]."""
_ROUND = (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_CAPSULE)
_UPRIGHT = 0.99
_ROUNDED = 1e-3
"""Rounding of the mass parameters of a base [m]. Arm postures differ slightly between scenes, and with rounding
they share the cached tables of a robot."""
_WITHIN = 1e-3
"""Largest protrusion from another part at which a part of the footprint is left out [m]."""


@dataclass(frozen=True, eq=False)
class CoastTables:
    """The base, the shapes that it can hit, and those at any height, which an object on its arm can hit.

    | field       | meaning                                                           | unit | shape   |
    |-------------|-------------------------------------------------------------------|------|---------|
    | outline     | parts of the footprint in the frame of the base joints, as shapes | m    | part 7  |
    | entity      | entity index of each shape; -1 for obstacles                      |      | shape   |
    | shape       | planar rectangles: centre, direction, half sizes, rounding radius | m    | shape 7 |
    | body        | mass parameters of the base                                       |      |         |
    | height      | range from the highest part it rolls over to its highest point    | m    | 2       |
    | high_entity | as entity, at any height                                          |      | high    |
    | high_shape  | as shape, at any height                                           | m    | high 7  |
    | high_range  | bottom and top of these shapes                                    | m    | high 2  |
    """

    outline: Float[Array, "part 7"]
    entity: Int[Array, " shape"]
    shape: Float[Array, "shape 7"]
    body: BaseBody
    height: tuple[float, float]
    high_entity: Int[Array, " high"]
    high_shape: Float[Array, "high 7"]
    high_range: Float[Array, "high 2"]


@per_scene
def coast_tables(scene: Scene) -> CoastTables:
    """Compute the tables of a scene with all objects in their initial poses."""
    assert scene.base is not None
    model, data = scene.model, scene.data_at(np.clip(np.zeros(len(scene.joints)), *scene.limits.position.T))
    body = int(model.jnt_bodyid[model.joint(scene.base.joints[2]).id])
    mine = [g for g in colliding_geoms(model, rigid_group(model, body)) if model.geom_type[g] != _GEOM.mjGEOM_PLANE]
    parts = [_from_above(model, data, geom) for geom in mine]
    low, high = min(bottom for _, bottom, _ in parts), max(top for *_, top in parts)
    owner = {geom: k for k, entity in enumerate(scene.entities.values()) for geom in entity.geoms}
    robot = scene.robot_bodies | ({model.body(scene.carried.body).id} if scene.carried is not None else set())
    rows = []
    for geom in range(model.ngeom):
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        if int(model.geom_bodyid[geom]) in robot or not collides or model.geom_type[geom] == _GEOM.mjGEOM_PLANE:
            continue
        rows.append((owner.get(geom, -1), *_from_above(model, data, geom)))
    entity = np.array([row[0] for row in rows], dtype=np.int32)
    shape = np.array([row[1] for row in rows]).reshape(-1, 7)
    heights = np.array([row[2:] for row in rows], dtype=float).reshape(-1, 2)
    met = (heights[:, 0] < high) & (heights[:, 1] > low + _OVER_THE_FLOOR)
    return CoastTables(
        outline=_outline(np.array([row for row, *_ in parts]), data.qpos[scene.qpos_adr[:3]]),
        entity=entity[met],
        shape=shape[met],
        body=_body(scene.base, model, data, body),
        height=(low + _OVER_THE_FLOOR, high),
        high_entity=entity,
        high_shape=shape,
        high_range=heights,
    )


def _body(base: DiffDrive, model: mujoco.MjModel, data: mujoco.MjData, body: int) -> BaseBody:
    """Sum the masses that move with the base, with the arm in its current posture."""
    bodies = sorted(subtree(model, body))
    mass, x = model.body_mass[bodies], data.xipos[bodies][:, :2]
    total = float(mass.sum())
    centre = mass @ x / max(total, 1e-9)
    R = data.ximat[bodies].reshape(-1, 3, 3)
    about = (R[:, 2] ** 2 * model.body_inertia[bodies]).sum(axis=1) + mass * ((x - centre) ** 2).sum(axis=1)
    gyration = float(np.sqrt(about.sum() / total)) if total > 0.0 else base.track
    middle = data.xpos[[model.body(name).id for name in base.wheels] or [body]][:, :2].mean(axis=0)
    from_origin = np.array([centre, middle]) - data.xpos[body][:2]
    (cx, cy), (mx, my) = from_origin @ data.xmat[body].reshape(3, 3)[:2, :2]
    return BaseBody(
        base=base,
        mass=max(total, 1e-9),
        gyration=max(_rounded(gyration), _ROUNDED),
        centre=(_rounded(cx), _rounded(cy)),
        middle=(_rounded(mx), _rounded(my)),
    )


def _rounded(length: float) -> float:
    return round(float(length) / _ROUNDED) * _ROUNDED


def _outline(rows: Float[Array, "geom 7"], pose: Float[Array, " 3"]) -> Float[Array, "part 7"]:
    """Transform the parts into the frame of the base and drop those contained in others."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    to_base = np.array([[c, s], [-s, c]])
    rows = np.column_stack([(rows[:, :2] - pose[:2]) @ to_base.T, rows[:, 2:4] @ to_base.T, rows[:, 4:]])
    rows = rows[np.argsort(-(rows[:, 4] + rows[:, 6]) * (rows[:, 5] + rows[:, 6]), kind="stable")]
    kept: list[Float[Array, " 7"]] = []
    for row in rows:
        if not any(_is_within(row, other) for other in kept):
            kept.append(row)
    return np.array(kept)


def _is_within(row: Float[Array, " 7"], other: Float[Array, " 7"]) -> bool:
    """Whether a rounded rectangle lies within another one, up to a small tolerance."""
    x, y = row[2:4], np.array([-row[3], row[2]])
    corners = np.array([row[:2] + a * row[4] * x + b * row[5] * y for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    u, w = corners - other[:2], np.stack([other[2:4], [-other[3], other[2]]])
    beyond = np.abs(u @ w.T) - other[4:6]
    outside = np.hypot(*np.maximum(beyond, 0.0).T) + np.minimum(beyond.max(axis=1), 0.0)
    return bool((outside + row[6] <= other[6] + _WITHIN).all())


def _from_above(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Float[Array, " 7"], float, float]:
    """Return a geom's planar shape (centre, direction, half sizes, rounding radius), its bottom and its top [m]."""
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
