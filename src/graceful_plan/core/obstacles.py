"""Geoms around the robot, as tables with and without their poses."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.core.arrays import OBSTACLE_TYPES, WorldArrays
from graceful_plan.core.covers import GEOM_KINDS, geom_name, hull_triangles
from graceful_plan.core.link_groups import LinkGroup
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.scene import Scene

_GEOM = mujoco.mjtGeom


@dataclass(frozen=True, kw_only=True, eq=False)
class Obstacles:
    """Geoms around the robot, with the tables that do not depend on where they are.

    | field   | meaning                                                        | unit | shape        |
    |---------|----------------------------------------------------------------|------|--------------|
    | geom    | ids, ascending                                                 |      | obstacle     |
    | kind    | as in `WorldArrays`                                            |      | obstacle     |
    | ignores | as in `WorldArrays`                                            |      | obstacle     |
    | hulls   | corners of triangles of meshes' hulls, in the geom's frame     | m    |              |
    | base    | geoms of the base                                              |      | geom         |
    """

    geom: Int[Array, " obstacle"]
    kind: Int[Array, " obstacle"]
    ignores: Int[Array, " obstacle"]
    hulls: tuple[Float[Array, "_ 3 3"], ...]
    base: Int[Array, " geom"]

    def near_base(self, model: mujoco.MjModel, data: mujoco.MjData) -> bool:
        """Return whether the bounding sphere of an obstacle meets that of a geom of the base; planes count as near."""
        radius = np.where(model.geom_rbound > 0.0, model.geom_rbound, np.inf)
        away = np.linalg.norm(data.geom_xpos[self.geom][:, None] - data.geom_xpos[self.base], axis=2)
        return bool(np.any(away <= radius[self.geom][:, None] + radius[self.base]))


def find_obstacles(scene: Scene, groups: list[LinkGroup]) -> Obstacles:
    """Return the geoms that do not move with the robot but may touch it.

    Raises:
        UnsupportedError: If the kernels do not support the shape of a geom.
    """
    model = scene.model
    moving = {geom for group in groups for geom in group.geoms}
    geoms = sorted({g for group in groups for g in group.partners} - moving)
    n_frame = len(scene.joints) + 1
    kind, ignores, hulls = [], [], []
    for geom in geoms:
        name = GEOM_KINDS.get(_GEOM(int(model.geom_type[geom])))
        if name is None:
            raise UnsupportedError(f"geom {geom_name(model, geom)!r} is a {_GEOM(int(model.geom_type[geom])).name}; "
                                   f"supported: {', '.join(OBSTACLE_TYPES)}")  # fmt: skip
        kind.append(OBSTACLE_TYPES.index(name))
        ignores.append(
            sum(1 << (n_frame + k) for k, group in enumerate(groups[: 62 - n_frame]) if geom not in group.partners)
        )
        mesh = name == "mesh"
        hulls.append(hull_triangles(model, int(model.geom_dataid[geom])) if mesh else np.zeros((0, 3, 3)))
    return Obstacles(
        geom=np.array(geoms, dtype=int),
        kind=np.array(kind, dtype=int),
        ignores=np.array(ignores, dtype=int),
        hulls=tuple(hulls),
        base=np.array([geom for group in groups if group.frame == 0 for geom in group.geoms], dtype=int),
    )


def world_arrays(scene: Scene, data: mujoco.MjData, obstacles: Obstacles) -> WorldArrays:
    """Return the obstacles as the kernels read them, at the poses of `data`."""
    model = scene.shapes
    # Nearest to the base first, since these obstacles collide most often.
    away = np.linalg.norm(data.geom_xpos[obstacles.geom] - data.xpos[min(scene.robot_bodies)], axis=1)
    order = np.argsort(away - model.geom_rbound[obstacles.geom], kind="stable")
    geoms = obstacles.geom[order]
    hulls = [
        obstacles.hulls[k] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        for k, geom in zip(order.tolist(), geoms.tolist(), strict=True)
        if len(obstacles.hulls[k])
    ]
    size = [len(obstacles.hulls[k]) for k in order.tolist()]
    pose = np.concatenate([data.geom_xmat[geoms], data.geom_xpos[geoms]], axis=1)
    radius = np.where(model.geom_type[geoms] == int(_GEOM.mjGEOM_PLANE), -1.0, model.geom_rbound[geoms] + 1e-6)
    return WorldArrays(
        kind=obstacles.kind[order],
        pose=pose,
        size=model.geom_size[geoms].reshape(-1, 3),
        bound=np.column_stack([pose[:, 9:], radius]),
        ignores=obstacles.ignores[order],
        hull_start=np.concatenate([[0], np.cumsum(size, dtype=int)]),
        triangles=np.concatenate([np.zeros((0, 3, 3)), *hulls]),
        geom=geoms,
    )
