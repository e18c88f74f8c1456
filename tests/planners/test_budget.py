"""Laws of a budget and of its parts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.planners.planner import Budget

_COUNTS = st.integers(0, 1000)
_SHARES = st.floats(-1.0, 1e6, allow_nan=False) | st.just(math.inf)


@given(whole=st.none() | _COUNTS, spent=_COUNTS, asked=_SHARES, tried=_COUNTS)
def test_a_part_holds_no_more_iterations_than_asked_for_and_than_are_left(whole, spent, asked, tried) -> None:
    budget = Budget(iterations=whole)
    budget.spent = spent
    left = budget.remaining_iterations
    with budget.share(iterations=asked) as part:
        granted = part.remaining_iterations
        done = sum(part.spend() for _ in range(tried))
    assert granted == min(left, math.ceil(max(0.0, asked)) if math.isfinite(asked) else math.inf)
    assert done == min(tried, granted)
    assert budget.spent == spent + done, "counted exactly once"


@given(limit=st.floats(0.0, 1e6) | st.just(math.inf), elapsed=st.floats(0.0, 1e6), asked=_SHARES)
def test_a_part_ends_no_later_than_the_whole(limit, elapsed, asked) -> None:
    whole = Budget(time_limit=limit)
    whole.started -= elapsed
    before = whole.elapsed
    with whole.share(seconds=asked) as part:
        assert part.started == whole.started, "one clock: times that are told are those of the whole"
        assert part.time_limit <= whole.time_limit
        assert part.remaining_seconds <= max(0.0, asked)
        assert min(limit, before + max(0.0, asked)) <= part.time_limit, "and not before what was granted is over"
    assert whole.time_limit == limit


def test_all_is_granted_by_default() -> None:
    budget = Budget(time_limit=1e6, iterations=7)
    with budget.share() as part:
        assert (part.time_limit, part.iterations) == (budget.time_limit, 7)
    with Budget().share() as part:
        assert (part.time_limit, part.iterations) == (np.inf, None)


@pytest.mark.parametrize(
    ("budget", "timed"),
    [
        (Budget(time_limit=1.0), True),
        (Budget(time_limit=1.0, iterations=7), False),
        (Budget(iterations=7), False),
        (Budget(), False),
    ],
)
def test_enough_time_is_decided_by_time_only_without_iterations(budget: Budget, timed: bool) -> None:
    assert budget.timed is timed
    with budget.share(seconds=0.5) as part:
        assert part.timed is (budget.iterations is None)


def test_iterations_count_after_an_exception() -> None:
    budget = Budget(time_limit=1e6, iterations=10)
    with pytest.raises(ValueError, match="midway"), budget.share(seconds=1.0, iterations=5) as part:
        assert part.spend(3)
        raise ValueError("midway")
    assert (budget.spent, budget.iterations, budget.time_limit) == (3, 10, 1e6)
    assert not budget.exhausted


def test_parts_of_parts_add_up() -> None:
    budget = Budget(iterations=10)
    with budget.share(iterations=6) as part, part.share(iterations=4) as smaller:
        assert sum(smaller.spend() for _ in range(9)) == 4
    assert (part.spent, budget.spent) == (4, 4)


def test_cancelling_a_budget_cancels_its_parts() -> None:
    cancelled = False
    budget = Budget(cancelled=lambda: cancelled)
    with budget.share(iterations=5) as part:
        assert part.spend()
        cancelled = True
        assert part.exhausted
        assert not part.spend()
