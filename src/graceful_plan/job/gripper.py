"""The parallel gripper of a scene in the tool frame: closing axis, pads, opening.

Frames: W world, T tool, G geom.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.frames import pose_matrix
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.couplings import followers
from graceful_plan.scene.model_parts import colliding_geoms, subtree
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

Array = np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class ParallelGripper:
    """Two fingers that slide along one axis in opposite directions; vectors are in the tool frame T.

    | field    | meaning                                                                          | unit | shape   |
    |----------|----------------------------------------------------------------------------------|------|---------|
    | closing  | unit vector from one pad to the other                                            |      | 3       |
    | approach | unit vector from the hand to the fingertips, an axis of T                        |      | 3       |
    | pads     | midpoint between the pads                                                        | m    | 3       |
    | half     | half size of a pad along the approach, and across                                | m    | 2       |
    | depth    | distance from the middle of the pads to the nearest part of the hand behind them | m    |         |
    | range    | least and largest opening                                                        | m    | 2       |
    | joints   | per leading finger joint: position at the least opening, and way that opens it   | m    |         |
    | geoms    | colliding geoms of the gripper                                                   |      | geom    |
    | X_TG     | their poses at the least opening                                                 | m    | geom 4 4|
    | moves    | displacement of each geom per metre of opening                                   |      | geom 3  |
    """

    closing: Float[Array, " xyz"]
    approach: Float[Array, " xyz"]
    pads: Float[Array, " xyz"]
    half: tuple[float, float]
    depth: float
    range: tuple[float, float]
    joints: Mapping[str, tuple[float, float]]
    geoms: tuple[int, ...]
    X_TG: Float[Array, "geom 4 4"]
    moves: Float[Array, "geom xyz"]

    def fingers(self, opening: float) -> dict[str, float]:
        """Return the positions of the leading finger joints at a distance of the pads [m]."""
        way = 0.5 * (float(np.clip(opening, *self.range)) - self.range[0])
        return {name: start + sign * way for name, (start, sign) in self.joints.items()}

    def poses(self, opening: float) -> Float[Array, "geom 4 4"]:
        """Return the poses of the gripper's geoms in T at a distance of the pads [m]."""
        X = self.X_TG.copy()
        X[:, :3, 3] += (float(np.clip(opening, *self.range)) - self.range[0]) * self.moves
        return X


@per_layout
def find_gripper(scene: Scene) -> ParallelGripper:
    """Return the parallel gripper of a scene.

    Raises:
        UnsupportedError: If the gripper does not consist of two fingers on slides that move in opposite directions.
    """
    model, hand = scene.model, scene.gripper_bodies
    slides = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) in hand and j not in scene.joint_ids]
    if len(slides) != 2 or any(int(model.jnt_type[j]) != 2 for j in slides):
        raise UnsupportedError(
            f"grasps are sampled for two fingers on slides; the gripper of {scene.name!r} has {len(slides)} joints of "
            "other kinds or numbers: give grasps by list"
        )
    data = Placement(scene).place(scene.home_qpos[scene.qpos_adr])
    site = data.site(scene.tool)
    X_WT = pose_matrix(site.xmat, site.xpos)
    geoms = colliding_geoms(model, hand)
    X_TG = np.stack([np.linalg.inv(X_WT) @ pose_matrix(data.geom_xmat[g], data.geom_xpos[g]) for g in geoms])
    fingers = [
        [geoms.index(g) for g in geoms if int(model.geom_bodyid[g]) in subtree(model, int(body))]
        for body in model.jnt_bodyid[slides]
    ]
    if not all(fingers):
        raise UnsupportedError(f"a finger of {scene.name!r} has no geoms that collide: give grasps by list")
    axes = np.stack([X_WT[:3, :3].T @ data.xaxis[j] for j in slides])
    between = X_TG[fingers[0], :3, 3].mean(axis=0) - X_TG[fingers[1], :3, 3].mean(axis=0)
    closing = axes[0] * np.sign(axes[0] @ between)
    outward = (closing, -closing)
    signs = [float(np.sign(axis @ way)) for axis, way in zip(axes, outward, strict=True)]
    middle, half = _boxes(scene, geoms, X_TG)
    inner, pad = [], []
    for mine, way in zip(fingers, outward, strict=True):
        near = middle[mine] @ way - half[mine] @ np.abs(way)
        pad.append(mine[int(np.argmin(near))])
        inner.append(float(near.min()))
    now = [float(scene.home_qpos[model.jnt_qposadr[j]]) for j in slides]
    limits = [model.jnt_range[j] for j in slides]
    closed = [float(low if sign > 0.0 else high) for (low, high), sign in zip(limits, signs, strict=True)]
    opened = [abs(position - start) for position, start in zip(now, closed, strict=True)]
    travel = min(float(high - low) for low, high in limits)
    for mine, way, out in zip(fingers, outward, opened, strict=True):
        X_TG[mine, :3, 3] -= out * way
        middle[mine] -= out * way
    least = inner[0] + inner[1] - opened[0] - opened[1]
    pads = middle[pad].mean(axis=0)
    pads -= closing * (closing @ pads) - 0.5 * closing * (inner[0] - opened[0] - inner[1] + opened[1])
    away = pads - middle.mean(axis=0)
    away -= closing * (closing @ away)
    approach = np.zeros(3)
    approach[np.argmax(np.abs(away))] = np.sign(away[np.argmax(np.abs(away))])
    across = np.cross(closing, approach)
    # The palm, which limits the depth of a grasp, is every part of the gripper but the fingers.
    own = set(fingers[0]) | set(fingers[1])
    palm = [k for k in range(len(geoms)) if k not in own]
    behind = [float(approach @ pads - (approach @ middle[k] + np.abs(approach) @ half[k])) for k in palm]
    moves = np.zeros((len(geoms), 3))
    for mine, way in zip(fingers, outward, strict=True):
        moves[mine] = 0.5 * way
    leading = followers(model).keys()
    return ParallelGripper(
        closing=closing,
        approach=approach,
        pads=pads,
        half=(float(np.abs(approach) @ half[pad[0]]), float(np.abs(across) @ half[pad[0]])),
        depth=max(min(behind, default=np.inf), 0.0),
        range=(max(least, 0.0), least + 2.0 * travel),
        joints={
            model.joint(j).name: (start, sign)
            for j, start, sign in zip(slides, closed, signs, strict=True)
            if j not in leading
        },
        geoms=geoms,
        X_TG=X_TG,
        moves=moves,
    )


def _boxes(
    scene: Scene, geoms: tuple[int, ...], X_TG: Float[Array, "geom 4 4"]
) -> tuple[Float[Array, "geom xyz"], Float[Array, "geom xyz"]]:
    """Return centre and half size in T of boxes around geoms."""
    box = scene.model.geom_aabb[list(geoms)].reshape(-1, 6)
    centre = np.einsum("gij,gj->gi", X_TG[:, :3, :3], box[:, :3]) + X_TG[:, :3, 3]
    return centre, np.einsum("gij,gj->gi", np.abs(X_TG[:, :3, :3]), box[:, 3:])
