"""Composition of a robot from URDF with a world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.exceptions import SceneError
from graceful_plan.scene.roles import rigid_pose
from graceful_plan.scene.screening import load_spec
from graceful_plan.scene.urdf.reading import UrdfJoint, UrdfRobot

TOOL = "graceful_plan_tool"
"""Name of the site with the frame of the tool's link."""


def composed(
    robot: UrdfRobot, tool: str, world: str | Path | mujoco.MjSpec | None, pose: ArrayLike | None
) -> mujoco.MjSpec:
    """Place a robot in a world.

    Args:
        robot: The robot.
        tool: Link whose frame is the tool's.
        world: The world; None for the robot alone.
        pose: Pose of the robot's root link in W, as a matrix; the identity if None.

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


def velocities(chain: Sequence[UrdfJoint]) -> list[float]:
    """Return the velocity limits of planned joints [rad/s or m/s].

    Raises:
        SceneError: If a joint has none.
    """
    without = [joint.name for joint in chain if not np.isfinite(joint.velocity)]
    if without:
        raise SceneError(f"no velocity limits in URDF: {', '.join(without)}; give velocity=[{len(chain)} numbers]")
    return [joint.velocity for joint in chain]


def held_still(robot: UrdfRobot, chain: Sequence[UrdfJoint], position: float) -> dict[str, float]:
    """Return positions of a gripper's joints: those in the subtree of the last planned joint.

    Args:
        robot: The robot.
        chain: Planned joints.
        position: Position of the joints that mimic no other joint [rad or m].
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
