"""Fit the margins of the body model to failures, by maximum likelihood.

How an arm moves when it fails is physics and is not fitted; how sure that is, is: an offset and a spread for each
generator and row. Where it is not known which joint has failed, each may have: the likelihood is of the mean.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from failbench.skill import SMALLEST
from graceful_plan import SettingError, StateBatch
from graceful_plan.array_types import Bool, Float
from graceful_plan.costs.interactions.body import BodyModel, chance
from graceful_plan.costs.interactions.body_constants import GENERATORS, BodySettings, Margin
from graceful_plan.exceptions import ShapeError

Array = np.ndarray

REACH = 0.35
"""Distance [m] up to which distances are computed for a fit."""
_PRIOR = (-0.03, 0.03)
"""Offset and spread [m] that the search begins with."""
_STEPS = (0.04, 0.8)
"""First steps of the search: of the offset [m], and of the logarithm of the spread."""
_FINEST = 1e-3
"""Share of the first steps at which it ends."""


def wide(settings: BodySettings) -> BodySettings:
    """Return settings whose margins do not cut any distance below `REACH`."""
    margin = Margin(offset=0.0, spread=REACH / 12.0)
    return replace(settings, **{g: replace(getattr(settings, g), body=margin, carried=margin) for g in GENERATORS})


def fit_distances(
    settings: BodySettings, batch: StateBatch, ahead: Float[Array, "n step nq"] | None = None
) -> Float[Array, "n mode row entity"]:
    """Return the distances of all ways to fail, up to `REACH`, that margins are fitted to."""
    return BodyModel(wide(settings)).distances(batch, ahead)


def fit_margin(d: Float[Array, "event way"], hit: Bool[Array, " n"]) -> Margin:
    """Return the margin under which what happened was likeliest.

    Args:
        d: Distance for each event and way in which it may have come about, all equally likely: one column if it is
            known which joint failed.
        hit: Whether it happened.

    Raises:
        ShapeError: If there is not one row for each event.
        SettingError: If nothing happened, or everything.
    """
    if d.ndim != 2 or len(d) != len(hit):
        raise ShapeError("d", d.shape, f"({len(hit)}, way)")
    if not 0 < hit.sum() < len(hit):
        raise SettingError("hit", int(hit.sum()), "some that happened and some that did not")

    def surprise(point: Float[Array, " 2"]) -> float:
        p = np.clip(
            predicted(d, Margin(offset=float(point[0]), spread=float(np.exp(point[1])))), SMALLEST, 1 - SMALLEST
        )
        return float(-np.log(np.where(hit, p, 1.0 - p)).sum())

    here, share = np.array([_PRIOR[0], np.log(_PRIOR[1])]), 1.0
    least = surprise(here)
    directions = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]]) * _STEPS
    while share > _FINEST:
        around = here + share * directions
        values = [surprise(point) for point in around]
        if min(values) < least:
            least, here = min(values), around[int(np.argmin(values))]
        else:
            share *= 0.5
    return Margin(offset=float(here[0]), spread=float(np.exp(here[1])))


def predicted(d: Float[Array, "event way"], margin: Margin) -> Float[Array, " event"]:
    """Return P of each event under a margin: the mean over the ways in which it may come about."""
    offset, spread = (np.full((d.shape[1], 1), value) for value in (margin.offset, margin.spread))
    return chance(d[:, :, None, None], offset, spread)[:, :, 0, 0].mean(axis=1)
