"""Closed chains, such as the linkage of a gripper: their passive joints close them."""

from __future__ import annotations

import copy
import logging
from collections.abc import Collection

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.equalities import (
    active_equalities,
    actuated,
    equality_label,
    followers,
    joint_names,
    loop_equalities,
    passive_joints,
    tied_joints,
)

_LOG = logging.getLogger(__name__)
_SAME = 1e-6
"""Largest residual of an equality that counts as fulfilled [m or rad]."""
_OPEN = 1e-3
"""Residual from which a closed chain counts as open [m or rad]: 1 mm is a tenth of a sphere's protrusion."""
_ROUNDS, _STEP = 60, 0.2
"""Newton steps to close a chain, and the largest change of a joint in one [m or rad]."""
_STILL = 1e-6
"""Step from which on the springs of a chain count as in balance [m or rad]."""
_SOFT = 1e-6
"""Stiffness of joints without springs [N m/rad or N/m]: of all ways to close a chain, the smallest change is taken."""
_SCALAR = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def closed(
    model: mujoco.MjModel,
    qpos: Float[Array, " model_nq"],
    chosen: Collection[int],
    planned: Collection[int],
    strict: bool,
) -> Float[Array, " model_nq"]:
    """Return a state with closed chains, by Gauss-Newton steps of the passive joints on MuJoCo's own residuals.

    Where the chains leave passive joints free, the springs of joints and tendons decide, against the joints' ranges.
    """
    loops = loop_equalities(model, planned)
    if not loops:
        return qpos
    free = set(passive_joints(model, planned)).difference(chosen)
    fixed = actuated(model) | set(chosen) | set(planned)
    for follower, leader in followers(model).items():
        if {follower, leader} & free:
            free |= {j for j in (follower, leader) if j >= 0 and j not in fixed}
    rows = [
        e
        for e in active_equalities(model)
        if e in loops or ((tied := tied_joints(model, e)) & free and not tied & set(planned))
    ]
    twin = copy.copy(model)
    twin.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    twin.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    twin.eq_active0[np.setdiff1d(np.arange(model.neq), rows)] = 0
    data = mujoco.MjData(twin)
    data.qpos[:] = qpos
    dofs = np.isin(twin.dof_jntid, list(free))
    for _ in range(_ROUNDS):
        residual, slope = _residual(twin, data)
        if not len(residual) or np.abs(residual).max() <= _SAME:
            break
        step = np.zeros(twin.nv)
        step[dofs] = np.linalg.lstsq(slope[:, dofs], -residual, rcond=1e-6)[0]
        step *= min(1.0, _STEP / max(np.abs(step).max(), 1e-12))
        mujoco.mj_integratePos(twin, data.qpos, step, 1.0)
        _clip(twin, data.qpos, free)
    _relax(twin, data, np.flatnonzero(dofs))
    residual, _ = _residual(twin, data)
    worst = float(np.abs(residual).max(initial=0.0))
    if worst > _OPEN:
        told = ", ".join(equality_label(model, e) for e in rows if e in loops)
        if strict and free:  # states of a simulation give all joints; they leave soft equalities open
            where = dict(zip(joint_names(model, chosen), [float(qpos[model.jnt_qposadr[j]]) for j in sorted(chosen)],
                             strict=True))  # fmt: skip
            raise SettingError("positions", where, f"positions that close {told}; they leave {worst:.3g} m or rad open")
        _LOG.warning("closed chains stay open by %.3g m or rad at their given or initial positions: %s", worst, told)
    return np.array(data.qpos)


def _relax(model: mujoco.MjModel, data: mujoco.MjData, dofs: Int[Array, " dof"]) -> None:
    """Let springs move passive joints of closed chains to the least energy, by Newton steps.

    A joint that reaches an end of its range stays there.
    """
    stiffness = np.diag(model.jnt_stiffness[model.dof_jntid].astype(float))
    for t in np.flatnonzero(model.tendon_stiffness).tolist():
        row = _tendon_slope(model, data, t)
        stiffness += model.tendon_stiffness[t] * np.outer(row, row)
    if not stiffness[dofs].any():
        return
    stiffness += _SOFT * np.eye(model.nv)
    loose = dofs
    for _ in range(_ROUNDS):
        residual, slope = _residual(model, data)
        mujoco.mj_fwdVelocity(model, data)  # the forces of springs
        J, K = slope[:, loose], stiffness[np.ix_(loose, loose)]
        system = np.block([[K, J.T], [J, np.zeros((len(J), len(J)))]])
        wanted = np.concatenate([data.qfrc_spring[loose], -residual])
        step = np.linalg.lstsq(system, wanted, rcond=1e-12)[0][: len(loose)]
        step *= min(1.0, _STEP / max(np.abs(step).max(initial=0.0), 1e-12))
        share = _share_in_range(model, data, loose, step)
        whole = np.zeros(model.nv)
        whole[loose] = min(1.0, share.min(initial=1.0)) * step
        mujoco.mj_integratePos(model, data.qpos, whole, 1.0)
        if share.min(initial=1.0) < 1.0:
            loose = np.delete(loose, share.argmin())
        elif np.abs(step).max(initial=0.0) <= _STILL:
            break


def _share_in_range(
    model: mujoco.MjModel, data: mujoco.MjData, dofs: Int[Array, " dof"], step: Float[Array, " dof"]
) -> Float[Array, " dof"]:
    """Return the share of a step after which each degree of freedom reaches an end of its joint's range."""
    joints = model.dof_jntid[dofs]
    limited = (model.jnt_limited[joints] != 0) & np.isin(model.jnt_type[joints], _SCALAR)
    end = np.where(step > 0.0, model.jnt_range[joints, 1], model.jnt_range[joints, 0])
    room = np.maximum((end - data.qpos[model.jnt_qposadr[joints]]) * np.sign(step), 0.0)
    moves = limited & (np.abs(step) > 1e-12)
    return np.where(moves, room / np.where(moves, np.abs(step), 1.0), np.inf)


def _tendon_slope(model: mujoco.MjModel, data: mujoco.MjData, tendon: int) -> Float[Array, " model_nv"]:
    row, first = np.zeros(model.nv), int(model.ten_J_rowadr[tendon])
    filled = slice(first, first + int(model.ten_J_rownnz[tendon]))
    row[model.ten_J_colind[filled]] = data.ten_J[filled]
    return row


def _residual(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Float[Array, " row"], Float[Array, "row model_nv"]]:
    """Return residuals and slopes of the active equalities."""
    mujoco.mj_fwdPosition(model, data)
    mine = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    return np.array(data.efc_pos[mine]), data.efc_J.reshape(-1, model.nv)[mine]


def _clip(model: mujoco.MjModel, qpos: Float[Array, " model_nq"], joints: Collection[int]) -> None:
    for joint in joints:
        if model.jnt_limited[joint] and int(model.jnt_type[joint]) not in (
            int(mujoco.mjtJoint.mjJNT_FREE),
            int(mujoco.mjtJoint.mjJNT_BALL),
        ):
            adr = model.jnt_qposadr[joint]
            qpos[adr] = np.clip(qpos[adr], *model.jnt_range[joint])
