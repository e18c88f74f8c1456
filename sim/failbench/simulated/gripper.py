"""Find the gripper in a scene's model, and the direction in which it opens."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from failbench.simulated.added_drives import ADHESION, adhesion_of
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float, Int
from graceful_plan.scene.fingers import Hand, clear_share, find_stroke, moving_bodies
from graceful_plan.scene.model_parts import colliding_geoms
from graceful_plan.scene.rules.grip import hand_of


class Gripper(NamedTuple):
    """Joints and actuators of the gripper, below the last planned joint."""

    bodies: tuple[int, ...]
    """The bodies that hang on the last planned joint."""
    pads: Int[Array, " geom"]
    """Colliding geoms that hold an object: of the moving parts, and of a fixed jaw."""
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
    model, hand = scene.model, hand_of(scene)
    if adhesion_of(scene) is not None:
        return _adhesive(scene)
    stroke = find_stroke(hand, scene.home_qpos)
    actuators = [a for a in range(model.nu) if _acts_on(model, a, hand.joints) and model.actuator_biasprm[a, 1] < 0.0]
    lengths = [_lengths(hand, scene.home_qpos, stroke.at(share)) for share in (1.0, 0.0)]
    return Gripper(
        bodies=tuple(sorted(scene.gripper_bodies)),
        pads=np.array(_pads(hand), dtype=int),
        joints=np.array(hand.joints, dtype=int),
        actuators=np.array(actuators, dtype=int),
        open=lengths[0][actuators],
        closed=lengths[1][actuators],
        home=_lengths(hand, scene.home_qpos, {})[actuators],
    )


def _adhesive(scene: Scene) -> Gripper:
    """Return a vacuum cup or magnet, which pulls (1) or does not (0)."""
    model = scene.model
    actuator = int(model.actuator(ADHESION).id)
    return Gripper(
        bodies=tuple(sorted(scene.gripper_bodies)),
        pads=np.array(colliding_geoms(model, [int(model.actuator_trnid[actuator, 0])]), dtype=int),
        joints=np.zeros(0, dtype=int),
        actuators=np.array([actuator]),
        open=np.zeros(1),
        closed=np.ones(1),
        home=np.zeros(1),
    )


def clear_opening(scene: Scene) -> float:
    """Return the opening from which on no finger touches the carried object.

    Returns:
        Opening from closed (0) to open (1); 0 without a carried object or a gripper.
    """
    if scene.carried is None or adhesion_of(scene) is not None:
        return 0.0
    model = scene.model
    data = scene.data_at(np.array([model.qpos0[a] for a in scene.qpos_adr]))
    return clear_share(hand_of(scene), data.qpos, scene.components["carried"].geoms)


def _pads(hand: Hand) -> tuple[int, ...]:
    """Return the colliding geoms of the moving parts; of the whole gripper if only one part moves, against a jaw."""
    moving = moving_bodies(hand)
    parts = {int(hand.model.body_weldid[body]) for body in moving if colliding_geoms(hand.model, [body])}
    return colliding_geoms(hand.model, hand.bodies if len(parts) == 1 else moving)


def _lengths(hand: Hand, qpos: Float[Array, " model_nq"], positions: dict[int, float]) -> Float[Array, " actuator"]:
    """Return the length of every actuator, which its servo controls, with gripper joints at given positions."""
    data = hand.posed(qpos, positions)
    mujoco.mj_fwdPosition(hand.model, data)
    return data.actuator_length.copy()


def _acts_on(model: mujoco.MjModel, actuator: int, joints: list[int]) -> bool:
    target = int(model.actuator_trnid[actuator, 0])
    kind = int(model.actuator_trntype[actuator])
    if kind == int(mujoco.mjtTrn.mjTRN_JOINT):
        return target in joints
    if kind == int(mujoco.mjtTrn.mjTRN_TENDON):
        first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
        return any(int(joint) in joints for joint in model.wrap_objid[first : first + count])
    return False
