"""What rides on the tool: frames and axes of tool and carried object, in the link that both ride on."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.scene import Scene

Array = np.ndarray

FRAMES = ("tool", "object")


def frame_in_link(scene: Scene, frame: str) -> tuple[int, Float[Array, "4 4"]]:
    """Return the link that a frame rides on, and its pose in it.

    Args:
        scene: The scene.
        frame: "tool" or "object", the carried one.

    Raises:
        SettingError: If there is no such frame.
    """
    robot = compile_scene(scene).robot
    if frame == "tool":
        return robot.tool_link, robot.X_LT
    if frame != "object":
        raise SettingError("frame", frame, f"one of {', '.join(FRAMES)}")
    if scene.carried is None:
        raise SettingError("frame", frame, "'tool': nothing is carried in this scene")
    return robot.tool_link, robot.X_LT @ scene.carried.X_TO


def default_frame(scene: Scene, frame: str | None) -> str:
    """Return the frame that was asked for: by default that of the carried object, without one that of the tool."""
    return frame if frame is not None else "tool" if scene.carried is None else "object"


def standing_axis(scene: Scene) -> Float[Array, " xyz"]:
    """Return the axis of the carried object that is vertical where it stands in the scene, in the object's frame.

    Without a carried object, that of the tool that points back from the fingers, in the tool's frame.
    """
    if scene.carried is None:
        return np.array([0.0, 0.0, -1.0])
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.model.qpos0
    mujoco.mj_kinematics(scene.model, data)
    return data.xmat[scene.model.body(scene.carried.body).id].reshape(3, 3)[2].copy()
