"""Equalities of a model: joints that follow others, and closed chains.

Equalities that planned joints would break are refused: planned joints are independent of each other and of everything
else. Equalities among other joints hold in the state in which a scene keeps them: followers follow their leaders, and
closed chains, such as the linkage of a gripper, are closed by their passive joints. Inactive equalities are ignored,
as in MuJoCo.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.scene.closed_chains import closed
from graceful_plan.scene.equalities import (
    active_equalities,
    equality_label,
    followers,
    joint_names,
    tendon_joints,
    tied_joints,
    ties_any,
    ties_loose_body,
)
from graceful_plan.scene.model_parts import names

_LOG = logging.getLogger(__name__)

_OBJ = mujoco.mjtObj
_EQ = mujoco.mjtEq
_TERMS = 5
"""Coefficients of the polynomial of a joint equality."""
_SAME = 1e-6
"""Largest residual of an equality that counts as fulfilled [m or rad]."""


def check_couplings(model: mujoco.MjModel, planned: Collection[int], robot: Collection[int]) -> None:
    """Check that no active equality restricts planned joints.

    Those that tie the robot to a free or mocap body of the surroundings are exempt: `warn_of_couplings` names them,
    unless the gripper holds the body.

    Raises:
        UnsupportedError: If one does; the message lists all of them.
    """
    problems = [
        f"{equality_label(model, e)} ({', '.join(joint_names(model, tied_joints(model, e) & set(planned)))})"
        for e in active_equalities(model)
        if tied_joints(model, e) & set(planned) and not ties_loose_body(model, e, robot)
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
        if not ties_any(model, e, held):
            _LOG.warning(
                "%s is ignored: the body stays where the scene has it while the robot moves; attach() a body that the "
                "robot carries",
                equality_label(model, e),
            )
    for t in np.flatnonzero(model.tendon_limited).tolist():
        tied = tendon_joints(model, t) & set(planned)
        if tied:
            label = names(model, _OBJ.mjOBJ_TENDON, [t])[0]
            _LOG.warning(
                "the limits of tendon %r are ignored; it depends on %s", label, ", ".join(joint_names(model, tied))
            )


def ties_to_loose(model: mujoco.MjModel, planned: Collection[int], robot: Collection[int]) -> list[int]:
    """Return the active equalities that tie planned joints to free or mocap bodies; motions ignore them."""
    return [
        e for e in active_equalities(model) if tied_joints(model, e) & set(planned) and ties_loose_body(model, e, robot)
    ]


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
    for e in active_equalities(model):
        y, x = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT) and y in given and x >= 0 and x not in given:
            chosen[x] = _leader(model, e, given[y])
    out = _with(model, qpos, chosen)
    ties = [e for e in active_equalities(model) if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT)]
    for _ in ties:  # a follower can lead others
        for e in ties:
            y, x = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            if y in planned or x in planned:
                continue
            value = _follower(model, e, out)
            if y in chosen and abs(chosen[y] - value) > _SAME and y in given:
                word = names(model, _OBJ.mjOBJ_JOINT, [y])[0]
                raise SettingError(f"position of {word}", given[y], f"{value:g}, by {equality_label(model, e)}")
            out[model.jnt_qposadr[y]] = value
            if x in chosen:
                chosen[y] = value
    return closed(model, out, chosen, planned, bool(given))


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
