"""Moving frames of a scene: one per planned joint, and the base; each body belongs to one."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.model_parts import body_joints, subtree
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.placement import PlacementPool
from graceful_plan.scene.scene import Scene


@dataclass(frozen=True, kw_only=True)
class MovingFrames:
    """Moving frames: 0 is the base, k + 1 belongs to planned joint k."""

    parent: list[int]
    X_W: Float[Array, "frame 4 4"]  # at the reference configuration
    reference: Float[Array, " nq"]
    of_body: list[int]


def reference_data(scene: Scene) -> mujoco.MjData:
    """Return the scene with all planned joints at their reference position, where joint rotations are the identity.

    The returned data is shared: the next call in this thread for a scene of the same layout overwrites it.
    """
    return _placements(scene).of(scene).place(scene.shapes.qpos0[scene.qpos_adr])


@per_layout
def _placements(scene: Scene) -> PlacementPool:
    del scene
    return PlacementPool()


def pose_matrix(rotation: Array, position: Array) -> Float[Array, "4 4"]:
    """Return the homogeneous matrix of a rotation, as 9 or 3 x 3 numbers, and a position [m]."""
    X = np.eye(4)
    X[:3, :3] = np.reshape(rotation, (3, 3))
    X[:3, 3] = position
    return X


def moving_frames(scene: Scene, data: mujoco.MjData) -> MovingFrames:
    """Return the frames of a scene at the reference configuration; the carried object is on the tool's."""
    model = scene.model
    frame_of_joint = {joint: k + 1 for k, joint in enumerate(scene.joint_ids)}
    of_body, parent, X_W = [0] * model.nbody, [-1] + [0] * len(frame_of_joint), [np.eye(4)] * (len(frame_of_joint) + 1)
    for body in range(1, model.nbody):
        frame = of_body[model.body_parentid[body]]
        for joint in body_joints(model, body):
            if joint not in frame_of_joint:
                continue
            parent[frame_of_joint[joint]], frame = frame, frame_of_joint[joint]
            X_W[frame] = pose_matrix(_rotation_with_z(data.xaxis[joint]), data.xanchor[joint])
        of_body[body] = frame
    if scene.carried is not None:
        tool_body = model.site_bodyid[model.site(scene.tool).id]
        root = model.body(scene.carried.body).id
        for body in subtree(model, root):
            of_body[body] = of_body[tool_body]
    return MovingFrames(parent=parent, X_W=np.stack(X_W), reference=model.qpos0[scene.qpos_adr].copy(), of_body=of_body)


def _rotation_with_z(axis: Array) -> Float[Array, "3 3"]:
    R, z = np.empty((3, 3)), axis / np.linalg.norm(axis)
    a, b, c = z.tolist()
    # The unit vector farthest from z, crossed with z.
    x = ((0.0, -c, b), (c, 0.0, -a), (-b, a, 0.0))[int(np.argmin(np.abs(z)))]
    d, e, f = (np.array(x) / np.linalg.norm(x)).tolist()
    R[:, 0], R[:, 1], R[:, 2] = (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d), z
    return R


def body_frames(scene: Scene) -> tuple[int, ...]:
    """Return the frame of each body: 0 if it does not move, k + 1 on planned joint k."""
    return tuple(moving_frames(scene, reference_data(scene)).of_body)
