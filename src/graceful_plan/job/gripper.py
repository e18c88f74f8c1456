"""The gripper of a scene in the tool frame: closing axis, pads, opening.

Frames: T tool, G geom.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.frames import pose_matrix
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.fingers import Hand, Pads, Stroke, find_pads, find_stroke, moving_bodies
from graceful_plan.scene.model_parts import colliding_geoms, names
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.rules.grip import hand_of
from graceful_plan.scene.scene import Scene

Array = np.ndarray

_SHARES = np.linspace(0.0, 1.0, 33)
"""Shares of the stroke at which openings are measured: between them, those of linkages are off by some 10 um."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ParallelGripper:
    """Two pads that face each other, at least one of which moves; vectors are in the tool frame T.

    | field    | meaning                                                                          | unit | shape   |
    |----------|----------------------------------------------------------------------------------|------|---------|
    | hand     | the gripper in its model                                                         |      |         |
    | qpos     | state of the model, apart from the gripper's joints                              |      |         |
    | stroke   | the joints that open it                                                          |      |         |
    | gaps     | distance of the pads at each of `_SHARES`                                        | m    | share   |
    | closing  | unit vector from one pad to the other, across the approach                       |      | 3       |
    | approach | unit vector from the hand to the fingertips, an axis of T                        |      | 3       |
    | half     | half size of a pad along the approach, and across                                | m    | 2       |
    | depth    | distance from the middle of the pads to the nearest part of the hand behind them | m    |         |
    | geoms    | colliding geoms of the gripper                                                   |      | geom    |
    | pads     | its pads                                                                         |      |         |
    """

    hand: Hand
    qpos: Float[Array, " model_nq"]
    stroke: Stroke
    gaps: Float[Array, " share"]
    closing: Float[Array, " xyz"]
    approach: Float[Array, " xyz"]
    half: tuple[float, float]
    depth: float
    geoms: tuple[int, ...]
    pads: Pads

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest opening [m]."""
        return max(float(self.gaps[0]), 0.0), float(self.gaps[-1])

    @property
    def has_fixed_pad(self) -> bool:
        """Whether one pad does not move, so that it touches the object before the other one closes."""
        moving = colliding_geoms(self.hand.model, moving_bodies(self.hand))
        return not set(moving).issuperset(self.pads.geoms)

    def _joints(self, opening: float) -> dict[int, float]:
        return self.stroke.at(float(np.interp(opening, self.gaps, _SHARES)))

    def fingers(self, opening: float) -> dict[str, float]:
        """Return the positions of the leading finger joints at a distance of the pads [m]."""
        joints = self._joints(opening)
        return dict(zip(names(self.hand.model, mujoco.mjtObj.mjOBJ_JOINT, joints), joints.values(), strict=True))

    def at(self, opening: float) -> tuple[Float[Array, "geom 4 4"], Float[Array, " xyz"]]:
        """Return the poses of the gripper's geoms and the middle between the pads in T, at a distance of the pads."""
        data = self.hand.posed(self.qpos, self._joints(opening))
        X_TG = _poses(self.hand, data, self.geoms)
        middle, _ = _boxes(self.hand, self.pads.geoms, _poses(self.hand, data, self.pads.geoms))
        return X_TG, _between(self.pads, data, middle)


@per_layout
def find_gripper(scene: Scene) -> ParallelGripper:
    """Return the gripper of a scene.

    Raises:
        UnsupportedError: If the tool is not between two pads that open.
    """
    hand, qpos = hand_of(scene), scene.home_qpos
    stroke = find_stroke(hand, qpos)
    if not stroke.joints:
        raise UnsupportedError(f"the gripper of {scene.name!r} has no joint with limits: give grasps by list")
    pads = find_pads(hand, qpos, stroke)
    gaps = np.array([pads.gap(hand.posed(qpos, stroke.at(share))) for share in _SHARES.tolist()])
    data = hand.posed(qpos, stroke.at(0.5))
    geoms = colliding_geoms(hand.model, hand.bodies)
    middle, half = _boxes(hand, geoms, _poses(hand, data, geoms))
    pad = [geoms.index(g) for g in pads.geoms]
    between = _between(pads, data, middle[pad])
    closing = pads.closing * np.sign(pads.closing[np.argmax(np.abs(pads.closing))])  # whichever pad is the nearer one
    away = between - middle.mean(axis=0)
    away -= closing * (closing @ away)
    approach = np.zeros(3)
    approach[np.argmax(np.abs(away))] = np.sign(away[np.argmax(np.abs(away))])
    closing -= approach * (approach @ closing)
    closing /= np.linalg.norm(closing)
    across = np.cross(closing, approach)
    # The palm, which limits the depth of a grasp, is every part of the gripper but the fingers.
    fingers = {*colliding_geoms(hand.model, moving_bodies(hand)), *pads.geoms}
    palm = [k for k, g in enumerate(geoms) if g not in fingers]
    behind = [float(approach @ (between - middle[k]) - np.abs(approach) @ half[k]) for k in palm]
    return ParallelGripper(
        hand=hand,
        qpos=qpos,
        stroke=stroke,
        gaps=np.maximum.accumulate(gaps),
        closing=closing,
        approach=approach,
        half=(float(np.abs(approach) @ half[pad[0]]), float(np.abs(across) @ half[pad[0]])),
        depth=max(min(behind, default=np.inf), 0.0),
        geoms=geoms,
        pads=pads,
    )


def _between(pads: Pads, data: mujoco.MjData, middle: Float[Array, "2 xyz"]) -> Float[Array, " xyz"]:
    """Return the middle between two pads from those of their boxes: along the closing axis, surfaces count."""
    centre = middle.mean(axis=0)
    return centre + pads.closing * (pads.closing @ (pads.offsets(data).mean(axis=0) - centre))


def _poses(hand: Hand, data: mujoco.MjData, geoms: tuple[int, ...]) -> Float[Array, "geom 4 4"]:
    """Return the poses of geoms in T."""
    X_WT = pose_matrix(data.site_xmat[hand.tool], data.site_xpos[hand.tool])
    return np.linalg.inv(X_WT) @ np.stack([pose_matrix(data.geom_xmat[g], data.geom_xpos[g]) for g in geoms])


def _boxes(
    hand: Hand, geoms: tuple[int, ...], X_TG: Float[Array, "geom 4 4"]
) -> tuple[Float[Array, "geom xyz"], Float[Array, "geom xyz"]]:
    """Return centre and half size in T of boxes around geoms."""
    box = hand.model.geom_aabb[list(geoms)].reshape(-1, 6)
    centre = np.einsum("gij,gj->gi", X_TG[:, :3, :3], box[:, :3]) + X_TG[:, :3, 3]
    return centre, np.einsum("gij,gj->gi", np.abs(X_TG[:, :3, :3]), box[:, 3:])
