"""Moving entities as mocap bodies: they follow prescribed poses, can be hit, and do not yield.

Mocap bodies pass through static geometry and push movable objects. Their poses at a step are one row of numbers: all
positions, then all orientations, in the order of MuJoCo's states.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from types import MappingProxyType

import mujoco
import numpy as np

from graceful_plan import MovingEntity, Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.scene.edit import StaticBody
from graceful_plan.scene.elements import EntityAnnotation

REACTIONS = ("walk", "stop", "aside")
"""Possible reactions of people to a failure: walk on, stop, or stop and step aside."""
PEOPLE = frozenset({"adult", "adult_head", "child"})
"""Entity classes that react."""
_REACTION = 0.4
"""Reaction time to a sudden event that is seen or heard [s]."""
_STOPPING = 0.4
"""Time from walking to standing still [s], about one step."""
_ASIDE, _HASTE = 0.6, 1.0
"""Distance [m] and speed [m/s] of a step aside."""


def staged(scene: Scene) -> Scene:
    """Return a scene in which each moving entity is a body with a geom, and an entity like a static one.

    All other ids are unchanged. The entities are in the order of `scene.entity_names`.
    """
    if not scene.moving:
        return scene
    spec, notes = scene.spec.copy(), dict(scene.notes.entities)
    for entity in scene.moving.values():
        first = entity.at(entity.t[0])
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(first.yaw), -np.sin(first.yaw)], [np.sin(first.yaw), np.cos(first.yaw)]]
        pose[:3, 3] = first.position
        kind = "cylinder" if entity.is_round else "box"
        StaticBody(name=entity.name, kind=kind, size=entity.size, pose=pose).add_to(spec)
        notes[entity.name] = EntityAnnotation(category=entity.category, severity=entity.severity)
    moving = MappingProxyType({})
    return Scene.build(spec, dataclasses.replace(scene.notes, entities=notes, moving=moving))


def set_free(spec: mujoco.MjSpec, walkers: Sequence[MovingEntity]) -> None:
    """Make the bodies of moving entities mocap bodies, so that their poses can be set during a simulation."""
    for walker in walkers:
        spec.body(walker.name).mocap = True


class EntityPoses:
    """Poses of the moving entities in one simulation: the prediction, plus random deviations.

    Args:
        model: The model, with the entities' bodies.
        walkers: The moving entities.
        luck: Generator of the deviations, scaled by `spread` and `growth`; None for none.
    """

    def __init__(
        self, model: mujoco.MjModel, walkers: Sequence[MovingEntity], luck: np.random.Generator | None = None
    ) -> None:
        self._count, self._walkers = model.nmocap, walkers
        self._slots = [int(model.body_mocapid[model.body(walker.name).id]) for walker in walkers]
        free = np.flatnonzero(model.body_mocapid >= 0)
        self._still = np.concatenate([model.body_pos[free].ravel(), model.body_quat[free].ravel()])
        draws = np.zeros((len(walkers), 2, 2)) if luck is None else luck.standard_normal((len(walkers), 2, 2))
        self._off = [draw * [[w.spread], [w.growth]] for draw, w in zip(draws, walkers, strict=True)]

    def rows(self, time: Float[Array, " n"]) -> Float[Array, "n mocap"]:
        """Return the poses at times on the motion's clock [s]."""
        rows = np.tile(self._still, (len(time), 1))
        for i, walker in enumerate(self._walkers):
            where = walker.at(time)
            known_for = np.maximum(time - walker.t[0], 0.0)[:, None]
            position = where.position.copy()
            position[:, :2] += self._off[i][0] + known_for * self._off[i][1]
            self.write(rows, i, position, where.yaw)
        return rows

    def write(
        self, rows: Float[Array, "n mocap"], walker: int, position: Float[Array, "n 3"], yaw: Float[Array, " n"]
    ) -> None:
        """Write the poses of one moving entity into rows."""
        slot, half = self._slots[walker], yaw / 2.0
        rows[:, 3 * slot : 3 * slot + 3] = position
        quat = rows[:, 3 * self._count + 4 * slot :][:, :4]
        quat[:] = 0.0
        quat[:, 0], quat[:, 3] = np.cos(half), np.sin(half)

    def reacted(
        self, rows: Float[Array, "n mocap"], dt: float, people: str, away: Float[Array, " 3"]
    ) -> Float[Array, "n mocap"]:
        """Return the poses if people react to a failure at the first row.

        Args:
            rows: Poses without a reaction, at each step.
            dt: Time step [s].
            people: One of `REACTIONS`.
            away: Position that they step away from, in W [m].
        """
        if people == "walk":
            return rows
        rows, time = rows.copy(), dt * np.arange(len(rows))
        late = np.clip(time - _REACTION, 0.0, _STOPPING)
        # People's own clock: after the reaction time its pace falls linearly to zero.
        clock = np.minimum(time, _REACTION) + late - late**2 / (2.0 * _STOPPING)
        for i, walker in enumerate(self._walkers):
            if walker.category not in PEOPLE:
                continue
            slot, quats = self._slots[i], 3 * self._count
            columns = np.r_[3 * slot : 3 * slot + 3, quats + 4 * slot : quats + 4 * slot + 4]
            rows[:, columns] = np.stack([np.interp(clock, time, axis) for axis in rows[:, columns].T], axis=1)
            if people == "aside":
                position = rows[:, 3 * slot : 3 * slot + 2]
                from_it = position[min(round(_REACTION / dt), len(rows) - 1)] - away[:2]
                aside = from_it / max(float(np.linalg.norm(from_it)), 1e-9)
                position += np.clip(_HASTE * (time - _REACTION), 0.0, _ASIDE)[:, None] * aside
        return rows


def set_entity_poses(model: mujoco.MjModel, data: mujoco.MjData, row: Float[Array, " mocap"]) -> None:
    """Set the poses of the moving entities from a row."""
    data.mocap_pos[:] = row[: 3 * model.nmocap].reshape(-1, 3)
    data.mocap_quat[:] = row[3 * model.nmocap : 7 * model.nmocap].reshape(-1, 4)


def append_entity_states(
    qpos: Float[Array, "*batch qpos"],
    qvel: Float[Array, "*batch qvel"],
    rows: Float[Array, "*batch_and_next mocap"],
    dt: float,
) -> tuple[Float[Array, "*batch positions"], Float[Array, "*batch velocities"]]:
    """Append the poses of moving entities to positions, and their linear velocities to velocities.

    Args:
        qpos: Positions in consecutive states.
        qvel: Velocities in the same states.
        rows: Poses of the moving entities in these states, and one step later.
        dt: Time step [s].
    """
    count = 3 * (rows.shape[-1] // 7)
    here, speed = rows[..., :-1, :], np.diff(rows[..., :count], axis=-2) / dt
    return np.concatenate([qpos, here], axis=-1), np.concatenate([qvel, speed], axis=-1)
