"""Limits of the planned joints: from the model, from declarations, or from the base."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError
from graceful_plan.scene.elements import Limits, Notes
from graceful_plan.scene.loading.naming import lookup
from graceful_plan.scene.model_parts import is_scalar

_OBJ = mujoco.mjtObj
_JOINT = mujoco.mjtJoint

_BASE_JOINTS = 3
"""Joints of a base: along x, along y, heading."""


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


def joint_limits(model: mujoco.MjModel, joints: tuple[int, ...], notes: Notes) -> Limits:
    """Collect limits: positions and torques from the model, the rest from the notes or custom numbers.

    A hinge without limits gets one turn in each direction, the heading of a base two. Limits of a base come from its
    `DiffDrive`; velocity and acceleration of the notes are for the other joints. Torque comes from the notes,
    actuatorfrcrange, or the forcerange of the actuators on the joint and the ctrlrange of motors; it is infinite if
    none is set.

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
    known = [force for a in np.flatnonzero(on_joint) if np.isfinite(force := _greatest_force(model, int(a)))]
    return sum(known) if known else np.inf


def _greatest_force(model: mujoco.MjModel, actuator: int) -> float:
    """Return the greatest force of an actuator on its joint [N m or N]; infinite if it is unlimited."""
    most = np.inf
    if model.actuator_forcelimited[actuator]:
        most = np.abs(model.actuator_forcerange[actuator]).max()
    if model.actuator_ctrllimited[actuator] and _is_motor(model, actuator):
        most = min(most, np.abs(model.actuator_gainprm[actuator, 0] * model.actuator_ctrlrange[actuator]).max())
    return float(most * abs(model.actuator_gear[actuator, 0]))


def _is_motor(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the actuator's force is proportional to its command."""
    return (
        int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        and int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)
        and int(model.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_NONE)
    )
