"""Fingers that have let go: how far they are open then, and whom they touch as they go on with the arm.

A gripper that fails opens, and the arm carries out the rest of its motion with fingers that are wider than those that
held. What they touch is decided by that motion to the millimetre, and hardly foreseen from a state alone: so they count
where the motion to come is known (`StateBatch.ahead`), and nowhere else.

Notation: W world, L the link that the tool rides on, T tool, G geom. A place is a configuration on the way.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import final

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.compile import CompiledScene, compile_scene, pose
from graceful_plan.core.covers import GroupCover, group_cover
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.cost import AHEAD
from graceful_plan.scene.model_parts import colliding_geoms, finger_joints
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

Array = np.ndarray

OPENING = 0.05
"""How long it takes until fingers are wider than they were [s]: in FailBench, a gripper that is told to open at once
touches nothing of what it passes in the first 0.06 s."""
_OFFSET, _SPREAD = 0.001, 0.001
"""Of the distance at which they touch something [m]: of 20,800 pairs of a drop in FailBench and an entity, the least
distance of opened fingers on the way tells 100 touches from the rest within a millimetre."""
_FAR = 8.0
"""Spreads beyond which nothing is touched."""
_PARTS = 10
"""Places between two that are told of the motion to come, 10 ms apart: fingers may graze something for 20 ms."""
_REACH = 0.2
"""Nothing is touched that is farther from all places that are told [m]: no finger moves at 4 m/s."""
_PROTRUSION = 0.002
"""How far the spheres of fingers may stick out [m]."""
_STATES = 2000
"""States that are worked on at once."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class OpenedFingers:
    """Kernels that see nothing but opened fingers.

    Args:
        all: With everything that they may touch and that belongs to an entity.
        each: By index of the entity: with what belongs to that alone.
    """

    all: Kernels
    each: dict[int, Kernels]

    def distance(self, q: Float[Array, "n nq"], n_entity: int) -> Float[Array, "n entity"]:
        """Return the distance to each entity [m] if it counts, and infinity elsewhere."""
        found = np.full((len(q), n_entity), np.inf)
        near = np.flatnonzero(~self.all.free(q, _OFFSET + _FAR * _SPREAD))
        for entity, kernels in self.each.items() if len(near) else ():
            found[near, entity] = kernels.clearance(q[near])
        return found


def opening_probability(
    scene: Scene, q: Float[Array, "n nq"], ahead: Float[Array, "n step nq"]
) -> Float[Array, "n entity"]:
    """Return P that fingers which open in some states touch each entity on the motion to come.

    Args:
        scene: Where.
        q: The states.
        ahead: The motion to come, see `StateBatch`.
    """
    fingers, count = opened_fingers(scene), len(scene.entities)
    if fingers is None:
        return np.zeros((len(q), count))
    least = np.full((len(q), count), np.inf)
    near = np.flatnonzero(~fingers.all.free(np.concatenate([q[:, None], ahead], axis=1), _REACH).all(axis=1))
    for k in range(0, len(near), _STATES):
        rows = near[k : k + _STATES]
        places = _places(q[rows], ahead[rows])
        found = fingers.distance(places.reshape(-1, q.shape[1]), count)
        least[rows] = found.reshape(*places.shape[:2], count).min(axis=1)
    scaled = (least - _OFFSET) / _SPREAD
    return np.where(scaled < _FAR, 1.0 / (1.0 + np.exp(np.clip(scaled, -_FAR, _FAR))), 0.0)


@per_scene
def opened_fingers(scene: Scene) -> OpenedFingers | None:
    """Return what sees them in a scene; None if no fingers hang on the tool's body, or they cannot touch anybody."""
    model, compiled = scene.model, compile_scene(scene)
    opened = opened_positions(scene)
    links = _geoms(model, opened)
    rows = _touchable(scene, compiled, {geom for link in links for geom in link})
    if not rows:
        return None
    data = scene.data_at(model.qpos0[scene.qpos_adr])
    data.qpos[model.jnt_qposadr[list(opened)]] = list(opened.values())
    mujoco.mj_kinematics(model, data)
    tool = data.site(scene.tool)
    X_LW = compiled.robot.X_LT @ np.linalg.inv(pose(tool.xmat, tool.xpos))

    def cover(geoms: tuple[int, ...]) -> GroupCover:
        X_LG = np.stack([X_LW @ pose(data.geom_xmat[geom], data.geom_xpos[geom]) for geom in geoms])
        return group_cover(model, geoms, X_LG, base=False, protrusion=_PROTRUSION)

    robot = _fingers_alone(compiled.robot, len(scene.joints) + 1, [cover(geoms) for geoms in links])

    def seeing(obstacles: Collection[int]) -> Kernels:
        world = compiled.world.some(np.array(sorted(obstacles), dtype=int))
        return Kernels(robot, replace(world, ignores=np.zeros_like(world.ignores)), compiled.hazards)

    return OpenedFingers(
        all=seeing([row for own in rows.values() for row in own]), each={e: seeing(own) for e, own in rows.items()}
    )


def opened_positions(scene: Scene) -> dict[int, float]:
    """Return the joints of the fingers with their positions when the gripper is open as far as it goes [rad or m].

    That is the end of their ranges at which they are farther apart. Joints without a range stay where they are.
    """
    model = scene.model
    tool, planned = int(model.site(scene.tool).bodyid[0]), [int(model.joint(name).id) for name in scene.joints]
    joints = [j for j in finger_joints(model, tool, planned) if model.jnt_limited[j]]
    data = scene.data_at(model.qpos0[scene.qpos_adr])
    spread = []
    for end in (0, 1):
        data.qpos[model.jnt_qposadr[joints]] = model.jnt_range[joints, end]
        mujoco.mj_kinematics(model, data)
        centres = data.xipos[model.jnt_bodyid[joints]]
        spread.append(float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).sum()))
    wide = int(spread[1] >= spread[0])
    return {j: float(model.jnt_range[j, wide]) for j in joints}


def _places(q: Float[Array, "n nq"], ahead: Float[Array, "n step nq"]) -> Float[Array, "n place nq"]:
    """Return configurations of the motion to come from when fingers have opened on: cubics through what is told."""
    known = np.concatenate([q[:, None], ahead], axis=1)
    slope = np.gradient(known, axis=1)
    first, last = known[:, :-1, None], known[:, 1:, None]
    begins, ends = slope[:, :-1, None], slope[:, 1:, None]
    s = (np.arange(_PARTS) / _PARTS)[:, None]
    step = last - first
    between = first + s * (begins + s * (3.0 * step - 2.0 * begins - ends + s * (begins + ends - 2.0 * step)))
    places = np.concatenate([between.reshape(len(q), -1, q.shape[1]), known[:, -1:]], axis=1)
    return places[:, int(np.ceil(OPENING / AHEAD[0] * _PARTS)) :]


def _geoms(model: mujoco.MjModel, joints: Collection[int]) -> list[tuple[int, ...]]:
    """Return the geoms that collide of each link of the fingers."""
    bodies = {int(model.jnt_bodyid[j]) for j in joints}
    links: dict[int, set[int]] = {body: set() for body in sorted(bodies)}
    for body in range(model.nbody):
        root = body
        while root > 0 and root not in bodies:
            root = int(model.body_parentid[root])
        if root in bodies:
            links[root].add(body)
    return [group for link in links.values() if (group := colliding_geoms(model, link))]


def _touchable(scene: Scene, compiled: CompiledScene, fingers: set[int]) -> dict[int, list[int]]:
    """Return the obstacles that fingers may touch by the index of the entity that they belong to."""
    pairs = scene.collision_pairs()
    partners = set(pairs[:, ::-1][np.isin(pairs, list(fingers))].tolist())
    found = {
        e: [k for k, geom in enumerate(compiled.world.geom.tolist()) if geom in partners and geom in entity.geoms]
        for e, entity in enumerate(scene.entities.values())
    }
    return {e: own for e, own in found.items() if own}


def _fingers_alone(robot: RobotArrays, n_frame: int, covers: list[GroupCover]) -> RobotArrays:
    """Return a robot of the same frames with nothing on them but opened fingers behind the tool."""
    n_link = n_frame + len(covers)
    return replace(
        robot,
        parent=np.append(robot.parent[:n_frame], [robot.tool_link] * len(covers)),
        joint=np.append(robot.joint[:n_frame], [-1] * len(covers)),
        slide=np.append(robot.slide[:n_frame], [0] * len(covers)),
        X_PL=np.concatenate([robot.X_PL[:n_frame], np.tile(np.eye(4), (len(covers), 1, 1))]),
        sphere_link=np.repeat(np.arange(n_frame, n_link), [len(cover.spheres) for cover in covers]),
        sphere=np.concatenate([cover.spheres for cover in covers]),
        bound=np.concatenate([np.tile([0.0, 0.0, 0.0, -1.0], (n_frame, 1)), [cover.bound for cover in covers]]),
        self_pair=robot.self_pair[:0],
        self_slack=robot.self_slack[:0],
    )
