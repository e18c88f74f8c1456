"""The check of joint torques along a motion: inverse dynamics of robot and carried object, with the judge's kinematics.

All times are evaluated together. In world coordinates the recursions of Newton and Euler are sums: of velocities and
accelerations over the joints that move a link, and of forces and moments over the links that a joint moves.

References:
    R. Featherstone, "Rigid Body Dynamics Algorithms", Springer 2008, section 5.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.judge.kinematics import cross_matrix, kinematics
from graceful_plan.judge.preparation import own_placement
from graceful_plan.path import Path
from graceful_plan.result import Check
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

TOLERANCE = 0.01
"""Relative tolerance of the torque limits; models of masses are no better than this."""
_FIRST, _SECOND = np.array([1, 2, 0]), np.array([2, 0, 1])
"""Axes of the two factors in each component of a cross product."""
FEW, MANY = 24, 256
"""Numbers of states that are evaluated for the warning, in 0.3 ms, and for the constraint."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkDynamics:
    """Masses of the links of a scene's robot, with the carried object, and forces of its joints.

    | field     | meaning                                                                | unit       | shape    |
    |-----------|------------------------------------------------------------------------|------------|----------|
    | mass      | of each link, link 1 first                                             | kg         | nq       |
    | centre    | of mass in W with all planned joints at 0                              | m          | nq 3     |
    | spread    | second moments of the mass about that centre, in the axes of W there   | kg m^2     | nq 3 3   |
    | lifted    | mass that the model's gravity compensation carries                     | kg         | nq       |
    | lifted_at | centre of that mass in W with all planned joints at 0                  | m          | nq 3     |
    | relieved  | whether that compensation is not a torque of the joint's drive         |            | nq       |
    | armature  | rotor inertia                                                          | kg m^2; kg | nq       |
    | damping   | viscous damping                                                        | N m s; N s/m | nq     |
    | stiffness | of a spring at the joint                                               | N m; N/m   | nq       |
    | relaxed   | position where that spring is relaxed                                  | rad or m   | nq       |
    | gravity   | acceleration of free fall in W                                         | m/s^2      | 3        |
    """

    mass: Float[Array, " nq"]
    centre: Float[Array, "nq 3"]
    spread: Float[Array, "nq 3 3"]
    lifted: Float[Array, " nq"]
    lifted_at: Float[Array, "nq 3"]
    relieved: Bool[Array, " nq"]
    armature: Float[Array, " nq"]
    damping: Float[Array, " nq"]
    stiffness: Float[Array, " nq"]
    relaxed: Float[Array, " nq"]
    gravity: Float[Array, " 3"]


def torque_check(motion: Path | Trajectory, scene: Scene, share: float = 1.0, states: int = FEW) -> Check:
    """Check joint torques against the limits of the scene; the worst value is relative to the limit.

    Those of a path hold the robot still at its vertices. Half of the states of a trajectory are at equal time steps,
    the others at both ends of the pieces with the hardest accelerations.

    Args:
        motion: The motion.
        scene: Scene in which at least one joint has a finite torque limit.
        share: Fraction of the limits to keep to.
        states: Number of states of a trajectory to evaluate.
    """
    if isinstance(motion, Trajectory) and len(motion) > 1:
        ends = motion.piece_accelerations
        hardest = np.maximum(*(np.abs(one / scene.limits.acceleration).max(axis=1) for one in ends))
        piece = np.argsort(-hardest, kind="stable")[: states // 4]
        rows = np.concatenate([piece, piece + 1])
        even = np.linspace(motion.t[0], motion.t[-1], states // 2)
        state = motion.at(even)
        q, qd = np.concatenate([motion.q[rows], state.q]), np.concatenate([motion.qd[rows], state.qd])
        qdd = np.concatenate([*(one[piece] for one in ends), state.qdd])
        at = np.append(motion.t[rows], even)
    else:
        q, qd, qdd = motion.q, np.zeros_like(motion.q), np.zeros_like(motion.q)
        at = motion.t if isinstance(motion, Trajectory) else np.append(0.0, np.cumsum(motion.segment_lengths))
    limit = share * scene.limits.torque
    torque = joint_torques(q, qd, qdd, scene)
    used = np.abs(torque) / limit
    row, joint = np.unravel_index(int(np.argmax(used)), used.shape)
    worst, beyond = float(used[row, joint]), (used > 1.0 + TOLERANCE).any(axis=1)
    need = f"{abs(torque[row, joint]):.3g} of {limit[joint]:.3g} N m or N"
    where = f"{at[row]:.3g} {'s' if isinstance(motion, Trajectory) else 'rad'}"
    detail = f"joint {scene.joints[joint]!r}: {need} at {where}"
    first = float(at[beyond].min()) if beyond.any() else None
    return Check(passed=first is None, worst=worst, limit=1.0 + TOLERANCE, first=first, detail=detail)


def joint_torques(
    q: Float[Array, "n nq"], qd: Float[Array, "n nq"], qdd: Float[Array, "n nq"], scene: Scene
) -> Float[Array, "n nq"]:
    """Return the torques of the joints in given states [N m or N]; dry friction and contacts are not included."""
    known, of = kinematics(scene), _dynamics(scene)
    links = np.stack(list(known.links(q)))
    axes, R, shift = known.joint_axes(links), links[1:, :, :3, :3], links[1:, :, :3, 3]
    p, z = axes[:, :, :3, 0], axes[:, :, :3, 1]
    v, a = qd.T[..., None], qdd.T[..., None]
    hinge, moves = ~known.slides[:, None, None], known.carries[:, 1:]
    turn = z * (hinge * v)
    w = _sums(moves.T, turn)
    before = w - turn
    alpha = _sums(moves.T, z * (hinge * a) + _cross(before, turn))
    # Times the offset of two points of a link, B is the difference of their accelerations.
    B = cross_matrix(alpha) + w[..., :, None] * w[..., None, :] - np.square(w).sum(axis=-1)[..., None, None] * np.eye(3)
    c = _placed(R, shift, of.centre)
    below = known.parent - 1  # the joint of the link on which a joint is; that of the base does not move
    offsets = (p - p[below]) * (below >= 0)[:, None, None]
    onwards = (B[below] @ offsets[..., None])[..., 0]
    if known.slides.any():
        onwards += ~hinge * (z * a + 2.0 * _cross(before, z * v))
    force = of.mass[:, None, None] * ((B @ (c - p)[..., None])[..., 0] + _sums(moves.T, onwards) - of.gravity)
    spins = B @ (R @ (of.spread[:, None] @ np.swapaxes(R, 2, 3)))
    moment = _cross(c, force) + spins[..., _SECOND, _FIRST] - spins[..., _FIRST, _SECOND]
    torque = _felt_at(p, z, hinge, moves, force, moment)
    if of.lifted.any():
        up = np.broadcast_to(-of.lifted[:, None, None] * of.gravity, c.shape)
        torque -= of.relieved * _felt_at(p, z, hinge, moves, up, _cross(_placed(R, shift, of.lifted_at), up))
    return torque + of.armature * qdd + of.damping * qd + of.stiffness * (q - of.relaxed)


def _felt_at(
    p: Float[Array, "nq n 3"],
    z: Float[Array, "nq n 3"],
    hinge: Bool[Array, "nq 1 1"],
    moves: Bool[Array, "nq nq"],
    force: Float[Array, "nq n 3"],
    moment: Float[Array, "nq n 3"],
) -> Float[Array, "n nq"]:
    """Return the torques of joints that apply forces [N] and moments about the origin of W [N m] to the links."""
    both = _sums(moves, np.concatenate([force, moment], axis=-1))
    force, moment = both[..., :3], both[..., 3:]
    return (z * np.where(hinge, moment - _cross(p, force), force)).sum(axis=-1).T


def _sums(chosen: Bool[Array, "nq nq"], values: Float[Array, "nq n size"]) -> Float[Array, "nq n size"]:
    """Return the sums of the chosen joints or links, one row for each sum."""
    return (chosen.astype(float) @ values.reshape(len(values), -1)).reshape(values.shape)


def _cross(a: Float[Array, "nq n 3"], b: Float[Array, "nq n 3"]) -> Float[Array, "nq n 3"]:
    return a[..., _FIRST] * b[..., _SECOND] - a[..., _SECOND] * b[..., _FIRST]


def _placed(
    R: Float[Array, "nq n 3 3"], shift: Float[Array, "nq n 3"], points: Float[Array, "nq 3"]
) -> Float[Array, "nq n 3"]:
    return (R @ points[:, None, :, None])[..., 0] + shift


@per_scene
def _dynamics(scene: Scene) -> LinkDynamics:
    placement, known = own_placement(scene), kinematics(scene)
    nq = len(scene.joints)
    data, model = placement.place(np.zeros(nq)), placement.model
    mujoco.mj_comPos(model, data)
    mass, lifted = np.zeros(nq), np.zeros(nq)
    centre, lifted_at, spread = np.zeros((nq, 3)), np.zeros((nq, 3)), np.zeros((nq, 3, 3))
    joints = [model.joint(name).id for name in scene.joints]
    for k in range(nq):
        bodies = np.flatnonzero(known.bodies == k + 1)
        m, x = model.body_mass[bodies], data.xipos[bodies]
        mass[k] = m.sum()
        centre[k] = m @ x / max(mass[k], 1e-12)
        R = data.ximat[bodies].reshape(-1, 3, 3)
        own = model.body_inertia[bodies]
        moments = R @ ((0.5 * own.sum(axis=1, keepdims=True) - own)[:, :, None] * np.swapaxes(R, 1, 2))
        off = x - centre[k]
        spread[k] = (moments + m[:, None, None] * off[:, :, None] * off[:, None]).sum(axis=0)
        carried = m * model.body_gravcomp[bodies]
        lifted[k] = carried.sum()
        lifted_at[k] = carried @ x / lifted[k] if lifted[k] else centre[k]
    dofs = model.jnt_dofadr[joints]
    return LinkDynamics(
        mass=mass,
        centre=centre,
        spread=spread,
        lifted=lifted,
        lifted_at=lifted_at,
        relieved=np.array(model.jnt_actgravcomp[joints]) == 0,
        armature=np.array(model.dof_armature[dofs]),
        damping=np.array(model.dof_damping[dofs]),
        stiffness=np.array(model.jnt_stiffness[joints]),
        relaxed=np.array(model.qpos_spring[model.jnt_qposadr[joints]]),
        gravity=np.array(model.opt.gravity),
    )
