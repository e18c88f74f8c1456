"""Rules as tables for the core: axes within cones, points within boxes, distances from obstacles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.arrays import BoundArrays, RobotArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.rules.rules import AxisRule, BoxRule, DistanceRule, Rule
from graceful_plan.scene.scene import Scene

Array = np.ndarray
Numbers = tuple[float, ...]


@final
@dataclass(frozen=True, kw_only=True)
class RuleBounds:
    """The rules that the core can check: rows of `BoundArrays`, and the distance to keep from each entity [m]."""

    cones: tuple[Numbers, ...]
    rooms: tuple[Numbers, ...]
    keep: tuple[tuple[str, float], ...]


def bounds_of(scene: Scene, rules: Iterable[Rule]) -> RuleBounds:
    """Convert those rules that the core can check; skip the others."""
    robot = compile_scene(scene).robot
    cones: list[Numbers] = []
    rooms: list[Numbers] = []
    keep: list[tuple[str, float]] = []
    for rule in rules:
        if isinstance(rule, AxisRule):
            axis = frame_in_link(scene, robot, rule.frame)[:3, :3] @ rule.axis
            cones.append((*axis.tolist(), *rule.direction, rule.angle))
        elif isinstance(rule, BoxRule):
            pose = *rule.X_WB[:3, :3].ravel().tolist(), *rule.X_WB[:3, 3].tolist()
            rooms.append((*robot.X_LT[:3, 3].tolist(), *pose, *rule.lower, *rule.upper))
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
        cone=np.array(cones).reshape(-1, 7),
        room_link=np.full(len(rooms), robot.tool_link),
        room=np.array(rooms).reshape(-1, 21),
        keep=kept,
    )
    return Kernels(robot, world, compiled.impact_tables, bounds=arrays)


def frame_in_link(scene: Scene, robot: RobotArrays, frame: str) -> Float[Array, "4 4"]:
    """Return the pose of the frame "tool" or "object" in the tool's link, to which both are fixed."""
    if frame == "tool" or scene.carried is None:
        return robot.X_LT
    return robot.X_LT @ scene.carried.X_TO
