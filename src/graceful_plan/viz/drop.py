"""Where it would do how much harm if the carried object fell: the impact of a drop over a plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.arrays import RobotArrays, WorldArrays
from graceful_plan.compile import compile_scene
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.kernels import Kernels
from graceful_plan.scene import Scene

Array = np.ndarray

FALLING = ("carried", "contents")
"""Components that fall when the gripper opens."""
_X_W1 = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
_X_W2 = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=float)
"""Frames whose z axes, along which sliding joints move, are the x and the y axis of W."""


def drop_impact(
    scene: Scene, q: Float[Array, " nq"], x: Float[Array, " nx"], y: Float[Array, " ny"]
) -> Float[Array, "ny nx"]:
    """Compute the impact of a drop with the carried object at every (x, y), turned and as high as it is at `q`.

    Args:
        scene: With an object in the gripper.
        q: Configuration that says how the object is held.
        x: Where the origin of the object's body is [m].
        y: Where the origin of the object's body is [m].
    """
    here = scene.data_at(q).body(scene.carried.body).xpos if scene.carried is not None else np.zeros(3)
    shifts = np.stack(np.meshgrid(x - here[0], y - here[1]), axis=-1)
    return _gantry(scene, q).impact(shifts, ImpactCost(components=FALLING).severity(scene))


def _gantry(scene: Scene, q: Float[Array, " nq"]) -> Kernels:
    """Put what falls, as it is held at `q`, on a robot that moves it along x and y."""
    tables = compile_scene(scene)
    falling = [name in FALLING for name in scene.components]
    hazards = tables.hazards
    parts = np.flatnonzero(np.array(falling)[hazards.part_component])
    boxes = hazards.part_box[parts].copy()
    X_2W = np.linalg.inv(_X_W2)
    poses = X_2W @ tables.kernels.link_poses(q)[hazards.part_link[parts]]
    boxes[:, 9:12] = np.einsum("pij,pj->pi", poses[:, :3, :3], boxes[:, 9:12]) + poses[:, :3, 3]
    boxes[:, :9] = (poses[:, :3, :3] @ boxes[:, :9].reshape(-1, 3, 3)).reshape(-1, 9)
    robot = RobotArrays(
        parent=np.array([-1, 0, 1]),
        joint=np.array([-1, 0, 1]),
        slide=np.array([0, 1, 1]),
        X_PL=np.stack([np.eye(4), _X_W1, np.linalg.inv(_X_W1) @ _X_W2]),
        lower=np.full(2, -np.inf),
        upper=np.full(2, np.inf),
        tool_link=2,
        X_LT=np.eye(4),
        sphere_link=np.zeros(0, dtype=int),
        sphere=np.zeros((0, 4)),
        bound=np.tile([0.0, 0.0, 0.0, -1.0], (3, 1)),
        self_pair=np.zeros((0, 2), dtype=int),
        protrusion=0.0,
    )
    carried = replace(
        hazards, part_component=hazards.part_component[parts], part_link=np.full(len(parts), 2), part_box=boxes
    )
    return Kernels(robot, _nothing_around(), carried)


def _nothing_around() -> WorldArrays:
    return WorldArrays(
        kind=np.zeros(0, dtype=int),
        pose=np.zeros((0, 12)),
        size=np.zeros((0, 3)),
        bound=np.zeros((0, 4)),
        ignores=np.zeros(0, dtype=int),
        hull_start=np.zeros(1, dtype=int),
        triangles=np.zeros((0, 3, 3)),
        geom=np.zeros(0, dtype=int),
    )
