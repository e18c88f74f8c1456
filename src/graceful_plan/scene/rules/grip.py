"""A grasp between two pads: the contacts with the carried object, and the load that friction and pressure can carry."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.model_parts import subtree
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_REACH = 0.004
"""Largest gap between pads and object [m]: the finger positions in scene notes are often a little too wide."""
_FLUSH = 0.001
"""Contacts up to this much farther than a pad's nearest one count: they touch once the fingers close [m]."""
_FACING = 0.7
"""Least cosine between a contact normal and the closing direction of the fingers."""
_FAR = 1e6
"""Control beyond any limit, so that the drive gives its largest force."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Grip:
    """Two pads that press on the carried body from opposite sides; vectors are in the body's frame B.

    The friction of each contact lies inside an ellipsoid: tangential force over `friction`, and torsion over `torsion`,
    relative to the normal force. MuJoCo's elliptic cones have this shape, and soft fingers approximately (Howe and
    Cutkosky 1996).

    | field    | meaning                                                                        | unit | shape |
    |----------|--------------------------------------------------------------------------------|------|-------|
    | mass     | of the carried object                                                          | kg   |       |
    | p_GC     | from the midpoint of the pads to the object's centre of mass                   | m    | 3     |
    | p_BC     | the object's centre of mass                                                    | m    | 3     |
    | axes     | rows: the closing direction of the fingers, and two axes across it             |      | 3 3   |
    | half     | half the distance between the pads, then half the size of the contact area     |      |       |
    |          | along the two axes across                                                      | m    | 3     |
    | friction | coefficient                                                                    |      |       |
    | torsion  | torque about the closing axis per unit of normal force                         | m    |       |
    | force    | total force of both fingers; NaN if the model does not define it               | N    |       |
    """

    mass: float
    p_GC: Float[Array, " xyz"]
    p_BC: Float[Array, " xyz"]
    axes: Float[Array, "3 xyz"]
    half: Float[Array, " 3"]
    friction: float
    torsion: float
    force: float

    @property
    def moments(self) -> Float[Array, "3 xyz"]:
        """Rows that map the specific force of the carried body to the moment about each axis [kg m]."""
        return self.mass * np.cross(self.axes, self.p_GC)

    @property
    def pressed(self) -> tuple[bool, bool]:
        """Whether the moment about each of the two axes across is carried by shifting pressure; otherwise by friction.

        Pressure shifts to the rim of the contact area; friction acts in opposite directions on the two pads. The
        mechanism that carries more counts. A round handle between flat pads resists rotation about its own axis only by
        friction.
        """
        h, first, second = self.half.tolist()
        return second > self.friction * h, first > self.friction * h


@per_layout
def find_grip(scene: Scene) -> Grip:
    """Return the grasp of the carried object in a scene.

    The pads are the contacts that MuJoCo finds between the carried body and geoms moved by the gripper's joints.
    Coefficients of friction are combined as in MuJoCo's simulation.

    Raises:
        UnsupportedError: If nothing is carried, or the object is not held between two pads.
    """
    if scene.carried is None:
        raise UnsupportedError("GraspHolds() needs a carried object; this scene has none")
    spec = scene.spec.copy()
    for geom in spec.geoms:
        geom.margin = _REACH
    model = spec.compile()
    body, site = int(model.body(scene.carried.body).id), int(model.site(scene.tool).id)
    joints = _finger_joints(scene, model)
    data = Placement(scene, model).place(scene.home_qpos[scene.qpos_adr])
    mujoco.mj_fwdPosition(model, data)
    X_BW = data.xmat[body].reshape(3, 3).T
    pads = [_touched(model, data, finger, body) for finger in model.jnt_bodyid[joints].tolist()]
    touched = [pad for pad in pads if len(pad)]
    if len(touched) != 2:
        raise UnsupportedError(f"{scene.carried.body!r} is held by {len(touched)} fingers; GraspHolds() needs two")
    centres = [pad[:, :3].mean(axis=0) for pad in touched]
    closing = _unit(touched[0][:, 3:6].mean(axis=0) - touched[1][:, 3:6].mean(axis=0))
    away = data.site_xmat[site].reshape(3, 3)[:, 2]
    first = _unit(away - closing * (closing @ away))
    axes = np.stack([closing, first, np.cross(closing, first)])
    off = [(pad[:, :3] - centre) @ axes[1:].T for pad, centre in zip(touched, centres, strict=True)]
    rims = np.min([np.abs(one).max(axis=0) for one in off], axis=0)
    friction = min(float(pad[:, 6].min()) for pad in touched)
    spread = min(float(np.linalg.norm(one, axis=1).mean()) for one in off)
    p_WC, p_WG = data.subtree_com[body], 0.5 * (centres[0] + centres[1])
    return Grip(
        mass=float(model.body_subtreemass[body]),
        p_GC=X_BW @ (p_WC - p_WG),
        p_BC=X_BW @ (p_WC - data.xpos[body]),
        axes=axes @ X_BW.T,
        half=np.array([0.5 * abs(float((centres[1] - centres[0]) @ closing)), *rims.tolist()]),
        friction=friction,
        torsion=min(float(pad[:, 7].min()) for pad in touched) + friction * spread,
        force=_force(model, data, joints),
    )


def _finger_joints(scene: Scene, model: mujoco.MjModel) -> Int[Array, " joint"]:
    """Return the gripper's joints."""
    hand, planned = scene.gripper_bodies, scene.joint_ids
    return np.array([j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in hand and j not in planned], dtype=int)


def _touched(model: mujoco.MjModel, data: mujoco.MjData, finger: int, body: int) -> Float[Array, "contact 8"]:
    """Return contacts between a finger and the carried object: position and normal in W, friction, torsion [m]."""
    mine, rows, dist = subtree(model, finger), [], []
    closing = data.xmat[finger].reshape(3, 3) @ model.jnt_axis[model.body_jntadr[finger]]
    for contact in data.contact[: data.ncon]:
        bodies = model.geom_bodyid[[contact.geom1, contact.geom2]].tolist()
        hers = [int(model.body_rootid[b]) == body for b in bodies]
        if not any(hers) or bodies[int(hers[0])] not in mine:
            continue
        normal = np.array(contact.frame[:3])
        if abs(float(normal @ closing)) < _FACING:
            continue
        # Normals point from the first geom to the second; rows have them point from the finger to the object.
        rows.append([*contact.pos, *(normal * (-1.0 if hers[0] else 1.0)), contact.friction[0], _torsion(contact)])
        dist.append(float(contact.dist))
    flush = np.array(dist) < min(dist, default=0.0) + _FLUSH
    return np.array(rows, dtype=float).reshape(-1, 8)[flush]


def _torsion(contact: mujoco.MjContact) -> float:
    return float(contact.friction[2]) if contact.dim >= 4 else 0.0


def _force(model: mujoco.MjModel, data: mujoco.MjData, joints: Int[Array, " joint"]) -> float:
    """Return the largest total force of the fingers' drives [N]; NaN if it is unknown."""
    if not np.all(model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_SLIDE)):
        return float("nan")
    forces = []
    for way in (-_FAR, _FAR):
        model.actuator_ctrllimited[:] = 0
        data.ctrl[:] = way
        mujoco.mj_fwdActuation(model, data)
        forces.append(float(np.abs(data.qfrc_actuator[model.jnt_dofadr[joints]]).sum()))
    return min(forces) if 0.0 < min(forces) < _FAR else float("nan")


def _unit(a: Float[Array, " xyz"]) -> Float[Array, " xyz"]:
    return a / np.linalg.norm(a)
