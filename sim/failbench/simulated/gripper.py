"""Find the gripper in a scene's model, and the direction in which it opens."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from graceful_plan import Scene
from graceful_plan.array_types import Float, Int

Array = np.ndarray


class Gripper(NamedTuple):
    """Joints and actuators of the gripper, below the last planned joint."""

    bodies: tuple[int, ...]
    """The bodies that hang on the last planned joint."""
    pads: Int[Array, " geom"]
    """Colliding geoms of the moving parts, which hold an object."""
    joints: Int[Array, " joint"]
    actuators: Int[Array, " actuator"]
    open: Float[Array, " actuator"]
    """Command of each actuator that opens the gripper fully."""
    closed: Float[Array, " actuator"]
    """Command of each actuator that closes the gripper fully."""
    home: Float[Array, " actuator"]
    """Command of each actuator that keeps the gripper at its home position in the scene."""


def find_gripper(scene: Scene) -> Gripper:
    """Find the gripper, as the scene does. Only position servos count as its actuators."""
    model = scene.model
    bodies = tuple(sorted(scene.gripper_bodies))
    joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in bodies and j not in scene.joint_ids]
    actuators = [a for a in range(model.nu) if _acts_on(model, a, joints) and model.actuator_biasprm[a, 1] < 0.0]
    fingers = {int(model.jnt_bodyid[j]) for j in joints}
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    pads = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in fingers and collides[g]]
    wide, closed = _ends(scene, joints)
    open_, shut, home = (_posture(scene, joints, q).length[actuators] for q in (wide, closed, None))
    return Gripper(
        bodies=bodies,
        pads=np.array(pads, dtype=int),
        joints=np.array(joints, dtype=int),
        actuators=np.array(actuators, dtype=int),
        open=open_,
        closed=shut,
        home=home,
    )


def clear_opening(scene: Scene, gripper: Gripper) -> float:
    """Return the opening from which on no finger touches the carried object.

    Returns:
        Opening from closed (0) to open (1), to within 0.001; 0 without a carried object or a gripper.
    """
    if scene.carried is None or not len(gripper.joints):
        return 0.0
    model = scene.model
    data = scene.data_at(np.array([model.qpos0[a] for a in scene.qpos_adr]))
    adr = model.jnt_qposadr[gripper.joints]
    wide, closed = _ends(scene, gripper.joints.tolist())
    held = scene.components["carried"].geoms

    def touches(opening: float) -> bool:
        data.qpos[adr] = closed + opening * (wide - closed)
        mujoco.mj_kinematics(model, data)
        return any(
            mujoco.mj_geomDistance(model, data, int(p), int(g), 1.0, None) <= 0 for p in gripper.pads for g in held
        )

    low, high = 0.0, 1.0
    while high - low > 1e-3 and touches(low):
        middle = (low + high) / 2.0
        low, high = (middle, high) if touches(middle) else (low, middle)
    return high if touches(low) else low


class _Posture(NamedTuple):
    spread: float
    """Sum of the distances between the moving bodies of the gripper [m]."""
    length: Float[Array, " actuator"]
    """Length of every actuator, which its servo controls."""


def _ends(scene: Scene, joints: list[int]) -> tuple[Float[Array, " joint"], Float[Array, " joint"]]:
    """Return the positions of the joints with the gripper open and closed.

    Each joint by itself, between the middles of the others, opens towards the end at which the moving bodies are
    farther apart: mirrored fingers have opposite signs.
    """
    ends = scene.model.jnt_range[joints]
    middle, wide = ends.mean(axis=1), np.ones(len(joints), dtype=int)
    for k in range(len(joints)):
        lower, upper = (
            _posture(scene, joints, np.where(np.arange(len(joints)) == k, ends[:, end], middle)).spread
            for end in (0, 1)
        )
        wide[k] = upper >= lower
    each = np.arange(len(joints))
    return ends[each, wide], ends[each, 1 - wide]


def _posture(scene: Scene, joints: list[int], q: Float[Array, " joint"] | None) -> _Posture:
    """Measure the gripper with its joints at positions, or at home (None)."""
    model = scene.model
    data = mujoco.MjData(model)
    data.qpos[:] = scene.home_qpos
    if q is not None:
        data.qpos[model.jnt_qposadr[joints]] = q
    mujoco.mj_fwdPosition(model, data)
    centres = data.xipos[model.jnt_bodyid[joints]]
    spread = float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).sum())
    return _Posture(spread, data.actuator_length.copy())


def _acts_on(model: mujoco.MjModel, actuator: int, joints: list[int]) -> bool:
    target = int(model.actuator_trnid[actuator, 0])
    kind = int(model.actuator_trntype[actuator])
    if kind == int(mujoco.mjtTrn.mjTRN_JOINT):
        return target in joints
    if kind == int(mujoco.mjtTrn.mjTRN_TENDON):
        first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
        return any(int(joint) in joints for joint in model.wrap_objid[first : first + count])
    return False
