"""The equalities of a model: which are active, the joints and bodies that they tie, and their names in messages."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np

from graceful_plan.scene.model_parts import ancestors, body_joints, names

_OBJ = mujoco.mjtObj
_EQ = mujoco.mjtEq
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
LOOPS = (int(_EQ.mjEQ_CONNECT), int(_EQ.mjEQ_WELD))
"""Kinds of equalities that close chains of bodies."""


def active_equalities(model: mujoco.MjModel) -> list[int]:
    """Return the equalities that are active."""
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY):
        return []
    return np.flatnonzero(model.eq_active0).tolist()


def followers(model: mujoco.MjModel) -> dict[int, int]:
    """Return the leader of each joint that an active equality makes follow another; -1 if it has to stay."""
    return {
        int(model.eq_obj1id[e]): int(model.eq_obj2id[e])
        for e in active_equalities(model)
        if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT)
    }


def passive_joints(model: mujoco.MjModel, planned: Collection[int]) -> frozenset[int]:
    """Return the joints of closed chains that neither are planned nor have an actuator."""
    return frozenset(j for e in loop_equalities(model, planned) for j in tied_joints(model, e)) - actuated(model)


def loop_equalities(model: mujoco.MjModel, planned: Collection[int]) -> list[int]:
    """Return active equalities, except those of joints, that joints can fulfil without the planned ones."""
    kinds = (*LOOPS, int(_EQ.mjEQ_TENDON))
    found = [e for e in active_equalities(model) if int(model.eq_type[e]) in kinds]
    scalar = [e for e in found if not any(int(model.jnt_type[j]) == _FREE for j in tied_joints(model, e))]
    return [e for e in scalar if tied_joints(model, e) and not tied_joints(model, e) & set(planned)]


def tied_joints(model: mujoco.MjModel, e: int) -> set[int]:
    """Return the joints on which an equality depends."""
    kind, ends = int(model.eq_type[e]), (int(model.eq_obj1id[e]), int(model.eq_obj2id[e]))
    if kind == int(_EQ.mjEQ_JOINT):
        return {j for j in ends if j >= 0}
    if kind == int(_EQ.mjEQ_TENDON):
        return {j for t in ends if t >= 0 for j in tendon_joints(model, t)}
    first, second = (joints_above(model, body) for body in tied_bodies(model, e))
    return first ^ second


def tied_bodies(model: mujoco.MjModel, e: int) -> tuple[int, int]:
    """Return the two bodies of a connect or weld equality."""
    ends = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    if int(model.eq_objtype[e]) == int(_OBJ.mjOBJ_SITE):
        ends = int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
    return ends


def joints_above(model: mujoco.MjModel, body: int) -> set[int]:
    """Return the joints between a body and the world."""
    return {joint for carrier in ancestors(model, body) for joint in body_joints(model, carrier)}


def tendon_joints(model: mujoco.MjModel, tendon: int) -> set[int]:
    """Return the joints on which the length of a tendon depends."""
    first, found = int(model.tendon_adr[tendon]), set[int]()
    for k in range(first, first + int(model.tendon_num[tendon])):
        kind, at = int(model.wrap_type[k]), int(model.wrap_objid[k])
        if kind == int(mujoco.mjtWrap.mjWRAP_JOINT):
            found.add(at)
        elif kind == int(mujoco.mjtWrap.mjWRAP_SITE):
            found |= joints_above(model, int(model.site_bodyid[at]))
        elif kind in (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER)):
            found |= joints_above(model, int(model.geom_bodyid[at]))
    return found


def actuated(model: mujoco.MjModel) -> frozenset[int]:
    """Return the joints with actuators, directly or through tendons."""
    found: set[int] = set()
    for a in range(model.nu):
        kind, target = int(model.actuator_trntype[a]), int(model.actuator_trnid[a, 0])
        if kind in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)):
            found.add(target)
        elif kind == int(mujoco.mjtTrn.mjTRN_TENDON):
            found |= tendon_joints(model, target)
    return frozenset(found)


def ties_any(model: mujoco.MjModel, e: int, bodies: Collection[int]) -> bool:
    """Return whether a connect or weld equality ties one of some bodies."""
    return int(model.eq_type[e]) in LOOPS and bool(set(tied_bodies(model, e)).intersection(bodies))


def ties_loose_body(model: mujoco.MjModel, e: int, robot: Collection[int]) -> bool:
    """Return whether an equality ties the robot to a free or mocap body of the surroundings."""
    if int(model.eq_type[e]) not in LOOPS:
        return False
    bodies = tied_bodies(model, e)  # a mocap body may have a name like those of the robot
    return any(int(model.body_mocapid[body]) >= 0 for body in bodies) or any(
        int(model.jnt_type[j]) == _FREE for body in bodies if body not in robot for j in joints_above(model, body)
    )


def equality_label(model: mujoco.MjModel, e: int) -> str:
    """Describe an equality: its kind, its name and what it ties."""
    kind = _EQ(int(model.eq_type[e])).name.removeprefix("mjEQ_").lower()
    name = mujoco.mj_id2name(model, _OBJ.mjOBJ_EQUALITY, e)
    if int(model.eq_type[e]) in LOOPS:
        ends = names(model, _OBJ.mjOBJ_BODY, tied_bodies(model, e))
    else:
        of = _OBJ.mjOBJ_JOINT if int(model.eq_type[e]) == int(_EQ.mjEQ_JOINT) else _OBJ.mjOBJ_TENDON
        ends = names(model, of, [i for i in (int(model.eq_obj1id[e]), int(model.eq_obj2id[e])) if i >= 0])
    return f"{kind} equality {f'{name!r} ' if name else ''}of {' and '.join(ends)}"


def joint_names(model: mujoco.MjModel, joints: Collection[int]) -> list[str]:
    """Return the names of joints, in the order of the model."""
    return names(model, _OBJ.mjOBJ_JOINT, sorted(joints))
