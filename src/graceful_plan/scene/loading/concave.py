"""Divide concave meshes of the surroundings into convex parts: MuJoCo collides with hulls, which close bins."""

from __future__ import annotations

import logging

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.model_parts import colliding_geoms, geom_label, robot_bodies
from graceful_plan.scene.specs import compile_spec
from graceful_plan.scene.urdf.convex_parts import convex_parts

_LOG = logging.getLogger(__name__)

CHOICES = (None, "hull", "parts")
_COPIED = ("contype", "conaffinity", "condim", "priority", "friction", "solmix", "solref", "solimp", "margin", "gap",
           "rgba")  # fmt: skip
"""Fields of a geom that its parts share."""
_GROUP = 3
"""Group of the parts: by convention that of collision geometry, which viewers hide."""


def divide_surroundings(spec: mujoco.MjSpec, robot: str, convex: str | None) -> None:
    """Replace colliding meshes outside of the robot by convex parts, where their hulls stick out.

    The mesh itself keeps its look and mass, but does not collide. The parts of a geom "bin" are "bin#0", "bin#1" and so
    on.

    Args:
        spec: The model, which is changed.
        robot: Prefix of the robot's bodies, or its root body.
        convex: "hull": nothing is divided. "parts": all meshes are. None: all are if the library is installed, and a
            warning names those that count as hulls if it is not.

    Raises:
        SettingError: If `convex` is unknown.
        UnsupportedError: If `convex` is "parts" and the library is missing.
    """
    if convex not in CHOICES:
        raise SettingError("convex", convex, "'hull', 'parts' or None")
    if convex == "hull" or not len(spec.meshes):
        return
    model = compile_spec(spec)
    mine, paired = robot_bodies(model, robot), {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
    others = colliding_geoms(model, frozenset(range(model.nbody)) - mine)
    meshes = [g for g in others if int(model.geom_type[g]) == int(mujoco.mjtGeom.mjGEOM_MESH)]
    parts: dict[int, list[Float[Array, "_ 3"]]] = {}
    geoms = {geom.id: geom for geom in spec.geoms}  # ids change once parts are added
    for g in meshes:
        mesh = int(model.geom_dataid[g])
        if mesh not in parts:
            name = f"mesh {model.mesh(mesh).name!r} of {geom_label(model, g)!r}"
            parts[mesh] = convex_parts(_triangles(model, mesh), name, needed=convex == "parts")
        if parts[mesh] and g in paired:
            _LOG.warning(
                "%r counts as its convex hull because the model lists its contacts in pairs", geom_label(model, g)
            )
        elif parts[mesh]:
            _divide(spec, model, g, geoms[g], parts[mesh])


def _divide(
    spec: mujoco.MjSpec, model: mujoco.MjModel, g: int, geom: mujoco.MjsGeom, parts: list[Float[Array, "_ 3"]]
) -> None:
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[g])
    for k, part in enumerate(parts):
        mesh = spec.add_mesh(inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
        mesh.name = f"{model.mesh(model.geom_dataid[g]).name}#{g}#{k}"
        mesh.uservert = (part @ R.reshape(3, 3).T + model.geom_pos[g]).ravel()
        piece = geom.parent.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, mass=0.0, group=_GROUP)
        if geom.name:
            piece.name = f"{geom.name}#{k}"
        for field in _COPIED:
            setattr(piece, field, getattr(geom, field))
    geom.contype = geom.conaffinity = 0


def _triangles(model: mujoco.MjModel, mesh: int) -> Float[Array, "triangle 3 3"]:
    """Return the triangles of a mesh in its own frame [m]."""
    vertices = slice(int(model.mesh_vertadr[mesh]), int(model.mesh_vertadr[mesh] + model.mesh_vertnum[mesh]))
    faces = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh] + model.mesh_facenum[mesh]))
    return model.mesh_vert[vertices].astype(float)[model.mesh_face[faces]]
