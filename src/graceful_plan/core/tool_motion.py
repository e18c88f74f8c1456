"""Differential kinematics of the tool in batches: pose, Jacobian, twist to a target pose, least-squares steps.

Twists are translation [m] and rotation vector [rad], both in W. If only the tool's axis counts (`free_yaw`), rotation
about the tool's own z axis is removed from the twist and the Jacobian.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.kernels import Kernels

_DAMPING = 1e-9
"""Damping of steps; keeps them finite near singular postures."""
_SINE = 1e-9
"""Sine below which an angle counts as 0 or pi."""


def tool_jacobian(kernels: Kernels, q: Float[Array, "n nq"]) -> tuple[Float[Array, "n 4 4"], Float[Array, "n 6 nq"]]:
    """Return the pose of the tool in W and the Jacobian of its twist, velocity before angular velocity.

    Columns are per rad for hinges and per metre for slides.

    Args:
        kernels: Kernels of the scene.
        q: Configurations.
    """
    robot = kernels.robot
    X_WL = kernels.link_poses(q)
    X_WT = X_WL[:, robot.tool_link] @ robot.X_LT
    links = _moving_links(robot)
    joints, slides = robot.joint[links], robot.slide[links] > 0
    moving = X_WL[:, links]
    axis = moving[:, :, :3, 2]  # joint axis: the z axis of its link
    lever = X_WT[:, None, :3, 3] - moving[:, :, :3, 3]
    jacobian = np.zeros((len(q), 6, kernels.nq))
    jacobian[:, :3, joints] = np.where(slides[:, None], axis, np.cross(axis, lever)).transpose(0, 2, 1)
    jacobian[:, 3:, joints] = np.where(slides[:, None], 0.0, axis).transpose(0, 2, 1)
    return X_WT, jacobian


def _moving_links(robot: RobotArrays) -> list[int]:
    """Return the links whose joints move the tool."""
    links, link = [], int(robot.tool_link)
    while link >= 0:
        links += [link] if robot.joint[link] >= 0 else []
        link = int(robot.parent[link])
    return links


def missing_twist(
    X_WT: Float[Array, "n 4 4"], X_WG: Float[Array, "n 4 4"], *, free_yaw: bool = False
) -> Float[Array, "n 6"]:
    """Return the twist that takes each pose to its target: translation [m] and rotation vector [rad] in W."""
    missing = np.empty((len(X_WT), 6))
    missing[:, :3] = X_WG[:, :3, 3] - X_WT[:, :3, 3]
    if free_yaw:
        z, wanted = X_WT[:, :3, 2], X_WG[:, :3, 2]
        missing[:, 3:] = rotation_vector(np.cross(z, wanted), np.einsum("ni,ni->n", z, wanted))
    else:
        missing[:, 3:] = matrix_vector(X_WG[:, :3, :3] @ X_WT[:, :3, :3].transpose(0, 2, 1))
    return missing


def without_yaw(X_WT: Float[Array, "n 4 4"], jacobian: Float[Array, "n 6 nq"]) -> Float[Array, "n 6 nq"]:
    """Return the Jacobian without rotation of the tool about its own z axis."""
    z = X_WT[:, :3, 2]
    turning = z[:, :, None] * np.einsum("ni,nij->nj", z, jacobian[:, 3:])[:, None]
    return np.concatenate([jacobian[:, :3], jacobian[:, 3:] - turning], axis=1)


def least_squares(
    twist: Float[Array, "n 6"], jacobian: Float[Array, "n 6 nq"], damping: Float[Array, " n"] | float = _DAMPING
) -> Float[Array, "n nq"]:
    """Return the shortest joint steps that produce the twists, damped."""
    gram = jacobian @ jacobian.transpose(0, 2, 1) + np.multiply.outer(damping, np.eye(6))
    return np.einsum("nij,ni->nj", jacobian, np.linalg.solve(gram, twist[..., None])[..., 0])


def steps_inside(
    twist: Float[Array, "n 6"],
    jacobian: Float[Array, "n 6 nq"],
    q: Float[Array, "n nq"],
    limits: tuple[Float[Array, " nq"], Float[Array, " nq"]],
    wish: Float[Array, "n nq"] | float = 0.0,
) -> tuple[Float[Array, "n nq"], Bool[Array, "n nq"]]:
    """Return joint steps that produce the twists within the position limits, and which joints a limit stops.

    Joints that would leave their limits stay; the others compensate as far as they can.

    Args:
        twist: Desired twist of the tool.
        jacobian: Jacobian at `q`.
        q: Configurations.
        limits: Lower and upper position limits.
        wish: Desired joint steps, taken in the null space of the twists.
    """
    wished = np.broadcast_to(np.asarray(wish, dtype=float), q.shape)
    held = np.zeros(q.shape, dtype=bool)
    step = np.zeros(q.shape)
    for _ in range(3):
        own = np.where(held[:, None, :], 0.0, jacobian)
        free = np.where(held, 0.0, wished)
        step = free + least_squares(twist - np.einsum("nij,nj->ni", own, free), own)
        leaving = (q + step < limits[0]) & (step < 0.0) | (q + step > limits[1]) & (step > 0.0)
        if not leaving.any():
            break
        held |= leaving
    return step, held


def matrix_vector(R: Float[Array, "n 3 3"]) -> Float[Array, "n 3"]:
    """Return the rotation vector [rad] of rotation matrices."""
    skew = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    return rotation_vector(skew, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))


def rotation_vector(sine: Float[Array, "n 3"], cosine: Float[Array, " n"]) -> Float[Array, "n 3"]:
    """Return rotation vectors from sin(angle) * axis and cos(angle); the axis is x if the angle is pi."""
    length = np.linalg.norm(sine, axis=1, keepdims=True)
    angle = np.arctan2(length[:, 0], cosine)[:, None]
    fallback = np.where(angle > 1.0, np.array([1.0, 0.0, 0.0]), 0.0)
    return angle * np.where(length > _SINE, sine / np.maximum(length, _SINE), fallback)


def rotation_matrix(vector: Float[Array, "n 3"]) -> Float[Array, "n 3 3"]:
    """Return the rotation matrices of rotation vectors [rad] (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=1)[:, None, None]
    x, y, z = (vector / np.maximum(angle[:, :, 0], 1e-300)).T
    zero = np.zeros_like(x)
    K = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)
