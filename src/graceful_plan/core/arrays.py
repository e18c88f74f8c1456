"""The tables that kernels read: robot, world, impact, bounds.

Axis words: `*batch time nq nv link geom sphere obstacle pair component entity harmed xyz(3) wxyz(4)`. Order: batch,
time, item, component. Tables are frozen; `compile.py` builds them from a scene, `kernels.py` passes them to the core.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Float, Int

OBSTACLE_TYPES = ("plane", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
"""Kinds of obstacles, in MuJoCo's geom-type order; the index is the code in `WorldArrays.kind`."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RobotArrays:
    """Tables of the robot: links in topological order, the spheres that cover them, joint limits.

    A link is one joint with everything rigidly attached to it; link 0 is the fixed base. The gripper and the carried
    object are separate links without a joint, attached to the tool's link.

    | field         | meaning                                                        | unit  | shape          |
    |---------------|----------------------------------------------------------------|-------|----------------|
    | parent        | parent link, -1 for the base                                   |       | link           |
    | joint         | index into q, -1 for a rigid link                              |       | link           |
    | slide         | 1 for a sliding joint, 0 for a hinge                           |       | link           |
    | X_PL          | pose of the link in its parent at q = 0; joint axis is local z | m     | link 4 4       |
    | lower         | lower position limit                                           | rad   | nq             |
    | upper         | upper position limit                                           | rad   | nq             |
    | tool_link     | link of the tool                                               |       |                |
    | X_LT          | tool in its link                                               | m     | 4 4            |
    | sphere_link   | link of each sphere, ascending                                 |       | sphere         |
    | sphere        | centre in the link frame, radius                               | m     | sphere 4       |
    | bound         | bounding sphere of each link, radius -1 if it has no spheres   | m     | link 4         |
    | self_pair     | pairs of links that may touch each other                       |       | pair 2         |
    | self_slack    | clearance of their spheres at which they touch, 0 or less      | m     | pair           |
    | protrusion    | largest protrusion of the spheres from the geoms               | m     |                |
    """

    parent: Int[Array, " link"]
    joint: Int[Array, " link"]
    slide: Int[Array, " link"]
    X_PL: Float[Array, "link 4 4"]
    lower: Float[Array, " nq"]
    upper: Float[Array, " nq"]
    tool_link: int
    X_LT: Float[Array, "4 4"]
    sphere_link: Int[Array, " sphere"]
    sphere: Float[Array, "sphere 4"]
    bound: Float[Array, "link 4"]
    self_pair: Int[Array, "pair 2"]
    self_slack: Float[Array, " pair"]
    protrusion: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WorldArrays:
    """Tables of the obstacles around the robot: exact primitives and convex hulls, in world coordinates.

    | field       | meaning                                                              | unit | shape         |
    |-------------|----------------------------------------------------------------------|------|---------------|
    | kind        | index into `OBSTACLE_TYPES`                                          |      | obstacle      |
    | pose        | rotation (row-major) and position                                    | m    | obstacle 12   |
    | size        | half sizes; radius, half length; semi-axes, as in MuJoCo             | m    | obstacle 3    |
    | bound       | bounding sphere; radius -1 for a plane                               | m    | obstacle 4    |
    | ignores     | bit l set if link l may touch it                                     |      | obstacle      |
    | hull_start  | first triangle of a mesh, one more entry at the end                  |      | obstacle + 1  |
    | triangles   | corners of the hulls' triangles in W, counter-clockwise from outside | m    | triangle 3 3  |
    | geom        | geom id in the scene's model                                         |      | obstacle      |
    """

    kind: Int[Array, " obstacle"]
    pose: Float[Array, "obstacle 12"]
    size: Float[Array, "obstacle 3"]
    bound: Float[Array, "obstacle 4"]
    ignores: Int[Array, " obstacle"]
    hull_start: Int[Array, " obstacle_end"]
    triangles: Float[Array, "triangle 3 3"]
    geom: Int[Array, " obstacle"]

    @classmethod
    def nothing(cls) -> WorldArrays:
        """Return a world without obstacles."""
        none = np.zeros(0, dtype=int)
        return cls(
            kind=none,
            pose=np.zeros((0, 12)),
            size=np.zeros((0, 3)),
            bound=np.zeros((0, 4)),
            ignores=none,
            hull_start=np.zeros(1, dtype=int),
            triangles=np.zeros((0, 3, 3)),
            geom=none,
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ImpactArrays:
    """Components that may hit, entities that may be hit, and the severities: boxes per geom of components and entities.

    | field          | meaning                                                 | unit | shape            |
    |----------------|---------------------------------------------------------|------|------------------|
    | part_component | component of each moving box, ascending                 |      | part             |
    | part_link      | link of each moving box                                 |      | part             |
    | part_box       | pose in the link (rotation row-major, centre), half size | m   | part 15          |
    | target_entity  | entity of each static box, ascending                    |      | target           |
    | target_box     | axis-aligned box in W: lower corner, upper corner       | m    | target 6         |
    | severity       | S of component against entity                           |      | component entity |
    """

    part_component: Int[Array, " part"]
    part_link: Int[Array, " part"]
    part_box: Float[Array, "part 15"]
    target_entity: Int[Array, " target"]
    target_box: Float[Array, "target 6"]
    severity: Float[Array, "component entity"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BoundArrays:
    """Bounds beyond collision: axes within cones, points within boxes, extra distance to obstacles.

    | field          | meaning                                                   | unit | shape    |
    |----------------|-----------------------------------------------------------|------|----------|
    | cone_link      | link that the axis is attached to                         |      | cone     |
    | cone_axis      | unit axis in the link                                     |      | cone 3   |
    | cone_direction | unit direction in W                                       |      | cone 3   |
    | cone_angle     | largest angle between axis and direction                  | rad  | cone     |
    | room_link      | link that the point is attached to                        |      | room     |
    | room_point     | point in the link that stays inside the box               | m    | room 3   |
    | room_rotation  | rotation of the box in W                                  |      | room 3 3 |
    | room_position  | position of the box in W                                  | m    | room 3   |
    | room_lower     | lower corner of the box in its own axes, may be infinite  | m    | room 3   |
    | room_upper     | upper corner of the box in its own axes, may be infinite  | m    | room 3   |
    | keep           | distance to keep from each obstacle, on top of any margin | m    | obstacle |
    """

    cone_link: Int[Array, " cone"]
    cone_axis: Float[Array, "cone 3"]
    cone_direction: Float[Array, "cone 3"]
    cone_angle: Float[Array, " cone"]
    room_link: Int[Array, " room"]
    room_point: Float[Array, "room 3"]
    room_rotation: Float[Array, "room 3 3"]
    room_position: Float[Array, "room 3"]
    room_lower: Float[Array, "room 3"]
    room_upper: Float[Array, "room 3"]
    keep: Float[Array, " obstacle"]

    @classmethod
    def none(cls, n_obstacle: int) -> BoundArrays:
        """Return tables without bounds."""
        no_link, no_vector = np.zeros(0, dtype=int), np.zeros((0, 3))
        return cls(
            cone_link=no_link,
            cone_axis=no_vector,
            cone_direction=no_vector,
            cone_angle=np.zeros(0),
            room_link=no_link,
            room_point=no_vector,
            room_rotation=np.zeros((0, 3, 3)),
            room_position=no_vector,
            room_lower=no_vector,
            room_upper=no_vector,
            keep=np.zeros(n_obstacle),
        )
