"""Which pairs of geoms MuJoCo would test for collision: its own filters, without running it.

The rules are those of MuJoCo's manual, section "Collision detection": contype and conaffinity, bodies welded together,
parent and child (unless the parent is welded to the world), excluded pairs of bodies, and explicitly listed pairs.
"""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np
from jaxtyping import Bool, Int

Array = np.ndarray


def tested_pairs(model: mujoco.MjModel, moving: Collection[int]) -> Int[Array, "pair 2"]:
    """Return every pair of geoms that MuJoCo tests with at least one geom of the bodies `moving` in it.

    The first geom of a pair is one of those; if both are, one that is not welded to the world, then the one of lower id.
    """
    n = model.ngeom
    body = np.asarray(model.geom_bodyid)
    weld = np.asarray(model.body_weldid)[body]
    tested = _affine(model) & ~_related(model, weld) & ~_excluded(model, body)
    tested[model.pair_geom1, model.pair_geom2] = tested[model.pair_geom2, model.pair_geom1] = True
    tested &= weld[:, None] != weld[None, :]
    mine = np.isin(body, list(moving))
    tested &= mine[:, None]
    # One of (a, b) and (b, a): prefer a first geom that moves.
    both = mine[:, None] & mine[None, :]
    rank = np.arange(n) + n * (weld == 0)
    tested &= ~both | (rank[:, None] < rank[None, :])
    return np.argwhere(tested)


def _affine(model: mujoco.MjModel) -> Bool[Array, "geom geom"]:
    contype, conaffinity = np.asarray(model.geom_contype), np.asarray(model.geom_conaffinity)
    one_way = (contype[:, None] & conaffinity[None, :]) != 0
    return one_way | one_way.T


def _related(model: mujoco.MjModel, weld: Int[Array, " geom"]) -> Bool[Array, "geom geom"]:
    if model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT):
        return np.zeros((len(weld), len(weld)), dtype=bool)
    parent = np.asarray(model.body_weldid)[np.asarray(model.body_parentid)[weld]]
    child_of = (weld[:, None] == parent[None, :]) & (weld[:, None] != 0) & (weld[None, :] != 0)
    return child_of | child_of.T


def _excluded(model: mujoco.MjModel, body: Int[Array, " geom"]) -> Bool[Array, "geom geom"]:
    excluded = np.zeros((model.nbody, model.nbody), dtype=bool)
    for signature in np.asarray(model.exclude_signature):
        first, second = int(signature) >> 16, int(signature) & 0xFFFF
        excluded[first, second] = excluded[second, first] = True
    return excluded[body[:, None], body[None, :]]
