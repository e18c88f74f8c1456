"""Fit one margin of the body model, an offset and a spread, to observed hits and their predicted distances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from failbench.basics.statistics import cluster_draws
from failbench.calibrations.fitting import Fitted
from failbench.calibrations.skill import SMALLEST, Figures, figures
from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.costs.models.body.body import chance
from graceful_plan.costs.models.body.constants import Margin
from graceful_plan.exceptions import SettingError, ShapeError

REACH = 0.35
"""Distance [m] up to which distances are computed for a fit."""
_PRIOR = Margin(offset=-0.03, spread=0.03)
"""Start of the search."""
_STEPS = (0.04, 0.8)
"""First steps of the search: of the offset [m], and of the logarithm of the spread."""
_FINEST = 1e-3
"""Fraction of the first steps at which the search ends."""
_CONFIDENCE = 0.95


class MarginEvents(NamedTuple):
    """Data for one generator and row: pairs of a failure and an entity."""

    d: Float[Array, " n"]
    """Predicted distance [m], at most `REACH`."""
    hit: Bool[Array, " n"]
    motion: Array
    """Index of the motion."""
    scene: Array
    """Name of the scene."""


def fit_margin(
    d: Float[Array, "event way"],
    hit: Bool[Array, " n"],
    weight: Float[Array, " n"] | None = None,
    start: Margin = _PRIOR,
) -> Margin:
    """Return the margin with the greatest likelihood.

    Args:
        d: Distance for each event and possible cause, all causes equally likely; one column if the failing joint is
            known.
        hit: Whether each event is a hit.
        weight: Weight of each event; 1 if None.
        start: Start of the search.

    Raises:
        ShapeError: If the numbers of rows and events differ.
        SettingError: If all events are hits, or none is.
    """
    if d.ndim != 2 or len(d) != len(hit):
        raise ShapeError("d", d.shape, f"({len(hit)}, way)")
    if not 0 < hit.sum() < len(hit):
        raise SettingError("hit", int(hit.sum()), "at least one hit and one miss")
    w = np.ones(len(hit)) if weight is None else weight

    def surprise(point: Float[Array, " 2"]) -> float:
        p = np.clip(predicted(d, _margin(point)), SMALLEST, 1 - SMALLEST)
        return float(-np.log(np.where(hit, p, 1.0 - p)) @ w)

    here, share = np.array([start.offset, np.log(start.spread)]), 1.0
    least = surprise(here)
    directions = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]]) * _STEPS
    while share > _FINEST:
        around = here + share * directions
        values = [surprise(point) for point in around]
        if min(values) < least:
            least, here = min(values), around[int(np.argmin(values))]
        else:
            share *= 0.5
    return _margin(here)


def predicted(d: Float[Array, "event way"], margin: Margin) -> Float[Array, " event"]:
    """Return the probability of each event under a margin: the mean over its possible causes."""
    offset, spread = (np.full((d.shape[1], 1), value) for value in (margin.offset, margin.spread))
    return chance(d[:, :, None, None], offset, spread)[:, :, 0, 0].mean(axis=1)


def _margin(point: Float[Array, " 2"]) -> Margin:
    return Margin(offset=float(point[0]), spread=float(np.exp(point[1])))


@dataclass(frozen=True, kw_only=True)
class FittedMargin:
    """A fitted margin, and its quality.

    Args:
        offset: Offset with its interval [m].
        spread: Spread with its interval [m].
        fitted: Figures on the data of the fit.
        held_out: Figures over all scenes, each predicted with a margin fitted on the others; None with one scene.
    """

    offset: Fitted
    spread: Fitted
    fitted: Figures
    held_out: Figures | None

    @property
    def margin(self) -> Margin:
        """The margin in the model's format."""
        return Margin(offset=self.offset.value, spread=self.spread.value)


def fit_touches(events: MarginEvents, *, resamples: int = 100, seed: int = 0) -> FittedMargin:
    """Fit one margin; intervals resample whole motions with replacement."""
    best = fit_margin(events.d[:, None], events.hit)
    near = events.d < REACH  # farther events do not affect the fit
    d, hit = events.d[near, None], events.hit[near]
    drawn = []
    for rows in cluster_draws(events.motion, resamples, seed):
        counts = np.bincount(rows, minlength=len(near))[near].astype(float)
        found = fit_margin(d, hit, counts, best)
        drawn.append((found.offset, found.spread))
    ends = (0.5 - 0.5 * _CONFIDENCE, 0.5 + 0.5 * _CONFIDENCE)
    low, high = np.quantile(drawn, ends, axis=0) if resamples else np.full((2, 2), np.nan)
    return FittedMargin(
        offset=Fitted(best.offset, float(low[0]), float(high[0])),
        spread=Fitted(best.spread, float(low[1]), float(high[1])),
        fitted=figures(predicted(events.d[:, None], best), events.hit),
        held_out=_held_out(events),
    )


def _held_out(events: MarginEvents) -> Figures | None:
    names = np.unique(events.scene)
    guessed = np.zeros(len(events.d))
    for name in names:
        own = events.scene == name
        if len(names) < 2 or not 0 < events.hit[~own].sum() < (~own).sum():
            return None
        margin = fit_margin(events.d[~own, None], events.hit[~own])
        guessed[own] = predicted(events.d[own, None], margin)
    return figures(guessed, events.hit)
