"""Paths over cells, headings and time against all paths, on floors small enough to enumerate them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.mobile.floor.timed_paths import (
    HEADINGS,
    LEAVES,
    STANDS,
    STEPS,
    DynamicObstacles,
    MoveKind,
    TimedLattice,
    TimedPaces,
)

DISC = np.array([[0.1, 0.0, 0.3]])
"""A base whose outline is ahead of its origin."""
TICK = 0.5


def lattice(opened, ticks, **given):
    return TimedLattice(open=opened, width=1.0, tick=TICK, ticks=ticks, outline=DISC, **given)


def everywhere(rows, columns):
    return np.full((HEADINGS, rows, columns), STANDS | LEAVES, dtype=np.uint8)


def walking(*places, radius=0.2, **given):
    """Return a round entity with these positions at half ticks; it stays at the last."""
    shape = np.zeros((1, len(places), 7))
    shape[0, :, :2], shape[0, :, 2], shape[0, :, 6] = places, 1.0, radius
    return DynamicObstacles(shape=shape, velocity=np.zeros((1, len(places)), dtype=np.int32), **given)


def price_of(of, who, node, move):
    """Return the cost of a move, infinite if it is forbidden."""
    (x, y, h, tick), rows, columns = node, *of.open.shape[1:]
    to, arrives = (x + move.columns, y + move.rows), (h + move.turn) % HEADINGS
    drives = move.kind in (MoveKind.FORWARD, MoveKind.SLOW, MoveKind.BACKWARD)
    if not (0 <= to[0] < columns and 0 <= to[1] < rows and of.open[arrives, to[1], to[0]] & STANDS):
        return np.inf
    leaves = of.open[h, to[1], to[0]] if move.kind is MoveKind.BACKWARD else of.open[h, y, x]
    if drives and not leaves & LEAVES:
        return np.inf
    price, seconds, gap = move.price, move.ticks * TICK, np.inf
    faces, share = (
        ((h + 4) % HEADINGS if move.kind is MoveKind.BACKWARD else h),
        1.0 if move.kind is MoveKind.FORWARD else 0.5,
    )
    if drives and of.rate is not None:
        price += share * seconds * of.rate[faces, y, x]
    middle = np.array([x, y]) + 0.5 * np.array([move.columns, move.rows])
    for half, at, heading in ((2 * tick + move.ticks, middle, h), (2 * (tick + move.ticks), np.array(to), arrives)):
        ahead = 0.1 * np.array([np.cos(heading * np.pi / 4), np.sin(heading * np.pi / 4)])
        there = who.shape[0, min(half, who.shape.shape[1] - 1), :2]
        gap = min(gap, np.hypot(*(at + ahead - there)) - 0.3 - who.shape[0, 0, 6])
    if gap < (who.driving if drives or move.turn else who.standing):
        return np.inf
    if drives and len(who.beside):
        i, j = np.rint((middle - who.shape[0, min(2 * tick + move.ticks, who.shape.shape[1] - 1), :2]) / who.apart) + 1
        if 0 <= i <= 2 and 0 <= j <= 2:
            price += share * seconds * who.beside[0, faces, int(i), int(j)]
    return price + who.close * seconds * max(0.0, 1.0 - max(gap, 0.0) / who.wanted) * (gap < who.wanted)


def every_path(of, who, start, goal):
    """Return the least cost: values of all states, from the last tick to the first."""
    rows, columns = of.open.shape[1:]
    left = np.full((of.ticks + 1, HEADINGS, rows, columns), np.inf)
    for tick in range(of.ticks, -1, -1):
        left[tick, :, goal[1], goal[0]] = 0.0
        for h, y, x in np.ndindex(HEADINGS, rows, columns):
            for move in of.paces.moves():
                if move.heading != h or tick + move.ticks > of.ticks or not of.open[h, y, x] & STANDS:
                    continue
                price = price_of(of, who, (x, y, h, tick), move)
                if np.isfinite(price):
                    arrives = (h + move.turn) % HEADINGS
                    after = left[tick + move.ticks, arrives, y + move.rows, x + move.columns]
                    left[tick, h, y, x] = min(left[tick, h, y, x], price + after)
    return left[0, start[2], start[1], start[0]]


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 10_000))
def test_costs_equal_those_of_the_best_of_all_paths(seed):
    rng = np.random.default_rng(seed)
    opened = everywhere(2, 3) & np.where(rng.uniform(size=(HEADINGS, 2, 3)) < 0.85, 3, 1).astype(np.uint8)
    places = rng.uniform([0.0, -1.0], [3.0, 2.0], (30, 2))
    who = walking(
        *places,
        beside=rng.uniform(0.0, 2.0, (1, HEADINGS, 3, 3)),
        apart=0.7,
        driving=0.1,
        standing=-0.2,
        wanted=0.4,
        close=3.0,
    )
    of = lattice(opened, 9, rate=rng.uniform(0.0, 1.0, (HEADINGS, 2, 3)))
    start, goal = (0, 0, int(rng.integers(HEADINGS))), (2, 1)
    found = of.cheapest(start, goal, others=who)
    best = every_path(of, who, start, goal)
    assert found.cost == pytest.approx(best, rel=1e-5)
    if np.isfinite(best):
        assert tuple(found.nodes[0]) == (*start, 0) and tuple(found.nodes[-1][:2]) == goal
        assert (np.diff(found.nodes[:, 3]) > 0).all()


def test_the_base_waits_for_a_door_or_turns_in_place():
    # A person blocks the door of a corridor until the 20th half tick.
    places = [[2.0, 0.0]] * 20 + [[2.0, 9.0]]
    of = lattice(everywhere(1, 4), 40)
    alone, found = of.cheapest((0, 0, 0), (3, 0)), of.cheapest((0, 0, 0), (3, 0), others=walking(*places))
    assert len(alone.nodes) == 4 and alone.nodes[-1, 3] == 6
    assert found.nodes[-1, 3] >= 12 and found.cost > alone.cost
    assert not len(lattice(everywhere(1, 4), 11).cheapest((0, 0, 0), (3, 0), others=walking(*places)).nodes)
    back = of.cheapest((3, 0, 0), (0, 0))
    assert (back.nodes[:, 2] == 0).all()  # a short distance is driven backwards
    round_ = lattice(everywhere(1, 4), 40, paces=TimedPaces(reverse=False)).cheapest((3, 0, 0), (0, 0))
    assert sorted({int(h) for h in round_.nodes[:, 2]}) in ([0, 1, 2, 3, 4], [0, 4, 5, 6, 7])


def test_the_base_lets_a_pedestrian_pass_at_a_bay():
    # A corridor one cell wide with a bay; a person comes from the far end: the base waits in the bay.
    opened = np.zeros((HEADINGS, 2, 9), dtype=np.uint8)
    opened[:, 0], opened[:, 1, 3] = STANDS | LEAVES, STANDS | LEAVES
    diagonal = [h for h, (c, r) in enumerate(STEPS) if c and r]
    opened[diagonal] &= STANDS
    half = np.arange(200)
    places = np.column_stack([8.0 - 0.12 * half, np.zeros(200)])
    who = walking(*places, driving=0.05, standing=0.0)
    of = lattice(opened, 90)
    found = of.cheapest((0, 0, 0), (8, 0), others=who)
    assert (found.nodes[:, 1] == 1).any()
    closed = opened.copy()
    closed[:, 1] = 0
    assert not len(lattice(closed, 90).cheapest((0, 0, 0), (8, 0), others=who).nodes)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ShapeError, match="open"):
        lattice(np.ones((HEADINGS, 0, 3), dtype=np.uint8), 3)
    with pytest.raises(SettingError, match="ticks"):
        lattice(everywhere(300, 300), 10_000)
    with pytest.raises(SettingError, match="turn"):
        lattice(everywhere(2, 2), 3, paces=TimedPaces(turn=0))
    with pytest.raises(SettingError, match="goal"):
        lattice(everywhere(2, 2), 3).cheapest((0, 0, 0), (2, 0))
