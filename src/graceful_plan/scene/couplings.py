"""Equalities of a model: joints that follow others, and closed chains.

Equalities that planned joints would break are refused: planned joints are independent of each other and of everything
else. Equalities among other joints hold in the state in which a scene keeps them: followers follow their leaders, and
closed chains, such as the linkage of a gripper, are closed by their passive joints. Inactive equalities are ignored,
as in MuJoCo.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.scene.model_parts import ancestors, body_joints, names

Array = np.ndarray

_LOG = logging.getLogger(__name__)

_OBJ = mujoco.mjtObj
_EQ = mujoco.mjtEq
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
_LOOPS = (int(_EQ.mjEQ_CONNECT), int(_EQ.mjEQ_WELD))
_TERMS = 5
"""Coefficients of the polynomial of a joint equality."""
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


def check_couplings(model: mujoco.MjModel, planned: Collection[int], robot: Collection[int]) -> None:
    """Check that no active equality restricts planned joints.

    Those that tie the robot to a free or mocap body of the surroundings are exempt: `warn_of_couplings` names them,
    unless the gripper holds the body.

    Raises:
        UnsupportedError: If one does; the message lists all of them.
    """
    problems = [
        f"{_label(model, e)} ({', '.join(_joint_names(model, _moving(model, e) & set(planned)))})"
        for e in _active(model)
        if _moving(model, e) & set(planned) and not _is_loose(model, e, robot)
    ]
    if problems:
        raise UnsupportedError(
            f"planned joints are restricted by equalities, which planners would break: {'; '.join(problems)}; plan "
            "other joints (joints=[...]), or set active='false' if the robot itself has no such coupling"
        )


def warn_of_couplings(
    model: mujoco.MjModel, planned: Collection[int], robot: Collection[int], held: Collection[int]
) -> None:
    """Log a warning for each restriction of planned joints that is ignored, by name."""
    for e in ties_to_loose(model, planned, robot):
        if not _touches(model, e, held):
            _LOG.warning(
                "%s is ignored: the body stays where the scene has it while the robot moves; attach() a body that the "
                "robot carries",
                _label(model, e),
            )
    for t in np.flatnonzero(model.tendon_limited).tolist():
        tied = _tendon_joints(model, t) & set(planned)
        if tied:
            label = names(model, _OBJ.mjOBJ_TENDON, [t])[0]
            _LOG.warning(
                "the limits of tendon %r are ignored; it depends on %s", label, ", ".join(_joint_names(model, tied))
            )


def ties_to_loose(model: mujoco.MjModel, planned: Collection[int], robot: Collection[int]) -> list[int]:
    """Return the active equalities that tie planned joints to free or mocap bodies; motions ignore them."""
    return [e for e in _active(model) if _moving(model, e) & set(planned) and _is_loose(model, e, robot)]


def followers(model: mujoco.MjModel) -> dict[int, int]:
    """Return the leader of each joint that an active equality makes follow another; -1 if it has to stay."""
    return {
        int(model.eq_obj1id[e]): int(model.eq_obj2id[e])
        for e in _active(model)
        if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT)
    }


def passive_joints(model: mujoco.MjModel, planned: Collection[int]) -> frozenset[int]:
    """Return the joints of closed chains that neither are planned nor have an actuator."""
    return frozenset(j for e in _loops(model, planned) for j in _moving(model, e)) - actuated(model)


def coupled(model: mujoco.MjModel, joint: int) -> frozenset[int]:
    """Return the joints that joint equalities tie to a joint, directly or over others, with the joint itself."""
    found, pairs = {joint}, followers(model).items()
    for _ in pairs:
        found |= {j for pair in pairs if found.intersection(pair) for j in pair if j >= 0}
    return frozenset(found)


def follow(
    model: mujoco.MjModel, qpos: Float[Array, " model_nq"], given: Mapping[int, float], planned: Collection[int]
) -> Float[Array, " model_nq"]:
    """Return a state in which joints have given positions and the equalities among joints that are not planned hold.

    A leader of which only a follower is given is moved so that the follower is where it is given. Passive joints close
    their chains.

    Args:
        model: The model.
        qpos: State of the whole model.
        given: Position of hinges and slides by joint id.
        planned: Planned joints, which stay.

    Raises:
        SettingError: If given positions contradict an equality, or leave a chain open although some of its passive
            joints are not given. If all are given, as in states of a simulation, an open chain is a warning.
    """
    if not model.neq:
        return _with(model, qpos, given)
    chosen = dict(given)
    for e in _active(model):
        y, x = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT) and y in given and x >= 0 and x not in given:
            chosen[x] = _leader(model, e, given[y])
    out = _with(model, qpos, chosen)
    ties = [e for e in _active(model) if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT)]
    for _ in ties:  # a follower can lead others
        for e in ties:
            y, x = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            if y in planned or x in planned:
                continue
            value = _follower(model, e, out)
            if y in chosen and abs(chosen[y] - value) > _SAME and y in given:
                word = names(model, _OBJ.mjOBJ_JOINT, [y])[0]
                raise SettingError(f"position of {word}", given[y], f"{value:g}, by {_label(model, e)}")
            out[model.jnt_qposadr[y]] = value
            if x in chosen:
                chosen[y] = value
    return _closed(model, out, chosen, planned, bool(given))


# --- joint equalities -------------------------------------------------------------------------------------------------


def _with(
    model: mujoco.MjModel, qpos: Float[Array, " model_nq"], positions: Mapping[int, float]
) -> Float[Array, " model_nq"]:
    out = np.array(qpos)
    for joint, value in positions.items():
        out[model.jnt_qposadr[joint]] = value
    return out


def _follower(model: mujoco.MjModel, e: int, qpos: Float[Array, " model_nq"]) -> float:
    """Return the position that a joint equality demands: MuJoCo's polynomial of the deviations from qpos0."""
    y, x = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    away = 0.0 if x < 0 else float(qpos[model.jnt_qposadr[x]] - model.qpos0[model.jnt_qposadr[x]])
    powers = away ** np.arange(_TERMS)
    return float(model.qpos0[model.jnt_qposadr[y]] + model.eq_data[e, :_TERMS] @ powers)


def _leader(model: mujoco.MjModel, e: int, value: float) -> float:
    """Return the leader's position at a position of its follower.

    Raises:
        SettingError: If the coupling is not linear.
    """
    y, x = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    offset, factor, *higher = model.eq_data[e, :_TERMS].tolist()
    if factor == 0.0 or any(higher):
        follower, leader = names(model, _OBJ.mjOBJ_JOINT, [y, x])
        raise SettingError(f"position of {follower}", value, f"the position of {leader}, which it follows")
    away = (value - float(model.qpos0[model.jnt_qposadr[y]]) - offset) / factor
    return float(model.qpos0[model.jnt_qposadr[x]]) + away


# --- closed chains ----------------------------------------------------------------------------------------------------


def _closed(
    model: mujoco.MjModel,
    qpos: Float[Array, " model_nq"],
    chosen: Collection[int],
    planned: Collection[int],
    strict: bool,
) -> Float[Array, " model_nq"]:
    """Return a state with closed chains, by Gauss-Newton steps of the passive joints on MuJoCo's own residuals.

    Where the chains leave passive joints free, the springs of joints and tendons decide, against the joints' ranges.
    """
    loops = _loops(model, planned)
    if not loops:
        return qpos
    free = set(passive_joints(model, planned)).difference(chosen)
    fixed = actuated(model) | set(chosen) | set(planned)
    for follower, leader in followers(model).items():
        if {follower, leader} & free:
            free |= {j for j in (follower, leader) if j >= 0 and j not in fixed}
    rows = [
        e for e in _active(model) if e in loops or (_moving(model, e) & free and not _moving(model, e) & set(planned))
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
        told = ", ".join(_label(model, e) for e in rows if e in loops)
        if strict and free:  # states of a simulation give all joints; they leave soft equalities open
            where = dict(zip(_joint_names(model, chosen), [float(qpos[model.jnt_qposadr[j]]) for j in sorted(chosen)],
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
        if model.jnt_limited[joint] and int(model.jnt_type[joint]) not in (_FREE, int(mujoco.mjtJoint.mjJNT_BALL)):
            adr = model.jnt_qposadr[joint]
            qpos[adr] = np.clip(qpos[adr], *model.jnt_range[joint])


# --- what equalities depend on ----------------------------------------------------------------------------------------


def _active(model: mujoco.MjModel) -> list[int]:
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY):
        return []
    return np.flatnonzero(model.eq_active0).tolist()


def _loops(model: mujoco.MjModel, planned: Collection[int]) -> list[int]:
    """Return active equalities, except those of joints, that joints can fulfil without the planned ones."""
    kinds = (*_LOOPS, int(_EQ.mjEQ_TENDON))
    found = [e for e in _active(model) if int(model.eq_type[e]) in kinds]
    scalar = [e for e in found if not any(int(model.jnt_type[j]) == _FREE for j in _moving(model, e))]
    return [e for e in scalar if _moving(model, e) and not _moving(model, e) & set(planned)]


def _moving(model: mujoco.MjModel, e: int) -> set[int]:
    """Return the joints on which an equality depends."""
    kind, ends = int(model.eq_type[e]), (int(model.eq_obj1id[e]), int(model.eq_obj2id[e]))
    if kind == int(_EQ.mjEQ_JOINT):
        return {j for j in ends if j >= 0}
    if kind == int(_EQ.mjEQ_TENDON):
        return {j for t in ends if t >= 0 for j in _tendon_joints(model, t)}
    first, second = (_joints_above(model, body) for body in _bodies(model, e))
    return first ^ second


def _bodies(model: mujoco.MjModel, e: int) -> tuple[int, int]:
    """Return the two bodies of a connect or weld equality."""
    ends = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    if int(model.eq_objtype[e]) == int(_OBJ.mjOBJ_SITE):
        ends = int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
    return ends


def _joints_above(model: mujoco.MjModel, body: int) -> set[int]:
    return {joint for carrier in ancestors(model, body) for joint in body_joints(model, carrier)}


def _tendon_joints(model: mujoco.MjModel, tendon: int) -> set[int]:
    first, found = int(model.tendon_adr[tendon]), set[int]()
    for k in range(first, first + int(model.tendon_num[tendon])):
        kind, at = int(model.wrap_type[k]), int(model.wrap_objid[k])
        if kind == int(mujoco.mjtWrap.mjWRAP_JOINT):
            found.add(at)
        elif kind == int(mujoco.mjtWrap.mjWRAP_SITE):
            found |= _joints_above(model, int(model.site_bodyid[at]))
        elif kind in (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER)):
            found |= _joints_above(model, int(model.geom_bodyid[at]))
    return found


def actuated(model: mujoco.MjModel) -> frozenset[int]:
    """Return the joints with actuators, directly or through tendons."""
    found: set[int] = set()
    for a in range(model.nu):
        kind, target = int(model.actuator_trntype[a]), int(model.actuator_trnid[a, 0])
        if kind in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
            found.add(target)
        elif kind == int(mujoco.mjtTrn.mjTRN_TENDON):
            found |= _tendon_joints(model, target)
    return frozenset(found)


def _touches(model: mujoco.MjModel, e: int, bodies: Collection[int]) -> bool:
    return int(model.eq_type[e]) in _LOOPS and bool(set(_bodies(model, e)).intersection(bodies))


def _is_loose(model: mujoco.MjModel, e: int, robot: Collection[int]) -> bool:
    """Return whether an equality ties the robot to a free or mocap body of the surroundings."""
    if int(model.eq_type[e]) not in _LOOPS:
        return False
    bodies = _bodies(model, e)  # a mocap body may have a name like those of the robot
    return any(int(model.body_mocapid[body]) >= 0 for body in bodies) or any(
        int(model.jnt_type[j]) == _FREE for body in bodies if body not in robot for j in _joints_above(model, body)
    )


def _label(model: mujoco.MjModel, e: int) -> str:
    """Describe an equality: its kind, its name and what it ties."""
    kind = _EQ(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()
    name = mujoco.mj_id2name(model, _OBJ.mjOBJ_EQUALITY, e)
    if int(model.eq_type[e]) in _LOOPS:
        ends = names(model, _OBJ.mjOBJ_BODY, _bodies(model, e))
    else:
        of = _OBJ.mjOBJ_JOINT if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT) else _OBJ.mjOBJ_TENDON
        ends = names(model, of, [i for i in (int(model.eq_obj1id[e]), int(model.eq_obj2id[e])) if i >= 0])
    return f"{kind} equality {f'{name!r} ' if name else ''}of {' and '.join(ends)}"


def _joint_names(model: mujoco.MjModel, joints: Collection[int]) -> list[str]:
    return names(model, _OBJ.mjOBJ_JOINT, sorted(joints))
