"""Bundled robots that drive, on wheels that turn, as a check of the wheels and motors that their models describe.

The base has a free joint instead of its three planar joints, and hinges and motors at its wheels.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.scene.loading.naming import lookup
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.wheels import KEEP_OUT
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_FREE = "rolling"
"""Name of the free joint, after the robot's prefix."""
_WHEEL = "wheel"
"""Default class of the hinges and motors of wheels, after the robot's prefix."""


def rolling_spec(scene: Scene) -> mujoco.MjSpec:
    """Return the model of a scene for simulation, with the robot on wheels that turn.

    Hinges and velocity motors of the wheels have the wheels' names. They use the defaults of the robot's class "wheel"
    if its model has one. Set a timestep of at most 2 ms, an elliptic cone and an impratio of 10 or more: the figures
    for the bundled robots were measured with these options.
    """
    base = scene.base
    assert base is not None
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


def rolling_qpos(scene: Scene, model: mujoco.MjModel, q: ArrayLike) -> Float[Array, " qpos"]:
    """Return the qpos of the compiled `rolling_spec` that places everything as the planning model does at q.

    Args:
        scene: The scene given to `rolling_spec`.
        model: The compiled model.
        q: Configuration [m, m, rad, ...].
    """
    base = scene.base
    assert base is not None
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
