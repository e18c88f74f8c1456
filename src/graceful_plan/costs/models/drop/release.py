"""State of the carried object when the gripper lets go."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.functions import part_reach
from graceful_plan.costs.models.drop.tables import DropTables

_UP = np.array([[0.0, 0.0, 1.0]])


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Release:
    """Pose and velocity of the object when the gripper lets go; W frame, parts in the order of the tables.

    | field  | meaning                                | unit  | shape      |
    |--------|----------------------------------------|-------|------------|
    | c      | centre of mass                         | m     | n 3        |
    | v      | its velocity                           | m/s   | n 3        |
    | w      | angular velocity                       | rad/s | n 3        |
    | offset | centre of each part from c             | m     | n part 3   |
    | axes   | axes of each part, as columns          |       | n part 3 3 |
    """

    c: Float[Array, "n 3"]
    v: Float[Array, "n 3"]
    w: Float[Array, "n 3"]
    offset: Float[Array, "n part 3"]
    axes: Float[Array, "n part 3 3"]

    def only(self, rows: Int[Array, " m"]) -> Release:
        """Return the given rows."""
        return Release(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def release(batch: StateBatch, tables: DropTables) -> Release:
    """Compute the state of the object at release for each state of a batch."""
    X, qd = batch.link_poses, batch.qd * tables.moves
    R, p = X[:, tables.link, :3, :3], X[:, tables.link, :3, 3]
    c = R @ tables.centre + p
    joints = X[:, tables.joint_link]
    axis, anchor = joints[..., :3, 2], joints[..., :3, 3]
    slide = batch.compiled.robot.slide[tables.joint_link].astype(bool)
    turning = np.where(slide, 0.0, qd)[..., None] * axis
    v = np.cross(turning, c[:, None] - anchor).sum(axis=1) + (np.where(slide, qd, 0.0)[..., None] * axis).sum(axis=1)
    return Release(
        c=c,
        v=v,
        w=turning.sum(axis=1),
        offset=np.einsum("nij,pj->npi", R, tables.part_offset),
        axes=np.einsum("nij,pjk->npik", R, tables.part_rotation),
    )


def heights(state: Release, tables: DropTables) -> tuple[Float[Array, "n part"], Float[Array, "n part"]]:
    """Return the heights in W of the lowest and of the highest point of each part [m]."""
    parts = enumerate(zip(tables.part_half, tables.part_kind, strict=True))
    reach = np.stack([part_reach(state.axes[:, p], half, int(kind), _UP)[:, 0] for p, (half, kind) in parts], axis=1)
    centre = state.c[:, None, 2] + state.offset[..., 2]
    return centre - reach, centre + reach
