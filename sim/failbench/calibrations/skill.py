"""Quality of predicted probabilities: scores, calibration, and their uncertainty.

Scores are the Brier score, the logarithmic loss, the area under the ROC curve, the calibration error and the
reliability curve. Events of one motion are correlated, so intervals resample whole motions.

References:
    [Brier1950] Verification of forecasts expressed in terms of probability.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from failbench.basics.statistics import Estimate, check_confidence, cluster_bootstrap
from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import finite_array

SMALLEST = 1e-4
"""Probabilities are clamped to this distance from 0 and 1 in the logarithmic loss, which is infinite there."""


class Reliability(NamedTuple):
    """A reliability curve: bins of events in the order of their predicted probability."""

    predicted: Float[Array, " bin"]
    """Mean prediction of each bin."""
    observed: Float[Array, " bin"]
    """Observed frequency in each bin."""
    low: Float[Array, " bin"]
    """Lower end of the band."""
    high: Float[Array, " bin"]
    """Upper end of the band."""
    events: Int[Array, " bin"]
    """Number of events in each bin."""


class Figures(NamedTuple):
    """Summary of the quality of predicted probabilities."""

    events: int
    """Number of events."""
    happened: int
    """Number of events that happened."""
    brier_skill: float
    """Brier skill relative to the base rate."""
    auc: float
    """Area under the ROC curve."""
    calibration_error: float
    """Expected calibration error, by bins of equal counts."""
    ratio: float
    """Predicted over observed number of events."""
    log_loss: float
    """Mean logarithmic loss [nat]."""


def figures(predicted: ArrayLike, happened: ArrayLike, bins: int = 10) -> Figures:
    """Compute all figures of predicted probabilities."""
    p, y = _events(predicted, happened)
    return Figures(
        events=len(y),
        happened=int(y.sum()),
        brier_skill=brier_skill(p, y),
        auc=auc(p, y),
        calibration_error=calibration_error(p, y, bins),
        ratio=predicted_ratio(p, y),
        log_loss=log_loss(p, y),
    )


def brier_skill(predicted: ArrayLike, happened: ArrayLike) -> float:
    """Return 1 - (Brier score) / (that of the base rate): 1 is perfect, 0 is as good as the base rate.

    NaN if all events happened, or none.
    """
    p, y = _events(predicted, happened)
    base = y.mean()
    return float(1.0 - np.mean((p - y) ** 2) / (base * (1.0 - base))) if 0.0 < base < 1.0 else math.nan


def log_loss(predicted: ArrayLike, happened: ArrayLike) -> float:
    """Return the mean negative logarithm of the probability predicted for the outcome [nat]; see `SMALLEST`."""
    p, y = _events(predicted, happened)
    p = np.clip(p, SMALLEST, 1.0 - SMALLEST)
    return float(-np.mean(np.where(y > 0.0, np.log(p), np.log1p(-p))))


def auc(predicted: ArrayLike, happened: ArrayLike) -> float:
    """Return the probability that a random hit has a higher prediction than a random miss; ties count half.

    NaN if all events happened, or none.
    """
    from scipy.stats import rankdata

    p, y = _events(predicted, happened)
    hits = int(np.count_nonzero(y))
    misses = len(y) - hits
    if hits == 0 or misses == 0:
        return math.nan
    return float((rankdata(p)[y > 0.0].sum() - 0.5 * hits * (hits + 1)) / (hits * misses))


def calibration_error(predicted: ArrayLike, happened: ArrayLike, bins: int = 10) -> float:
    """Return the mean distance of predicted probability and observed frequency, by bins of equal counts (ECE)."""
    p, y = _events(predicted, happened)
    return float(sum(len(m) * abs(p[m].mean() - y[m].mean()) for m in _bins(p, bins)) / len(p))


def predicted_ratio(predicted: ArrayLike, happened: ArrayLike) -> float:
    """Return the predicted over the observed number of events; NaN if none happened."""
    p, y = _events(predicted, happened)
    return float(p.sum() / y.sum()) if y.any() else math.nan


def reliability(
    predicted: ArrayLike,
    happened: ArrayLike,
    clusters: ArrayLike,
    *,
    bins: int = 10,
    by_hits: bool = False,
    resamples: int = 1000,
    seed: int = 0,
    confidence: float = 0.95,
) -> Reliability:
    """Compute the reliability curve with bootstrap bands.

    Args:
        predicted: Probabilities.
        happened: Outcomes.
        clusters: Index of each event's motion; whole motions are drawn with replacement.
        bins: Number of bins.
        by_hits: Whether bins have equal numbers of predicted hits instead of equal numbers of events. Most events are
            nearly impossible, so bins of equal counts resolve the other events poorly.
        resamples: Number of resamples.
        seed: Seed of the resamples.
        confidence: Confidence level of each bin's band.
    """
    check_confidence(confidence)
    p, y = _events(predicted, happened)
    members = _clusters(clusters, len(p))
    parts = _bins_of_hits(p, bins) if by_hits else _bins(p, bins)
    shape = (len(parts), int(members.max()) + 1)
    hits, counts = np.zeros(shape), np.zeros(shape)
    for i, part in enumerate(parts):
        hits[i] = np.bincount(members[part], weights=y[part], minlength=shape[1])
        counts[i] = np.bincount(members[part], minlength=shape[1])
    # Number of draws of each cluster; a bin without any drawn cluster is NaN in that resample.
    drawn = np.random.default_rng(seed).multinomial(shape[1], np.full(shape[1], 1.0 / shape[1]), size=resamples)
    totals = counts @ drawn.T
    rates = np.divide(hits @ drawn.T, totals, out=np.full(totals.shape, np.nan), where=totals > 0.0)
    low, high = np.nanquantile(rates, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], axis=1)
    observed = hits.sum(axis=1) / counts.sum(axis=1)
    return Reliability(np.array([p[m].mean() for m in parts]), observed, low, high, counts.sum(axis=1).astype(int))


def bootstrap(
    statistic: Callable[[Array, Array], float],
    predicted: ArrayLike,
    observed: ArrayLike,
    clusters: ArrayLike | None = None,
    *,
    resamples: int = 1000,
    seed: int = 0,
    confidence: float = 0.95,
) -> Estimate:
    """Estimate any of these figures with its percentile interval.

    Args:
        statistic: Function of (predicted, observed).
        predicted: Predictions.
        observed: Outcomes.
        clusters: Index of each pair's motion, to resample whole motions; None to resample pairs.
        resamples: Number of resamples. Those with a NaN figure are left out.
        seed: Seed of the resamples.
        confidence: Probability that the interval covers the true value.
    """
    a, b = np.asarray(predicted, dtype=float), np.asarray(observed, dtype=float)
    _check_pairs(a, b)
    return cluster_bootstrap(
        np.column_stack([a, b]),
        np.arange(len(a)) if clusters is None else clusters,
        lambda pairs: statistic(pairs[:, 0], pairs[:, 1]),
        resamples=resamples,
        seed=seed,
        confidence=confidence,
    )


def _bins(p: Float[Array, " n"], bins: int) -> list[Int[Array, " member"]]:
    if not 1 <= bins <= len(p):
        raise SettingError("bins", bins, f"between 1 and the number of events, {len(p)}")
    return np.array_split(np.argsort(p, kind="stable"), bins)


def _bins_of_hits(p: Float[Array, " n"], bins: int) -> list[Int[Array, " member"]]:
    order = np.argsort(p, kind="stable")
    reached = np.cumsum(p[order])
    cuts = np.searchsorted(reached, reached[-1] * np.arange(1, bins) / bins)
    cuts = np.searchsorted(p[order], p[order[cuts]])  # equal predictions stay together
    return [part for part in np.split(order, cuts) if len(part)]


def _events(predicted: ArrayLike, happened: ArrayLike) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    p, y = finite_array("predicted", predicted, ndim=1), finite_array("happened", happened, ndim=1)
    _check_pairs(p, y)
    if not len(p):
        raise ShapeError("predicted", p.shape, "at least one event")
    for name, values, wrong in (("predicted", p, (p < 0.0) | (p > 1.0)), ("happened", y, (y != 0.0) & (y != 1.0))):
        if wrong.any():
            valid = "probabilities in [0, 1]" if name == "predicted" else "true or false"
            raise SettingError(name, float(values[wrong][0]), valid)
    return p, y


def _check_pairs(a: Array, b: Array) -> None:
    if a.ndim != 1 or a.shape != b.shape:
        raise ShapeError("observed", b.shape, f"{a.shape}, one for each prediction")


def _clusters(clusters: ArrayLike, n: int) -> Int[Array, " n"]:
    labels = np.asarray(clusters)
    if labels.shape != (n,):
        raise ShapeError("clusters", labels.shape, f"({n},), one for each event")
    return np.unique(labels, return_inverse=True)[1]
