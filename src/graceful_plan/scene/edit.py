"""Add bodies to a MjSpec."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SceneError, SettingError
from graceful_plan.path import finite_array
from graceful_plan.scene.roles import rigid_pose

Array = np.ndarray


def add_primitive(
    spec: mujoco.MjSpec, name: str, kind: mujoco.mjtGeom, size: Float[Array, " size"], pose: ArrayLike
) -> None:
    """Add a body with one geom of a MuJoCo type and size.

    Raises:
        SettingError: If a size is not above 0.
        SceneError: If the name is taken.
    """
    if (size <= 0.0).any():
        raise SettingError(f"size of {name}", size.tolist(), "lengths above 0")
    _add_body(spec, name, pose).add_geom(name=name, type=kind, size=[*size, *[0.0] * (3 - len(size))])


def add_hull(spec: mujoco.MjSpec, name: str, vertices: ArrayLike, pose: ArrayLike) -> None:
    """Add a body with the convex hull of some points.

    Raises:
        SceneError: If the name is taken or the points lie in a plane.
    """
    points = finite_array(f"vertices of {name}", vertices, ndim=2, last=3)
    if len(points) < 4 or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6) < 3:
        raise SceneError(f"the vertices of {name!r} have no volume")
    spec.add_mesh(name=name, uservert=points.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
    _add_body(spec, name, pose).add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)


def _add_body(spec: mujoco.MjSpec, name: str, pose: ArrayLike) -> mujoco.MjsBody:
    if not name or spec.body(name) is not None or spec.geom(name) is not None:
        raise SceneError(f"the name {name!r} is empty or taken")
    X_WO = np.eye(4)
    if np.ndim(pose) == 1:
        X_WO[:3, 3] = finite_array(f"pose of {name}", pose, last=3)
    else:
        X_WO = rigid_pose(f"pose of {name}", pose)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, X_WO[:3, :3].ravel())
    return spec.worldbody.add_body(name=name, pos=X_WO[:3, 3], quat=quaternion)
