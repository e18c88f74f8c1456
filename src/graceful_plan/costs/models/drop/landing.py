"""Landing of a dropped object and its falls from there: steps 0 to 3 of the drop model, in NumPy.

The treatment of moving entities needs these steps, since the core knows no times. Symbols are those of the
specification in the docstring of the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.models.drop.constants import DropConstants
from graceful_plan.costs.models.drop.functions import box, fall_time, step
from graceful_plan.costs.models.drop.outlines import Shape, Targets, shape_of
from graceful_plan.costs.models.drop.release import Release
from graceful_plan.costs.models.drop.sides import SideStop, find_stop
from graceful_plan.costs.models.drop.tables import DropTables

_TOUCH = 0.008  # smoothing width of the height at which a part reaches a top [m]
_LOWEST = 0.012  # parts with bottoms this close to the lowest one support the object, too [m]
_LEAST_AREA = 1e-6  # [m2]
_LEAST_MOMENT = 1e-5  # [m2]
LEAST_MASS = 1e-6


# --- the first contact and the support --------------------------------------------------------------------------------


def _overlap(
    targets: Targets, constants: DropConstants, state: Release, shape: Shape, stop: SideStop
) -> Float[Array, "n target"]:
    """D: P that the object overlaps a target in top view when it reaches the height of its top."""
    top, (a, b), d = targets.top, targets.tables.target_half.T, targets.tables.target_diagonal
    D = np.zeros((len(state.c), len(top)))
    for p in range(state.offset.shape[1]):
        h = shape.bottom[:, p, None] - top
        t = fall_time(state.v[:, 2:], h)
        s = np.sqrt(constants.position_spread**2 + (constants.velocity_spread * t) ** 2)
        x, y = targets.place(state.c + state.offset[:, p])
        vx, vy = targets.turn(state.v + np.cross(state.w, state.offset[:, p]))
        px, py = targets.turn(stop.pushed(t + constants.delay))
        x, y = x + vx * (t + constants.delay) + px, y + vy * (t + constants.delay) + py
        upright = box(x, a + shape.x[:, p], s) * box(y, b + shape.y[:, p], s)
        turned = box((x + y) / np.sqrt(2.0), d + shape.diagonal[0][:, p], s)
        turned *= box((y - x) / np.sqrt(2.0), d + shape.diagonal[1][:, p], s)
        np.maximum(D, upright * turned * step(h / _TOUCH + 1.0), out=D)
    return D


def _first(targets: Targets, D: Float[Array, "n target"]) -> Float[Array, "n target"]:
    """F: P that the object hits a target first."""
    missed = targets.product(1.0 - D)
    arrives = np.cumprod(np.concatenate([np.ones((len(D), 1)), missed[:, :-1]], axis=1), axis=1)
    share = D / (targets.spread(targets.sum(D)) + LEAST_MASS)
    return targets.spread(arrives * (1.0 - missed)) * share


def _support(
    targets: Targets, constants: DropConstants, state: Release, shape: Shape, place: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return T [n level] and n [n level 2]: P that the object leaves each level after landing there, and direction."""
    a, b = targets.tables.target_carries.T
    c, s = targets.axis.T
    moments = np.zeros((6, len(state.c), len(c)))
    for p in range(state.offset.shape[1]):
        ox, oy = targets.turn(state.offset[:, p])
        weight = np.exp(-(((shape.bottom[:, p, None] - shape.low) / _LOWEST) ** 2))
        x0, x1 = np.maximum(ox - shape.x[:, p], -a - place[0]), np.minimum(ox + shape.x[:, p], a - place[0])
        y0, y1 = np.maximum(oy - shape.y[:, p], -b - place[1]), np.minimum(oy + shape.y[:, p], b - place[1])
        wx, wy, mx, my = np.maximum(x1 - x0, 0.0), np.maximum(y1 - y0, 0.0), 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        ux, uy = c * mx - s * my, s * mx + c * my
        qx, qy = wx * wx / 12.0, wy * wy / 12.0
        area = weight * wx * wy
        second = (ux * ux + c * c * qx + s * s * qy, uy * uy + s * s * qx + c * c * qy, ux * uy + c * s * (qx - qy))
        moments += area * np.stack([np.ones_like(area), ux, uy, *second])
    S0, *rest = (targets.sum(m) for m in moments)
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


# --- the landing and the falls ----------------------------------------------------------------------------------------


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Landing:
    """The first impact: mean position and height, and the mass that leaves each level again; W frame.

    | field       | meaning                                                              | unit | shape       |
    |-------------|----------------------------------------------------------------------|------|-------------|
    | point       | L: mean landing point                                                | m    | n 2         |
    | total       | probability that it lands on anything                                |      | n 1         |
    | height      | mean height of the surface that it lands on                          | m    | n 1         |
    | time        | mean time until it lands, including the delay                        | s    | n 1         |
    | blur        | variance of the landing point                                        | m2   | n 1         |
    | fall_spread | sd: standard deviation of the landing point after leaving a support  | m    | n 1         |
    | velocity    | of its centre of mass at release                                     | m/s  | n 2         |
    | stop        | the blocking side                                                    |      |             |
    | mass        | probability that it lands on each level                              |      | n level     |
    | times       | time until it reaches the first top of each level, with the delay    | s    | n level     |
    | leaving     | M: probability that it lands on each level and leaves it             |      | n level     |
    | away        | direction in which it leaves each level, scaled by at most 1         |      | n level 2   |
    """

    point: Float[Array, "n 2"]
    total: Float[Array, "n 1"]
    height: Float[Array, "n 1"]
    time: Float[Array, "n 1"]
    blur: Float[Array, "n 1"]
    fall_spread: Float[Array, "n 1"]
    velocity: Float[Array, "n 2"]
    stop: SideStop
    mass: Float[Array, "n level"]
    times: Float[Array, "n level"]
    leaving: Float[Array, "n level"]
    away: Float[Array, "n level 2"]

    def goes_on(self, time: float) -> Float[Array, "n 2"]:
        """Compute where the object would be a time after landing [s]."""
        down = self.time[:, 0]
        return self.point + time * self.velocity + self.stop.pushed(down + time) - self.stop.pushed(down)

    def falls_to(
        self, constants: DropConstants, size: float, B: Float[Array, "n *level 1"], N: Float[Array, "n *level 2"]
    ) -> Float[Array, "n *level 2"]:
        """Compute where the object lands after leaving a support, with mass B and directions N."""
        start = self.goes_on(constants.carry)
        start = start[:, None] if N.ndim == 3 else start
        return start + constants.drift * size * N / (B + LEAST_MASS)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """Intermediate results of a flight before the landing."""

    targets: Targets
    shape: Shape
    D: Float[Array, "n target"]
    F: Float[Array, "n target"]
    place: tuple[Array, Array]
    """c at the first contact, in the targets' axes."""


def fly(tables: DropTables, constants: DropConstants, state: Release) -> tuple[Flight, Landing]:
    """Compute flight and landing of the object for each state; requires at least one target."""
    targets = Targets(tables)
    shape = shape_of(targets, state)
    stop = find_stop(targets, constants, state, shape)
    D = _overlap(targets, constants, state, shape, stop)
    F = _first(targets, D)
    fallen = shape.low - targets.top
    times = fall_time(state.v[:, 2:], fallen) + constants.delay
    x, y = targets.place(state.c)
    vx, vy = targets.turn(state.v)
    px, py = targets.turn(stop.pushed(times))
    place = (x + vx * times + px, y + vy * times + py)
    T, away = _support(targets, constants, state, shape, place)
    total = F.sum(axis=1, keepdims=True) + LEAST_MASS
    time = (F * times).sum(axis=1, keepdims=True) / total
    height_fallen = (F * np.maximum(fallen, 0.0)).sum(axis=1, keepdims=True) / total
    k, mass = constants, targets.sum(F)
    blur = k.position_spread**2 + (k.velocity_spread * time) ** 2 + (k.height_spread * height_fallen) ** 2
    speed2 = (state.v[:, :2] ** 2).sum(axis=1, keepdims=True)
    landing = Landing(
        point=state.c[:, :2] + state.v[:, :2] * time + stop.pushed(time[:, 0]),
        total=total,
        height=(F * targets.top).sum(axis=1, keepdims=True) / total,
        time=time,
        blur=blur,
        fall_spread=np.sqrt(blur + (k.size_spread * tables.size) ** 2 + k.carry_spread**2 * speed2),
        velocity=state.v[:, :2],
        stop=stop,
        mass=mass,
        times=times[:, tables.level_start[:-1]],
        leaving=mass * T,
        away=away,
    )
    return Flight(targets=targets, shape=shape, D=D, F=F, place=place), landing


def land(tables: DropTables, constants: DropConstants, state: Release) -> Landing:
    """Compute the landing of the object for each state; requires at least one target."""
    return fly(tables, constants, state)[1]
