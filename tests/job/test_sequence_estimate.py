"""Estimates of sequences: exact if costs are sums over pairs and all are known, and never above the best order."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graceful_plan.job.sequence_estimate import KnownCosts

NAMES = ("a", "b", "c", "d")
HARM = st.floats(0.0, 50.0)


def cost_of(order: tuple[str, ...], alone: dict[str, float], harm: dict[tuple[str, str, bool], float]) -> float:
    """Return the cost of an order whose harm is a sum over pairs."""
    moved: set[str] = set()
    total = 0.0
    for name in order:
        total += alone[name] + sum(harm[name, other, other in moved] for other in order if other != name)
        moved.add(name)
    return total


def learned(
    orders: list[tuple[str, ...]], alone: dict[str, float], harm: dict[tuple[str, str, bool], float]
) -> KnownCosts:
    known = KnownCosts()
    for order in orders:
        moved: set[str] = set()
        for name in order:
            seen = {(other, other in moved): harm[name, other, other in moved] for other in order if other != name}
            known.learn(
                name,
                keys=("choice", "all"),
                bound=1.0,
                cost=alone[name] + sum(seen.values()),
                motion=alone[name],
                harm=seen,
            )
            moved.add(name)
    return known


def estimate(known: KnownCosts) -> float:
    return known.rest(dict.fromkeys(NAMES, 1.0), "all", dict.fromkeys(NAMES, False))


def drawn(data: st.DataObject) -> tuple[dict[str, float], dict[tuple[str, str, bool], float]]:
    alone = {name: data.draw(st.floats(1.0, 10.0)) for name in NAMES}
    pairs = [(a, b, moved) for a in NAMES for b in NAMES if a != b for moved in (False, True)]
    return alone, {pair: data.draw(HARM) for pair in pairs}


@given(st.data())
def test_the_rest_is_never_estimated_above_the_best_order(data: st.DataObject) -> None:
    alone, harm = drawn(data)
    orders = data.draw(st.lists(st.permutations(NAMES).map(tuple), min_size=1, max_size=4))
    best = min(cost_of(order, alone, harm) for order in permutations(NAMES))
    assert estimate(learned(orders, alone, harm)) <= best + 1e-9


@given(st.data())
def test_the_rest_is_exact_if_only_one_object_can_be_harmed(data: st.DataObject) -> None:
    alone, harm = drawn(data)
    harm = {(a, b, moved): value * (b == "a") for (a, b, moved), value in harm.items()}
    known = learned([NAMES, NAMES[::-1]], alone, harm)
    assert estimate(known) == pytest.approx(min(cost_of(order, alone, harm) for order in permutations(NAMES)))


def test_a_case_that_was_not_seen_counts_as_no_harm() -> None:
    known = KnownCosts()
    known.learn("a", keys=("grasp", "lids"), bound=2.0, cost=12.0, motion=3.0, harm={("b", False): 7.0})
    assert known.cost("a", ("grasp", "lids"), 2.0, {"b": False}) == 12.0
    assert known.cost("a", ("other", "lids"), 2.0, {"b": True}) == 5.0
    # Without harm and with another lid, only the motion is known.
    assert known.cost("a", ("other", "no lids"), 2.0, {"b": False}) == 3.0
    assert known.motion("b", 4.0) > 4.0
    assert np.isfinite(known.cost("b", ("grasp",), 4.0, {}))
