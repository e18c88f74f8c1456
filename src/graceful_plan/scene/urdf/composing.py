"""A robot from URDF in a world, and which of its links may touch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.exceptions import SceneError
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.model_parts import robot_bodies
from graceful_plan.scene.roles import rigid_pose
from graceful_plan.scene.screening import compile_spec, load_spec
from graceful_plan.scene.urdf.reading import UrdfJoint, UrdfRobot

TOOL = "graceful_plan_tool"
"""Name of the site in the frame of the tool's link."""
_SAMPLES, _ALWAYS = 200, 0.95
"""Configurations drawn, and in which share of them a pair of links has to touch to be one that always does."""


def composed(
    robot: UrdfRobot, tool: str, world: str | Path | mujoco.MjSpec | None, pose: ArrayLike | None
) -> mujoco.MjSpec:
    """Put a robot into a world.

    Args:
        robot: The robot.
        tool: Link whose frame is the tool's.
        world: Where to; nothing but the robot if None.
        pose: Of its root link in W, as a matrix; the identity if None.

    Raises:
        SceneError: If names in the world clash with those of the robot.
    """
    spec = mujoco.MjSpec() if world is None else load_spec(world)
    X_WR = np.eye(4) if pose is None else rigid_pose("pose", pose)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, X_WR[:3, :3].ravel())
    robot.spec.body(tool).add_site(name=TOOL)
    frame = spec.worldbody.add_frame(pos=X_WR[:3, 3], quat=quaternion)
    prefix = f"{robot.name}/"
    try:
        spec.attach(robot.spec, prefix=prefix, frame=frame)
    except ValueError as error:
        raise SceneError(" ".join(str(error).split())) from None
    return spec


def touching(spec: mujoco.MjSpec, prefix: str, chain: Sequence[UrdfJoint]) -> tuple[AllowedContact, ...]:
    """Return pairs of links that a joint lies between, and those that touch nearly wherever the joints are.

    Args:
        spec: With the robot.
        prefix: Of its names.
        chain: Planned joints, which are drawn evenly within their limits; others stay.
    """
    model = compile_spec(spec)
    robot = robot_bodies(model, prefix)
    group = {body: _rigid_root(model, body, robot) for body in robot}
    pairs = {
        (group[parent], group[body])
        for body in robot
        if model.body_jntnum[body] and (parent := int(model.body_parentid[body])) in robot
    }
    reasons = dict.fromkeys(_always(model, group, [model.joint(prefix + joint.name).id for joint in chain]), "overlap")
    reasons |= dict.fromkeys(pairs, "adjacent")
    named = sorted((model.body(a).name, model.body(b).name, reason) for (a, b), reason in reasons.items())
    return tuple(AllowedContact(a, b, reason=reason) for a, b, reason in named)


def _rigid_root(model: mujoco.MjModel, body: int, robot: frozenset[int]) -> int:
    """Return the body nearest to the base that this one hangs on rigidly."""
    while not model.body_jntnum[body] and int(model.body_parentid[body]) in robot:
        body = int(model.body_parentid[body])
    return body


def _always(model: mujoco.MjModel, group: Mapping[int, int], joints: Sequence[int]) -> set[tuple[int, int]]:
    data, rng, count = mujoco.MjData(model), np.random.default_rng(0), Counter[tuple[int, int]]()
    for _ in range(_SAMPLES):
        for joint in joints:
            data.qpos[model.jnt_qposadr[joint]] = rng.uniform(*_range(model, joint))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom[data.contact.dist < 0.0]].tolist()
        touched = {(group[a], group[b]) for a, b in bodies if a in group and b in group}
        count.update({(min(pair), max(pair)) for pair in touched})
    return {pair for pair, found in count.items() if found >= _ALWAYS * _SAMPLES}


def _range(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    return tuple(model.jnt_range[joint]) if model.jnt_limited[joint] else (-np.pi, np.pi)


def velocities(chain: Sequence[UrdfJoint]) -> list[float]:
    """Return the velocity limits of planned joints [rad/s or m/s].

    Raises:
        SceneError: If one has none.
    """
    without = [joint.name for joint in chain if not np.isfinite(joint.velocity)]
    if without:
        raise SceneError(f"the URDF limits no velocity of {', '.join(without)}; give velocity=[{len(chain)} numbers]")
    return [joint.velocity for joint in chain]


def held_still(robot: UrdfRobot, chain: Sequence[UrdfJoint], position: float) -> dict[str, float]:
    """Return positions of the joints of a gripper: those that hang on the last planned joint.

    Args:
        robot: The robot.
        chain: Planned joints.
        position: Of those that follow no other joint [rad or m].
    """
    moving = [joint for joint in robot.joints if joint.kind != "fixed" and joint not in chain]
    behind = {chain[-1].child} if chain else set()
    for _ in robot.joints:
        behind |= {joint.child for joint in robot.joints if joint.parent in behind}
    fingers = [joint for joint in moving if joint.parent in behind]
    found = {joint.name: position for joint in fingers if joint.mimic is None}
    for joint in fingers:
        if joint.mimic is not None and joint.mimic[0] in found:
            found[joint.name] = joint.mimic[1] * found[joint.mimic[0]] + joint.mimic[2]
    return {f"{robot.name}/{name}": value for name, value in found.items()}
