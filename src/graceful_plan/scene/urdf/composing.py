"""A robot from URDF in a world, and which of its links may touch."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.exceptions import SceneError
from graceful_plan.scene.elements import AllowedContact
from graceful_plan.scene.model_parts import robot_bodies
from graceful_plan.scene.roles import rigid_pose
from graceful_plan.scene.screening import MAX_EXTENT, compile_spec, load_spec
from graceful_plan.scene.urdf.reading import UrdfJoint, UrdfRobot

TOOL = "graceful_plan_tool"
"""Name of the site in the frame of the tool's link."""
_SAMPLES, _ALWAYS = 200, 0.95
"""Configurations drawn, and in which share of them a pair of links has to touch to be one that always does."""
OFTEN = 0.25
"""Share of configurations in which links may touch before meshes are divided: hulls of a UR5 do in half of them and its
parts in a quarter, those of a Panda, xArm 7, Jaco or Z1 in 6 to 14 %."""


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


@final
@dataclass(frozen=True)
class Touching:
    """Which links touch, as far as it was looked at.

    | field    | meaning                                                                                      |
    |----------|----------------------------------------------------------------------------------------------|
    | contacts | pairs that a joint lies between, and those that touch nearly wherever the joints are          |
    | often    | share of configurations in which other links touch, those aside that may                      |
    """

    contacts: tuple[AllowedContact, ...]
    often: float


def touching(
    spec: mujoco.MjSpec, prefix: str, chain: Sequence[UrdfJoint], allowed: Sequence[AllowedContact] = ()
) -> Touching:
    """Find links that touch.

    Args:
        spec: With the robot.
        prefix: Of its names.
        chain: Planned joints, which are drawn evenly within their limits; others stay.
        allowed: What may touch besides.
    """
    model = compile_spec(spec)
    robot = robot_bodies(model, prefix)
    group = {body: _rigid_root(model, body, robot) for body in robot}
    pairs = {
        (group[parent], group[body])
        for body in robot
        if model.body_jntnum[body] and (parent := int(model.body_parentid[body])) in robot
    }
    touched = _touched(model, group, [model.joint(prefix + joint.name).id for joint in chain])
    count = Counter(pair for found in touched for pair in found)
    reasons = dict.fromkeys((pair for pair, found in count.items() if found >= _ALWAYS * _SAMPLES), "overlap")
    reasons |= dict.fromkeys(pairs, "adjacent")
    named = sorted((model.body(a).name, model.body(b).name, reason) for (a, b), reason in reasons.items())
    body = {model.body(k).name: k for k in robot}
    may = {(group[body[c.first]], group[body[c.second]]) for c in allowed if c.first in body and c.second in body}
    free = set(reasons) | may | {pair[::-1] for pair in may}
    often = sum(bool(found - free) for found in touched) / _SAMPLES
    return Touching(tuple(AllowedContact(a, b, reason=reason) for a, b, reason in named), often)


def _rigid_root(model: mujoco.MjModel, body: int, robot: frozenset[int]) -> int:
    """Return the body nearest to the base that this one hangs on rigidly."""
    while not model.body_jntnum[body] and int(model.body_parentid[body]) in robot:
        body = int(model.body_parentid[body])
    return body


def _touched(
    model: mujoco.MjModel, group: Mapping[int, int], joints: Sequence[int]
) -> list[frozenset[tuple[int, int]]]:
    """Return which links touch in each of some random configurations."""
    data, rng, touched = mujoco.MjData(model), np.random.default_rng(0), list[frozenset[tuple[int, int]]]()
    for _ in range(_SAMPLES):
        for joint in joints:
            data.qpos[model.jnt_qposadr[joint]] = rng.uniform(*_range(model, joint))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        bodies = model.geom_bodyid[data.contact.geom[data.contact.dist < 0.0]].tolist()
        found = {(group[a], group[b]) for a, b in bodies if a in group and b in group}
        touched.append(frozenset((min(pair), max(pair)) for pair in found))
    return touched


def _range(model: mujoco.MjModel, joint: int) -> tuple[float, float]:
    if not model.jnt_limited[joint]:
        return -np.pi, np.pi
    lower, upper = model.jnt_range[joint]
    if max(abs(lower), abs(upper)) > MAX_EXTENT:
        name = model.joint(joint).name
        raise SceneError(f"the limits of joint {name!r} are {lower:g} and {upper:g}; {MAX_EXTENT:g} is the farthest")
    return lower, upper


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
