"""Mixtures of causes: the true shares, the optimum, the ends of the range."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from failbench.calibrations.mixture import likely, log_likelihood, most_likely

TRUE = (0.5, 0.1, 0.0, 0.25, 0.0, 0.05)


def draw(shares, n=10_000, seed=0):
    """Draw events of causes with given probabilities."""
    rng = np.random.default_rng(seed)
    probability = rng.beta(0.2, 1.0, size=(n, len(shares)))
    cause = rng.choice(len(shares) + 1, size=n, p=[*shares, max(0.0, 1.0 - sum(shares))])
    chance = np.column_stack([probability, np.zeros(n)])[np.arange(n), cause]
    return probability, rng.random(n) < chance


def test_the_truth_is_found():
    shares, gap = most_likely(*draw(TRUE, n=40_000))
    assert gap <= 1e-4
    np.testing.assert_allclose(shares, TRUE, atol=0.03)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6))
def test_no_other_shares_are_likelier(seed, other):
    rng = np.random.default_rng(seed)
    true = rng.dirichlet(np.full(7, 0.3))[:6]
    probability, happened = draw(true / max(1.0, true.sum()), n=400, seed=seed)
    shares, gap = most_likely(probability, happened)
    assert (shares >= 0.0).all() and shares.sum() <= 1.0 + 1e-9 and gap <= 1e-4
    reached = log_likelihood(likely(probability @ shares), happened)
    for tried in (np.array(other) / max(1.0, sum(other)), true):
        assert reached >= log_likelihood(likely(probability @ tried), happened) - gap - 1e-9


def test_weights_count_like_repetitions():
    probability, happened = draw(TRUE, n=500)
    weight = np.random.default_rng(2).integers(0, 4, size=500)
    rows = np.repeat(np.arange(500), weight)
    weighted, _ = most_likely(probability, happened, weight.astype(float))
    repeated, _ = most_likely(probability[rows], happened[rows])
    np.testing.assert_allclose(weighted, repeated, atol=1e-5)


def test_the_start_does_not_matter():
    probability, happened = draw(TRUE)
    cold, _ = most_likely(probability, happened)
    for start in (np.zeros(6), np.eye(6)[2], np.array(TRUE)):
        np.testing.assert_allclose(most_likely(probability, happened, start=start)[0], cold, atol=1e-4)


def test_known_shares_are_not_fitted_again():
    probability, happened = draw(TRUE, n=40_000)
    known = 0.5 * probability[:, 0]
    rest, _ = most_likely(0.5 * probability[:, 1:], happened, offset=known)
    np.testing.assert_allclose(0.5 * rest, TRUE[1:], atol=0.03)


def test_shares_can_be_required_to_sum_to_one():
    probability, happened = draw((0.3, 0.7))
    shares, _ = most_likely(probability, happened, harmless=False)
    assert shares.sum() == pytest.approx(1.0) and shares[0] == pytest.approx(0.3, abs=0.05)


def test_ends_of_the_range():
    probability, happened = draw(TRUE, n=300)
    never, always = np.zeros(300, bool), np.ones(300, bool)
    assert most_likely(probability, never)[0].sum() == pytest.approx(0.0, abs=1e-6)
    assert most_likely(probability, always)[0].sum() == pytest.approx(1.0)
    # One cause that is always right, and five without information.
    right = np.zeros((300, 6))
    right[:, 3] = happened
    np.testing.assert_allclose(most_likely(right, happened)[0], [0, 0, 0, 1, 0, 0], atol=1e-3)
    assert not most_likely(np.zeros((300, 6)), happened)[0].any()


def test_equal_causes_share_the_weight():
    probability, happened = draw((0.6, 0.0, 0.0, 0.0, 0.0, 0.0), n=40_000)
    probability[:, 4] = probability[:, 0]
    shares, gap = most_likely(probability, happened)
    assert gap <= 1e-4 and shares[0] + shares[4] == pytest.approx(0.6, abs=0.03)
