"""Find the parts of a scene in a MuJoCo model: robot bodies, planned joints and their limits, geoms of bodies.

Except for `add_tool` and `set_limits`, the functions only read the model. They raise if a needed part is missing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import mujoco
import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError, UnsupportedError
from graceful_plan.scene.elements import Limits, Notes
from graceful_plan.scene.loading.naming import is_name, lookup
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.screening import MAX_EXTENT, compile_spec

Array = np.ndarray

_OBJ = mujoco.mjtObj
_GEOM = mujoco.mjtGeom
_JOINT = mujoco.mjtJoint
_NO_CONTACTS = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
_SCALAR_JOINTS = (int(_JOINT.mjJNT_HINGE), int(_JOINT.mjJNT_SLIDE))

_BASE_JOINTS = 3
"""Joints of a base: along x, along y, heading."""

SUPPORTED_GEOMS = (_GEOM.mjGEOM_PLANE, _GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_ELLIPSOID,
                   _GEOM.mjGEOM_CYLINDER, _GEOM.mjGEOM_BOX, _GEOM.mjGEOM_MESH)  # fmt: skip
"""Supported types of colliding geoms; meshes count as their convex hulls, as in MuJoCo."""


def names(model: mujoco.MjModel, kind: mujoco.mjtObj, ids: Iterable[int]) -> list[str]:
    """Return the names of bodies, geoms, joints...; "#3" for an unnamed one with id 3."""
    return [mujoco.mj_id2name(model, kind, int(i)) or f"#{int(i)}" for i in ids]


def geom_label(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom; for an unnamed one, its body's name and the geom's id."""
    return model.geom(geom).name or f"{model.body(model.geom_bodyid[geom]).name}#{geom}"


def find(model: mujoco.MjModel, kind: mujoco.mjtObj, word: str, name: str) -> int:
    """Return an id by name; `word` names the kind in the error message.

    Raises:
        UnknownNameError: If there is no such name.
    """
    found = lookup(model, kind, name)
    if found < 0:
        count = {_OBJ.mjOBJ_BODY: model.nbody, _OBJ.mjOBJ_SITE: model.nsite, _OBJ.mjOBJ_JOINT: model.njnt,
                 _OBJ.mjOBJ_GEOM: model.ngeom}[kind]  # fmt: skip
        raise UnknownNameError(word, name, (n for n in names(model, kind, range(count)) if not n.startswith("#")))
    return found


def subtree(model: mujoco.MjModel, body: int) -> frozenset[int]:
    """Return a body and all its descendants; for the world, only the world itself."""
    inside = {body}
    if body != 0:
        for other, parent in enumerate(model.body_parentid.tolist()):  # parents come first
            if parent in inside:
                inside.add(other)
    return frozenset(inside)


def ancestors(model: mujoco.MjModel, body: int) -> tuple[int, ...]:
    """Return a body and all bodies that carry it, from the body on; without the world."""
    found: list[int] = []
    while body > 0:
        found.append(body)
        body = int(model.body_parentid[body])
    return tuple(found)


def body_joints(model: mujoco.MjModel, body: int) -> range:
    """Return the joints between a body and its parent."""
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body]))


def rigid_group(model: mujoco.MjModel, body: int) -> frozenset[int]:
    """Return a body and all descendants that are rigidly attached to it."""
    return frozenset(b for b in subtree(model, body) if model.body_weldid[b] == model.body_weldid[body])


def collides(model: mujoco.MjModel) -> Bool[Array, " geom"]:
    """Return which geoms take part in collisions."""
    taking_part = (np.asarray(model.geom_contype) != 0) | (np.asarray(model.geom_conaffinity) != 0)
    taking_part[model.pair_geom1] = taking_part[model.pair_geom2] = True
    return taking_part


def colliding_geoms(model: mujoco.MjModel, bodies: Collection[int]) -> tuple[int, ...]:
    """Return the colliding geoms of given bodies, ascending."""
    mine = np.isin(model.geom_bodyid, list(bodies))
    return tuple(np.flatnonzero(mine & collides(model)).tolist())


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


def robot_bodies(model: mujoco.MjModel, robot: str) -> frozenset[int]:
    """Return the robot's bodies: the body of this name, else all bodies whose names start with it, with their subtrees.

    Raises:
        UnknownNameError: If there is no such body.
    """
    root = lookup(model, _OBJ.mjOBJ_BODY, robot)
    if root > 0:
        return subtree(model, root)
    every = names(model, _OBJ.mjOBJ_BODY, range(model.nbody))
    found = frozenset(b for b, name in enumerate(every) if b > 0 and is_name(robot) and name.startswith(robot))
    if not found:
        prefixes = {name.partition("/")[0] + "/" for name in every if "/" in name}
        roots = {every[b] for b in range(1, model.nbody) if model.body_parentid[b] == 0}
        raise UnknownNameError("robot prefix or root body", robot, prefixes | roots)
    return frozenset().union(*(subtree(model, body) for body in found))  # grippers may have another prefix


def add_tool(spec: mujoco.MjSpec, tool: str) -> None:
    """Add a site with the frame of a body if `tool` is the name of a body; the site gets the same name."""
    body = spec.body(tool) if is_name(tool) else None
    if body is not None and spec.site(tool) is None:
        body.add_site(name=tool)


def tool_body(model: mujoco.MjModel, tool: str, robot: Collection[int]) -> int:
    """Return the body that carries the tool's site.

    Raises:
        UnknownNameError: If there is no such site; the message lists sites and robot bodies.
    """
    site = lookup(model, _OBJ.mjOBJ_SITE, tool)
    if site < 0:
        valid = {*names(model, _OBJ.mjOBJ_SITE, range(model.nsite)), *names(model, _OBJ.mjOBJ_BODY, robot)}
        raise UnknownNameError("tool (site or body)", tool, (name for name in valid if not name.startswith("#")))
    return int(model.site_bodyid[site])


def set_limits(model: mujoco.MjModel, robot: Collection[int], limits: Mapping[str, tuple[float, float]]) -> None:
    """Replace joint limits of the robot in the model, for planner, inverse kinematics and judge alike.

    Raises:
        UnknownNameError: If the robot has no such hinge or slide joint.
        SettingError: If a lower limit is not below the upper one.
    """
    joints = {model.joint(j).name: j for j in range(model.njnt) if is_scalar(model, j, robot)}
    for name, (lower, upper) in limits.items():
        if name not in joints:
            raise UnknownNameError("joint", name, joints)
        if not (np.isfinite([lower, upper]).all() and lower < upper):
            raise SettingError(f"limits of {name}", (lower, upper), "two finite numbers, the lower one first")
        model.jnt_range[joints[name]], model.jnt_limited[joints[name]] = (lower, upper), 1


def is_scalar(model: mujoco.MjModel, joint: int, robot: Collection[int]) -> bool:
    """Return whether a joint is a hinge or a slide of the robot."""
    return int(model.jnt_bodyid[joint]) in robot and int(model.jnt_type[joint]) in _SCALAR_JOINTS


def planned_joints(
    model: mujoco.MjModel, tool_body: int, robot: Collection[int], wanted: Sequence[str] | None = None
) -> tuple[int, ...]:
    """Return the hinge and slide joints to plan, base first.

    Args:
        model: The model.
        tool_body: Body of the tool.
        robot: Bodies of the robot.
        wanted: Names of the joints; by default all joints from the world to the tool.

    Raises:
        SceneError: If the tool is not on the robot, or no joint moves it.
        SettingError: If the wanted joints are not in the model's order, or none of them moves the tool.
        UnknownNameError: If the robot has no such hinge or slide joint.
        UnsupportedError: If a joint on the chain is of another type.
    """
    if tool_body not in robot:
        raise SceneError(f"the tool is on body {model.body(tool_body).name!r}, which is not part of the robot")
    chain = [joint for body in reversed(ancestors(model, tool_body)) for joint in body_joints(model, body)]
    if wanted is not None:
        return _wanted_joints(model, chain, robot, wanted)
    other = [j for j in chain if int(model.jnt_type[j]) not in _SCALAR_JOINTS]
    if other:
        wrong = ", ".join(names(model, _OBJ.mjOBJ_JOINT, other))
        raise UnsupportedError(f"joints between world and tool have to be hinge or slide, not: {wrong}")
    if not chain:
        raise SceneError(f"no joint moves the body {model.body(tool_body).name!r} of the tool")
    return tuple(chain)


def _wanted_joints(
    model: mujoco.MjModel, chain: Collection[int], robot: Collection[int], wanted: Sequence[str]
) -> tuple[int, ...]:
    known = {model.joint(j).name: j for j in range(model.njnt) if is_scalar(model, j, robot) and model.joint(j).name}
    for name in wanted:
        if name not in known:
            raise UnknownNameError("joint to plan", name, known)
    found = [known[name] for name in wanted]
    if found != sorted(set(found)):  # limits are given in this order
        order = tuple(names(model, _OBJ.mjOBJ_JOINT, sorted(set(found))))
        raise SettingError("joints", tuple(wanted), f"the order of the model, each joint once: {order}")
    if not set(chain).intersection(found):
        raise SettingError("joints", tuple(wanted), f"one that moves the tool: {names(model, _OBJ.mjOBJ_JOINT, chain)}")
    return tuple(found)


def gripper_bodies(model: mujoco.MjModel, tool_body: int, planned: Collection[int]) -> frozenset[int]:
    """Return the bodies that hang on the last planned joint before the tool, whichever of them has the tool.

    The body of the joint itself counts if the tool is on it, a finger joint is directly on it, or nothing else has
    colliding geoms. Otherwise it is the last link of the arm, which no held object may touch.
    """
    jointed = (body for body in ancestors(model, tool_body) if not set(body_joints(model, body)).isdisjoint(planned))
    last = next(jointed, 0)
    behind = subtree(model, last)
    fingers = [int(model.jnt_bodyid[j]) for j in range(model.njnt) if j not in planned]
    is_palm = last == tool_body or any(int(model.body_parentid[body]) == last for body in fingers)
    return behind if is_palm or not colliding_geoms(model, behind - {last}) else behind - {last}


def check_base(model: mujoco.MjModel, joints: tuple[int, ...], base: DiffDrive) -> None:
    """Check that a base's joints are the first planned joints: slides along x and y, then a hinge about z.

    Raises:
        UnknownNameError: If a joint of the base is not planned.
        SceneError: If the joints have other types, poses or another order.
    """
    known = names(model, mujoco.mjtObj.mjOBJ_JOINT, joints)
    for name in base.joints:
        if name not in known:
            raise UnknownNameError("planned joint of the base", name, known)
    if tuple(known[:3]) != base.joints:
        raise SceneError(f"the base's joints {base.joints} have to be the first planned ones, which are {known[:3]}")
    kinds = [int(_JOINT.mjJNT_SLIDE), int(_JOINT.mjJNT_SLIDE), int(_JOINT.mjJNT_HINGE)]
    for joint, kind, axis in zip(joints, kinds, np.eye(3)[[0, 1, 2]], strict=False):
        body = model.jnt_bodyid[joint]
        upright = np.allclose(model.body_quat[body], [1.0, 0.0, 0.0, 0.0])
        centred = np.allclose(model.body_pos[body, :2] + model.jnt_pos[joint, :2], 0.0)
        if model.jnt_type[joint] != kind or not np.allclose(model.jnt_axis[joint], axis) or not upright or not centred:
            what = "slides along x and y and a hinge about z, in bodies that are neither turned nor moved along x and y"
            raise SceneError(f"the base's joint {model.joint(joint).name!r}: expected {what}")


def joint_limits(model: mujoco.MjModel, joints: tuple[int, ...], notes: Notes) -> Limits:
    """Collect limits: positions and torques from the model, the rest from the notes or custom numbers.

    A hinge without limits gets one turn in each direction, the heading of a base two. Limits of a base come from its
    `DiffDrive`; velocity and acceleration of the notes are for the other joints. Torque comes from the notes,
    actuatorfrcrange or the forcerange of the actuators on the joint; it is infinite if none is set.

    Raises:
        SceneError: If a slide has no limits, or velocity or acceleration limits are missing.
    """
    base = notes.base
    behind = joints if base is None else joints[_BASE_JOINTS:]
    torque = _limit(model, behind, notes, "torque", notes.torque)
    if torque is None:
        torque = np.array([_torque(model, j) for j in behind])
    velocity, acceleration = (
        _needed_limit(model, behind, notes, name, given) if behind else np.zeros(0)
        for name, given in (("velocity", notes.velocity), ("acceleration", notes.acceleration))
    )
    position = np.array([joint_range(model, j) for j in joints])
    if base is not None:
        fastest, hardest = base.joint_limits
        velocity, acceleration = np.concatenate([fastest, velocity]), np.concatenate([hardest, acceleration])
        torque = np.concatenate([np.full(_BASE_JOINTS, np.inf), torque])
        if not model.jnt_limited[joints[2]]:
            position[2] *= 2.0
    limits = Limits(position=position, velocity=velocity, acceleration=acceleration, torque=torque)
    for values in (limits.position, limits.velocity, limits.acceleration, limits.torque):
        values.flags.writeable = False
    return limits


def _needed_limit(
    model: mujoco.MjModel, joints: tuple[int, ...], notes: Notes, name: str, given: tuple[float, ...] | None
) -> Float[Array, " nq"]:
    found = _limit(model, joints, notes, name, given)
    if found is None:
        custom = _custom(model, notes, name)
        raise SceneError(
            f"no {name} limits: give {name}=[{len(joints)} numbers], or the model a custom numeric {custom!r}"
        )
    return found


def _custom(model: mujoco.MjModel, notes: Notes, name: str) -> str:
    is_body = lookup(model, _OBJ.mjOBJ_BODY, notes.robot) > 0
    prefix = notes.robot[: notes.robot.rfind("/") + 1] if is_body else notes.robot
    return f"{prefix}{name}_limit"


def _limit(
    model: mujoco.MjModel, joints: tuple[int, ...], notes: Notes, name: str, given: tuple[float, ...] | None
) -> Float[Array, " nq"] | None:
    custom = mujoco.mj_name2id(model, _OBJ.mjOBJ_NUMERIC, _custom(model, notes, name))
    if given is None and custom < 0:
        return None
    values = np.array(model.numeric(custom).data if given is None else given, dtype=float)
    if values.shape != (len(joints),) or not np.isfinite(values).all() or (values <= 0.0).any():
        raise SettingError(
            f"{name} limits", values.tolist(), f"{len(joints)} finite numbers above 0, one per planned joint"
        )
    return values


def joint_range(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    """Return the limits of a hinge or slide; a hinge without limits gets a turn each way.

    Raises:
        SceneError: If a slide has no limits.
    """
    if model.jnt_limited[joint]:
        return tuple(model.jnt_range[joint])
    if int(model.jnt_type[joint]) == int(_JOINT.mjJNT_SLIDE):
        raise SceneError(f"the sliding joint {model.joint(joint).name!r} has no range")
    return -2.0 * np.pi, 2.0 * np.pi


def _torque(model: mujoco.MjModel, joint: int) -> float:
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    on_joint = (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)) & (model.actuator_trnid[:, 0] == joint)
    limited = np.flatnonzero(on_joint & (model.actuator_forcelimited != 0))
    forces = np.abs(model.actuator_forcerange[limited]).max(axis=1) * np.abs(model.actuator_gear[limited, 0])
    return float(forces.sum()) if len(limited) else np.inf
