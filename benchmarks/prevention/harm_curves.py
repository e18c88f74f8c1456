"""What one planner is worth beside another: harm at equal duration or equal motion, and averages of ratios over tasks.

Costs have different units, and so have their weights. What can be compared is what they are traded for: over its
weights, each planner offers some harm for some duration. `harm_at` reads that curve where it is asked to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from failbench import Estimate
from failbench.basics.statistics import cluster_bootstrap

Array = np.ndarray


class Offer(NamedTuple):
    """What a planner offers at one weight."""

    extent: float
    """Duration or motion, relative to that at w = 0."""
    harm: float
    """Of an executed task, > 0."""


def lower_envelope(offers: Sequence[Offer]) -> list[Offer]:
    """Return the offers that do less harm than every one of at most the same extent, from the shortest on."""
    found: list[Offer] = []
    for offer in sorted(offers):
        if not found or offer.harm < found[-1].harm:
            found.append(offer)
    return found


def harm_at(offers: Sequence[Offer], extent: float) -> float:
    """Interpolate the logarithm of the harm along the lower envelope at an extent.

    Beyond the last offer of the envelope more extent brings nothing; before the first there is no motion.

    Args:
        offers: Of one planner in one task, that of w = 0 among them.
        extent: Where to read the envelope.

    Returns:
        The harm; NaN before the first offer.

    Raises:
        ValueError: If an offer has no positive harm, of which there is no logarithm.
    """
    if any(not offer.harm > 0.0 for offer in offers):
        raise ValueError("harm has to be > 0: see `floored`")
    envelope = lower_envelope(offers)
    if not envelope or extent < envelope[0].extent:
        return math.nan
    extents, harms = zip(*envelope, strict=True)
    return float(np.exp(np.interp(extent, extents, np.log(harms))))


def floored(mean: float, n: int, least: float) -> float:
    """Return the mean of n observed impacts, or what it were if one of them had been the least possible one.

    Nothing hit in n failures is no proof that nothing can be hit, and there is no ratio to nothing.

    Args:
        mean: Observed impact of a failure.
        n: Number of failures.
        least: Least positive severity of the scene.
    """
    return max(mean, least / n)


class Typical(NamedTuple):
    """How many times less harm there is over some tasks."""

    median: float
    geometric: Estimate
    """Geometric mean, with the interval between percentiles of resampled tasks."""


def typical(ratios: Sequence[float]) -> Typical:
    """Summarise ratios of harm, one for each task; NaN are left out. Without any, everything is NaN."""
    kept = np.array([ratio for ratio in ratios if not math.isnan(ratio)])
    if not len(kept):
        return Typical(math.nan, Estimate(math.nan, math.nan, math.nan, 0))
    logs = cluster_bootstrap(np.log(kept), np.arange(len(kept)))
    geometric = Estimate(math.exp(logs.mean), math.exp(logs.low), math.exp(logs.high), len(kept))
    return Typical(float(np.median(kept)), geometric)
