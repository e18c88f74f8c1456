import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from graceful_plan.compare.reports.statistics import compare_all, compare_pair, holm, signed_rank
from graceful_plan.exceptions import SettingError, ShapeError

costs = st.lists(
    st.one_of(st.floats(0.1, 10.0), st.just(math.inf)).flatmap(
        lambda a: st.tuples(st.just(a), st.one_of(st.floats(0.1, 10.0), st.just(math.inf), st.just(a)))
    ),
    min_size=1,
    max_size=12,
)


def pair(a, b):
    return compare_pair("a", "b", a, b)


def test_by_hand():
    found = pair([1.0, 2.0, 4.0, 5.0], [2.0, 4.0, 4.0, 2.5])
    assert (found.wins, found.ties, found.losses, found.n) == (1, 1, 2, 4)
    assert found.ratio == pytest.approx(math.sqrt(2.0))  # of 0.5, 1, 2, 2: between 1 and 2 on a logarithmic axis


def test_signed_rank_by_hand():
    # All six differences have one sign: 2 of the 2^6 assignments of signs are as extreme.
    assert signed_rank([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) == pytest.approx(2 / 64)
    # With five, even that is above 0.05.
    assert signed_rank([1.0, 2.0, 3.0, 4.0, 5.0]) == pytest.approx(2 / 32)


@given(st.integers(0, 2**31), st.integers(1, 30))
def test_signed_rank_equals_that_of_scipy(seed, n):
    difference = np.random.default_rng(seed).normal(0.3, 1.0, n)
    assert signed_rank(difference) == pytest.approx(stats.wilcoxon(difference, method="exact").pvalue)


@given(st.lists(st.sampled_from([-3.0, -1.0, 0.0, 1.0, 2.0, math.inf]), min_size=1, max_size=9))
def test_signed_rank_with_ties_counts_all_signs(difference):
    d = np.array([x for x in difference if x])
    ranks = stats.rankdata(np.abs(d))
    sums = np.array([ranks @ np.array(signs) for signs in itertools.product([0, 1], repeat=len(d))])
    observed = ranks[d > 0].sum()
    expected = 2.0 * min(np.mean(sums <= observed + 1e-9), np.mean(sums >= observed - 1e-9))
    assert signed_rank(difference) == pytest.approx(min(1.0, expected))


def test_five_problems_never_suffice():
    assert signed_rank([math.inf] * 5) == pytest.approx(2 / 32)
    assert signed_rank([math.inf] * 6) == pytest.approx(2 / 64)


def test_many_differences_are_normal():
    difference = np.random.default_rng(2).normal(0.1, 1.0, 201)
    expected = stats.wilcoxon(difference, method="asymptotic", correction=True).pvalue
    assert signed_rank(difference) == pytest.approx(expected)
    # The exact and the asymptotic p-value agree where the method changes.
    exact = signed_rank(difference[:200])
    assert exact == pytest.approx(stats.wilcoxon(difference[:200], method="asymptotic").pvalue, rel=0.05)


def test_no_difference_is_no_evidence():
    found = pair([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert (found.p, found.ratio, found.low, found.high, found.ties) == (1.0, 1.0, 1.0, 1.0, 3)


def test_a_run_that_one_planner_fails_is_lost_and_one_that_both_fail_is_ignored():
    found = pair([1.0, math.inf, math.inf, 1.0], [math.inf, 1.0, math.inf, 1.0])
    assert (found.wins, found.ties, found.losses, found.n) == (1, 2, 1, 3)
    assert found.ratio == 1.0
    assert (found.low, found.high) == (0.0, math.inf)
    never = pair([1.0] * 6, [math.inf] * 6)
    assert (never.losses, never.ratio, never.low, never.high) == (6, math.inf, math.inf, math.inf)
    assert never.p < 0.05
    nothing = pair([math.inf], [math.inf])
    assert (nothing.n, nothing.ties, nothing.p) == (0, 1, 1.0)
    assert math.isnan(nothing.ratio) and math.isnan(nothing.low)


def test_paths_that_cost_nothing():
    found = pair([0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    assert (found.wins, found.ties, found.losses) == (1, 1, 1)


@settings(max_examples=30, deadline=None)
@given(costs)
def test_swapped_arguments_give_the_inverse(values):
    a, b = ([pair[i] for pair in values] for i in range(2))
    there, back = pair(a, b), pair(b, a)
    assert (there.wins, there.ties, there.losses) == (back.losses, back.ties, back.wins)
    assert there.wins + there.ties + there.losses == len(values)
    assert there.p == pytest.approx(back.p)
    if there.n:
        assert there.low <= there.ratio <= there.high
        if 0.0 < there.ratio < math.inf:
            assert there.ratio * back.ratio == pytest.approx(1.0)


def test_intervals_have_the_stated_coverage():
    rng = np.random.default_rng(1)
    covered = 0
    for i in range(100):
        a = np.exp(rng.normal(0.0, 1.0, 25))
        b = a * np.exp(rng.normal(math.log(1.2), 0.3, 25))
        found = compare_pair("a", "b", a, b, seed=i)
        covered += found.low <= 1.2 <= found.high
    assert 88 <= covered <= 100


def test_holm_by_hand():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8))
def test_holm_keeps_the_order_and_never_helps(p):
    corrected = holm(p)
    assert all(a <= b <= 1.0 for a, b in zip(p, corrected, strict=True))
    assert min(corrected) == pytest.approx(min(1.0, len(p) * min(p)))
    order = np.argsort(p, kind="stable")
    assert np.all(np.diff(np.array(corrected)[order]) >= 0.0)


def test_every_pair_once_and_the_reference_first():
    values = np.array([[1.0] * 8, [1.1] * 8, [2.0] * 8]) * (1.0 + np.arange(8))
    values[1] *= 1.0 + 0.001 * np.arange(8)
    values[2] *= 1.0 + 0.003 * np.arange(8)
    found = compare_all(["a", "b", "c"], values)
    assert [(x.first, x.second) for x in found] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert [x.p for x in found] == pytest.approx([2 / 256] * 3)
    assert [x.p_holm for x in found] == pytest.approx([6 / 256] * 3)
    assert compare_all(["a"], values[:1]) == ()


def test_misuse():
    with pytest.raises(ShapeError, match="pairs"):
        pair([1.0], [1.0, 2.0])
    with pytest.raises(SettingError, match="infinite"):
        pair([math.nan], [1.0])
    with pytest.raises(SettingError, match="costs >= 0"):
        pair([1.0], [-1.0])
