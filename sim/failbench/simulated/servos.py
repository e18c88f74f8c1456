"""The robot's servos in the simulated model: actuators, gains and force limits; contacts of the fingertips."""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.simulated.added_drives import inertia_at
from failbench.simulated.gripper import Gripper, clear_opening
from failbench.simulated.robot import Robot
from failbench.simulated.rolling import PLANAR, driven_joints, kept_joints, lifted, same_side
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import UnsupportedError

STIFF = [0.9999, 0.9999, 0.001, 0.5, 2.0]
"""Solver impedance of a constraint, as stiff as the solver allows."""
_FIRM = [0.95, 0.99, 0.001, 0.5, 2.0]
"""Solver impedance of the fingertips' contacts."""
_BANDWIDTH = 40.0
"""Natural frequency of the computed-torque controller [rad/s], critically damped."""


def actuator_of(model: mujoco.MjModel, name: str) -> int:
    """Return the actuator of a joint.

    Raises:
        UnsupportedError: Unless the joint has exactly one actuator, without dynamics.
    """
    joint = int(model.joint(name).id)
    of_joint = (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT) & (model.actuator_trnid[:, 0] == joint)
    found = np.flatnonzero(of_joint)
    if len(found) != 1:
        raise UnsupportedError(f"the joint {name!r} has {len(found)} actuators; FailBench drives it by exactly one")
    if int(model.actuator_dyntype[found[0]]) != int(mujoco.mjtDyn.mjDYN_NONE):
        raise UnsupportedError(f"the actuator of {name!r} has dynamics; FailBench supports actuators without")
    return int(found[0])


def tuned_robot(
    model: mujoco.MjModel,
    scene: Scene,
    actuators: list[int],
    gripper: Gripper,
    *,
    timestep: float,
    control: str,
    grasp: str,
) -> Robot:
    """Set up the servos in the simulated model, and return the indices of the robot's parts in it."""
    driven = driven_joints(scene)
    joints = [int(model.joint(name).id) for name in driven]
    kept = kept_joints(scene, model)
    fingers = [kept[j] for j in gripper.joints.tolist()]
    dofs = model.jnt_dofadr[joints].astype(int)
    _ungear(model, actuators)
    _limit_forces(model, scene, actuators, gripper)
    # Feed-forward moves commands beyond the joints' range, and gravity must act on an arm without power.
    model.actuator_ctrllimited[actuators] = 0
    model.body_gravcomp[sorted(scene.robot_bodies)] = 0.0
    # The fingertips' contact parameters take priority: otherwise an object with soft contacts would creep.
    model.geom_priority[gripper.pads] = model.geom_priority.max() + 1
    model.geom_solref[gripper.pads] = [2.0 * timestep, 1.0]
    model.geom_solimp[gripper.pads] = _FIRM
    # Light fingers that follow others by soft constraints would yield to the object.
    tied = (model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)) & np.isin(model.eq_obj1id, fingers)
    model.eq_solref[tied] = [2.0 * timestep, 1.0]
    model.eq_solimp[tied] = STIFF
    if control == "torque":
        inertia = np.diag(inertia_at(model, lifted(scene, model, scene.home_qpos)))[dofs]
        model.actuator_gaintype[actuators] = mujoco.mjtGain.mjGAIN_FIXED
        model.actuator_gainprm[actuators, 0] = 1.0
        model.actuator_biastype[actuators] = mujoco.mjtBias.mjBIAS_AFFINE
        model.actuator_biasprm[actuators, 1] = -(_BANDWIDTH**2) * inertia
        model.actuator_biasprm[actuators, 2] = -2.0 * _BANDWIDTH * inertia
    kp, kd = -model.actuator_biasprm[actuators, 1], -model.actuator_biasprm[actuators, 2]
    for j, name in enumerate(driven):
        if not kp[j] > 0.0:
            raise UnsupportedError(f"the actuator of {name!r} is no position servo; use SimSettings(control='torque')")
    grasps = grasp == "fingers" and scene.carried is not None
    return Robot(
        joints=driven,
        joint_ids=np.array(joints),
        qpos=model.jnt_qposadr[joints].astype(int),
        reference=model.qpos0[model.jnt_qposadr[joints]].copy(),
        dofs=dofs,
        actuators=np.array(actuators),
        locks=np.array([int(model.equality(f"failbench/lock/{name}").id) for name in driven]),
        kp=kp,
        kd=kd,
        gain=model.actuator_gainprm[actuators, 0].copy(),
        acceleration=_accelerations(scene),
        together=same_side(scene.base),
        gripper_joints=np.array(fingers, dtype=int),
        gripper_dofs=model.jnt_dofadr[np.array(fingers, dtype=int)].astype(int),
        gripper_actuators=gripper.actuators,
        grip_open=gripper.open,
        grip_closed=gripper.closed if grasps else gripper.home,
        grip_clear=clear_opening(scene),
        pads=gripper.pads,
        weld=-1 if grasps or scene.carried is None else int(model.equality("failbench/hold").id),
    )


def _accelerations(scene: Scene) -> Float[Array, " driven"]:
    """Return the acceleration limits of the driven joints in motions."""
    arm = scene.limits.acceleration
    if scene.base is None:
        return arm.copy()
    wheel = (scene.base.a_max + scene.base.lever * scene.base.alpha_max) / scene.base.radius
    return np.concatenate([np.full(len(scene.base.wheels), wheel), arm[PLANAR:]])


def _ungear(model: mujoco.MjModel, actuators: list[int]) -> None:
    """Express actuators in joint coordinates: the same torques, with gear 1 and no constant force.

    The controller compensates the constant force anyway, so healthy motions are unchanged.
    """
    gear = model.actuator_gear[actuators, 0].copy()
    model.actuator_gear[actuators, 0] = 1.0
    model.actuator_gainprm[actuators, 0] *= gear
    model.actuator_biasprm[actuators, 0] = 0.0
    model.actuator_biasprm[actuators, 1:3] *= gear[:, None] ** 2
    model.actuator_forcerange[actuators] = np.sort(model.actuator_forcerange[actuators] * gear[:, None], axis=1)


def _limit_forces(model: mujoco.MjModel, scene: Scene, actuators: list[int], gripper: Gripper) -> None:
    """Limit actuators that have no force limit: faults scale friction and grip by it.

    Joints get the scene's torque limit, if it is known; fingers get the servo's force over the full stroke.
    """
    torque = scene.limits.torque
    if scene.base is not None:  # wheel drives have their own limits
        torque = np.concatenate([np.full(len(scene.base.wheels), np.inf), torque[PLANAR:]])
    known = [(a, t) for a, t in zip(actuators, torque, strict=True) if np.isfinite(t)]
    stroke = np.abs(gripper.open - gripper.closed)
    known += zip(gripper.actuators.tolist(), -model.actuator_biasprm[gripper.actuators, 1] * stroke, strict=True)
    for actuator, force in known:
        if not model.actuator_forcelimited[actuator]:
            model.actuator_forcelimited[actuator] = 1
            model.actuator_forcerange[actuator] = -force, force
