"""The state of everything that is not planned: fingers, other joints of the robot, doors, drawers and free bodies.

Later ones win: the model's initial state, the `fingers` of a scene, its `state`, the `fingers` of the held object.
Joints that equalities couple follow (`couplings`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import SettingError, UnknownNameError, UnsupportedError
from graceful_plan.path import finite_array, is_real
from graceful_plan.scene.couplings import coupled, follow
from graceful_plan.scene.elements import Fingers, Notes, ObjectNote, Opening
from graceful_plan.scene.equalities import followers
from graceful_plan.scene.fingers import Hand, leading_joints, positions_at
from graceful_plan.scene.joint_limits import joint_range
from graceful_plan.scene.loading.naming import is_name, lookup
from graceful_plan.scene.model_parts import colliding_geoms, is_scalar, subtree
from graceful_plan.scene.roles import rigid_pose

State = Mapping[str, tuple[float, ...]]
"""Position of joints in MuJoCo's order, by the name of the joint; a free body's joint may go by the body's name."""

_OBJ = mujoco.mjtObj
_JOINT = mujoco.mjtJoint
_SIZES = {int(_JOINT.mjJNT_FREE): 7, int(_JOINT.mjJNT_BALL): 4, int(_JOINT.mjJNT_SLIDE): 1, int(_JOINT.mjJNT_HINGE): 1}
_SLACK = 1e-9
"""How far a position may exceed its joint's range by rounding [rad or m]."""
_FAR, _TURNED = 1e-3, 1e-2
"""Differences from which the state of a keyframe differs from that of a scene [m] and [rad]."""


def rest_state(
    model: mujoco.MjModel, robot: Collection[int], planned: Collection[int], gripper: Collection[int], notes: Notes
) -> Float[Array, " model_nq"]:
    """Return the state of the whole model with the planned joints at their initial positions.

    Args:
        model: The model.
        robot: Bodies of the robot.
        planned: Planned joints.
        gripper: Bodies of the gripper; one number for `fingers` sets the joints of these bodies.
        notes: Their `fingers`, `state` and held object.

    Raises:
        UnknownNameError: If a name is not that of a joint that can be set.
        SettingError: If a position is outside its joint's range or contradicts a coupling.
    """
    levels = [_fingers(model, robot, planned, gripper, notes.fingers)]
    qpos = model.qpos0.copy()
    scalars: dict[int, float] = {}
    for label, values in notes.state.items():
        joint = _joint(model, label)
        if len(values) == 1:
            scalars[joint] = values[0]
        else:
            adr = int(model.jnt_qposadr[joint])
            qpos[adr : adr + len(values)] = values
    levels.append(scalars)
    if notes.held is not None and notes.held.fingers is not None:
        levels.append(_fingers(model, robot, planned, gripper, notes.held.fingers))
    given: dict[int, float] = {}
    for level in levels:
        tied = {other for joint in level for other in coupled(model, joint)}
        given = {joint: value for joint, value in given.items() if joint not in tied} | level
    qpos = follow(model, qpos, given, planned)
    qpos.flags.writeable = False
    return qpos


def with_openings(
    model: mujoco.MjModel, robot: Collection[int], planned: Collection[int], gripper: Collection[int], notes: Notes
) -> Notes:
    """Return notes in which openings of the gripper are positions of its joints.

    Raises:
        UnsupportedError: If the gripper has no joint, or the tool is not between two pads.
        SettingError: If an opening is out of reach, or nothing is carried on which to close.
    """
    hand = Hand(model, gripper, planned, model.site(notes.tool).id)
    if isinstance(notes.fingers, Opening):
        qpos = rest_state(model, robot, planned, gripper, notes)
        notes = replace(notes, fingers=positions_at(hand, qpos, notes.fingers, ()))
    held = notes.held
    if held is not None and isinstance(held.fingers, Opening):
        qpos = rest_state(model, robot, planned, gripper, notes).copy()
        body = model.body(held.body).id
        qpos[model.jnt_qposadr[model.body_jntadr[body]] :][:7] = _held_pose(hand, qpos, held)
        touched = colliding_geoms(model, subtree(model, body))
        notes = replace(notes, held=replace(held, fingers=positions_at(hand, qpos, held.fingers, touched)))
    return notes


def _held_pose(hand: Hand, qpos: Float[Array, " model_nq"], held: ObjectNote) -> Float[Array, " pose"]:
    """Return position and quaternion of the held object in W."""
    assert held.X_TO is not None
    tool = hand.posed(qpos, {}).site(hand.tool)
    R_WT, quaternion = tool.xmat.reshape(3, 3), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, (R_WT @ held.X_TO[:3, :3]).ravel())
    return np.concatenate([tool.xpos + R_WT @ held.X_TO[:3, 3], quaternion])


def _fingers(
    model: mujoco.MjModel,
    robot: Collection[int],
    planned: Collection[int],
    gripper: Collection[int],
    fingers: Fingers | None,
) -> dict[int, float]:
    """Return positions of finger joints: one number for all of the gripper's that follow no other, or by joint name."""
    if fingers is None or isinstance(fingers, Opening):  # an opening is solved in the state without it
        return {}
    held = {model.joint(j).name: j for j in range(model.njnt) if j not in planned and is_scalar(model, j, robot)}
    if not isinstance(fingers, Mapping):
        behind = {name: j for name, j in held.items() if int(model.jnt_bodyid[j]) in gripper}
        driven = leading_joints(Hand(model, gripper, planned, tool=-1))
        if behind and not driven:
            raise SettingError("fingers", fingers, f"positions by joint name, as none leads: {', '.join(behind)}")
        _check_shared(model, {name: j for name, j in behind.items() if j in driven}, fingers)
        fingers = {name: fingers for name, j in behind.items() if j in driven}
    for name in fingers:
        if name not in held:
            raise UnknownNameError("finger joint", name, held)
    return {held[name]: _inside(model, held[name], position) for name, position in fingers.items()}


def _check_shared(model: mujoco.MjModel, joints: Mapping[str, int], position: float) -> None:
    """Check that one position suits all fingers; those of mirrored grippers have opposite signs.

    Raises:
        SettingError: If it does not; the message has positions by name that do.
    """
    ranges = {name: _limits(model, j) for name, j in joints.items()}
    if not is_real(position) or all(lower - _SLACK <= position <= upper + _SLACK for lower, upper in ranges.values()):
        return
    mirrored = {name: -position if lower <= -position <= upper else position for name, (lower, upper) in ranges.items()}
    if len(joints) > 1 and all(ranges[name][0] <= value <= ranges[name][1] for name, value in mirrored.items()):
        raise SettingError("fingers", position, f"positions by joint name, such as fingers={mirrored}")


def _limits(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    return joint_range(model, joint) if model.jnt_limited[joint] else (-np.inf, np.inf)


def _inside(model: mujoco.MjModel, joint: int, position: object) -> float:
    lower, upper = _limits(model, joint)
    if not is_real(position) or not lower - _SLACK <= position <= upper + _SLACK or not np.isfinite(position):
        raise SettingError(f"position of {model.joint(joint).name}", position, f"between {lower:g} and {upper:g}")
    return float(position)


# --- states by name ---------------------------------------------------------------------------------------------------


def given_state(
    model: mujoco.MjModel, planned: Collection[int], held: Collection[int], state: Mapping[str, float | ArrayLike]
) -> dict[str, tuple[float, ...]]:
    """Check positions of joints, and free bodies by poses.

    Args:
        model: The model.
        planned: Planned joints, which belong to configurations instead.
        held: Bodies in the gripper.
        state: Position of each hinge or slide [rad or m], quaternion of a ball joint, position and quaternion or 4 x 4
            pose in W of a free joint, by joint, or by body for an unnamed joint or a free body.

    Raises:
        UnknownNameError: If there is no such joint.
        SettingError: If a joint is planned, its body is in the gripper, or its position is impossible.
    """
    found = {}
    for name, value in state.items():
        joint = _joint(model, name)
        label = label_of(model, joint)
        if joint in planned:
            raise SettingError("state", name, "joints that are not planned: configurations set the planned ones")
        if int(model.jnt_bodyid[joint]) in held:
            raise SettingError("state", name, "joints of other bodies than the one in the gripper")
        size, value = _SIZES[int(model.jnt_type[joint])], np.asarray(value)
        if size == 1:
            found[label] = (_inside(model, joint, float(finite_array(f"state of {name}", value, ndim=0))),)
        elif size == 7 and np.ndim(value) == 2:
            X, quaternion = rigid_pose(f"state of {name}", value), np.empty(4)
            mujoco.mju_mat2Quat(quaternion, X[:3, :3].ravel())
            found[label] = (*X[:3, 3].tolist(), *quaternion.tolist())
        else:
            values = finite_array(f"state of {name}", value, ndim=1, last=size).tolist()
            length = float(np.linalg.norm(values[-4:]))
            if not 0.9 < length < 1.1:
                raise SettingError(f"state of {name}", values, "a quaternion wxyz of length 1 at the end")
            found[label] = (*values[:-4], *(v / length for v in values[-4:]))
    return found


def model_states(model: mujoco.MjModel, planned: Collection[int]) -> dict[str, State]:
    """Return the state of all joints that are not planned in each of the model's keyframes.

    Followers are left out because they follow. A joint without a name, on a body without a name, goes by its id. Mocap
    bodies go by their names, with their pose.
    """
    spared = set(planned) | followers(model).keys()
    labels = {j: label_of(model, j) for j in range(model.njnt) if j not in spared} if model.nkey else {}
    mocap = {b: model.body(b).name for b in range(model.nbody) if model.nkey and int(model.body_mocapid[b]) >= 0}
    found = {}
    for i in range(model.nkey):
        state = {label: tuple(model.key_qpos[i][_slice(model, j)].tolist()) for j, label in labels.items()}
        for body, label in mocap.items():
            at = int(model.body_mocapid[body])
            pose = [*model.key_mpos[i].reshape(-1, 3)[at], *model.key_mquat[i].reshape(-1, 4)[at]]
            state[label] = tuple(float(number) for number in pose)
        found[model.key(i).name] = state
    return {name: state for name, state in found.items() if name}


def keyframe_state(
    model: mujoco.MjModel, planned: Collection[int], held: Collection[int], notes: Notes, keyframe: str
) -> dict[str, tuple[float, ...]]:
    """Return the state in a keyframe of the joints that are neither planned nor in the gripper.

    Raises:
        UnknownNameError: If the keyframe does not exist or has only planned joints.
        UnsupportedError: If it moves a joint that has no name, or a mocap body.
    """
    if keyframe not in notes.states:
        raise UnknownNameError("keyframe of the whole model", keyframe, notes.states)
    found = {}
    for label, values in notes.states[keyframe].items():
        if label.startswith("#"):
            joint = int(label[1:])
            if joint >= model.njnt or not np.allclose(values, model.qpos0[_slice(model, joint)]):
                raise UnsupportedError(f"the keyframe {keyframe!r} moves a joint without a name; name the joint")
            continue
        if _is_mocap(model, label):
            if _mocap_difference(model, label, values):
                raise UnsupportedError(f"the keyframe {keyframe!r} moves the mocap body {label!r}; use edit(move=)")
            continue
        joint = find_joint(model, label)
        if joint >= 0 and joint not in planned and int(model.jnt_bodyid[joint]) not in held:
            found[label] = values
    return found


def differences(
    model: mujoco.MjModel, qpos: Float[Array, " model_nq"], state: State, ignored: Iterable[int]
) -> list[str]:
    """Return how a state differs from that of the whole model, one phrase a joint.

    Args:
        model: The model.
        qpos: State of the whole model.
        state: The other state.
        ignored: Joints that may differ.
    """
    told, spared = [], set(ignored)
    for label, values in state.items():
        if _is_mocap(model, label):
            told += _mocap_difference(model, label, values)
            continue
        joint = find_joint(model, label)
        if joint < 0 or joint in spared or len(values) != _SIZES[int(model.jnt_type[joint])]:
            continue
        here, there = qpos[_slice(model, joint)], np.array(values)
        if len(values) == 1 and abs(here[0] - there[0]) > _FAR:
            told.append(f"{label} is at {there[0]:.4g} instead of {here[0]:.4g}")
        elif len(values) > 1:
            told += _pose_difference(label, here, there)
    return told


def _pose_difference(label: str, here: Float[Array, " n"], there: Float[Array, " n"]) -> list[str]:
    """Compare positions and quaternions; quaternions alone for ball joints."""
    away = float(np.linalg.norm(here[:-4] - there[:-4]))
    turned = 2.0 * np.arccos(min(1.0, abs(float(here[-4:] @ there[-4:]))))
    return [f"{label} is {away:.3g} m and {turned:.2g} rad away"] if away > _FAR or turned > _TURNED else []


def _is_mocap(model: mujoco.MjModel, label: str) -> bool:
    body = lookup(model, _OBJ.mjOBJ_BODY, label)
    return body > 0 and int(model.body_mocapid[body]) >= 0


def _mocap_difference(model: mujoco.MjModel, label: str, values: tuple[float, ...]) -> list[str]:
    body = model.body(label).id
    return _pose_difference(label, np.concatenate([model.body_pos[body], model.body_quat[body]]), np.array(values))


def label_of(model: mujoco.MjModel, joint: int) -> str:
    """Return the name of a joint; else of its body, if that has no other joint; else "#" and its id."""
    body = int(model.jnt_bodyid[joint])
    alone = int(model.body_jntnum[body]) == 1
    return model.joint(joint).name or (model.body(body).name if alone else "") or f"#{joint}"


def find_joint(model: mujoco.MjModel, label: str) -> int:
    """Return a joint by its name, or by that of a body that has only this joint; -1 if there is none."""
    joint = lookup(model, _OBJ.mjOBJ_JOINT, label)
    if joint >= 0:
        return joint
    body = lookup(model, _OBJ.mjOBJ_BODY, label)
    return int(model.body_jntadr[body]) if body > 0 and int(model.body_jntnum[body]) == 1 else -1


def without_bodies(model: mujoco.MjModel, state: State, bodies: Collection[int]) -> State:
    """Return a state without the joints of given bodies."""
    return {label: v for label, v in state.items() if int(model.jnt_bodyid[_joint(model, label)]) not in bodies}


def _joint(model: mujoco.MjModel, label: str) -> int:
    joint = find_joint(model, label) if is_name(label) else -1
    if joint < 0:
        named = [label_of(model, j) for j in range(model.njnt)]
        raise UnknownNameError("joint or free body", label, [name for name in named if not name.startswith("#")])
    return joint


def _slice(model: mujoco.MjModel, joint: int) -> slice:
    adr = int(model.jnt_qposadr[joint])
    return slice(adr, adr + _SIZES[int(model.jnt_type[joint])])
