"""Probability that contents leave a container in a protective stop of the robot: part of the spill model, in NumPy.

The native kernel has the same and the entities that they reach; `graceful_plan.costs.models.spill` specifies both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.functions import GRAVITY
from graceful_plan.costs.models.drop.release import release
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.spill.constants import StopSettings
from graceful_plan.costs.models.spill.tables import SpillTables, spill_tables

_LEAST_FELT = 1e-4
_SCALE = np.sqrt(3.0) / np.pi
"""Scale of a logistic distribution with standard deviation 1."""


class StopSpill(NamedTuple):
    """Effect of a stop on the contents.

    | field  | meaning                                                      | unit | shape |
    |--------|--------------------------------------------------------------|------|-------|
    | chance | P that a noticeable part of the contents gets out            |      | n     |
    | lost   | share of the contents that gets out                          |      | n     |
    | time   | stopping time of the robot                                   | s    | n     |
    """

    chance: Float[Array, " n"]
    lost: Float[Array, " n"]
    time: Float[Array, " n"]


def stop_spill(batch: StateBatch, settings: StopSettings | None = None) -> StopSpill:
    """Compute the effect of a stop in each state on the contents of the carried object.

    Args:
        batch: The states, with their velocities, in a scene with a carried object that has contents.
        settings: Constants of the protective stop; the shipped ones by default.
    """
    settings = StopSettings.shipped() if settings is None else settings
    spill, tables = spill_tables(batch.scene), drop_tables(batch.scene)
    state, R = release(batch, tables), batch.link_poses[:, tables.link, :3, :3]
    velocity, axis = state.v + np.cross(state.w, R @ spill.mouth), R @ spill.axis
    time = (np.abs(batch.qd) / (settings.deceleration * batch.scene.limits.acceleration)).max(axis=1)
    felt = -settings.amplification * velocity / np.hypot(time, settings.response)[:, None]
    felt[:, 2] += GRAVITY
    cosine = (axis * felt).sum(axis=1) / np.sqrt((felt**2).sum(axis=1) + _LEAST_FELT)
    before = _fill(spill, axis[:, 2] * GRAVITY / np.sqrt(GRAVITY**2 + _LEAST_FELT))
    braked = _fill(spill, cosine)
    chance = 1.0 - _stays(braked, settings) / _stays(before, settings)
    return StopSpill(np.maximum(chance, 0.0), np.maximum(_kept(before) - _kept(braked), 0.0), time)


def _fill(spill: SpillTables, cosine: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the ratio of contents to capacity, for this cosine between container axis and apparent gravity."""
    up = 0.5 * (cosine + np.sqrt(cosine**2 + 0.01))
    x = np.maximum(np.sqrt(1.0051 - up**2) / up - spill.repose, 0.0) * spill.rim / spill.depth
    return (1.0 + x + x**2 + 1.7 * x**3) / spill.full


def _kept(fill: Float[Array, " n"]) -> Float[Array, " n"]:
    return (1.0 + fill**4) ** -0.25


def _stays(fill: Float[Array, " n"], settings: StopSettings) -> Float[Array, " n"]:
    return 1.0 / (1.0 + np.exp(np.minimum(np.log(fill) / (_SCALE * settings.spread), 60.0)))
