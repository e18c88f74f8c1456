"""Paired statistics of planners: wins, cost ratios and significance.

The unit is a problem, represented by the median over its seeds, because seeds of one problem say little about other
problems. An unsolved problem has infinite cost. A problem that neither planner solves is a tie and is left out of the
ratios.

References:
    [Wilcoxon1945] Individual comparisons by ranking methods.
    [Holm1979] A simple sequentially rejective multiple test procedure.
    [Demsar2006] Statistical comparisons of classifiers over multiple data sets: problems as the unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Float
from graceful_plan.exceptions import SettingError, ShapeError

Array = np.ndarray

TIE = 1e-3
"""Relative difference below which two costs are a tie."""
EXACT = 200
"""Number of differences up to which the rank test is exact."""
RESAMPLES = 2000
CONFIDENCE = 0.95
_FAR = 1e6
"""Substitute for an infinite log ratio if only ranks count."""


@dataclass(frozen=True, kw_only=True)
class Paired:
    """Comparison of two planners on the same problems.

    Args:
        first: Label of the reference.
        second: Label of the other planner.
        wins: Number of problems on which the second costs less.
        ties: Number of problems with a difference below `TIE`, or that neither solves.
        losses: Number of problems on which the second costs more.
        ratio: Median of the cost of the second over that of the first; NaN if no problem is solved by either.
        low: Lower end of the bootstrap interval of that median.
        high: Upper end.
        p: Two-sided p-value of Wilcoxon's signed-rank test on the logarithms of the ratios.
        p_holm: p, corrected for all compared pairs.
        n: Number of problems that at least one of the two solves.
    """

    first: str
    second: str
    wins: int
    ties: int
    losses: int
    ratio: float
    low: float
    high: float
    p: float
    p_holm: float = math.nan
    n: int


def compare_pair(first: str, second: str, a: ArrayLike, b: ArrayLike, *, seed: int = 0) -> Paired:
    """Compare costs of two planners by problem.

    Args:
        first: Label of the first planner.
        second: Label of the second.
        a: Costs of the first by problem, >= 0; infinite if unsolved.
        b: Costs of the second on the same problems.
        seed: Seed of the bootstrap.

    Raises:
        ShapeError: If the numbers of costs differ.
        SettingError: If a cost is negative or NaN.
    """
    costs = [_costs(name, x) for name, x in (("a", a), ("b", b))]
    if costs[0].shape != costs[1].shape:
        raise ShapeError("b", costs[1].shape, f"{costs[0].shape}: pairs")
    solved = np.isfinite(costs[0]) | np.isfinite(costs[1])
    log = _log_ratio(costs[0][solved], costs[1][solved])
    low, high = _interval(log, seed)
    wins, losses = int(np.sum(log < -math.log1p(TIE))), int(np.sum(log > math.log1p(TIE)))
    return Paired(
        first=first,
        second=second,
        wins=wins,
        ties=len(solved) - wins - losses,
        losses=losses,
        ratio=_ratio(_median(log[None])[0]) if len(log) else math.nan,
        low=_ratio(low),
        high=_ratio(high),
        p=signed_rank(log),
        n=len(log),
    )


def compare_all(labels: Sequence[str], costs: Float[Array, "planner problem"], *, seed: int = 0) -> tuple[Paired, ...]:
    """Compare every pair of planners, pairs with the first one first, with Holm's correction for all of them.

    Args:
        labels: Labels of the planners, the reference first.
        costs: Costs by planner and problem; infinite if unsolved.
        seed: Seed of the bootstrap.
    """
    pairs = [
        compare_pair(labels[i], labels[j], costs[i], costs[j], seed=seed)
        for i in range(len(labels))
        for j in range(i + 1, len(labels))
    ]
    corrected = holm([pair.p for pair in pairs])
    return tuple(replace(pair, p_holm=p) for pair, p in zip(pairs, corrected, strict=True))


def signed_rank(log_ratio: ArrayLike) -> float:
    """Compute the two-sided p-value of Wilcoxon's signed-rank test; 1 if all differences are 0.

    The test is exact up to `EXACT` differences, also with tied ranks, which unsolved problems cause: for few problems
    the normal approximation is then too optimistic. Zeros are dropped.
    """
    difference = np.clip(np.asarray(log_ratio, dtype=float), -_FAR, _FAR)
    difference = difference[difference != 0.0]
    if not len(difference):
        return 1.0
    if len(difference) <= EXACT:
        return _exact_signed_rank(difference)
    from scipy.stats import wilcoxon

    result: Any = wilcoxon(difference, method="asymptotic", correction=True)
    return float(result.pvalue)


def _exact_signed_rank(difference: Float[Array, " n"]) -> float:
    """Compute the share of all assignments of signs to these ranks that are at least as extreme."""
    _, place, count = np.unique(np.abs(difference), return_inverse=True, return_counts=True)
    # Twice the mean rank of each group of ties, an integer.
    doubled = (2 * np.cumsum(count) - count + 1)[place]
    probability = np.zeros(int(doubled.sum()) + 1)
    probability[0] = 1.0
    for rank in doubled.tolist():
        with_it = np.zeros_like(probability)
        with_it[rank:] = probability[: len(probability) - rank]
        probability = 0.5 * (probability + with_it)
    observed = int(doubled[difference > 0.0].sum())
    tails = probability[: observed + 1].sum(), probability[observed:].sum()
    return min(1.0, 2.0 * float(min(tails)))


def holm(p: Sequence[float]) -> list[float]:
    """Correct p-values for multiple tests by Holm's step-down method."""
    order = np.argsort(p, kind="stable")
    corrected, least = [1.0] * len(p), 0.0
    for rank, i in enumerate(order.tolist()):
        least = max(least, min(1.0, (len(p) - rank) * p[i]))
        corrected[i] = least
    return corrected


def _costs(name: str, values: ArrayLike) -> Float[Array, " n"]:
    costs = np.asarray(values, dtype=float)
    if costs.ndim != 1:
        raise ShapeError(name, costs.shape, "one cost for each problem")
    if np.isnan(costs).any() or (costs < 0.0).any():
        raise SettingError(name, costs.tolist(), "costs >= 0; infinite where not solved")
    return costs


def _log_ratio(a: Float[Array, " n"], b: Float[Array, " n"]) -> Float[Array, " n"]:
    """Compute the logarithm of b / a: 0 if both are equal, infinite if one of them is 0 or infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(a == b, 0.0, np.log(b) - np.log(a))


def _interval(log: Float[Array, " n"], seed: int) -> tuple[float, float]:
    """Compute the bootstrap percentile interval of the median over problems."""
    if not len(log):
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    medians = np.sort(_median(log[rng.integers(len(log), size=(RESAMPLES, len(log)))]))
    tail = 0.5 * (1.0 - CONFIDENCE)
    return float(medians[int(tail * RESAMPLES)]), float(medians[RESAMPLES - 1 - int(tail * RESAMPLES)])


def _median(values: Float[Array, "n m"]) -> Float[Array, " n"]:
    """Compute medians of rows as the mean of two middle values; 0 for opposite infinities."""
    ordered = np.sort(values, axis=1)
    m = ordered.shape[1]
    below, above = ordered[:, (m - 1) // 2], ordered[:, m // 2]
    with np.errstate(invalid="ignore"):
        return np.where(np.isnan(below + above), 0.0, 0.5 * (below + above))


def _ratio(log: float) -> float:
    # Infinite logarithms are valid here.
    return math.inf if log > 700.0 else math.exp(log)
