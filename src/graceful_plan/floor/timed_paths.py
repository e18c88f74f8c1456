"""Paths of a point over the cells of a floor and over time, where what a step costs changes: somebody walks there.

Time goes in ticks. A point waits, or steps to one of eight neighbours, fast or slowly; each move takes a number of
ticks, and no diagonal one cuts a corner. What a move costs that begins in a cell at a tick is told by whoever asks, and
is infinite where it must not be made. Costs of all cells at all ticks are found by dynamic programming, one tick after
the other, and are exact: every move leads to a later tick.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.exceptions import SettingError, ShapeError

Array = np.ndarray

MOST_STATES = 20_000_000
"""Cells times ticks."""


class TimedMove(NamedTuple):
    """A step to a neighbour, or to wait."""

    columns: int
    rows: int
    ticks: int

    @property
    def length(self) -> float:
        """In cells."""
        return float(np.hypot(self.columns, self.rows))


def _moves() -> tuple[TimedMove, ...]:
    around = [(c, r) for c in (-1, 0, 1) for r in (-1, 0, 1) if (c, r) != (0, 0)]
    fast = [TimedMove(c, r, 3 if c and r else 2) for c, r in around]
    return (TimedMove(0, 0, 1), *fast, *(TimedMove(c, r, 2 * ticks) for c, r, ticks in fast))


MOVES = _moves()
"""Wait; steps of a cell in two ticks, or three along a diagonal; and the same at half the speed."""

Charge = Callable[[int], Float[Array, "move row column"]]
"""What each move costs that begins at a tick, in each cell; infinite where it must not be made."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class TimedPath:
    """Cells and the ticks at which a point is there.

    | field | meaning                                              | unit | shape   |
    |-------|------------------------------------------------------|------|---------|
    | cells | column and row, from the start to the goal           |      | point 2 |
    | ticks | when it gets there, which is when the next move begins |    | point   |
    | cost  | sum of the charges; infinite if no path leads there  |      |         |
    """

    cells: Int[Array, "point 2"] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    ticks: Int[Array, " point"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    cost: float = np.inf


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class TimedGrid:
    """Cells of which some are free.

    Args:
        free: Whether the point may be there.
        ticks: After how many it has to be at its goal.
        moves: What it can do.

    Raises:
        ShapeError: If there are no cells.
        SettingError: If there are too many cells and ticks, or moves that take no time.
    """

    free: Bool[Array, "row column"]
    ticks: int
    moves: tuple[TimedMove, ...] = MOVES

    def __post_init__(self) -> None:
        if not np.size(self.free):
            raise ShapeError("free", np.shape(self.free), "(rows, columns)")
        if self.ticks < 0 or (self.ticks + 1) * np.size(self.free) > MOST_STATES:
            raise SettingError("TimedGrid.ticks", self.ticks, f"at least 0, times cells at most {MOST_STATES}")
        if any(move.ticks < 1 for move in self.moves):
            raise SettingError("TimedGrid.moves", self.moves, "moves of at least one tick")

    def cheapest(self, start: tuple[int, int], goal: tuple[int, int], charge: Charge) -> TimedPath:
        """Return the path of least cost from one cell (column, row) at tick 0 to another one by the last tick."""
        rows, columns = self.free.shape
        for name, (column, row) in (("start", start), ("goal", goal)):
            if not (0 <= column < columns and 0 <= row < rows):
                raise SettingError(name, (column, row), f"a column and a row below {columns} and {rows}")
        best = np.full((self.ticks + 1, rows, columns), np.inf)
        move_to = np.full(best.shape, -1, dtype=np.int8)
        best[0][start[::-1]] = 0.0
        steps = [self._step(move) for move in self.moves]
        for tick in range(self.ticks):
            if not np.isfinite(best[tick]).any():
                continue
            charges = charge(tick)
            for k, (move, (begin, end, may)) in enumerate(zip(self.moves, steps, strict=True)):
                if (after := tick + move.ticks) > self.ticks:
                    continue
                value = np.where(may, best[tick][begin] + charges[k][begin], np.inf)
                better = value < best[after][end]
                best[after][end][better] = value[better]
                move_to[after][end][better] = k
        return self._traced(best[:, goal[1], goal[0]], move_to, goal)

    def _traced(
        self, costs: Float[Array, " tick"], move_to: Int[Array, "tick row column"], goal: tuple[int, int]
    ) -> TimedPath:
        tick = int(np.argmin(costs))
        if not np.isfinite(costs[tick]):
            return TimedPath()
        column, row = goal
        cells, ticks, cost = [goal], [tick], float(costs[tick])
        while (k := int(move_to[tick, row, column])) >= 0:
            move = self.moves[k]
            column, row, tick = column - move.columns, row - move.rows, tick - move.ticks
            cells.append((column, row))
            ticks.append(tick)
        return TimedPath(cells=np.array(cells[::-1]), ticks=np.array(ticks[::-1]), cost=cost)

    def _step(self, move: TimedMove) -> tuple[tuple[slice, slice], tuple[slice, slice], Bool[Array, "row column"]]:
        """Return where a move may begin, where it then ends, and whether both and what is beside are free."""
        rows, columns = self.free.shape

        def at(r: int, c: int) -> tuple[slice, slice]:
            first_r, first_c = max(0, -move.rows), max(0, -move.columns)
            last_r, last_c = rows - max(0, move.rows), columns - max(0, move.columns)
            return slice(first_r + r, max(last_r, first_r) + r), slice(first_c + c, max(last_c, first_c) + c)

        begin, end = at(0, 0), at(move.rows, move.columns)
        may = self.free[begin] & self.free[end]
        if move.rows and move.columns:
            may = may & self.free[at(move.rows, 0)] & self.free[at(0, move.columns)]
        return begin, end, may
