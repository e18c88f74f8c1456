"""The drive described in a robot's model, and the same robot on rolling wheels for simulation.

For planning, a base has three planar joints and wheels that do not turn. For simulation, it has a free joint instead,
and hinges and motors at its wheels. Everything else is equal.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import MISSING, fields

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SceneError, SettingError
from graceful_plan.scene.facts import SceneFacts
from graceful_plan.scene.loading.naming import is_name, lookup
from graceful_plan.scene.mobile.diff_drive import DiffDrive

Array = np.ndarray

KEEP_OUT = "keep_out"
"""Name prefix of geoms that exist only for planning: over stairs going down, where a base must not drive."""
_FREE = "rolling"
"""Name of the free joint, after the robot's prefix."""
_WHEEL = "wheel"
"""Default class of the hinges and motors of wheels, after the robot's prefix."""


def described_drive(spec: mujoco.MjSpec, robot: str, planned: Collection[str] | None = None) -> DiffDrive | None:
    """Read the drive of a robot from its model: texts and numerics "<robot>drive/FIELD", with the fields of DiffDrive.

    Names of joints and wheels are without prefix, separated by spaces.

    Args:
        spec: The model.
        robot: Prefix of the names of the robot's bodies, or its root body.
        planned: Names of the joints to plan; all by default.

    Returns:
        The base; None if the model does not describe one, or not all of its joints are planned.

    Raises:
        SceneError: If the description is incomplete or has unknown fields.
    """
    prefix = robot[: robot.rfind("/") + 1] if is_name(robot) and spec.body(robot) is not None else robot
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
    drive = DiffDrive(**told)  # pyright: ignore[reportArgumentType]  checked by DiffDrive
    return drive if planned is None or set(drive.joints).issubset(planned) else None


def rolling_spec(scene: SceneFacts) -> mujoco.MjSpec:
    """Return the model of a scene for simulation, with the robot on wheels that turn.

    Hinges and velocity motors of the wheels have the wheels' names. They use the defaults of the robot's class "wheel"
    if its model has one. Set a timestep of at most 2 ms, an elliptic cone and an impratio of 10 or more: the figures
    for the bundled robots were measured with these options.

    Raises:
        SettingError: If the robot has no base, or the base does not name its wheels.
    """
    base = scene.base
    if base is None or not base.wheels:
        raise SettingError("scene", scene.name, "a scene with a robot that drives: give it a DiffDrive with wheels")
    spec = scene.spec.copy()
    for key in list(spec.keys):  # for another number of joints
        spec.delete(key)
    joints = [spec.joint(name) for name in base.joints]
    root = joints[0].parent
    for joint in joints:
        spec.delete(joint)
    root.add_freejoint(name=_prefix(base) + _FREE)
    defaults = spec.find_default(_prefix(base) + _WHEEL)
    for name in base.wheels:
        hinge, motor = spec.body(name).add_joint(defaults, name=name), spec.add_actuator(defaults, name=name)
        hinge.type, hinge.axis = mujoco.mjtJoint.mjJNT_HINGE, [0.0, 1.0, 0.0]
        motor.trntype, motor.target = mujoco.mjtTrn.mjTRN_JOINT, name
    for geom in spec.geoms:
        if geom.name.startswith(KEEP_OUT):
            geom.contype = geom.conaffinity = 0
    return spec


def rolling_qpos(scene: SceneFacts, model: mujoco.MjModel, q: ArrayLike) -> Float[Array, " qpos"]:
    """Return the qpos of the compiled `rolling_spec` that places everything as the planning model does at q.

    Args:
        scene: The scene given to `rolling_spec`.
        model: The compiled model.
        q: Configuration [m, m, rad, ...].
    """
    base = scene.base
    if base is None:
        raise SettingError("scene", scene.name, "a scene with a robot that drives: give it a DiffDrive")
    planned, qpos = scene.data_at(q), model.qpos0.copy()
    widths = {int(mujoco.mjtJoint.mjJNT_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}
    for j in range(scene.model.njnt):
        name, adr = scene.model.joint(j).name, int(scene.model.jnt_qposadr[j])
        there = lookup(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        if there >= 0:
            width = widths.get(int(model.jnt_type[there]), 1)
            to = int(model.jnt_qposadr[there])
            qpos[to : to + width] = planned.qpos[adr : adr + width]
    x, y, yaw = np.asarray(q, dtype=float)[:3]
    adr = int(model.joint(_prefix(base) + _FREE).qposadr[0])
    qpos[adr : adr + 7] = [x, y, qpos[adr + 2], np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)]
    return qpos


def _prefix(base: DiffDrive) -> str:
    return base.joints[0][: base.joints[0].rfind("/") + 1]
