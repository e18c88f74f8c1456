"""Find the parts of a scene in a MuJoCo model: robot bodies, planned joints, geoms of bodies.

Except for `add_tool`, the functions only read the model. They raise if a needed part is missing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError, UnsupportedError
from graceful_plan.scene.loading.naming import is_name, lookup
from graceful_plan.scene.mobile.diff_drive import DiffDrive

_OBJ = mujoco.mjtObj
_JOINT = mujoco.mjtJoint
_SCALAR_JOINTS = (int(_JOINT.mjJNT_HINGE), int(_JOINT.mjJNT_SLIDE))


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
