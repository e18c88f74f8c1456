"""Two versions of a robot that drives, of one model: on planar joints to plan with, and on its wheels to simulate.

Only the root differs: three joints in a plane, or a free joint. Wheels, motors and everything else stay.
"""

from __future__ import annotations

from dataclasses import MISSING, fields

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SceneError, SettingError
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Array = np.ndarray

KEEP_OUT = "keep_out"
"""Geoms whose names begin so are there for planning only: over stairs going down, where a base must not drive."""
_REACH = 10.0
"""How far a base may go along x and y unless limits of its joints are given [m]: a hall of 20 m."""
_FREE = mujoco.mjtJoint.mjJNT_FREE


def plan_on_plane(spec: mujoco.MjSpec, robot: str, given: DiffDrive | None) -> DiffDrive | None:
    """Replace a robot's free joint by those of its base, unless the model has these already.

    Args:
        spec: Is changed.
        robot: Prefix of the names of its bodies, or its root body.
        given: How it drives; as its model says if None.

    Returns:
        How it drives; None if it does not.

    Raises:
        SceneError: If the model says only a part of it.
    """
    base = given or _drive_of(spec, robot)
    if base is None or any(spec.joint(name) is not None for name in base.joints):
        return base
    for joint in spec.joints:
        if joint.type == _FREE and joint.parent.name.startswith(robot):
            root = joint.parent
            spec.delete(joint)
            for name, axis in zip(base.joints[:2], np.eye(3), strict=False):
                reach = [-_REACH, _REACH]
                root.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, range=reach, limited=1)
            root.add_joint(name=base.joints[2], type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 0.0, 1.0])
            break
    return base


def rolling_spec(scene: SceneFacts) -> mujoco.MjSpec:
    """Return the model of a scene in which its robot stands on its wheels, to be simulated.

    Give its options a timestep of at most 2 ms, an elliptic cone and an impratio of 10 or more: what is said of the
    bundled robots is measured with these.

    Raises:
        SettingError: If its robot does not drive.
    """
    base = scene.base
    if base is None:
        raise SettingError("scene", scene.name, "a scene with a robot that drives: give it a DiffDrive")
    spec = scene.spec.copy()
    for key in list(spec.keys):  # of another number of joints
        spec.delete(key)
    joints = [spec.joint(name) for name in base.joints]
    root = joints[0].parent
    for joint in joints:
        spec.delete(joint)
    root.add_freejoint(name=_free_name(base))
    for geom in spec.geoms:
        if geom.name.startswith(KEEP_OUT):
            geom.contype = geom.conaffinity = 0
    return spec


def rolling_qpos(scene: SceneFacts, model: mujoco.MjModel, q: ArrayLike) -> Float[Array, " qpos"]:
    """Return the state of the compiled `rolling_spec` in which everything is where it is planned to be at q.

    Args:
        scene: The scene that it was made of.
        model: The compiled model.
        q: Configuration [m, m, rad, ...].
    """
    base = scene.base
    if base is None:
        raise SettingError("scene", scene.name, "a scene with a robot that drives: give it a DiffDrive")
    planned, qpos = scene.data_at(q), model.qpos0.copy()
    widths = {int(_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}
    for j in range(scene.model.njnt):
        name, adr = scene.model.joint(j).name, int(scene.model.jnt_qposadr[j])
        there = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if there >= 0:
            width = widths.get(int(model.jnt_type[there]), 1)
            to = int(model.jnt_qposadr[there])
            qpos[to : to + width] = planned.qpos[adr : adr + width]
    x, y, yaw = np.asarray(q, dtype=float)[:3]
    adr = int(model.joint(_free_name(base)).qposadr[0])
    qpos[adr : adr + 7] = [x, y, qpos[adr + 2], np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]
    return qpos


def _free_name(base: DiffDrive) -> str:
    return f"{base.joints[0].rpartition('/')[0]}/rolling".lstrip("/")


def _drive_of(spec: mujoco.MjSpec, robot: str) -> DiffDrive | None:
    """Read how a robot drives from its model: texts and numerics "<robot>drive/FIELD", with the fields of DiffDrive."""
    prefix = robot[: robot.rfind("/") + 1] if spec.body(robot) is not None else robot
    start = f"{prefix}drive/"
    told: dict[str, object] = {}
    for text in spec.texts:
        if text.name.startswith(start):
            told[text.name.removeprefix(start)] = tuple(prefix + name for name in text.data.split())
    for number in spec.numerics:
        if number.name.startswith(start):
            told[number.name.removeprefix(start)] = float(np.array(number.data)[0])
    if not told:
        return None
    known = {item.name: item.default is MISSING for item in fields(DiffDrive)}
    wrong = sorted(set(told) - set(known))
    missing = [name for name, needed in known.items() if needed and name not in told]
    if wrong or missing:
        what = f"does not know {', '.join(wrong)}" if wrong else f"needs {', '.join(missing)}"
        raise SceneError(f"the drive of {robot!r} in its model {what}; its fields are {', '.join(known)}")
    if "reverse" in told:
        told["reverse"] = bool(told["reverse"])
    return DiffDrive(**told)  # pyright: ignore[reportArgumentType]  checked there
