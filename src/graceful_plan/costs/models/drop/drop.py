"""The arithmetic of the drop model, vectorised; `footprint.py` has the specification that it follows."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import final

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import FootprintConstants
from graceful_plan.costs.models.drop.functions import box, fall_time, part_reach, positive, step
from graceful_plan.costs.models.drop.tables import BALL, ROUND, FootprintTables

Array = np.ndarray

_TOUCH = 0.008  # how sharply a part passes the height of a top [m]
_LOWEST = 0.012  # parts whose bottoms are this near to the lowest one stand on the ground with it [m]
_LEAST_AREA = 1e-6  # [m2]
_LEAST_MOMENT = 1e-5  # [m2]
LEAST_MASS = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Drop:
    """What becomes of a dropped object.

    | field   | meaning                                                                  | shape    |
    |---------|--------------------------------------------------------------------------|----------|
    | first   | F: probability that a target is what it hits first; they sum to at most 1 | n target |
    | contact | C: probability that a target is touched in the first contact             | n target |
    | hit     | P: probability that a target is hit at all                               | n target |
    | entity  | probability that an entity is hit at all                                 | n entity |
    """

    first: Float[Array, "n target"]
    contact: Float[Array, "n target"]
    hit: Float[Array, "n target"]
    entity: Float[Array, "n entity"]


# --- the state at release -------------------------------------------------------------------------------------------


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Release:
    """Where the object is and how it moves when the gripper lets go; W frame, parts in the order of the tables.

    | field  | meaning                                | unit  | shape      |
    |--------|----------------------------------------|-------|------------|
    | c      | centre of mass                         | m     | n 3        |
    | v      | its velocity                           | m/s   | n 3        |
    | w      | angular velocity                       | rad/s | n 3        |
    | offset | centre of each part from c             | m     | n part 3   |
    | axes   | axes of each part, as columns          |       | n part 3 3 |
    """

    c: Float[Array, "n 3"]
    v: Float[Array, "n 3"]
    w: Float[Array, "n 3"]
    offset: Float[Array, "n part 3"]
    axes: Float[Array, "n part 3 3"]

    def only(self, rows: Int[Array, " m"]) -> Release:
        """Return some of the states."""
        return Release(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def release(batch: StateBatch, tables: FootprintTables, rows: slice = slice(None)) -> Release:
    """Return the state of the object at release in some of a batch's states."""
    X, qd = batch.link_poses[rows], batch.qd[rows] * tables.moves
    R, p = X[:, tables.link, :3, :3], X[:, tables.link, :3, 3]
    c = R @ tables.centre + p
    joints = X[:, tables.joint_link]
    axis, anchor = joints[..., :3, 2], joints[..., :3, 3]
    slide = batch.compiled.robot.slide[tables.joint_link].astype(bool)
    turning = np.where(slide, 0.0, qd)[..., None] * axis
    v = np.cross(turning, c[:, None] - anchor).sum(axis=1) + (np.where(slide, qd, 0.0)[..., None] * axis).sum(axis=1)
    return Release(
        c=c,
        v=v,
        w=turning.sum(axis=1),
        offset=np.einsum("nij,pj->npi", R, tables.part_offset),
        axes=np.einsum("nij,pjk->npik", R, tables.part_rotation),
    )


# --- the targets' axes ------------------------------------------------------------------------------------------------


@final
class _Frames:
    """Turns vectors of W into the targets' axes, seen from above."""

    def __init__(self, tables: FootprintTables) -> None:
        self.axis, self.centre = tables.target_axis, tables.target_centre
        self.x = np.concatenate([self.axis, np.zeros((len(self.axis), 1))], axis=1)
        self.y = np.concatenate([-self.axis[:, 1:], self.axis[:, :1], np.zeros((len(self.axis), 1))], axis=1)

    def turn(self, vector: Array) -> tuple[Array, Array]:
        """Turn vectors [n 2+] or [n target 2+]."""
        vector = vector[:, None] if vector.ndim == 2 else vector
        c, s = self.axis[:, 0], self.axis[:, 1]
        return c * vector[..., 0] + s * vector[..., 1], c * vector[..., 1] - s * vector[..., 0]

    def place(self, point: Array) -> tuple[Array, Array]:
        """Turn points [n 2+] or [n target 2+] relative to the targets' centres."""
        point = point[:, None] if point.ndim == 2 else point
        return self.turn(point[..., :2] - self.centre)


# --- the four steps -------------------------------------------------------------------------------------------------


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class _Shape:
    """How far parts reach: per part [n part] or [n part target]."""

    bottom: Array
    x: Array
    y: Array
    diagonal: tuple[Array, Array]
    low: Array
    high: Array
    tilt: Array


def _shape(tables: FootprintTables, state: Release, frames: _Frames) -> _Shape:
    up = np.array([[0.0, 0.0, 1.0]])
    diagonals = ((frames.x + frames.y) / np.sqrt(2.0), (frames.y - frames.x) / np.sqrt(2.0))

    def reach(u: Array) -> Array:
        each = zip(tables.part_half, tables.part_kind, strict=True)
        return np.stack(
            [part_reach(state.axes[:, p], half, int(kind), u) for p, (half, kind) in enumerate(each)], axis=1
        )

    z, height = reach(up)[..., 0], state.c[:, None, 2] + state.offset[..., 2]
    m = state.axes[:, tables.main, 2] ** 2
    kind = tables.part_kind[tables.main]
    if kind == ROUND:
        m = np.stack([m[:, 0] + m[:, 1], m[:, 2]], axis=1)
    tilt = np.zeros(len(m)) if kind == BALL else 1.0 - (m * m).sum(axis=1)
    return _Shape(
        bottom=height - z,
        x=reach(frames.x),
        y=reach(frames.y),
        diagonal=(reach(diagonals[0]), reach(diagonals[1])),
        low=(height - z).min(axis=1, keepdims=True),
        high=(height + z).max(axis=1, keepdims=True),
        tilt=tilt[:, None],
    )


def _overlap(
    tables: FootprintTables, constants: FootprintConstants, state: Release, shape: _Shape, frames: _Frames
) -> Float[Array, "n target"]:
    """D: P that the object is over a target when it passes the height of its top."""
    top, (a, b), d = tables.target_height[:, 1], tables.target_half.T, tables.target_diagonal
    D = np.zeros((len(state.c), len(top)))
    for p in range(state.offset.shape[1]):
        h = shape.bottom[:, p, None] - top
        t = fall_time(state.v[:, 2:], h)
        s = np.sqrt(constants.position_spread**2 + (constants.velocity_spread * t) ** 2)
        x, y = frames.place(state.c + state.offset[:, p])
        vx, vy = frames.turn(state.v + np.cross(state.w, state.offset[:, p]))
        x, y = x + vx * (t + constants.delay), y + vy * (t + constants.delay)
        upright = box(x, a + shape.x[:, p], s) * box(y, b + shape.y[:, p], s)
        turned = box((x + y) / np.sqrt(2.0), d + shape.diagonal[0][:, p], s)
        turned *= box((y - x) / np.sqrt(2.0), d + shape.diagonal[1][:, p], s)
        np.maximum(D, upright * turned * step(h / _TOUCH + 1.0), out=D)
    return D


@final
class _Levels:
    """Sums and products over the targets of a level, handed to each of them."""

    def __init__(self, start: Array) -> None:
        self.start, self.of = start[:-1], np.repeat(np.arange(len(start) - 1), np.diff(start))

    def sum(self, value: Array) -> Array:
        return np.add.reduceat(value, self.start, axis=1)

    def product(self, value: Array) -> Array:
        return np.multiply.reduceat(value, self.start, axis=1)

    def spread(self, value: Array) -> Array:
        return value[:, self.of]


def _first(D: Array, levels: _Levels) -> tuple[Array, Array]:
    """C and F."""
    missed = levels.product(1.0 - D)
    arrives = np.cumprod(np.concatenate([np.ones((len(D), 1)), missed[:, :-1]], axis=1), axis=1)
    share = D / (levels.spread(levels.sum(D)) + LEAST_MASS)
    return levels.spread(arrives) * D, levels.spread(arrives * (1.0 - missed)) * share


def _support(
    tables: FootprintTables,
    constants: FootprintConstants,
    state: Release,
    shape: _Shape,
    frames: _Frames,
    levels: _Levels,
    place: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Return T [n level], and n [n level 2]: P that it leaves each level if it comes down there, and whereto."""
    a, b = tables.target_carries.T
    c, s = tables.target_axis.T
    moments = np.zeros((6, len(state.c), len(c)))
    for p in range(state.offset.shape[1]):
        ox, oy = frames.turn(state.offset[:, p])
        weight = np.exp(-(((shape.bottom[:, p, None] - shape.low) / _LOWEST) ** 2))
        x0, x1 = np.maximum(ox - shape.x[:, p], -a - place[0]), np.minimum(ox + shape.x[:, p], a - place[0])
        y0, y1 = np.maximum(oy - shape.y[:, p], -b - place[1]), np.minimum(oy + shape.y[:, p], b - place[1])
        wx, wy, mx, my = np.maximum(x1 - x0, 0.0), np.maximum(y1 - y0, 0.0), 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        ux, uy = c * mx - s * my, s * mx + c * my
        qx, qy = wx * wx / 12.0, wy * wy / 12.0
        area = weight * wx * wy
        second = (ux * ux + c * c * qx + s * s * qy, uy * uy + s * s * qx + c * c * qy, ux * uy + c * s * (qx - qy))
        moments += area * np.stack([np.ones_like(area), ux, uy, *second])
    S0, *rest = (levels.sum(m) for m in moments)
    Ex, Ey, Vxx, Vyy, Vxy = (m / (S0 + _LEAST_AREA) for m in rest)
    Vxx, Vyy, Vxy = Vxx - Ex * Ex + _LEAST_MOMENT, Vyy - Ey * Ey + _LEAST_MOMENT, Vxy - Ex * Ey
    det = np.maximum(Vxx * Vyy - Vxy * Vxy, 1e-11)
    d2 = (Vyy * Ex * Ex - 2.0 * Vxy * Ex * Ey + Vxx * Ey * Ey) / det
    off, narrow = d2 / (3.0 + d2), det / (Vxx + Vyy)
    height = state.c[:, 2:] - shape.low
    speed = np.sqrt((state.v[:, :2] ** 2).sum(axis=1, keepdims=True) + 1e-4)
    k = constants
    leaves = k.leave + 2.0 * k.leave_offset * (off - 0.5) + k.leave_speed * speed + 2.0 * k.leave_tilt * shape.tilt
    leaves += 0.5 * k.leave_narrow * np.log((height * height + 1e-6) / (3.0 * narrow))
    away = -off / np.sqrt(Ex * Ex + Ey * Ey + 1e-6)
    return step(leaves), np.stack([away * Ex, away * Ey], axis=-1)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Landing:
    """The first impact as a whole, where and how high, and what leaves it again; W frame.

    | field       | meaning                                                              | unit | shape       |
    |-------------|----------------------------------------------------------------------|------|-------------|
    | point       | L: where it comes down, on average                                   | m    | n 2         |
    | total       | probability that it comes down on anything                           |      | n 1         |
    | low         | height of its lowest point at release                                | m    | n 1         |
    | fallen      | hs: height of fall, on average                                       | m    | n 1         |
    | height      | of what it comes down on, on average                                 | m    | n 1         |
    | time        | until it comes down, with the delay, on average                      | s    | n 1         |
    | blur        | variance of the place                                                | m2   | n 1         |
    | fall_spread | sd: standard deviation of where it comes down after it has fallen off | m    | n 1         |
    | velocity    | of its centre of mass at release                                     | m/s  | n 2         |
    | mass        | probability that it comes down on each level                         |      | n level     |
    | times       | until it is down at the first top of each level, with the delay      | s    | n level     |
    | leaving     | M: probability that it comes down on each level and leaves it        |      | n level     |
    | away        | whereto it leaves each level: direction, times at most 1             |      | n level 2   |
    """

    point: Float[Array, "n 2"]
    total: Float[Array, "n 1"]
    low: Float[Array, "n 1"]
    fallen: Float[Array, "n 1"]
    height: Float[Array, "n 1"]
    time: Float[Array, "n 1"]
    blur: Float[Array, "n 1"]
    fall_spread: Float[Array, "n 1"]
    velocity: Float[Array, "n 2"]
    mass: Float[Array, "n level"]
    times: Float[Array, "n level"]
    leaving: Float[Array, "n level"]
    away: Float[Array, "n level 2"]

    def falls_to(
        self, constants: FootprintConstants, size: float, B: Float[Array, "n *level 1"], N: Float[Array, "n *level 2"]
    ) -> Float[Array, "n *level 2"]:
        """Where it comes down if it has left a support: B has, in the directions N."""
        start = self.point + constants.carry * self.velocity
        start = start[:, None] if N.ndim == 3 else start
        return start + constants.drift * size * N / (B + LEAST_MASS)


def loose(
    tables: FootprintTables, constants: FootprintConstants, landing: Landing
) -> tuple[Float[Array, "n levels"], Float[Array, "n levels 2"]]:
    """Return B [n level+1] and N [n level+1 2]: what has left the levels above each one and was not caught; and all."""
    k, size, frames = constants, tables.size, _Frames(tables)
    a_top, b_top = tables.target_carries.T
    B, N = [np.zeros((len(landing.point), 1))], [np.zeros((len(landing.point), 2))]
    for level, (first, last) in enumerate(zip(tables.level_start[:-1], tables.level_start[1:], strict=True)):
        here = slice(first, last)
        x, y = (value[:, here] for value in frames.place(landing.falls_to(k, size, B[-1], N[-1])))
        inside = box(x, positive(a_top[here] + k.catch_margin * size), landing.fall_spread)
        inside *= box(y, positive(b_top[here] + k.catch_margin * size), landing.fall_spread)
        keep = np.prod(1.0 - k.catch * inside, axis=1, keepdims=True)
        M = landing.leaving[:, level, None]
        B.append(B[-1] * keep + M)
        N.append(N[-1] * keep + M * landing.away[:, level])
    return np.concatenate(B, axis=1), np.stack(N, axis=1)


def _falls(
    tables: FootprintTables, constants: FootprintConstants, frames: _Frames, levels: _Levels, landing: Landing
) -> Array:
    """G: P that it is hit by what has left something higher."""
    a, b = tables.target_half.T
    B, N = loose(tables, constants, landing)
    point = landing.falls_to(constants, tables.size, B[..., None], N)
    x, y = frames.place(point[:, levels.of])
    reach = constants.tumble_reach * tables.size
    return B[:, levels.of] * box(x, a + reach, landing.fall_spread) * box(y, b + reach, landing.fall_spread)


def _sides(
    tables: FootprintTables,
    constants: FootprintConstants,
    state: Release,
    shape: _Shape,
    frames: _Frames,
    landing: Landing,
    place: tuple[Array, Array],
    below: Array,
) -> Array:
    """H: P that it is swept from the side; `below` is P that the object comes down beside it."""
    k, size = constants, tables.size
    leaves = landing.leaving.sum(axis=1, keepdims=True) / landing.total
    drift = np.einsum("nl,nli->ni", landing.leaving, landing.away) / landing.total
    x, y = frames.place(landing.point + k.slide * state.v[:, :2] + k.drift * size * drift)
    sd = np.sqrt(landing.blur + (k.side_spread * size) ** 2 + (k.size_spread * size * leaves) ** 2)
    reach = (k.side_reach + k.topple_reach * leaves) * size
    (a, b), bottom = tables.target_half.T, tables.target_height[:, 0]
    H = step((landing.height + shape.high - shape.low - bottom) / k.side_height) * below
    H *= box(0.5 * (place[0] + x), a + 0.5 * np.sqrt((x - place[0]) ** 2 + 1e-6) + reach, sd)
    H *= box(0.5 * (place[1] + y), b + 0.5 * np.sqrt((y - place[1]) ** 2 + 1e-6) + reach, sd)
    return H


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class _Flight:
    """What leads to a landing."""

    frames: _Frames
    levels: _Levels
    shape: _Shape
    C: Array
    F: Array
    place: tuple[Array, Array]  # c at the first contact, in the targets' axes


def _fly(tables: FootprintTables, constants: FootprintConstants, state: Release) -> tuple[_Flight, Landing]:
    frames, levels, top = _Frames(tables), _Levels(tables.level_start), tables.target_height[:, 1]
    shape = _shape(tables, state, frames)
    C, F = _first(_overlap(tables, constants, state, shape, frames), levels)
    fallen = shape.low - top
    times = fall_time(state.v[:, 2:], fallen) + constants.delay
    x, y = frames.place(state.c)
    vx, vy = frames.turn(state.v)
    place = (x + vx * times, y + vy * times)
    T, away = _support(tables, constants, state, shape, frames, levels, place)
    total = F.sum(axis=1, keepdims=True) + LEAST_MASS
    time = (F * times).sum(axis=1, keepdims=True) / total
    height_fallen = (F * np.maximum(fallen, 0.0)).sum(axis=1, keepdims=True) / total
    k, mass = constants, levels.sum(F)
    blur = k.position_spread**2 + (k.velocity_spread * time) ** 2 + (k.height_spread * height_fallen) ** 2
    speed2 = (state.v[:, :2] ** 2).sum(axis=1, keepdims=True)
    landing = Landing(
        point=state.c[:, :2] + state.v[:, :2] * time,
        total=total,
        low=shape.low,
        fallen=height_fallen,
        height=(F * top).sum(axis=1, keepdims=True) / total,
        time=time,
        blur=blur,
        fall_spread=np.sqrt(blur + (k.size_spread * tables.size) ** 2 + k.carry_spread**2 * speed2),
        velocity=state.v[:, :2],
        mass=mass,
        times=times[:, tables.level_start[:-1]],
        leaving=mass * T,
        away=away,
    )
    return _Flight(frames=frames, levels=levels, shape=shape, C=C, F=F, place=place), landing


def land(tables: FootprintTables, constants: FootprintConstants, state: Release) -> Landing:
    """Return where the object comes down in each state; there has to be a target."""
    return _fly(tables, constants, state)[1]


def simulate(tables: FootprintTables, constants: FootprintConstants, state: Release) -> Drop:
    """Return what becomes of the object in each state; `entity` is left empty."""
    none = np.zeros((len(state.c), 0))
    if not len(tables.target_height):
        return Drop(first=none, contact=none, hit=none, entity=none)
    flight, landing = _fly(tables, constants, state)
    levels, C = flight.levels, flight.C
    G = _falls(tables, constants, flight.frames, levels, landing)
    below = np.maximum(levels.spread(np.cumsum(landing.mass[:, ::-1], axis=1)[:, ::-1]) - C, 0.0)
    H = _sides(tables, constants, state, flight.shape, flight.frames, landing, flight.place, below)
    return Drop(first=flight.F, contact=C, hit=1.0 - (1.0 - C) * (1.0 - G) * (1.0 - H), entity=none)
