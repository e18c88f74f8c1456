"""Paths over cells and time against all there are, on grids so small that they can be listed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.floor.timed_paths import MOVES, TimedGrid, TimedMove

TICKS = 7


def every_path(free, charges, start, goal, tick=0):
    """The least cost of all ways to be at the goal at some tick, by trying every move everywhere."""
    best = 0.0 if start == goal else np.inf
    rows, columns = free.shape
    for k, move in enumerate(MOVES):
        column, row = start[0] + move.columns, start[1] + move.rows
        if not (0 <= column < columns and 0 <= row < rows) or tick + move.ticks > TICKS:
            continue
        passed = free[start[::-1]], free[row, column], free[start[1], column], free[row, start[0]]
        cost = charges[tick, k, start[1], start[0]]
        if all(passed) and np.isfinite(cost):
            best = min(best, cost + every_path(free, charges, (column, row), goal, tick + move.ticks))
    return best


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_costs_are_those_of_the_best_of_all_paths(seed):
    rng = np.random.default_rng(seed)
    free = rng.uniform(size=(2, 3)) < 0.85
    free[0, 0] = True
    charges = rng.uniform(0.0, 1.0, (TICKS, len(MOVES), 2, 3))
    charges[rng.uniform(size=charges.shape) < 0.2] = np.inf
    found = TimedGrid(free=free, ticks=TICKS).cheapest((0, 0), (2, 1), lambda tick: charges[tick])
    assert found.cost == pytest.approx(every_path(free, charges, (0, 0), (2, 1)))
    if np.isfinite(found.cost):
        paid = 0.0
        for (c, r), (c1, r1), t, t1 in zip(found.cells, found.cells[1:], found.ticks, found.ticks[1:], strict=False):
            paid += charges[t, MOVES.index(TimedMove(c1 - c, r1 - r, t1 - t)), r, c]
        assert paid == pytest.approx(found.cost)
        assert found.ticks[0] == 0 and tuple(found.cells[0]) == (0, 0) and tuple(found.cells[-1]) == (2, 1)


def test_it_waits_until_the_door_is_open():
    free, opens = np.ones((1, 4), dtype=bool), 9

    def charge(tick):
        cost = np.array([0.01 * move.ticks + move.length for move in MOVES])[:, None, None] * np.ones((1, 1, 4))
        if tick < opens:
            cost[1:, 0, 1] = np.inf  # nobody leaves the second cell
        return cost

    path = TimedGrid(free=free, ticks=30).cheapest((0, 0), (3, 0), charge)
    assert path.ticks[-1] == opens + 4
    assert path.cost == pytest.approx(3.0 + 0.01 * (opens + 4))
    assert not len(TimedGrid(free=free, ticks=opens + 3).cheapest((0, 0), (3, 0), charge).cells)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ShapeError, match="free"):
        TimedGrid(free=np.ones((0, 3), dtype=bool), ticks=3)
    with pytest.raises(SettingError, match="ticks"):
        TimedGrid(free=np.ones((1000, 1000), dtype=bool), ticks=1000)
    with pytest.raises(SettingError, match="moves"):
        TimedGrid(free=np.ones((2, 2), dtype=bool), ticks=3, moves=(TimedMove(1, 0, 0),))
    with pytest.raises(SettingError, match="goal"):
        TimedGrid(free=np.ones((2, 2), dtype=bool), ticks=3).cheapest((0, 0), (2, 0), lambda _: np.zeros((17, 2, 2)))
