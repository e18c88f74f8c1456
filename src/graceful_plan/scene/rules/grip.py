"""A grasp between two pads: the contacts with the carried object, and the load that friction and pressure can carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.equalities import actuated
from graceful_plan.scene.fingers import Hand, find_stroke, gap_between, leading_joints, moving_bodies
from graceful_plan.scene.model_parts import colliding_geoms, names
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

_REACH = 0.004
"""Largest gap between pads and object [m]: the finger positions in scene notes are often a little too wide."""
_FLUSH = 0.001
"""Contacts up to this much farther than a pad's nearest one count: they touch once the fingers close [m]."""
_FACING = 0.7
"""Least cosine between a contact normal and the closing direction of the fingers."""
_STEP = 0.01
"""Share of the stroke over which the motion of closing fingers is measured."""
HAND_FORCE = 70.0
"""Total force of fingers without drives [N], that of the bundled hand: efforts in URDFs may be placeholders."""
_FAR = 1e6
"""Control beyond any limit, so that the drive gives its largest force."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hold:
    """What holds the carried body; vectors are in the body's frame B.

    | field    | meaning                                                                        | unit | shape |
    |----------|--------------------------------------------------------------------------------|------|-------|
    | mass     | of the carried object                                                          | kg   |       |
    | p_GC     | from the middle of what holds it to the object's centre of mass                | m    | 3     |
    | p_BC     | the object's centre of mass                                                    | m    | 3     |
    | axes     | rows: the direction of the normal force, and two axes across it                |      | 3 3   |
    | friction | coefficient                                                                    |      |       |
    | torsion  | torque about the first axis per unit of normal force                           | m    |       |
    | force    | largest normal force; NaN if the model does not define it                      | N    |       |
    """

    mass: float
    p_GC: Float[Array, " xyz"]
    p_BC: Float[Array, " xyz"]
    axes: Float[Array, "3 xyz"]
    friction: float
    torsion: float
    force: float

    @property
    def moments(self) -> Float[Array, "3 xyz"]:
        """Rows that map the specific force of the carried body to the moment about each axis [kg m]."""
        return self.mass * np.cross(self.axes, self.p_GC)


@dataclass(frozen=True, kw_only=True, eq=False)
class Grip(Hold):
    """Two pads that press on the carried body from opposite sides, along the closing direction of the fingers.

    The friction of each contact lies inside an ellipsoid: tangential force over `friction`, and torsion over `torsion`,
    relative to the normal force. MuJoCo's elliptic cones have this shape, and soft fingers approximately (Howe and
    Cutkosky 1996). `p_GC` begins at the midpoint of the pads, and `force` is the total of both fingers.

    | field    | meaning                                                                        | unit | shape |
    |----------|--------------------------------------------------------------------------------|------|-------|
    | half     | half the distance between the pads, then half the size of the contact area     |      |       |
    |          | along the two axes across                                                      | m    | 3     |
    | approach | approach of the pads to each other over the stroke, at the present rate        | m    |       |
    """

    half: Float[Array, " 3"]
    approach: float

    @property
    def pressed(self) -> tuple[bool, bool]:
        """Whether the moment about each of the two axes across is carried by shifting pressure; otherwise by friction.

        Pressure shifts to the rim of the contact area; friction acts in opposite directions on the two pads. The
        mechanism that carries more counts. A round handle between flat pads resists rotation about its own axis only by
        friction.
        """
        h, first, second = self.half.tolist()
        return second > self.friction * h, first > self.friction * h


@dataclass(frozen=True, kw_only=True, eq=False)
class AdhesiveGrip(Hold):
    """A disc that holds the carried body by adhesion.

    `p_GC` begins at the centre of the disc, the first of `axes` points from the object to the disc, `torsion` is that
    of friction on the whole disc, and `force` is the breaking force. `radius` is that of the disc [m].
    """

    radius: float


def find_hold(scene: Scene) -> Grip | AdhesiveGrip:
    """Return how the carried object is held: by adhesion where the scene says so, else by two pads.

    Raises:
        UnsupportedError: If nothing is carried, or the object is not held between two pads.
    """
    held = scene.notes.held
    if held is None or held.grip is None:
        return find_grip(scene)
    data = Placement(scene).place(scene.home_qpos[scene.qpos_adr])
    mujoco.mj_comPos(scene.model, data)
    body, tool = scene.model.body(held.body).id, data.site(scene.tool)
    X_BW, R_WT = data.xmat[body].reshape(3, 3).T, tool.xmat.reshape(3, 3)
    return AdhesiveGrip(
        mass=float(scene.model.body_subtreemass[body]),
        p_GC=X_BW @ (data.subtree_com[body] - tool.xpos),
        p_BC=X_BW @ (data.subtree_com[body] - data.xpos[body]),
        axes=(R_WT * [1.0, 1.0, -1.0])[:, [2, 0, 1]].T @ X_BW.T,
        radius=held.grip.radius,
        friction=held.grip.friction,
        torsion=held.grip.friction * held.grip.radius * 2.0 / 3.0,
        force=held.grip.force,
    )


@per_layout
def find_grip(scene: Scene) -> Grip:
    """Return the grasp of the carried object between two pads in a scene.

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
    data = Placement(scene, model).place(scene.home_qpos[scene.qpos_adr])
    mujoco.mj_fwdPosition(model, data)
    X_BW = data.xmat[body].reshape(3, 3).T
    hand = Hand(model, scene.gripper_bodies, scene.joint_ids, site)
    closes = _closing_motion(hand, data.qpos)
    touched = _pads(hand, data, closes, body)
    if touched is None:
        raise UnsupportedError(f"GraspHolds() needs two pads: {told_of_pads(scene)}")
    pads = [pad.contacts for pad in touched]
    centres = [pad[:, :3].mean(axis=0) for pad in pads]
    closing = _unit(touched[0].normal - touched[1].normal)
    away = data.site_xmat[site].reshape(3, 3)[:, 2]
    first = _unit(away - closing * (closing @ away))
    axes = np.stack([closing, first, np.cross(closing, first)])
    off = [(pad[:, :3] - centre) @ axes[1:].T for pad, centre in zip(pads, centres, strict=True)]
    rims = np.min([np.abs(one).max(axis=0) for one in off], axis=0)
    friction = min(float(pad[:, 6].min()) for pad in pads)
    spread = min(float(np.linalg.norm(one, axis=1).mean()) for one in off)
    p_WC, p_WG = data.subtree_com[body], 0.5 * (centres[0] + centres[1])
    return Grip(
        mass=float(model.body_subtreemass[body]),
        p_GC=X_BW @ (p_WC - p_WG),
        p_BC=X_BW @ (p_WC - data.xpos[body]),
        axes=axes @ X_BW.T,
        half=np.array([0.5 * abs(float((centres[1] - centres[0]) @ closing)), *rims.tolist()]),
        friction=friction,
        torsion=min(float(pad[:, 7].min()) for pad in pads) + friction * spread,
        force=_force(hand, data, closes, touched),
        approach=sum(float(pad.velocity @ pad.normal) for pad in touched),
    )


def hand_of(scene: Scene) -> Hand:
    """Return the gripper of a scene."""
    return Hand(scene.model, scene.gripper_bodies, scene.joint_ids, scene.model.site(scene.tool).id)


def told_of_pads(scene: Scene) -> str:
    """Tell the distances of the fingers from the carried object at home."""
    assert scene.carried is not None
    model = scene.model
    hand = hand_of(scene)
    data = Placement(scene).place(scene.home_qpos[scene.qpos_adr])
    mine, geoms = moving_bodies(hand), scene.components["carried"].geoms
    name, remedy = scene.carried.body, "fingers=gp.Opening() in attach() closes them on it"
    gaps = {body: gap_between(model, data, colliding_geoms(model, [body]), geoms) for body in mine}
    gaps = {body: gap for body, gap in gaps.items() if colliding_geoms(model, [body])}
    if not gaps:
        return f"the gripper that holds {name!r} has no fingers that move and collide"
    near = {body: gap for body, gap in gaps.items() if gap <= _REACH}
    if not near:
        gap = min(gaps.values())
        far = f"{1e3 * gap:.0f} mm away" if gap < 1.0 else "more than 1 m away"
        return f"no finger touches {name!r} ({far}); {remedy}"
    words = ", ".join(names(model, mujoco.mjtObj.mjOBJ_BODY, near))
    return f"only {words} touch {name!r}, not from two opposite sides in the direction in which the fingers close"


class _Pad(NamedTuple):
    """A rigid part of the gripper that presses on the carried object."""

    contacts: Float[Array, "contact 8"]
    """Position and normal in W, towards the object; friction, torsion [m]."""
    velocity: Float[Array, " xyz"]
    """Velocity of the part at the contacts while the gripper closes, per share of its stroke [m]."""

    @property
    def normal(self) -> Float[Array, " xyz"]:
        return _unit(self.contacts[:, 3:6].mean(axis=0))


def _closing_motion(hand: Hand, qpos: Float[Array, " model_nq"]) -> Float[Array, " model_nv"]:
    """Return the velocity of all joints while the gripper closes, per share of its stroke."""
    model = hand.model
    stroke, velocity = find_stroke(hand, qpos), np.zeros(model.nv)
    if not stroke.joints:
        return velocity
    now = {j: float(qpos[model.jnt_qposadr[j]]) for j in stroke.joints}
    step = dict(zip(stroke.joints, (_STEP * (stroke.closed - stroke.open)).tolist(), strict=True))
    ends = {j: sorted(pair) for j, *pair in zip(stroke.joints, stroke.closed, stroke.open, strict=True)}
    before, after = (
        hand.posed(qpos, {j: float(np.clip(now[j] + way * step[j], *ends[j])) for j in stroke.joints}).qpos
        for way in (-0.5, 0.5)
    )
    mujoco.mj_differentiatePos(model, velocity, _STEP, before, after)
    return velocity


def _pads(hand: Hand, data: mujoco.MjData, closes: Float[Array, " model_nv"], body: int) -> tuple[_Pad, _Pad] | None:
    """Return the two parts of the gripper that approach each other and press on the carried object; None if not two."""
    model = hand.model
    found: dict[int, list[list[float]]] = {}
    for contact in data.contact[: data.ncon]:
        bodies = model.geom_bodyid[[contact.geom1, contact.geom2]].tolist()
        hers = [int(model.body_rootid[b]) == body for b in bodies]
        if not any(hers) or bodies[int(hers[0])] not in hand.bodies:
            continue
        # Normals point from the first geom to the second; rows have them point from the finger to the object.
        normal = np.array(contact.frame[:3]) * (-1.0 if hers[0] else 1.0)
        row = [*contact.pos, *normal, contact.friction[0], _torsion(contact), float(contact.dist)]
        found.setdefault(int(model.body_weldid[bodies[int(hers[0])]]), []).append(row)
    parts = {part: np.array(rows) for part, rows in found.items()}
    speeds = {part: _speed(model, data, part, rows[:, :3].mean(axis=0), closes) for part, rows in parts.items()}
    pairs = []
    for i, j in combinations(sorted(parts), 2):
        nearing = speeds[i] - speeds[j]
        length = float(np.linalg.norm(nearing))
        if length > 0.0:
            first, second = (_facing(parts[part], side * nearing / length) for part, side in ((i, 1.0), (j, -1.0)))
            if len(first) and len(second):
                pairs.append((_Pad(first, speeds[i]), _Pad(second, speeds[j])))
    return pairs[0] if len(pairs) == 1 else None


def _facing(rows: Float[Array, "contact 9"], closing: Float[Array, " xyz"]) -> Float[Array, "facing 8"]:
    """Return the contacts that press along a direction, except those much farther from the object than the nearest."""
    rows = rows[rows[:, 3:6] @ closing >= _FACING]
    return rows[rows[:, 8] < rows[:, 8].min(initial=np.inf) + _FLUSH, :8]


def _speed(
    model: mujoco.MjModel, data: mujoco.MjData, body: int, point: Float[Array, " xyz"], qvel: Float[Array, " model_nv"]
) -> Float[Array, " xyz"]:
    """Return the velocity of a point of a body while the joints move."""
    slope = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, slope, None, point, body)
    return slope @ qvel


def _torsion(contact: mujoco.MjContact) -> float:
    return float(contact.friction[2]) if contact.dim >= 4 else 0.0


def _force(hand: Hand, data: mujoco.MjData, closes: Float[Array, " model_nv"], pads: Sequence[_Pad]) -> float:
    """Return the largest total force with which drives press both pads together [N]; NaN if it is unknown.

    The power of the drives while the gripper closes is the force of a pad times the speed at which the pads approach.
    Without drives, it is that of the bundled hand, or that of the efforts of the leading joints if they are less.
    """
    model, nearing = hand.model, sum(float(pad.velocity @ pad.normal) for pad in pads)
    dofs = np.isin(model.dof_jntid, hand.joints)
    if actuated(model).isdisjoint(hand.joints):
        leading = [j for j in leading_joints(hand) if model.jnt_actfrclimited[j]]
        power = float(np.abs(model.jnt_actfrcrange[leading, 1] * closes[model.jnt_dofadr[leading]]).sum())
        return min(HAND_FORCE, 2.0 * power / nearing) if leading else HAND_FORCE
    powers = []
    for way in (-_FAR, _FAR):
        model.actuator_ctrllimited[:] = 0
        data.ctrl[:] = way
        mujoco.mj_fwdActuation(model, data)
        powers.append(abs(float(data.qfrc_actuator[dofs] @ closes[dofs])))
    force = 2.0 * min(powers) / nearing
    return force if 0.0 < force < _FAR else float("nan")


def _unit(a: Float[Array, " xyz"]) -> Float[Array, " xyz"]:
    return a / np.linalg.norm(a)
