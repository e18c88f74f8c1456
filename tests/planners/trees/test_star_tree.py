"""The tree of RRT*: costs equal the sums along its branches after any rewiring, and neighbours are the nearest."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.planners.trees.star_tree import StarTree

_TOLERANCE = 1e-9
"""Costs of descendants are updated by differences, which round."""


def _tree(goals: int = 1) -> StarTree:
    ends = np.arange(2.0 * (1 + goals)).reshape(-1, 2)
    return StarTree(ends[0], ends[1:], np.zeros(1 + goals))


def _steps_changed_at_random(tree: StarTree, n: int, rng: np.random.Generator) -> dict[tuple[int, int], float]:
    """Add nodes one by one and rewire random nodes; return the given cost of every edge."""
    steps: dict[tuple[int, int], float] = {}
    for _ in range(n):
        parent = int(rng.choice(np.flatnonzero(np.isfinite(tree.cost))))
        step = float(rng.choice([0.0, rng.uniform()]))
        (node,) = tree.add(rng.normal(size=(1, 2)), np.array([parent]), np.array([step]), np.zeros(1))
        steps[parent, int(node)] = step
        for _ in range(3):
            over, led = int(rng.choice(np.flatnonzero(np.isfinite(tree.cost)))), int(rng.integers(len(tree)))
            cheaper = float(rng.uniform(0.0, 0.4))
            before = tree.cost[led]
            if led != over and tree.lead(led, over, cheaper):
                steps[over, led] = cheaper
                assert tree.cost[led] < before
    return steps


@given(seed=st.integers(0, 1000), n=st.integers(1, 40), goals=st.integers(1, 3))
@settings(max_examples=30, deadline=None)
def test_costs_are_sums_along_branches(seed: int, n: int, goals: int) -> None:
    tree = _tree(goals)
    steps = _steps_changed_at_random(tree, n, np.random.default_rng(seed))
    for node in np.flatnonzero(np.isfinite(tree.cost)).tolist():
        branch = tree.branch(node).tolist()
        assert branch[0] == 0 and branch[-1] == node and len(set(branch)) == len(branch)
        assert tree.cost[node] == pytest.approx(sum(steps[edge] for edge in itertools.pairwise(branch)))
    assert (tree.parent[np.isinf(tree.cost)] == -1).all()


@given(seed=st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_rewiring_never_raises_costs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree = _tree()
    _steps_changed_at_random(tree, 20, rng)
    for _ in range(20):
        before = tree.cost.copy()
        node, over = rng.integers(len(tree), size=2)
        taken = node != over and np.isfinite(before[over]) and tree.lead(int(node), int(over), float(rng.uniform()))
        assert np.all(tree.cost <= before + _TOLERANCE)
        assert taken or np.array_equal(tree.cost, before)


def test_goals_are_there_from_the_beginning_and_not_reached() -> None:
    tree = _tree(3)
    assert len(tree) == 4
    np.testing.assert_array_equal(tree.goals, [1, 2, 3])
    np.testing.assert_array_equal(tree.cost, [0.0, np.inf, np.inf, np.inf])
    assert tree.lead(2, 0, 1.5)
    assert not tree.lead(2, 0, 1.5)
    np.testing.assert_array_equal(tree.branch(2), [0, 2])
    np.testing.assert_array_equal(tree.q[[0, 2]], [[0.0, 1.0], [4.0, 5.0]])


def test_nearest_and_neighbours_equal_a_scan() -> None:
    """More nodes than the initial capacity."""
    rng, tree = np.random.default_rng(0), _tree(2)
    q = rng.normal(size=(2500, 2))
    for part in np.split(q, 5):
        tree.add(part, np.zeros(500, dtype=int), np.ones(500), np.arange(500.0))
    np.testing.assert_array_equal(tree.q[3:], q)
    np.testing.assert_array_equal(tree.impact[3:], np.tile(np.arange(500.0), 5))
    target = rng.normal(size=(7, 2))
    distance = np.linalg.norm(tree.q - target[:, None], axis=2)
    expected = np.argsort(distance, axis=1)
    np.testing.assert_array_equal(np.sort(tree.neighbours(target, 9)), np.sort(expected[:, :9]))
    assert tree.neighbours(target, 5000).shape == (7, len(tree))
    distance[:, tree.goals] = np.inf
    np.testing.assert_array_equal(tree.nearest(target), distance.argmin(axis=1))
    np.testing.assert_array_equal(tree.nearest(tree.q[tree.goals]) > 2, [True, True])
