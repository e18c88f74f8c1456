"""Paths over the cells of a floor map and over time, among those who move: before or behind somebody, or after a wait.

A disc goes over coarse cells by dynamic programming over time (`floor.timed_paths`). A step costs its length, its time
and w times what those who move would suffer if the base failed on it, where they then are; nobody is driven into, and
nobody is waited for where they walk. What is found becomes turns in place and straight stretches, and loses its times:
the law of time is found again on the smooth curve. Impact on those who stand is left to that as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.costs.cost import moving_batch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.coast.walkers import seen_from_above
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.floor.floor_map import FloorMap
from graceful_plan.floor.timed_paths import MOVES, TimedGrid, TimedMove
from graceful_plan.path import Path
from graceful_plan.planners.driving.bases_only import of_a_base
from graceful_plan.planners.driving.footprint import floor_around, footprint, radii, turns_and_straights
from graceful_plan.planners.driving.postures import BASE
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.settings import positive
from graceful_plan.planners.trivial import stays_at_goal
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray

_FINE = 0.05
"""Cells of the map that is cut out of the scene [m]."""
_CRUISE = 0.7
"""Share of the fastest speed at which a cell is crossed in two ticks."""
_SHARES = (1.0, 0.5, 0.0)
"""Of the way from the disc inside of the robot to the one around it: what keeps clear, one after the other."""
_REACH, _APART = 3.0, 0.5
"""How far off somebody is looked at, and between these places [m]."""
_MOST_VELOCITIES = 4
_SLOW = 0.5
"""Impact at half the speed, as a share: routes need no more, the law of time looks again."""
_KEPT = 0.2
"""Clearance to those who move, besides the discs [m]."""
_TIME = 0.3
"""What a second costs besides [m/s]: about as much as when motions are compared."""


@final
@dataclass(frozen=True, kw_only=True)
class FloorInTime(Planner):
    """Dynamic programming over cells and time; one path for each disc that gets through.

    The arm stays as it is at the start. One iteration is one search.

    Args:
        cell: Width of a cell [m].
        around: How far beyond start and goals the map reaches, if the limits of the base let it [m].
        late: How many seconds it may take, besides one for each metre of length and width of the map.
    """

    name: ClassVar[str] = "floor_in_time"
    anytime: ClassVar[bool] = False

    cell: float = 0.25
    around: float = 8.0
    late: float = 8.0

    def __post_init__(self) -> None:
        for name in ("cell", "around", "late"):
            positive(name, getattr(self, name))

    @stays_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield a path, if there is one.

        Raises:
            SettingError: If the robot has no base that drives.
        """
        del rng
        driven = charging, _ = of_a_base(objective, self.name)
        start = problem.start
        goals = [goal for goal in problem.goals if np.array_equal(goal[BASE:], start[BASE:])]
        if not goals:
            return
        discs, top = footprint(charging.scene, start)
        inside, outside = radii(discs)
        floor = floor_around(charging.scene, top, np.array([start, *problem.goals])[:, :2], (_FINE, self.around))
        seconds = sum(floor.size) + self.late
        charge = _Charge(self, driven, start, outside + _KEPT, seconds, budget)
        for share in _SHARES:
            if not budget.spend():
                return
            cells = _Cells.of(floor, self.cell, inside + share * (outside - inside), (start, goals[0]))
            grid = TimedGrid(free=cells.free, ticks=charge.ticks)
            try:
                found = grid.cheapest(cells.start, cells.goal, lambda tick, xy=cells.xy: charge(tick, xy))
            except _Over:
                return
            if len(found.cells) == 0:
                continue
            xy = cells.xy[found.cells[:, 1], found.cells[:, 0]]
            q = turns_and_straights(_without_collinear(xy), start, goals[0])
            if problem.edges_free(q[:-1], q[1:]).all():
                yield Path(q).without_duplicates()
                return


@dataclass(frozen=True, eq=False)
class _Cells:
    """Coarse cells: their centres in W, which are free, and where the ends are."""

    xy: Float[Array, "row column 2"]
    free: Bool[Array, "row column"]
    start: tuple[int, int]
    goal: tuple[int, int]

    @classmethod
    def of(
        cls, floor: FloorMap, cell: float, radius: float, ends: tuple[Float[Array, " nq"], Float[Array, " nq"]]
    ) -> _Cells:
        (width, height), yaw = floor.size, floor.origin[2]
        assert yaw == 0.0
        columns, rows = max(1, int(width / cell)), max(1, int(height / cell))
        at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        xy = floor.in_world((at + 0.5) * cell)
        free = floor.clearance(xy) >= radius
        places = []
        for end in ends:
            column, row = np.floor(floor.on_map(end[:2]) / cell).astype(int)
            place = int(np.clip(column, 0, columns - 1)), int(np.clip(row, 0, rows - 1))
            free[place[::-1]] = True
            places.append(place)
        return cls(xy, free, places[0], places[1])


class _Over(Exception):
    """The search is given up, for its time is."""


class _Charge:
    """What moves cost at ticks."""

    def __init__(
        self,
        of: FloorInTime,
        driven: tuple[SceneObjective, DiffDrive],
        start: Float[Array, " nq"],
        kept: float,
        seconds: float,
        budget: Budget,
    ) -> None:
        objective, base = driven
        self.objective, self.cell, self.start, self.budget = objective, of.cell, start, budget
        self.tick = 0.5 * of.cell / (_CRUISE * base.v_max)
        self.ticks = int(seconds / self.tick)
        halves = 2 * (self.ticks + max(move.ticks for move in MOVES))
        self.walkers = [
            _Walker(self, entity, kept + _radius(entity), halves) for entity in objective.scene.moving.values()
        ]
        self.own = np.array([of.cell * move.length + _TIME * self.tick * move.ticks for move in MOVES])

    def go_on(self) -> None:
        """Raise `_Over` once there is no time left for the search."""
        if self.budget.over:
            raise _Over

    def __call__(self, tick: int, xy: Float[Array, "row column 2"]) -> Float[Array, "move row column"]:
        self.go_on()
        cost = np.repeat(self.own, xy.shape[0] * xy.shape[1]).reshape(len(MOVES), *xy.shape[:2])
        for k, move in enumerate(MOVES):
            middle = xy + 0.5 * self.cell * np.array([move.columns, move.rows])
            for walker in self.walkers:
                walker.add(cost[k], k, middle, 2 * tick + move.ticks)
        return cost

    def speed(self, move: TimedMove) -> float:
        """Of the base on a move [m/s]."""
        return self.cell * move.length / (self.tick * move.ticks)


class _Walker:
    """One who moves: a table of w times the impact by where the base is, seen from them, and where it drives."""

    def __init__(self, charge: _Charge, entity: MovingEntity, kept: float, halves: int) -> None:
        self.charge, self.entity, self.kept = charge, entity, kept
        n = int(np.ceil(_REACH / _APART))
        self.places = _APART * np.arange(-n, n + 1)
        self.t = 0.5 * charge.tick * np.arange(halves)
        shape, self.velocity, _ = seen_from_above(entity, self.t)
        self.position = shape[:, :2]
        self.tables: dict[tuple[float, ...], Float[Array, "move place place"]] = {}

    def add(self, cost: Float[Array, "row column"], move: int, xy: Float[Array, "row column 2"], half: int) -> None:
        """Add what a move costs in the middle of a tick, or between two, from everywhere."""
        x, y = np.moveaxis(xy - self.position[half], -1, 0)
        near = (np.abs(x) < _REACH) & (np.abs(y) < _REACH)
        if not near.any():
            return
        x, y = x[near], y[near]
        more = np.where(np.hypot(x, y) < self.kept, np.inf, 0.0)
        if self.charge.objective.w > 0.0 and MOVES[move].length > 0.0:
            at = (np.rint(of / _APART).astype(int) + len(self.places) // 2 for of in (x, y))
            more += self.charge.tick * MOVES[move].ticks * self._table(half)[move][tuple(at)]
        cost[near] += more

    def _table(self, half: int) -> Float[Array, "move place place"]:
        """Return w times the impact of each move, for the velocity at a time."""
        key = tuple(np.round(self.velocity[half], 1).tolist())
        if key not in self.tables and len(self.tables) >= _MOST_VELOCITIES:
            key = min(self.tables, key=lambda known: float(np.hypot(known[0] - key[0], known[1] - key[1])))
        if key not in self.tables:
            self.tables[key] = self._looked_at(float(self.t[half]))
        return self.tables[key]

    def _looked_at(self, t: float) -> Float[Array, "move place place"]:
        impact, objective = self.charge.objective.objective.impact, self.charge.objective
        table = np.zeros((len(MOVES), len(self.places), len(self.places)))
        if not isinstance(impact, ImpactCost):
            return table
        there, scene = self.entity.at(t).position[:2], objective.scene
        alone = scene.without_moving().with_moving(self.entity)
        x, y = np.meshgrid(self.places, self.places, indexing="ij")
        q = np.tile(self.charge.start, (x.size, 1))
        q[:, 0], q[:, 1] = there[0] + x.ravel(), there[1] + y.ravel()
        for k, move in enumerate(MOVES):
            if move.length == 0.0:
                continue
            fast = move._replace(ticks=move.ticks // 2)
            if fast in MOVES[:k]:
                table[k] = _SLOW * table[MOVES.index(fast)]
                continue
            way = np.array([move.columns, move.rows]) / move.length
            qd = np.zeros_like(q)
            q[:, 2], qd[:, :2] = np.arctan2(way[1], way[0]), self.charge.speed(move) * way
            self.charge.go_on()
            found = impact.moving_state(moving_batch(alone, q, qd, np.full(len(q), t)))
            table[k] = objective.w * found.reshape(x.shape)
        return table


def _radius(entity: MovingEntity) -> float:
    return float(entity.size[0] if entity.is_round else np.linalg.norm(entity.size[:2]))


def _without_collinear(xy: Float[Array, "_ 2"]) -> Float[Array, "_ 2"]:
    """Leave out waits, and points on the straight line from the one before to the next."""
    xy = xy[np.append(True, np.abs(np.diff(xy, axis=0)).max(axis=1) > 0.0)]
    if len(xy) < 3:
        return xy
    a, b = np.diff(xy, axis=0)[:-1], np.diff(xy, axis=0)[1:]
    bends = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > 1e-9
    return xy[np.concatenate([[True], bends, [True]])]
