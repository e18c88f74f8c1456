"""Whether the healthy robot follows a trajectory and keeps its object, and why not."""

from __future__ import annotations

import mujoco
import numpy as np

from failbench.basics.errors import ExecutionRefused
from failbench.simulated.rolling import PLANAR
from failbench.simulated.states import STATE
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float
from graceful_plan.scene.fingers import gap_between

_STRAYING = (0.2, 0.2, 0.35)
"""Tracking error of a base along x, y [m] and heading [rad] above which it counts as not following. In tight curves a
skid-steer is held at an angle of up to 0.15 rad to its path, so that its origin stays on the path."""
_TOUCH = 5e-4
"""Distance up to which a finger counts as touching [m]; contacts of the simulation are soft."""


def why_lost(world: World, start: Float[Array, " state"], slip: float) -> str:
    """Return why a healthy gripper loses the object, and the remedy.

    Args:
        world: The simulated world.
        start: State at the beginning of the motion, when the fingers have closed.
        slip: Displacement of the object [m].
    """
    model, remedy = world.model, "use SimSettings(grasp='weld')"
    if world.robot.weld >= 0 or not len(world.robot.pads):
        return f"it has slipped by {slip:.3g} m; slow the motion down, or {remedy}"
    data, geoms = mujoco.MjData(model), world.scene.components["carried"].geoms
    mujoco.mj_setState(model, data, start, int(STATE))
    mujoco.mj_kinematics(model, data)
    gaps: dict[int, float] = {}
    for pad in world.robot.pads.tolist():
        part = int(model.body_weldid[model.geom_bodyid[pad]])
        gaps[part] = min(gaps.get(part, np.inf), gap_between(model, data, [pad], geoms))
    near = [model.body(part).name for part, gap in gaps.items() if gap <= _TOUCH]
    if not near:
        what = "no finger touches it" if len(world.robot.gripper_joints) else "the gripper does not touch it"
        away = f"{1e3 * min(gaps.values()):.0f} mm away"
        return f"{what} ({away}) although the gripper is closed; change the grasp (at=, X_TO=), or {remedy}"
    if len(near) == 1 and len(world.robot.gripper_joints):
        return f"only {near[0]} touches it; change the grasp (at=, X_TO=), or {remedy}"
    return f"it has slipped by {slip:.3g} m; slow the motion down, press harder, or {remedy}"


def touched_pairs(world: World, sensordata: Float[Array, "step sensordata"]) -> frozenset[tuple[str, str]]:
    """Return the pairs of component and entity that touch at any step."""
    felt = np.any(sensordata[:, world.sensor_adr] > 0.0, axis=0)
    return frozenset(pair for pair, touches in zip(world.pairs, felt, strict=True) if touches)


def is_allowed(world: World, component: str, entity: str) -> bool:
    """Return whether the scene allows a component to touch an entity, for example an object its support."""
    scene = world.scene
    pairs = scene.allowed_pairs("always") | scene.allowed_pairs("ends")
    own, other = scene.components[component].geoms, scene.entities[entity].geoms
    return any((min(a, b), max(a, b)) in pairs for a in own for b in other)


def check_range(wanted: Float[Array, "step nq"], tolerance: float, world: World, dt: float) -> None:
    """Raise ExecutionRefused at the first step where a target is farther beyond its joint's range than `tolerance`."""
    low, high = world.scene.limits.position.T
    off = np.argwhere((wanted < low - tolerance) | (wanted > high + tolerance))
    if len(off):
        step, joint = (int(i) for i in off[0])
        problem = f"its target is {wanted[step, joint]:.3g}, its range is {low[joint]:.3g} to {high[joint]:.3g}"
        raise ExecutionRefused(f"joint {world.scene.joints[joint]!r}", (step + 1) * dt, problem)


def check_tracking(error: Float[Array, "step nq"], tolerance: float, world: World, dt: float) -> None:
    """Raise ExecutionRefused at the first step where a joint is farther from the trajectory than `tolerance`."""
    most = np.full(error.shape[1], tolerance)
    if world.rolling is not None:
        most[:PLANAR] = np.maximum(tolerance, _STRAYING)
    off = np.argwhere(~(error <= most))
    if len(off):
        step, joint = (int(i) for i in off[0])
        problem = f"{error[step, joint]:.3g} rad from the trajectory, {most[joint]:g} are allowed; slow the motion down"
        raise ExecutionRefused(f"joint {world.scene.joints[joint]!r}", (step + 1) * dt, problem)


def displacement(
    xpos: Float[Array, "step body xyz"], xquat: Float[Array, "step body wxyz"], world: World
) -> Float[Array, " step"]:
    """Return the displacement of the carried object from its first position, in the tool's frame [m]."""
    if world.carried_body < 0:
        return np.zeros(len(xpos))
    from scipy.spatial.transform import Rotation

    tool = int(world.model.site(world.scene.tool).bodyid[0])
    turned = Rotation.from_quat(xquat[:, tool], scalar_first=True)
    place = turned.apply(xpos[:, world.carried_body] - xpos[:, tool], inverse=True)
    return np.linalg.norm(place - place[0], axis=-1)
