"""Drives that a scene's model lacks: servos of joints without actuators, as in URDF, and the pull of adhesion."""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.simulated.rolling import PLANAR
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.elements import Adhesion
from graceful_plan.scene.equalities import actuated
from graceful_plan.scene.fingers import Hand, Stroke, find_stroke
from graceful_plan.scene.rules.grip import HAND_FORCE, find_grip, hand_of

_BANDWIDTH = 0.2
"""Natural frequency of servos, times the time step: 100 rad/s at 2 ms, far from instability. Without feed-forward, an
acceleration of 5 rad/s^2 lags by 0.5 mrad; one of other joints moves a light wrist by more."""
ADHESION = "failbench/adhesion"
"""Name of the actuator of a vacuum cup or magnet, and of the body that touches the object."""
_SPHERES, _SPHERE = 12, 0.2
"""Number of spheres on the rim of a vacuum cup or magnet, and their radius relative to the disc's."""
_SAME = 1e-6
"""Differences of positions along the stroke that count as none [rad or m]."""
_LIGHT = 1e-4
"""Mass of such a sphere [kg]."""
_HIDDEN = 4
"""Group of geoms that pictures leave out."""
_GAP = 0.001
"""Gap across which vacuum cups and magnets pull [m]: the weld before the motion may leave one."""
_SOFT = 0.1
"""Share of the stroke by which fingers are short of their target when they press with their greatest force."""


def with_drives(scene: Scene, timestep: float) -> Scene:
    """Return a scene in which planned joints without an actuator have a servo, and so do fingers if none has one.

    A vacuum cup or magnet has an actuator that pulls. Servos are critically damped. Those of the arm have the scene's
    torque limits. Fingers press with the force of `find_grip`, or 70 N if they do not touch the object in the scene.

    Args:
        scene: The scene.
        timestep: Time step of the simulation [s].
    """
    model = scene.model
    driven = actuated(model)
    arm = scene.joint_ids if scene.base is None else scene.joint_ids[PLANAR:]
    bare = [j for j in arm if j not in driven]
    hand = hand_of(scene)
    stroke = find_stroke(hand, scene.home_qpos)
    idle = bool(stroke.joints) and driven.isdisjoint(hand.joints)
    grip = adhesion_of(scene)
    if not bare and not idle and grip is None:
        return scene
    spec, inertia, frequency = scene.spec.copy(), inertia_at(model, scene.home_qpos), _BANDWIDTH / timestep
    for joint in bare:
        moment = float(inertia[model.jnt_dofadr[joint], model.jnt_dofadr[joint]])
        _add_servo(spec, model.joint(joint).name, frequency**2 * moment, 2.0 * frequency * moment)
    if grip is not None:
        _add_adhesion(spec, scene, grip)
    elif idle:
        _add_finger_servos(spec, scene, hand, stroke, inertia)
    return Scene.build(spec, scene.notes)


def adhesion_of(scene: Scene) -> Adhesion | None:
    """Return the vacuum cup or magnet that holds the carried object; None if there is none."""
    return None if scene.notes.held is None else scene.notes.held.grip


def _add_adhesion(spec: mujoco.MjSpec, scene: Scene, grip: Adhesion) -> None:
    """Add a rim of small spheres at the tool, and an actuator that pulls the object to those that touch it.

    The sphere contacts stay when the object tilts, which those of a flat disc do not. They replace the contacts of the
    gripper with the object.
    """
    assert scene.carried is not None
    site, bodies = scene.model.site(scene.tool), spec.bodies
    for body in scene.gripper_bodies:
        bodies[body].name = bodies[body].name or f"failbench/body{body}"
        spec.add_exclude(bodyname1=bodies[body].name, bodyname2=scene.carried.body)
    parent = bodies[int(site.bodyid[0])]
    rim = parent.add_body(name=ADHESION, pos=site.pos, quat=site.quat)
    small = _SPHERE * grip.radius
    for angle in 2.0 * np.pi * np.arange(_SPHERES) / _SPHERES:
        place = [grip.radius * np.cos(angle), grip.radius * np.sin(angle), -small - _GAP]
        geom = rim.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[small, 0.0, 0.0], pos=place, mass=_LIGHT)
        # Contacts act from a distance of the gap on, where the plane of the disc is, so that none switches off and on.
        geom.margin, geom.gap, geom.group = _GAP, _GAP, _HIDDEN
        geom.friction = [grip.friction, 0.005, 0.0001]
    pull = spec.add_actuator(name=ADHESION, target=ADHESION, trntype=mujoco.mjtTrn.mjTRN_BODY)
    pull.set_to_adhesion(gain=grip.force)
    pull.ctrllimited, pull.ctrlrange = True, [0.0, 1.0]
    pull.forcelimited, pull.forcerange = True, [0.0, grip.force]


def _add_finger_servos(
    spec: mujoco.MjSpec, scene: Scene, hand: Hand, stroke: Stroke, inertia: Float[Array, "nv nv"]
) -> None:
    model, moving = hand.model, np.isin(hand.model.dof_jntid, hand.joints)
    force, approach = _pressing(scene, hand, stroke)
    ends = [hand.posed(scene.home_qpos, stroke.at(share)).qpos for share in (0.0, 1.0)]
    whole = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, whole, 1.0, ends[0], ends[1])
    whole[~moving] = 0.0
    mass = float(whole @ inertia @ whole)  # of all fingers, per share of the stroke
    tied = _tie_fingers(spec, scene, stroke)
    driven = 1 if tied else len(stroke.joints)
    for joint, length in zip(stroke.joints[:driven], np.abs(stroke.open - stroke.closed).tolist(), strict=False):
        limit = 0.5 * force * approach / (driven * length)
        kp = limit / (_SOFT * length)
        _add_servo(spec, model.joint(joint).name, kp, 2.0 * np.sqrt(kp * mass / driven) / length, limit)


def _tie_fingers(spec: mujoco.MjSpec, scene: Scene, stroke: Stroke) -> bool:
    """Let all leading joints follow the first, as if one motor moved them; otherwise loads push an object sideways.

    Returns:
        Whether the positions in the scene allow it.
    """
    model, way = scene.model, stroke.open - stroke.closed
    now = scene.home_qpos[model.jnt_qposadr[list(stroke.joints)]]
    shares = (now - stroke.closed) / way
    if np.ptp(shares * np.abs(way)) > _SAME:
        return False
    zero = model.qpos0[model.jnt_qposadr[list(stroke.joints)]]
    for k in range(1, len(stroke.joints)):
        factor = float(way[k] / way[0])
        offset = float(stroke.closed[k] - zero[k] - factor * (stroke.closed[0] - zero[0]))
        tie = spec.add_equality(name=f"failbench/tie{k}", type=mujoco.mjtEq.mjEQ_JOINT)
        tie.objtype = mujoco.mjtObj.mjOBJ_JOINT
        tie.name1, tie.name2 = (model.joint(stroke.joints[j]).name for j in (k, 0))
        tie.data = [offset, factor, *np.zeros(10)]
    return True


def _pressing(scene: Scene, hand: Hand, stroke: Stroke) -> tuple[float, float]:
    """Return the total force of the fingers [N], and the approach of the pads over the stroke [m]."""
    try:
        grip = find_grip(scene)
    except UnsupportedError:
        data = hand.posed(scene.home_qpos, {})
        away = np.linalg.norm(data.xanchor[list(stroke.joints)] - data.site_xpos[hand.tool], axis=1)
        slides = hand.model.jnt_type[list(stroke.joints)] == int(mujoco.mjtJoint.mjJNT_SLIDE)
        return HAND_FORCE, float((np.where(slides, 1.0, away) * np.abs(stroke.open - stroke.closed)).sum())
    return grip.force, grip.approach


def inertia_at(model: mujoco.MjModel, qpos: Float[Array, " qpos"]) -> Float[Array, "nv nv"]:
    """Return the inertia matrix in a state."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def _add_servo(spec: mujoco.MjSpec, joint: str, kp: float, kv: float, limit: float | None = None) -> None:
    servo = spec.add_actuator(name=f"failbench/servo/{joint}", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=kp, kv=kv)
    if limit is not None:
        servo.forcelimited, servo.forcerange = True, [-limit, limit]
