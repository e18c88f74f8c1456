"""Checks that a scene can represent a MuJoCo model, which MuJoCo's compiler does not make."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from graceful_plan.exceptions import SceneError, UnsupportedError
from graceful_plan.scene.model_parts import collides, geom_label, names
from graceful_plan.scene.screening import MAX_EXTENT
from graceful_plan.scene.specs import compile_spec

_OBJ = mujoco.mjtObj
_GEOM = mujoco.mjtGeom
_NO_CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)

SUPPORTED_GEOMS = (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_ELLIPSOID,
                   _GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_BOX, _GEOM.mjGEOM_MESH)  # fmt: skip
"""Supported types of colliding geoms; meshes count as their convex hulls, as in MuJoCo."""


def checked_model(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a model and check that a scene can represent it.

    Raises:
        SceneError: If it cannot be compiled or contains numbers that are not finite.
        UnsupportedError: If it has unsupported features.
    """
    model = compile_spec(spec)
    check_numbers(model)
    check_supported(model)
    return model


def check_supported(model: mujoco.MjModel) -> None:
    """Check that a model uses only supported geoms, contacts and bodies.

    Raises:
        UnsupportedError: If it does not; the message lists all unsupported features.
    """
    problems = []
    for geom in np.flatnonzero(collides(model)).tolist():
        kind = _GEOM(model.geom_type[geom])
        if kind not in SUPPORTED_GEOMS:
            problems.append(f"geom {geom_label(model, geom)!r} of type {kind.name.removeprefix('mjGEOM_').lower()}")
    if model.opt.disableflags & _NO_CONTACTS:
        problems.append("contacts switched off by <flag>")
    problems += ["flexible bodies"] * bool(model.nflex) + ["plugins"] * bool(model.nplugin)
    if problems:
        known = ", ".join(kind.name.removeprefix("mjGEOM_").lower() for kind in SUPPORTED_GEOMS)
        raise UnsupportedError(f"not supported: {', '.join(problems)}; geoms that collide may be {known}")


def check_numbers(model: mujoco.MjModel) -> None:
    """Check that numbers are finite, the timestep is above 0, and lengths are at most `MAX_EXTENT`.

    MuJoCo's compiler does not check this.

    Raises:
        SceneError: If a check fails; the message names field and object.
    """
    if not (np.isfinite(model.opt.timestep) and model.opt.timestep > 0.0):
        raise SceneError(f"the timestep is {model.opt.timestep}, it has to be above 0")
    for kind, fields in _FINITE_FIELDS.items():
        for field in fields:
            values = np.asarray(getattr(model, field))
            bad = np.argwhere(~np.isfinite(values))
            if len(bad):
                index = int(bad[0, 0])
                name = "" if kind is None else f" of {names(model, kind, [index])[0]!r}"
                raise SceneError(f"{field}{name} is not finite")
    for kind, field in _LENGTHS:
        values = np.asarray(getattr(model, field))
        far = np.argwhere(np.abs(values) > MAX_EXTENT)
        if len(far):
            index = int(far[0, 0])
            name = "" if kind is None else f" of {names(model, kind, [index])[0]!r}"
            raise SceneError(f"{field}{name} is {values[tuple(far[0])]:g} m; single precision takes {MAX_EXTENT:g} m")


_LENGTHS = (
    (_OBJ.mjOBJ_BODY, "body_pos"),
    (_OBJ.mjOBJ_GEOM, "geom_pos"),
    (_OBJ.mjOBJ_GEOM, "geom_size"),
    (_OBJ.mjOBJ_SITE, "site_pos"),
    (None, "mesh_vert"),
)
_FINITE_FIELDS: Mapping[mujoco.mjtObj | None, tuple[str, ...]] = {
    _OBJ.mjOBJ_BODY: ("body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "body_iquat"),
    _OBJ.mjOBJ_GEOM: ("geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_margin"),
    _OBJ.mjOBJ_JOINT: ("jnt_range", "jnt_pos", "jnt_axis", "jnt_stiffness"),
    _OBJ.mjOBJ_SITE: ("site_pos", "site_quat"),
    None: ("qpos0", "qpos_spring", "mesh_vert", "dof_armature", "dof_damping", "actuator_gainprm", "actuator_biasprm",
           "actuator_forcerange", "key_qpos", "numeric_data"),
}  # fmt: skip
