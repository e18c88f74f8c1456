"""Rules as tables for the core: axes within cones, points within boxes, distances from obstacles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.arrays import BoundArrays, RobotArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.rules.rules import AxisRule, BoxRule, DistanceRule, Rule
from graceful_plan.scene.scene import Scene

Numbers = tuple[float, ...]


class _Cone(NamedTuple):
    """A unit axis in the tool's link within an angle [rad] of a unit direction in W."""

    axis: Numbers
    direction: Numbers
    angle: float


class _Room(NamedTuple):
    """A point in the tool's link inside a box: rotation and position in W, corners in the axes of the box [m]."""

    point: Numbers
    rotation: Numbers
    position: Numbers
    lower: Numbers
    upper: Numbers


@final
@dataclass(frozen=True, kw_only=True)
class RuleBounds:
    """The rules that the core can check, and the distance to keep from each entity [m]."""

    cones: tuple[_Cone, ...]
    rooms: tuple[_Room, ...]
    keep: tuple[tuple[str, float], ...]


def bounds_of(scene: Scene, rules: Iterable[Rule]) -> RuleBounds:
    """Convert those rules that the core can check; skip the others."""
    robot = compile_scene(scene).robot
    cones: list[_Cone] = []
    rooms: list[_Room] = []
    keep: list[tuple[str, float]] = []
    for rule in rules:
        if isinstance(rule, AxisRule):
            axis = frame_in_link(scene, robot, rule.frame)[:3, :3] @ rule.axis
            cones.append(_Cone(tuple(axis.tolist()), rule.direction, rule.angle))
        elif isinstance(rule, BoxRule):
            point, rotation, position = robot.X_LT[:3, 3], rule.X_WB[:3, :3].ravel(), rule.X_WB[:3, 3]
            box = tuple(rotation.tolist()), tuple(position.tolist()), rule.lower, rule.upper
            rooms.append(_Room(tuple(point.tolist()), *box))
        elif isinstance(rule, DistanceRule):
            keep.append((rule.entity, rule.metres))
    return RuleBounds(cones=tuple(cones), rooms=tuple(rooms), keep=tuple(keep))


def bounded_kernels(scene: Scene, bounds: RuleBounds, room: float = 0.0) -> Kernels:
    """Return the scene's kernels, extended by bounds.

    Args:
        scene: The scene.
        bounds: Bounds that the kernels check.
        room: Clearance to keep from all obstacles, on top of any margin [m]. Unlike a margin, it tightens no bound.
    """
    if not (bounds.cones or bounds.rooms or bounds.keep or room):
        return compile_scene(scene).kernels
    return _kernels(scene, bounds, room)


@per_scene(most=8)
def _kernels(scene: Scene, bounds: RuleBounds, room: float) -> Kernels:
    """Build kernels with bounds, which takes milliseconds; the last few are cached."""
    compiled = compile_scene(scene)
    robot, world = compiled.robot, compiled.world
    kept = np.full(len(world.geom), room)
    for entity, metres in bounds.keep:
        mine = np.isin(world.geom, list(scene.entities[entity].geoms))
        kept[mine] = np.maximum(kept[mine], metres)
    cones, rooms = bounds.cones, bounds.rooms
    arrays = BoundArrays(
        cone_link=np.full(len(cones), robot.tool_link),
        cone_axis=np.array([cone.axis for cone in cones]).reshape(-1, 3),
        cone_direction=np.array([cone.direction for cone in cones]).reshape(-1, 3),
        cone_angle=np.array([cone.angle for cone in cones]).reshape(-1),
        room_link=np.full(len(rooms), robot.tool_link),
        room_point=np.array([box.point for box in rooms]).reshape(-1, 3),
        room_rotation=np.array([box.rotation for box in rooms]).reshape(-1, 3, 3),
        room_position=np.array([box.position for box in rooms]).reshape(-1, 3),
        room_lower=np.array([box.lower for box in rooms]).reshape(-1, 3),
        room_upper=np.array([box.upper for box in rooms]).reshape(-1, 3),
        keep=kept,
    )
    return Kernels(robot, world, compiled.impact_tables, bounds=arrays)


def frame_in_link(scene: Scene, robot: RobotArrays, frame: str) -> Float[Array, "4 4"]:
    """Return the pose of the frame "tool" or "object" in the tool's link, to which both are fixed."""
    if frame == "tool" or scene.carried is None:
        return robot.X_LT
    return robot.X_LT @ scene.carried.X_TO
