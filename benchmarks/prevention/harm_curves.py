"""Comparison of planners: harm at equal duration or equal motion, and averages of ratios over tasks.

Costs have different units, and so have their weights. Each planner gives a curve of harm over duration, and `harm_at`
reads that curve at a given duration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from failbench import Estimate
from failbench.basics.statistics import cluster_bootstrap


class Offer(NamedTuple):
    """Duration or motion, and harm, of a planner at one weight."""

    extent: float
    """Duration or motion, relative to that at w = 0."""
    harm: float
    """Harm per executed task, > 0."""


def lower_envelope(offers: Sequence[Offer]) -> list[Offer]:
    """Return the offers with less harm than all others of at most the same extent, from the shortest on."""
    found: list[Offer] = []
    for offer in sorted(offers):
        if not found or offer.harm < found[-1].harm:
            found.append(offer)
    return found


def harm_at(offers: Sequence[Offer], extent: float) -> float:
    """Interpolate the logarithm of the harm along the lower envelope at an extent.

    The curve is constant beyond the last offer of the envelope and undefined before the first.

    Args:
        offers: All offers of one planner in one task, including w = 0.
        extent: Where to read the envelope.

    Returns:
        The harm; NaN before the first offer.

    Raises:
        ValueError: If the harm of an offer is not positive.
    """
    if any(not offer.harm > 0.0 for offer in offers):
        raise ValueError("harm has to be > 0: see `floored`")
    envelope = lower_envelope(offers)
    if not envelope or extent < envelope[0].extent:
        return math.nan
    extents, harms = zip(*envelope, strict=True)
    return float(np.exp(np.interp(extent, extents, np.log(harms))))


def floored(mean: float, n: int, least: float) -> float:
    """Return the mean of n observed impacts, at least as large as if one of them had the least severity.

    Ratios need a positive harm even if none of the n failures hit anything.

    Args:
        mean: Observed impact of a failure.
        n: Number of failures.
        least: Least positive severity of the scene.
    """
    return max(mean, least / n)


class Typical(NamedTuple):
    """Typical ratio of harm over tasks."""

    median: float
    geometric: Estimate
    """Geometric mean, with an interval from resampled tasks."""


def typical(ratios: Sequence[float]) -> Typical:
    """Summarise ratios of harm, one per task, without NaN; all fields are NaN if there are none."""
    kept = np.array([ratio for ratio in ratios if not math.isnan(ratio)])
    if not len(kept):
        return Typical(math.nan, Estimate(math.nan, math.nan, math.nan, 0))
    logs = cluster_bootstrap(np.log(kept), np.arange(len(kept)))
    geometric = Estimate(math.exp(logs.mean), math.exp(logs.low), math.exp(logs.high), len(kept))
    return Typical(float(np.median(kept)), geometric)
