"""Composition of a robot from URDF with a world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.exceptions import SceneError, SettingError, UnknownNameError
from graceful_plan.scene.roles import rigid_pose
from graceful_plan.scene.specs import load_spec
from graceful_plan.scene.urdf.reading import UrdfJoint, UrdfRobot
from graceful_plan.scene.urdf.srdf import Srdf

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


def chosen_joints(
    robot: UrdfRobot, srdf: Srdf, tool: str, joints: Sequence[str] | None, group: str | None
) -> list[UrdfJoint]:
    """Return the joints to plan: the given ones, those of a group, or those that move the tool.

    Raises:
        SettingError: If both joints and a group are given.
        UnknownNameError: If there is no such link, joint or group.
    """
    robot.check_link(tool)
    if joints is not None and group is not None:
        raise SettingError("group", group, "one of joints and group")
    if group is not None:
        return srdf.joints(group, robot)
    if joints is None:
        return robot.chain(tool)
    wanted = [name.removeprefix(f"{robot.name}/") for name in joints]
    known = {joint.name: joint for joint in robot.joints if joint.is_movable}
    for name in wanted:
        if name not in known:
            raise UnknownNameError("joint to plan", name, known)
    return [known[name] for name in wanted]


def velocities(chain: Sequence[UrdfJoint]) -> list[float]:
    """Return the velocity limits of planned joints [rad/s or m/s].

    Raises:
        SceneError: If a joint has none.
    """
    without = [joint.name for joint in chain if not np.isfinite(joint.velocity)]
    if without:
        raise SceneError(f"no velocity limits in URDF: {', '.join(without)}; give velocity=[{len(chain)} numbers]")
    return [joint.velocity for joint in chain]
