"""Edit the surroundings: add bodies to a MjSpec, move them, remove them."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count
from typing import final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SceneError, SettingError, ShapeError, UnknownNameError, UnsupportedError
from graceful_plan.path import finite_array, plain_numbers, real_array
from graceful_plan.scene.loading.naming import check_new
from graceful_plan.scene.model_parts import ancestors, find
from graceful_plan.scene.roles import free_joint, rigid_pose

_GEOM = mujoco.mjtGeom
_KINDS = {
    "box": (_GEOM.mjGEOM_BOX, 3),
    "sphere": (_GEOM.mjGEOM_SPHERE, 1),
    "cylinder": (_GEOM.mjGEOM_CYLINDER, 2),
    "capsule": (_GEOM.mjGEOM_CAPSULE, 2),
}
"""MuJoCo type and number of sizes of each kind of geom."""
Pose = tuple[Float[Array, " 3"], Float[Array, " wxyz"]]
"""Position [m] and quaternion in W."""
_POSES = ("body_pos", "body_quat", "qpos0", "qpos_spring")
"""Fields of a model that depend on the poses of its bodies."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class StaticBody:
    """A static body to add to a scene.

    | field  | meaning                                                                                 | unit |
    |--------|-----------------------------------------------------------------------------------------|------|
    | name   | of the new body                                                                         |      |
    | kind   | "box", "sphere", "cylinder" or "capsule" along z, or "mesh": the convex hull of points  |      |
    | size   | half sizes of a box; radius; radius and half of the (straight) length; mesh points      | m    |
    | pose   | in W, as a 4 x 4 matrix, or the position of its centre                                  | m    |
    | entity | entity class if it can be harmed; None for an obstacle only                             |      |
    """

    name: str
    kind: str
    size: float | Sequence[float] | ArrayLike
    pose: ArrayLike
    entity: str | None = None

    def __post_init__(self) -> None:
        plain_numbers(self)
        if self.kind not in (*_KINDS, "mesh"):
            raise UnknownNameError("kind of solid", self.kind, (*_KINDS, "mesh"))

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add a body with this one geom.

        Raises:
            SettingError: If a size is not above 0.
            SceneError: If the name is taken, or the points lie in a plane.
        """
        if self.kind == "mesh":
            add_hull(spec, self.name, self.size, self.pose)
            return
        kind, sizes = _KINDS[self.kind]
        try:
            size = np.atleast_1d(real_array("size", self.size))
        except ShapeError:
            raise SettingError(f"size of {self.name}", self.size, f"{sizes} lengths above 0") from None
        add_primitive(spec, self.name, kind, finite_array(f"size of {self.name}", size, ndim=1, last=sizes), self.pose)


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
    """Add a body with the convex hull of given points.

    Raises:
        SceneError: If the name is taken or the points lie in a plane.
    """
    points = finite_array(f"vertices of {name}", vertices, ndim=2, last=3)
    if len(points) < 4 or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-6) < 3:
        raise SceneError(f"the vertices of {name!r} have no volume")
    check_new(spec, name)
    mesh = _mesh_name(spec, name)
    spec.add_mesh(name=mesh, uservert=points.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
    _add_body(spec, name, pose).add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh)


def _mesh_name(spec: mujoco.MjSpec, name: str) -> str:
    """Return an unused name for a body's mesh; an unused mesh left by a removed body of this name is deleted first."""
    used = {geom.meshname for geom in spec.geoms}
    left = spec.mesh(name)
    if left is not None and name not in used:
        spec.delete(left)
    return next(one for one in chain([name], (f"{name}#{i}" for i in count(1))) if spec.mesh(one) is None)


def _add_body(spec: mujoco.MjSpec, name: str, pose: ArrayLike) -> mujoco.MjsBody:
    check_new(spec, name)
    position, quaternion = _position_and_quaternion(_pose(name, pose))
    return spec.worldbody.add_body(name=name, pos=position, quat=quaternion)


def _pose(name: str, pose: ArrayLike) -> Float[Array, "4 4"]:
    if np.ndim(pose) != 1:
        return rigid_pose(f"pose of {name}", pose)
    X_WO = np.eye(4)
    X_WO[:3, 3] = finite_array(f"pose of {name}", pose, last=3)
    return X_WO


def _position_and_quaternion(X: Float[Array, "4 4"]) -> Pose:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, X[:3, :3].ravel())
    return X[:3, 3].copy(), quaternion


def removed(spec: mujoco.MjSpec, model: mujoco.MjModel, name: str, kept: frozenset[int]) -> None:
    """Remove a body with its subtree from a MjSpec.

    Args:
        spec: The MjSpec to change.
        model: The model compiled from it.
        name: Name of the body.
        kept: Bodies that must stay: the robot and the object it holds.

    Raises:
        UnknownNameError: If there is no such body.
        SceneError: If the body must stay.
    """
    body = find(model, mujoco.mjtObj.mjOBJ_BODY, "body", name)
    if body == 0 or body in _carrying(model, kept):
        raise SceneError(f"{name!r} is part of the robot, or holds it or is held by it; it cannot be removed")
    if spec.body(name) is not None:  # it may have gone with another
        spec.delete(spec.body(name))


def _carrying(model: mujoco.MjModel, kept: frozenset[int]) -> set[int]:
    """Return the given bodies with all bodies that carry them."""
    return {body for other in kept for body in ancestors(model, other)}


@final
class PosedModel:
    """A model and its MjSpec in which some bodies have been moved; both are copied only when they are read.

    Models of robots with meshes take tens of megabytes, so a scene whose obstacles move must not copy one.

    Args:
        declared: The MjSpec, which must not change any more.
        shapes: The model compiled from it, which must not change either.
        poses: Position [m] and quaternion wxyz in W by body, for children of the world body.
    """

    def __init__(
        self, declared: mujoco.MjSpec, shapes: mujoco.MjModel, poses: Mapping[str, Pose] | None = None
    ) -> None:
        self._declared, self.shapes, self._poses = declared, shapes, dict(poses or {})

    def moved(self, poses: Mapping[str, Pose]) -> PosedModel:
        """Return the same model with more bodies elsewhere."""
        return PosedModel(self._declared, self.shapes, {**self._poses, **poses}) if poses else self

    def in_frame(self, body: str) -> bool:
        """Return whether the MjSpec gives the pose of a body in another frame."""
        return self._declared.body(body).frame is not None

    def pose(self, body: int) -> Pose:
        """Return the pose of a body in its parent: position [m] and quaternion."""
        moved = self._poses.get(self.shapes.body(body).name)
        return (np.array(self.shapes.body_pos[body]), np.array(self.shapes.body_quat[body])) if moved is None else moved

    def copy_poses_to(self, model: mujoco.MjModel) -> None:
        """Give the bodies of another copy of the model their poses."""
        for name in _POSES:
            getattr(model, name)[:] = getattr(self.shapes, name)
        for name, (position, quaternion) in self._poses.items():
            body = model.body(name).id
            model.body_pos[body], model.body_quat[body] = position, quaternion
            adr = free_joint(model, body)
            if adr >= 0:
                model.qpos0[adr : adr + 7] = model.qpos_spring[adr : adr + 7] = [*position, *quaternion]

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The model with all bodies in their poses; read only."""
        if not self._poses:
            return self.shapes
        model = copy.copy(self.shapes)
        self.copy_poses_to(model)
        return model

    @cached_property
    def spec(self) -> mujoco.MjSpec:
        """The MjSpec with all bodies in their poses; copy it before any change."""
        if not self._poses:
            return self._declared
        spec = self._declared.copy()
        for name, (position, quaternion) in self._poses.items():
            body = spec.body(name)
            body.pos, body.quat = position, quaternion
            body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        return spec


def moved(posed: PosedModel, poses: Mapping[str, ArrayLike], kept: frozenset[int]) -> PosedModel:
    """Return a model with some bodies moved; nothing is recompiled or copied.

    Args:
        posed: The model.
        poses: New poses in W by body, as 4 x 4 matrices, or as positions that keep the orientation.
        kept: Bodies that must stay.

    Raises:
        UnknownNameError: If there is no such body.
        SceneError: If the body must stay.
        UnsupportedError: If its parent is not the world, or its pose is given in another frame.
    """
    model, new = posed.shapes, {}
    carrying = _carrying(model, kept)
    for name, pose in poses.items():
        body = find(model, mujoco.mjtObj.mjOBJ_BODY, "body", name)
        if body == 0 or body in carrying:
            raise SceneError(f"{name!r} is part of the robot, or holds it or is held by it; it cannot be moved")
        adr, joints = free_joint(model, body), int(model.body_jntnum[body])
        if model.body_parentid[body] != 0 or joints > (adr >= 0) or posed.in_frame(name):
            raise UnsupportedError(f"{name!r} is not a child of the world body; move its parent")
        position, quaternion = _position_and_quaternion(_pose(name, pose))
        new[name] = position, posed.pose(body)[1] if np.ndim(pose) == 1 else quaternion
    return posed.moved(new)
