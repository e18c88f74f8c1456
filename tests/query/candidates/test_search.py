"""Results that are kept of a search."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.query.candidates.search import subsampled


def test_few_improvements_are_all_kept_and_of_many_the_late_ones() -> None:
    assert [subsampled(n) for n in range(4)] == [[], [0], [1, 0], [2, 1, 0]]
    assert subsampled(20) == [19, 18, 17, 15, 11, 3]


@given(st.integers(1, 10_000))
def test_kept_improvements_begin_at_the_last_and_are_ever_farther_apart(n: int) -> None:
    kept = subsampled(n)
    gaps = -np.diff(kept)
    assert kept[0] == n - 1 and kept[-1] >= 0
    assert np.all(gaps > 0) and np.all(np.diff(gaps) >= 0)
    assert len(kept) <= np.log2(n) + 2
    assert kept[-1] <= n / 2, "some of the early ones are among them"
