"""Cheapest paths of a base over cells, headings and time among moving entities, exact, in the native core.

Time is divided into ticks. A base waits, turns in place to the next of eight headings, or drives to the next cell along
its heading: fast, slowly, or backwards. Each move takes a number of ticks and has a price. The expected impact of
failures during the move is added, for static and moving entities at their positions at that time. Moves closer to
moving entities than a limit are excluded, and small clearances have a price.

A* finds the path of least cost. A preceding search without moving entities gives a lower bound on the cost to go.

References:
    D. Silver, "Cooperative pathfinding", AIIDE 2005.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float, Int, UInt8
from graceful_plan.core import _native
from graceful_plan.exceptions import SettingError, ShapeError

HEADINGS = 8
"""Number of headings. The first is along x, and each leads to a different neighbouring cell."""
STEPS = tuple((round(np.cos(a)), round(np.sin(a))) for a in 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS)
"""Columns and rows of a move along each heading."""
STANDS, LEAVES = 1, 2
"""Bits of a cell and heading: the base may be there; it may drive forward from there."""
MOST_STATES = 2**28
"""Largest number of states: cells times headings times ticks."""


class MoveKind(IntEnum):
    """Kind of a move; values as in the core."""

    WAIT = 0
    TURN = 1
    FORWARD = 2
    SLOW = 3
    BACKWARD = 4


class TimedMove(NamedTuple):
    """A move that begins in a heading; turns are counted in headings, positive to the left."""

    heading: int
    columns: int
    rows: int
    turn: int
    ticks: int
    kind: MoveKind
    price: float


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class TimedPaces:
    """Durations of moves and their prices.

    | field   | meaning                             | unit |
    |---------|-------------------------------------|------|
    | turn    | ticks of a turn to the next heading |      |
    | reverse | whether the base drives backwards   |      |
    | width   | price of driving a cell's width     |      |
    | second  | price of a tick                     |      |
    | turning | price of a turn                     |      |
    """

    turn: int = 1
    reverse: bool = True
    width: float = 1.0
    second: float = 0.1
    turning: float = 0.2

    def moves(self) -> tuple[TimedMove, ...]:
        """Return all moves: a cell takes two ticks, three along a diagonal, and twice that slowly or backwards."""
        found = []
        for h, (c, r) in enumerate(STEPS):
            ticks = 3 if c and r else 2
            length = self.width * float(np.hypot(c, r))
            wait = TimedMove(heading=h, columns=0, rows=0, turn=0, ticks=1, kind=MoveKind.WAIT, price=self.second)
            fast = wait._replace(
                columns=c, rows=r, ticks=ticks, kind=MoveKind.FORWARD, price=length + self.second * ticks
            )
            slow = fast._replace(ticks=2 * ticks, kind=MoveKind.SLOW, price=length + 2 * self.second * ticks)
            turning = self.turning + self.second * self.turn
            turns = [wait._replace(turn=turn, ticks=self.turn, kind=MoveKind.TURN, price=turning) for turn in (1, -1)]
            found += [wait, *turns, fast, slow]
            if self.reverse:
                found.append(slow._replace(columns=-c, rows=-r, kind=MoveKind.BACKWARD))
        return tuple(found)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class DynamicObstacles:
    """Moving entities in the format of the core; none by default.

    | field    | meaning                                                                 | shape         |
    |----------|-------------------------------------------------------------------------|---------------|
    | shape    | planar rectangles in the frame of the cells, at half ticks [m]: x, y,   | other half 7  |
    |          | cosine and sine of the yaw, half length, half width, rounding radius    |               |
    | velocity | velocity class                                                          | other half    |
    | beside   | price of a second of fast driving, by the position of the base relative | class heading |
    |          | to the entity along x and y                                             | place place   |
    | apart    | distance between these positions [m]                                    |               |
    | driving  | clearance below which no move drives or turns [m]                       |               |
    | standing | clearance below which no move waits [m]                                 |               |
    | wanted   | clearance below which closeness has a price [m]                         |               |
    | close    | price of a second at zero clearance                                     |               |
    """

    shape: Float[Array, "other half 7"] = field(default_factory=lambda: np.zeros((0, 1, 7)))
    velocity: Int[Array, "other half"] = field(default_factory=lambda: np.zeros((0, 1), dtype=np.int32))
    beside: Float[Array, "class heading place place"] = field(default_factory=lambda: np.zeros((0, HEADINGS, 1, 1)))
    apart: float = 0.5
    driving: float = 0.0
    standing: float = 0.0
    wanted: float = 0.0
    close: float = 0.0


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class TimedPath:
    """Cells and headings of a path, with the ticks at which the base is there.

    | field      | meaning                                          | unit | shape   |
    |------------|--------------------------------------------------|------|---------|
    | nodes      | column, row, heading and tick, from the start    |      | point 4 |
    | cost       | sum of the prices; infinite if no path was found |      |         |
    | expansions | number of expanded states                        |      |         |
    | stopped    | whether the time was up                          |      |         |
    """

    nodes: Int[Array, "point 4"] = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int32))
    cost: float = np.inf
    expansions: int = 0
    stopped: bool = False


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class TimedLattice:
    """Lattice of cells and headings, some of which are open.

    Args:
        open: `STANDS` and `LEAVES` bits of each cell, for eight headings.
        width: Width of a cell [m].
        tick: Duration of a tick [s].
        ticks: Last tick.
        outline: Discs that cover the base, in its frame: x, y, radius [m].
        paces: Durations and prices of moves.
        rate: Price of a second of fast driving in each cell and heading, for static entities; None: 0.
        slow: Factor on `rate`, and on the price beside moving entities, for slow and backward moves.

    Raises:
        ShapeError, SettingError: If they do not fit, or there would be too many states.
    """

    open: UInt8[Array, "heading row column"]
    width: float
    tick: float
    ticks: int
    outline: Float[Array, "disc 3"]
    paces: TimedPaces = field(default_factory=TimedPaces)
    rate: Float[Array, "heading row column"] | None = None
    slow: float = 0.5

    def __post_init__(self) -> None:
        shape = np.shape(self.open)
        if len(shape) != 3 or shape[0] != HEADINGS or 0 in shape:
            raise ShapeError("open", shape, f"({HEADINGS}, rows, columns)")
        if self.ticks < 0 or (self.ticks + 1) * np.size(self.open) >= MOST_STATES:
            raise SettingError("TimedLattice.ticks", self.ticks, f"at least 0, times cells below {MOST_STATES}")
        if self.paces.turn < 1:
            raise SettingError("TimedPaces.turn", self.paces.turn, "at least 1 tick")

    def cheapest(
        self,
        start: tuple[int, int, int],
        goal: tuple[int, int],
        *,
        others: DynamicObstacles | None = None,
        ending: Float[Array, " heading"] | None = None,
        late: Callable[[], bool] = lambda: False,
    ) -> TimedPath:
        """Return the cheapest path from a column, row and heading at tick 0 to a cell by the last tick.

        Args:
            start: Column, row and heading of the start.
            goal: Column and row of the goal.
            others: Moving entities.
            ending: Price of each heading at the goal; default: 0.
            late: Polled during the search; the search stops once it returns True.
        """
        _, rows, columns = self.open.shape
        for name, (column, row) in (("start", start[:2]), ("goal", goal)):
            if not (0 <= column < columns and 0 <= row < rows):
                raise SettingError(name, (column, row), f"a column and a row below {columns} and {rows}")
        moves, who = self.paces.moves(), DynamicObstacles() if others is None else others
        rate = np.zeros(0) if self.rate is None else self.rate
        found = _native.timed_path(
            open=np.ascontiguousarray(self.open, dtype=np.uint8),
            rate=np.ascontiguousarray(rate, dtype=np.float32),
            width=self.width,
            moves=np.array([move[:6] for move in moves], dtype=np.int32),
            price=np.array([move.price for move in moves]),
            shape=np.ascontiguousarray(who.shape, dtype=np.float64),
            velocity=np.ascontiguousarray(who.velocity, dtype=np.int32),
            beside=np.ascontiguousarray(who.beside, dtype=np.float32),
            apart=who.apart,
            outline=np.ascontiguousarray(self.outline, dtype=np.float64),
            rules={
                "driving": who.driving,
                "standing": who.standing,
                "wanted": who.wanted,
                "price": who.close,
                "slow": self.slow,
                "tick": self.tick,
            },
            ticks=self.ticks,
            start=np.array(start, dtype=np.int32),
            goal=np.array(goal, dtype=np.int32),
            ending=np.zeros(HEADINGS) if ending is None else np.ascontiguousarray(ending, dtype=np.float64),
            late=late,
        )
        if not found["found"]:
            return TimedPath(expansions=found["expansions"], stopped=found["stopped"])
        return TimedPath(nodes=found["nodes"], cost=found["cost"], expansions=found["expansions"])
