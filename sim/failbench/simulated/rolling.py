"""A driving base in the simulated world: it keeps its planned joints and gets wheels.

Below the planned joints for x, y and heading, the base gets a vertical slide and two tilt hinges, by which it stands on
its wheels. It is then as free as a body with a free joint, and the planned joints keep their meaning. Wheels turn on
hinges driven by position servos, which are equivalent to speed controllers with an integral term. Faults of drives and
encoders therefore act on wheels as on the joints of an arm.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan import Scene
from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.wheels import KEEP_OUT

PLANAR = 3
"""Number of planned joints of a base."""
_STANDS = ("z", "pitch", "roll")
_INTEGRAL = 5.0
"""Ratio of stiffness to damping of a wheel's servo [1/s]."""
_GAIN = 20.0
"""Damping of wheel servos if the model does not set it [N m s/rad]."""
_GRIP, _GRAVITY = 0.7, 9.81


@dataclass(frozen=True, eq=False)
class Rolling:
    """Indices of a driving base's parts in the simulated model.

    | field   | meaning                                                             | shape |
    |---------|---------------------------------------------------------------------|-------|
    | base    | the kinematics of the base                                          |       |
    | qpos    | addresses of x, y and heading                                       | 3     |
    | dofs    | addresses of the same joints in qvel                                | 3     |
    | planned | addresses in qpos of all planned joints                             | nq    |
    | tree    | dofs of everything that moves with the base                         |       |
    """

    base: DiffDrive
    qpos: Int[Array, " 3"]
    dofs: Int[Array, " 3"]
    planned: Int[Array, " nq"]
    tree: Int[Array, " dof"]

    def drives(
        self, qpos: Float[Array, " qpos"], qvel: Float[Array, " qvel"]
    ) -> tuple[float, float, float, float, float]:
        """Return x [m], y [m], heading [rad], forward speed [m/s] and yaw rate [rad/s]."""
        (x, y, yaw), (vx, vy, omega) = qpos[self.qpos].tolist(), qvel[self.dofs].tolist()
        return x, y, yaw, vx * float(np.cos(yaw)) + vy * float(np.sin(yaw)), omega


def driven_joints(scene: Scene) -> tuple[str, ...]:
    """Return the joints that faults strike: the planned ones, with wheels in place of a base's x, y and heading."""
    if scene.base is None:
        return scene.joints
    if not scene.base.wheels or len(scene.base.wheels) % 2:
        raise UnsupportedError("a driving base needs a DiffDrive with `wheels`: left ones, then as many right ones")
    return (*scene.base.wheels, *scene.joints[PLANAR:])


def add_wheels(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Add the joints and actuators for driving to a copy of a scene's model."""
    base = scene.base
    if base is None:
        return
    body = spec.joint(base.joints[2]).parent
    kinds = (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_HINGE)
    for name, kind, axis in zip(_STANDS, kinds, ([0, 0, 1], [0, 1, 0], [1, 0, 0]), strict=True):
        body.add_joint(name=f"failbench/{name}", type=kind, axis=axis)
    prefix = base.joints[0][: base.joints[0].rfind("/") + 1]
    defaults = spec.find_default(f"{prefix}wheel")
    force = _GRIP * float(scene.model.body_subtreemass[scene.model.body(body.name).id]) * _GRAVITY * base.radius
    for name in base.wheels:
        hinge = spec.body(name).add_joint(defaults, name=name) if defaults else spec.body(name).add_joint(name=name)
        hinge.type, hinge.axis = mujoco.mjtJoint.mjJNT_HINGE, [0.0, 1.0, 0.0]
        for geom in spec.body(name).geoms:
            if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
                # A cylinder on a box floor alternates between contacts at its two rims and loses grip in between.
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_ELLIPSOID, [geom.size[0], geom.size[0], geom.size[1]]
        if defaults is None:
            hinge.armature = base.rotor
        motor = spec.add_actuator(defaults, name=name) if defaults else spec.add_actuator(name=name)
        motor.trntype, motor.target = mujoco.mjtTrn.mjTRN_JOINT, name
        damping = motor.gainprm[0] if defaults else _GAIN
        motor.set_to_position(kp=_INTEGRAL * damping, kv=damping)
        if not motor.forcerange[1] > motor.forcerange[0]:
            motor.forcerange, motor.forcelimited = [-force, force], mujoco.mjtLimited.mjLIMITED_TRUE
    for geom in spec.geoms:
        if geom.name.startswith(KEEP_OUT):
            geom.contype = geom.conaffinity = 0


def find_rolling(scene: Scene, model: mujoco.MjModel) -> Rolling | None:
    """Return the indices of the base's parts; None if the robot does not drive."""
    if scene.base is None:
        return None
    joints = [model.joint(name) for name in scene.joints]
    body = int(model.jnt_bodyid[joints[0].id])
    root = int(model.body_rootid[body])
    return Rolling(
        base=scene.base,
        qpos=np.array([int(joint.qposadr[0]) for joint in joints[:PLANAR]]),
        dofs=np.array([int(joint.dofadr[0]) for joint in joints[:PLANAR]]),
        planned=np.array([int(joint.qposadr[0]) for joint in joints]),
        tree=np.flatnonzero(model.body_rootid[model.dof_bodyid] == root),
    )


def lifted(scene: Scene, model: mujoco.MjModel, qpos: Float[Array, " qpos"]) -> Float[Array, " simulated"]:
    """Convert positions of a scene's model to those of the simulated model, with wheels and stand at 0."""
    if model.nq == len(qpos):
        return qpos
    out = model.qpos0.copy()
    widths = {int(mujoco.mjtJoint.mjJNT_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}
    for j, k in enumerate(kept_joints(scene, model)):
        width = widths.get(int(scene.model.jnt_type[j]), 1)
        here, there = int(scene.model.jnt_qposadr[j]), int(model.jnt_qposadr[k])
        out[there : there + width] = qpos[here : here + width]
    return out


def kept_joints(scene: Scene, model: mujoco.MjModel) -> list[int]:
    """Return the id in the simulated model of each joint of the scene's model, in the same order."""
    added = {f"failbench/{name}" for name in _STANDS} | set(() if scene.base is None else scene.base.wheels)
    return [j for j in range(model.njnt) if model.joint(j).name not in added]


def same_side(base: DiffDrive | None) -> tuple[tuple[int, ...], ...]:
    """Return the groups of driven joints with a common motor: the wheels of each side."""
    if base is None:
        return ()
    half = len(base.wheels) // 2
    return tuple(range(half)), tuple(range(half, 2 * half))
