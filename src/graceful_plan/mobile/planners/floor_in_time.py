"""Paths over floor cells, headings and time among moving entities: passing before or behind them, or waiting.

The footprint of the robot, as discs at the heading of travel, moves over coarse cells in the core
(`mobile.floor.timed_paths`). A move costs its length, its time, and w times the impact of a base failure during the
move, with all entities at their positions at that time. The base never drives into a moving entity, nor waits where one
walks. If no path is found, the cells are halved. The path becomes turns in place and straight stretches without times;
the timing is computed again on the smooth curve.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int, UInt8
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.costs.static_objective import without_moving
from graceful_plan.mobile.coast.moving_entities import planar_shapes
from graceful_plan.mobile.floor.occupancy_grid import OccupancyGrid
from graceful_plan.mobile.floor.timed_paths import (
    HEADINGS,
    LEAVES,
    MOST_STATES,
    STANDS,
    STEPS,
    DynamicObstacles,
    TimedLattice,
    TimedPaces,
)
from graceful_plan.mobile.planners.bases_only import of_a_base
from graceful_plan.mobile.planners.footprint import floor_around, footprint, near_entities, turns_and_straights
from graceful_plan.mobile.planners.postures import BASE
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.motion_descent import DRIVING_TIME_PRICE
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.moving import MovingEntity
from graceful_plan.setting_checks import positive_or_none

_FINE = 0.05
"""Width of the cells of the map cut from the scene [m]."""
_CRUISE = 0.7
"""Share of the fastest speed at which a cell is crossed in two ticks."""
_TURNS = 0.5
"""Share of the duration of a turn in place at the greatest rate; on smooth curves, most of it happens while driving."""
_TURN_PRICE = 0.25
"""Additional cost of turning by a radian [m]: curves are slower and longer than straight paths."""
_YAW = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
_REACH, _APART = 3.0, 0.3
"""Distance from a moving entity up to which impact is evaluated, and spacing of the evaluated positions [m]."""
_MOST_VELOCITIES = 4
_COARSE = 2
"""Row and column stride of the cells in which impact on static entities is evaluated."""
_DRIVING, _STANDING, _WANTED = 0.1, 0.0, 0.3
"""Clearances to moving entities below which discs do not drive, do not wait, and have a price [m]."""
_CLOSE = 2.0
"""Additional cost of a second at zero clearance [m/s]."""
_FINER = (1.0, 0.5)
"""Factors on the cell width, tried one after the other until a path is found."""
_REPAIRS = 6
"""Largest number of searches at one width; after each, the cells of colliding moves are closed."""


@final
@dataclass(frozen=True, kw_only=True)
class FloorInTime(Planner):
    """A* over cells, headings and time.

    The arm keeps its start posture. One iteration is one search.

    Args:
        cell: Width of a cell [m].
        around: Extent of the map beyond start and goals, within the limits of the base [m].
        late: Latest arrival [s], in addition to one second for each metre of length and width of the map.
    """

    name: ClassVar[str] = "floor_in_time"
    anytime: ClassVar[bool] = False
    drives: ClassVar[bool] = True

    cell: float = 0.25
    around: float = 8.0
    late: float = 8.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("cell", "around", "late"):
            positive_or_none(name, getattr(self, name))

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield a path, if there is one.

        Raises:
            SettingError: If the robot has no base.
        """
        del rng
        charging, base = of_a_base(objective, self.name)
        start = problem.start
        goals = [goal for goal in problem.goals if np.array_equal(goal[BASE:], start[BASE:])]
        if not goals:
            return
        discs, top = footprint(charging.scene, start)
        floor = floor_around(charging.scene, top, np.array([start, *problem.goals])[:, :2], (_FINE, self.around))
        beside = _Beside(charging, base, start, budget)
        for share in _FINER:
            cells = _Cells.of(floor, share * self.cell, discs, (start, goals[0]))
            for _ in range(_REPAIRS):
                if not budget.spend():
                    return
                try:
                    q = self._found(cells, beside, discs, budget)
                except _Over:
                    return
                if q is None:
                    break
                blocked = ~problem.edges_free(q[:-1], q[1:])
                if not blocked.any():
                    yield Path(q).without_duplicates()
                    return
                cells.close(q[:-1][blocked], q[1:][blocked])

    def _found(
        self, cells: _Cells, beside: _Beside, discs: Float[Array, "disc 3"], budget: Budget
    ) -> Float[Array, "vertex nq"] | None:
        """Search once; return the path, or None if there is none or the time is up."""
        base, width = beside.base, cells.width
        tick = 0.5 * width / (_CRUISE * base.v_max)
        seconds = width * sum(cells.open.shape[1:]) + self.late
        ticks = min(int(seconds / tick), MOST_STATES // cells.open.size - 2)
        turn, angle = _TURNS * 2.0 * np.pi / HEADINGS / base.omega_max, 2.0 * np.pi / HEADINGS
        paces = TimedPaces(
            turn=max(1, round(turn / tick)),
            reverse=base.reverse,
            width=width,
            second=DRIVING_TIME_PRICE * tick,
            turning=_TURN_PRICE * angle,
        )
        rate = beside.standing(cells.xy)
        lattice = TimedLattice(
            open=cells.open, width=width, tick=tick, ticks=ticks, outline=discs, paces=paces, rate=rate
        )
        found = lattice.cheapest(
            cells.start,
            cells.goal,
            others=beside.others(cells.xy[0, 0], 0.5 * tick, 2 * ticks + 2),
            ending=_TURN_PRICE * np.abs(_turned(_YAW - cells.ends[1][2])),
            late=lambda: budget.over,
        )
        return cells.path(found.nodes) if len(found.nodes) else None


@dataclass(frozen=True, eq=False)
class _Cells:
    """Coarse cells aligned with the start: their centres in W, the open headings of each, and both ends."""

    xy: Float[Array, "row column 2"]
    open: UInt8[Array, "heading row column"]
    width: float
    start: tuple[int, int, int]
    goal: tuple[int, int]
    ends: tuple[Float[Array, " nq"], Float[Array, " nq"]]

    @classmethod
    def of(
        cls,
        floor: OccupancyGrid,
        width: float,
        discs: Float[Array, "disc 3"],
        ends: tuple[Float[Array, " nq"], Float[Array, " nq"]],
    ) -> _Cells:
        (x0, y0, yaw), (start, goal) = floor.origin, ends
        assert yaw == 0.0
        corner, size = np.array([x0, y0]), np.array(floor.size)
        first = np.floor((start[:2] - corner) / width).astype(int)
        columns, rows = (first + np.floor((corner + size - start[:2]) / width).astype(int) + 1).tolist()
        at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        xy = start[:2] + (at - first) * width
        opened = np.zeros((HEADINGS, rows, columns), dtype=np.uint8)
        for h, step in enumerate(STEPS):
            stands = _clear(floor, xy, discs, _YAW[h])
            middle = _clear(floor, xy + 0.5 * width * np.array(step), discs, _YAW[h])
            opened[h] = STANDS * stands + LEAVES * (stands & middle)
        column, row = np.clip(np.rint((goal[:2] - start[:2]) / width).astype(int) + first, 0, (columns - 1, rows - 1))
        heading = int(np.argmin(np.abs(_turned(_YAW - start[2]))))
        opened[heading, first[1], first[0]] |= STANDS
        opened[:, row, column] |= STANDS
        return cls(xy, opened, width, (int(first[0]), int(first[1]), heading), (int(column), int(row)), ends)

    def path(self, nodes: Int[Array, "point 4"]) -> Float[Array, "vertex nq"]:
        """Return turns and straight stretches; waits are left out."""
        moves = np.append(True, np.abs(np.diff(nodes[:, :2], axis=0)).max(axis=1) > 0)
        at = nodes[moves]
        steps, way = np.diff(at[:, :2], axis=0), np.array(STEPS)[at[1:, 2]]
        forward = (steps * way).sum(axis=1) > 0
        changes = (np.diff(steps, axis=0) != 0).any(axis=1) | (np.diff(forward) != 0)
        kept = np.concatenate([[True], changes, [True]]) if len(at) > 1 else np.array([True])
        xy = self.xy[at[kept, 1], at[kept, 0]]
        if len(xy) == 1:
            xy = np.repeat(xy, 2, axis=0)
        gears: Bool[Array, " edge"] = forward[np.flatnonzero(kept)[1:] - 1] if len(at) > 1 else np.array([True])
        return turns_and_straights(xy, *self.ends, gears)

    def close(self, a: Float[Array, "edge nq"], b: Float[Array, "edge nq"]) -> None:
        """Close the cells under edges that are not free."""
        origin = self.xy[0, 0]
        for from_, to in zip(a, b, strict=True):
            n = max(2, math.ceil(float(np.linalg.norm(to[:2] - from_[:2])) / (0.5 * self.width)) + 1)
            cell = np.rint((np.linspace(from_[:2], to[:2], n) - origin) / self.width).astype(int)
            column, row = np.clip(cell, 0, np.array(self.open.shape[:0:-1]) - 1).T
            for yaw in np.linspace(from_[2], to[2], 3):
                self.open[round(yaw / (2.0 * np.pi / HEADINGS)) % HEADINGS, row, column] &= STANDS
        self.open[self.start[2], self.start[1], self.start[0]] |= STANDS


class _Over(Exception):
    """The search is abandoned because its time is up."""


class _Beside:
    """Cost of base failures beside static and moving entities."""

    def __init__(self, objective: SceneObjective, base: DiffDrive, start: Float[Array, " nq"], budget: Budget) -> None:
        self.objective, self.base, self.start, self.budget = objective, base, start, budget
        self.speed = _CRUISE * base.v_max

    @cached_property
    def _still(self) -> SceneObjective:
        of = self.objective
        return SceneObjective(of.objective, without_moving(of.scene), of.paces)

    def standing(self, xy: Float[Array, "row column 2"]) -> Float[Array, "heading row column"] | None:
        """Return the price of a second of driving in each cell and heading for static entities; None if w is 0."""
        if self.objective.w == 0.0:
            return None
        coarse = xy[::_COARSE, ::_COARSE]
        near = near_entities(coarse, self._still.scene)
        rate = np.zeros((HEADINGS, *near.shape))
        if near.any():
            for h in range(HEADINGS):
                self._go_on()
                rate[h][near] = self.objective.w * self._still.approximate_states(*self._driving(coarse[near], h))
        return rate.repeat(_COARSE, axis=1).repeat(_COARSE, axis=2)[:, : xy.shape[0], : xy.shape[1]]

    def others(self, origin: Float[Array, " 2"], half: float, halves: int) -> DynamicObstacles:
        """Return the moving entities at half ticks [s], relative to the first cell; empty if there are none."""
        if not self.objective.scene.moving:
            return DynamicObstacles()
        t = half * np.arange(halves)
        n = math.ceil(_REACH / _APART)
        places, shapes, velocities = _APART * np.arange(-n, n + 1), [], []
        tables: list[Float[Array, "heading place place"]] = []
        for entity in self.objective.scene.moving.values():
            shape, velocity, _ = planar_shapes(entity, t)
            shape[:, :2] -= origin
            classes, row = _classes(velocity)
            shapes.append(shape)
            velocities.append(len(tables) + row)
            tables += [self._beside(entity, float(t[np.argmax(row == k)]), places) for k in range(classes)]
        return DynamicObstacles(
            shape=np.stack(shapes),
            velocity=np.stack(velocities),
            beside=np.stack(tables),
            apart=_APART,
            driving=_DRIVING,
            standing=_STANDING,
            wanted=_WANTED,
            close=_CLOSE,
        )

    def _beside(
        self, entity: MovingEntity, t: float, places: Float[Array, " place"]
    ) -> Float[Array, "heading place place"]:
        """Return the price of a second of driving beside an entity, at its state at a time."""
        impact, n = self.objective.objective.impact, len(places)
        table = np.zeros((HEADINGS, n, n))
        if self.objective.w == 0.0 or not isinstance(impact, ImpactCost):
            return table
        alone = without_moving(self.objective.scene).with_moving(entity)
        rough = impact.moving_impact(alone, rough=True)
        xy = entity.at(t).position[:2] + np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
        for h in range(HEADINGS):
            self._go_on()
            found = rough.impact(*self._driving(xy, h), np.full(len(xy), t))
            table[h] = self.objective.w * found.reshape(n, n)
        return table

    def _go_on(self) -> None:
        """Raise `_Over` once the search has no time left."""
        if self.budget.over:
            raise _Over

    def _driving(self, xy: Float[Array, "n 2"], heading: int) -> tuple[Float[Array, "n nq"], Float[Array, "n nq"]]:
        """Return configurations and velocities of a base that drives at these places and heading."""
        q = np.tile(self.start, (len(xy), 1))
        qd = np.zeros_like(q)
        q[:, :2], q[:, 2] = xy, _YAW[heading]
        qd[:, :2] = self.speed * np.array([np.cos(_YAW[heading]), np.sin(_YAW[heading])])
        return q, qd


def _classes(velocity: Float[Array, "half 2"]) -> tuple[int, Int[Array, " half"]]:
    """Return the number of velocity classes, and the class of each velocity."""
    known, row = np.unique(np.round(velocity, 1), axis=0, return_inverse=True)
    if len(known) > _MOST_VELOCITIES:
        often = np.argsort(-np.bincount(row.ravel()), kind="stable")[:_MOST_VELOCITIES]
        known = known[often]
        row = np.argmin(np.linalg.norm(velocity[:, None] - known, axis=2), axis=1)
    return len(known), row.ravel()


def _clear(
    floor: OccupancyGrid, xy: Float[Array, "row column 2"], discs: Float[Array, "disc 3"], yaw: float
) -> Bool[Array, "row column"]:
    """Return where the discs around a robot with this heading touch nothing."""
    c, s = np.cos(yaw), np.sin(yaw)
    offset = np.column_stack([c * discs[:, 0] - s * discs[:, 1], s * discs[:, 0] + c * discs[:, 1]])
    found = np.ones(xy.shape[:2], dtype=bool)
    for at, radius in zip(offset, discs[:, 2], strict=True):
        found &= floor.clearance(xy + at) >= radius
    return found


def _turned(angle: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Wrap angles to [-pi, pi)."""
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
