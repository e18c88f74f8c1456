from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from failbench.basics.statistics import (
    Estimate,
    cluster_bootstrap,
    effective_sample_size,
    estimate_difference,
    estimate_mean,
    estimate_probability,
    estimate_ratio,
    wilson,
)
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError

_EXACT = 1e-9
"""Relative; closed forms agree up to rounding."""


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [  # Newcombe 1998, Statistics in Medicine 17:857, table I, method 3
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_agrees_with_the_published_table(hits: int, n: int, low: float, high: float) -> None:
    found = wilson(hits, n)
    assert (found.mean, found.n) == (hits / n, n)
    assert found.low == pytest.approx(low, abs=5e-5)
    assert found.high == pytest.approx(high, abs=5e-5)


@given(st.integers(0, 50), st.integers(1, 50), st.floats(0.01, 0.999))
def test_wilson_mirrors_contains_and_never_vanishes(hits: int, more: int, confidence: float) -> None:
    n = hits + more
    found, mirrored = wilson(hits, n, confidence), wilson(n - hits, n, confidence)
    assert 0.0 <= found.low <= found.mean <= found.high <= 1.0
    assert found.high > found.low
    assert found.low == pytest.approx(1.0 - mirrored.high, abs=_EXACT)
    assert (found.low == 0.0) == (hits == 0)


def test_no_observations_give_the_whole_range() -> None:
    assert math.isnan(wilson(0, 0).mean)
    assert (wilson(0, 0).low, wilson(0, 0).high) == (0.0, 1.0)
    nothing = estimate_mean([], (0.0, 7.0))
    assert math.isnan(nothing.mean)
    assert (nothing.low, nothing.high, nothing.n) == (0.0, 7.0, 0)


def test_only_zeros_are_bounded_like_the_rule_of_three() -> None:
    n = 1000
    found = estimate_mean(np.zeros(n), (0.0, 10.0))
    assert (found.mean, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(10.0 * 3.0 / n, rel=0.05)


def test_many_dense_observations_give_the_ordinary_interval() -> None:
    y = np.random.default_rng(0).normal(5.0, 1.0, 10_000)
    found = estimate_mean(y, (0.0, 10.0))
    assert found.mean == pytest.approx(y.mean(), abs=_EXACT)
    assert found.high - found.low == pytest.approx(2.0 * 1.96 * y.std() / 100.0, rel=0.05)


_VALUES = st.lists(st.floats(0.0, 10.0), min_size=1, max_size=30)


@given(_VALUES, st.floats(0.5, 0.99))
def test_intervals_stay_in_bounds_and_contain_the_mean(values: list[float], confidence: float) -> None:
    found = estimate_mean(values, (0.0, 10.0), confidence=confidence)
    slack = 1e-12
    assert -slack <= found.low <= found.mean + slack
    assert found.mean - slack <= found.high <= 10.0 + slack
    assert found.high > found.low


@given(_VALUES, st.floats(0.1, 10.0))
def test_the_scale_of_weights_does_not_matter(values: list[float], scale: float) -> None:
    even = estimate_mean(values, (0.0, 10.0))
    scaled = estimate_mean(values, (0.0, 10.0), weights=np.full(len(values), scale))
    assert scaled.mean == pytest.approx(even.mean, abs=_EXACT)
    assert (scaled.low, scaled.high) == pytest.approx((even.low, even.high), abs=_EXACT)


@given(_VALUES, st.data())
def test_a_difference_turns_round_and_of_equals_contains_zero(values: list[float], data: st.DataObject) -> None:
    others = data.draw(st.lists(st.floats(0.0, 10.0), min_size=len(values), max_size=len(values)))
    there, back = (estimate_difference(*pair, (0.0, 10.0)) for pair in ((values, others), (others, values)))
    assert there.mean == pytest.approx(-back.mean, abs=_EXACT)
    assert there.low == pytest.approx(-back.high, abs=_EXACT)
    same = estimate_difference(values, values, (0.0, 10.0))
    assert same.mean == 0.0
    assert same.low < 0.0 < same.high


def coverage(draw_estimate, truth: float, repeats: int = 400) -> float:
    return float(np.mean([e.low <= truth <= e.high for e in (draw_estimate() for _ in range(repeats))]))


_SEVERITIES, _SHARES = np.array([1.0, 2.0, 3.0, 10.0]), np.array([0.3, 0.4, 0.15, 0.15])
_LEAST_COVERAGE = 0.93
"""Nominal coverage is 0.95; with 400 repetitions, 1 run in 30 would be below this, and the seeds are fixed."""


@pytest.mark.parametrize(("p", "n"), [(0.003, 400), (0.03, 100), (0.1, 100), (0.5, 40), (0.5, 400), (0.95, 100)])
def test_coverage_of_impacts_that_are_mostly_zero(p: float, n: int) -> None:
    rng = np.random.default_rng(1)

    def impacts() -> np.ndarray:
        return (rng.random(n) < p) * rng.choice(_SEVERITIES, n, p=_SHARES)

    truth = p * float(_SEVERITIES @ _SHARES)
    assert coverage(lambda: estimate_mean(impacts(), (0.0, 10.0)), truth) >= _LEAST_COVERAGE


def test_coverage_where_the_worst_is_rarely_seen() -> None:
    rng, n, p = np.random.default_rng(2), 100, 0.1

    def impacts() -> np.ndarray:
        return (rng.random(n) < p) * np.where(rng.random(n) < 0.05, 20.0, 1.0)

    truth = p * (0.95 + 1.0)
    assert coverage(lambda: estimate_mean(impacts(), (0.0, 20.0)), truth) >= _LEAST_COVERAGE
    # Without the added pseudo-observation, most intervals miss the truth.
    assert coverage(lambda: estimate_mean(impacts(), (0.0, 0.0)), truth) < 0.7


@pytest.mark.parametrize(("p", "n"), [(0.02, 200), (0.5, 50)])
def test_coverage_of_paired_differences(p: float, n: int) -> None:
    rng = np.random.default_rng(3)

    def difference() -> Estimate:
        impact = (rng.random(n) < p) * rng.choice(_SEVERITIES, n, p=_SHARES)
        return estimate_difference(impact, impact * (rng.random(n) < 0.5), (0.0, 10.0))

    assert coverage(difference, 0.5 * p * float(_SEVERITIES @ _SHARES)) >= _LEAST_COVERAGE


def test_coverage_of_weighted_probabilities() -> None:
    rng, n = np.random.default_rng(4), 100

    def probability() -> Estimate:
        risky = rng.random(n) < 0.8  # oversampled: drawn with 0.8 instead of 0.5
        hits = rng.random(n) < np.where(risky, 0.4, 0.02)
        return estimate_probability(hits, weights=np.where(risky, 0.5 / 0.8, 0.5 / 0.2))

    assert coverage(probability, 0.5 * 0.4 + 0.5 * 0.02) >= _LEAST_COVERAGE


def test_even_weights_give_wilsons_interval() -> None:
    hits = [True, False, False, True, False]
    assert estimate_probability(hits, weights=[2.0] * 5) == estimate_probability(hits) == wilson(2, 5)


def test_effective_sample_size() -> None:
    assert effective_sample_size(np.full(7, 0.3)) == pytest.approx(7.0)
    assert effective_sample_size([1.0, 0.0, 0.0]) == 1.0
    assert effective_sample_size([]) == 0.0


@given(st.integers(1, 6), st.integers(1, 5))
def test_copies_within_a_cluster_tell_nothing_new(clusters: int, copies: int) -> None:
    y = np.random.default_rng(clusters).normal(size=clusters)
    single = cluster_bootstrap(y, np.arange(clusters), resamples=50)
    copied = cluster_bootstrap(np.repeat(y, copies), np.repeat(np.arange(clusters), copies), resamples=50)
    assert copied.n == single.n == clusters
    assert (copied.mean, copied.low, copied.high) == pytest.approx((single.mean, single.low, single.high))


def test_cluster_bootstrap_of_independent_values_agrees_with_the_t_interval() -> None:
    y = np.random.default_rng(5).normal(size=400)
    found, t = cluster_bootstrap(y, np.arange(400), resamples=2000), estimate_mean(y, (-1.0, 1.0))
    assert found.high - found.low == pytest.approx(t.high - t.low, rel=0.1)


def test_cluster_bootstrap_takes_any_statistic() -> None:
    pairs = np.column_stack([np.arange(30.0), np.arange(30.0) ** 3])

    def rank_agreement(rows: np.ndarray) -> float:
        return float(np.mean(np.sign(np.diff(rows[:, 0])) == np.sign(np.diff(rows[:, 1]))))

    assert cluster_bootstrap(pairs, np.arange(30), rank_agreement, resamples=20).low == 1.0


def test_misuse_is_refused() -> None:
    with pytest.raises(SettingError, match=r"hits = 3.*n = 2"):
        wilson(3, 2)
    with pytest.raises(SettingError, match=r"confidence = 95\.0"):
        estimate_mean([1.0], (0.0, 1.0), confidence=95.0)
    with pytest.raises(SettingError, match=r"weights = -1\.0"):
        estimate_mean([1.0, 2.0], (0.0, 2.0), weights=[1.0, -1.0])
    with pytest.raises(ShapeError, match=r"weights.*\(1,\)"):
        estimate_mean([1.0, 2.0], (0.0, 2.0), weights=[1.0])
    with pytest.raises(ShapeError, match=r"second.*\(1,\).*\(2,\)"):
        estimate_difference([1.0, 2.0], [1.0], (0.0, 2.0))
    with pytest.raises(NonFiniteError, match=r"values.*finite"):
        estimate_mean([0.0, math.nan], (0.0, 1.0))
    with pytest.raises(SettingError, match="bounds"):
        estimate_mean([0.0], (1.0, 0.0))
    with pytest.raises(ShapeError, match="clusters"):
        cluster_bootstrap([], [])


# --- ratios -----------------------------------------------------------------------------------------------------------


@given(_VALUES, st.data())
def test_a_ratio_turns_round_and_holds_its_point(values: list[float], data: st.DataObject) -> None:
    others = data.draw(st.lists(st.floats(0.0, 10.0), min_size=len(values), max_size=len(values)))
    there, back = (estimate_ratio(*pair, (0.0, 10.0)) for pair in ((values, others), (others, values)))
    if sum(values) == 0.0 and sum(others) == 0.0:
        assert math.isnan(there.mean) and (there.low, there.high) == (0.0, math.inf)
        return
    assert 0.0 <= there.low <= there.mean <= there.high
    assert there.low < there.high
    assert there.mean == (math.inf if back.mean == 0.0 else pytest.approx(1.0 / back.mean, rel=_EXACT))
    assert there.low == pytest.approx(0.0 if math.isinf(back.high) else 1.0 / back.high, rel=_EXACT)


@given(st.lists(st.floats(0.01, 10.0), min_size=2, max_size=30), st.floats(0.1, 10.0))
def test_a_ratio_of_proportional_pairs_is_their_factor(values: list[float], factor: float) -> None:
    found = estimate_ratio(factor * np.array(values), values, (0.0, 10.0))
    assert found.mean == pytest.approx(factor, rel=_EXACT)
    assert found.low < factor < found.high


def test_a_ratio_to_nothing_is_infinite_but_its_lower_end_is_not() -> None:
    found = estimate_ratio(np.ones(1000), np.zeros(1000), (0.0, 10.0))
    assert (found.mean, found.high) == (math.inf, math.inf)
    assert 1.0 < found.low < 1000.0 / 10.0
    assert estimate_ratio([], [], (0.0, 1.0)).n == 0


@pytest.mark.parametrize(("p", "reduced", "n"), [(0.3, 0.1, 200), (0.5, 0.2, 1000), (0.1, 0.03, 400)])
def test_coverage_of_a_ratio_of_impacts_that_are_mostly_zero(p: float, reduced: float, n: int) -> None:
    rng = np.random.default_rng(2)

    def pairs() -> tuple[np.ndarray, np.ndarray]:
        u, severity = rng.random(n), rng.choice(_SEVERITIES, n, p=_SHARES)
        return (u < p) * severity, (u < reduced) * severity

    found = coverage(lambda: estimate_ratio(*pairs(), (0.0, 10.0)), p / reduced)
    assert found >= _LEAST_COVERAGE


def test_certain_amounts_are_added_to_both_sides_of_a_ratio() -> None:
    a, b = np.array([0.0, 4.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0, 3.0])
    plain, none = (estimate_ratio(a, b, (0.0, 5.0), **x) for x in ({}, {"certain": (0.0, 0.0)}))
    assert plain == none
    found = estimate_ratio(a, b, (0.0, 5.0), certain=(10.0, 100.0))
    assert found.mean == pytest.approx(11.5 / 101.0)
    shifted = estimate_ratio(a + 10.0, b + 100.0, (0.0, 105.0))
    assert shifted.mean == pytest.approx(found.mean)
    assert shifted.low < found.low < found.mean < found.high < shifted.high  # known constants do not widen it
    sure = estimate_ratio(1e-6 * a, 1e-6 * b, (0.0, 5e-6), certain=(8.0, 4.0))
    assert (sure.low, sure.high) == pytest.approx((2.0, 2.0), rel=1e-5)
    with pytest.raises(SettingError, match="certain"):
        estimate_ratio(a, b, (0.0, 5.0), certain=(-1.0, 0.0))


def test_a_known_amount_shifts_an_estimate() -> None:
    found = estimate_mean([0.0, 1.0, 5.0], (0.0, 5.0))
    moved = found.shifted(2.0)
    assert (moved.mean, moved.low, moved.high, moved.n) == (found.mean + 2.0, found.low + 2.0, found.high + 2.0, 3)
    assert found.shifted(0.0) == found
    with pytest.raises(SettingError, match="by = inf"):
        found.shifted(float("inf"))


def test_invalid_ratios_are_refused() -> None:
    with pytest.raises(ShapeError, match="pairs"):
        estimate_ratio([1.0], [1.0, 2.0], (0.0, 1.0))
    with pytest.raises(SettingError, match=">= 0"):
        estimate_ratio([-1.0], [1.0], (0.0, 1.0))
    with pytest.raises(SettingError, match=r"factor = -1\.0"):
        wilson(1, 2).scaled(-1.0)


@given(_VALUES, st.floats(0.0, 100.0))
def test_scaling_an_estimate_scales_all_of_it(values: list[float], factor: float) -> None:
    found = estimate_mean(values, (0.0, 10.0))
    scaled = found.scaled(factor)
    assert (scaled.mean, scaled.low, scaled.high) == (factor * found.mean, factor * found.low, factor * found.high)
    assert scaled.n == found.n
