"""Pairs of node and goal: each is tried once, the nearest first."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.planners.trees.untried import Untried


@given(seed=st.integers(0, 1000), nodes=st.integers(0, 20), goals=st.integers(1, 3), later=st.integers(0, 5))
@settings(max_examples=30, deadline=None)
def test_all_pairs_come_once_the_nearest_first(seed: int, nodes: int, goals: int, later: int) -> None:
    rng = np.random.default_rng(seed)
    goal_q, q = rng.normal(size=(goals, 3)), rng.normal(size=(nodes + later, 3))
    untried = Untried(goal_q)
    untried.learn(q[:nodes])
    untried.learn(q)
    for goal in range(goals):
        distance = np.linalg.norm(q - goal_q[goal], axis=1)
        taken = [untried.take(goal) for _ in range(len(q))]
        assert [pair and pair[0] for pair in taken] == np.argsort(distance, kind="stable").tolist()
        np.testing.assert_allclose([pair[1] for pair in taken if pair], np.sort(distance))
        assert untried.take(goal) is None


def test_nodes_learned_late_come_before_farther_ones() -> None:
    untried = Untried(np.zeros((1, 1)))
    q = np.array([[2.0], [3.0], [1.0]])
    untried.learn(q[:2])
    assert untried.take(0) == (0, 2.0)
    untried.learn(q)
    assert untried.take(0) == (2, 1.0)
    assert untried.take(0) == (1, 3.0)


def test_excluded_pairs_do_not_come() -> None:
    untried = Untried(np.array([[0.0], [5.0]]))
    untried.learn(np.array([[1.0], [2.0]]))
    untried.exclude(0, 0)
    assert untried.take(0) == (1, 2.0)
    assert untried.take(0) is None
    assert untried.take(1) == (1, 3.0)
    assert untried.take(1) == (0, 4.0)
