"""The spill model in NumPy: an oracle of the native kernel that is fast enough for many states.

It starts from the landing of the container by `landing`. `spill_oracle` shares no code with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropConstants
from graceful_plan.costs.models.drop.functions import GRAVITY, box, positive, step
from graceful_plan.costs.models.drop.landing import LEAST_MASS, Landing, fly
from graceful_plan.costs.models.drop.release import release
from graceful_plan.costs.models.drop.tables import DropTables
from graceful_plan.costs.models.spill.constants import SpillConstants
from graceful_plan.costs.models.spill.tables import SpillTables

Array = np.ndarray


class Poured(NamedTuple):
    """Inputs of a spill, apart from the constants of its use.

    | field    | meaning                                                     | unit | shape       |
    |----------|-------------------------------------------------------------|------|-------------|
    | landing  | where the container would come down                         |      |             |
    | low      | height of its lowest point at release                       | m    | n 1         |
    | fallen   | hs: height of fall, on average                              | m    | n 1         |
    | mouth    | m: the middle of the contents' top                          | m    | n 3         |
    | velocity | vm: its velocity                                            | m/s  | n 3         |
    | up       | z: cosine of the container's tilt                           |      | n 1         |
    | falling  | vz: vertical velocity of the object's centre of mass        | m/s  | n 1         |
    """

    landing: Landing
    low: Float[Array, "n 1"]
    fallen: Float[Array, "n 1"]
    mouth: Float[Array, "n 3"]
    velocity: Float[Array, "n 3"]
    up: Float[Array, "n 1"]
    falling: Float[Array, "n 1"]


def pour(batch: StateBatch, tables: DropTables, spill: SpillTables, constants: DropConstants) -> Poured:
    """Return the inputs of spills, for a scene with something to land on."""
    state = release(batch, tables)
    flight, landing = fly(tables, constants, state)
    low = flight.shape.low
    R = batch.link_poses[:, tables.link, :3, :3]
    offset = R @ spill.mouth
    return Poured(
        landing=landing,
        low=low,
        fallen=(flight.F * np.maximum(low - flight.targets.top, 0.0)).sum(axis=1, keepdims=True) / landing.total,
        mouth=state.c + offset,
        velocity=state.v + np.cross(state.w, offset),
        up=(R @ spill.axis)[:, 2:],
        falling=state.v[:, 2:],
    )


def spread_out(
    tables: DropTables,
    spill: SpillTables,
    constants: SpillConstants,
    poured: Poured,
    lost: Float[Array, " n"] | None = None,
) -> Float[Array, "n target"]:
    """Return P that contents reach each target: all contents, or the share that a stop spills."""
    k, place = constants, _Places(tables, poured.mouth)
    speed2 = (poured.velocity[:, :2] ** 2).sum(axis=1, keepdims=True)
    rho = _radius(spill, k, poured.up, speed2)
    if lost is not None:
        rho = spill.radius * (lost[:, None] + 0.01) ** spill.power
    s = k.position_spread**2 + (k.rim_spread * spill.rim) ** 2 + k.speed_spread**2 * speed2
    s = np.sqrt(s + (k.height_spread * poured.fallen) ** 2)
    arrives, L = _arrivals(tables, k, poured)
    n, (a, b) = len(L), tables.target_half.T
    A, B = np.zeros((n, len(a))), np.zeros((n, len(a)))
    mass, o, U, W = np.zeros((n, 1)), np.zeros((n, 2)), [], []  # mass: O
    inner = spill.radius * k.edge
    for level, (first, last) in enumerate(zip(tables.level_start[:-1], tables.level_start[1:], strict=True)):
        here, come = slice(first, last), arrives[:, level, None]
        x, y = place(L[:, level, None], here)
        A[:, here] = come * box(x, a[here] + k.margin, s) * box(y, b[here] + k.margin, s)
        flows = o / (mass + LEAST_MASS)
        x, y = place(flows[:, None], here)
        onto = spill.visible[here] * box(x, a[here] + k.run_off * rho, s) * box(y, b[here] + k.run_off * rho, s)
        B[:, here] = mass * onto
        past = np.prod(1.0 - onto, axis=1, keepdims=True)
        U.append(come + mass * (1.0 - past))
        W.append(come * L[:, level] + mass * (1.0 - past) * flows)
        x, y = place((W[-1] / (U[-1] + LEAST_MASS))[:, None], here)
        wide = np.minimum(a[here], b[here]) > inner
        over = np.prod(1.0 - wide * box(x, a[here] - inner, s) * box(y, b[here] - inner, s), axis=1, keepdims=True)
        mass, o = mass * past + U[-1] * over, o * past + W[-1] * over
    D = _standing(tables, spill, place, np.concatenate(U, axis=1), np.stack(W, axis=1), k.reach * rho, s)
    return 1.0 - (1.0 - A) * (1.0 - B) * (1.0 - D)


def _radius(spill: SpillTables, k: SpillConstants, up: Array, speed2: Array) -> Float[Array, "n 1"]:
    """Return rho: the radius of a puddle of the contents."""
    up = 0.5 * (up + np.sqrt(up * up + 0.01))  # above 0, and below the root of 1.0051
    lean = np.maximum(np.sqrt(1.0051 - up * up) / up - spill.repose, 0.0) + k.slosh * np.sqrt(speed2 + 1e-4)
    x = spill.rim * lean / spill.depth
    fill = (1.0 + x + x * x + 1.7 * x**3) / spill.full
    return spill.radius * (1.0 + fill**4) ** (-0.25 * spill.power)


def _arrivals(tables: DropTables, k: SpillConstants, poured: Poured) -> tuple[Array, Array]:
    """Return a [n level] and L [n level 2]."""
    landing = poured.landing
    top = tables.target_height[tables.level_start[:-1], 1]
    u = np.sqrt(poured.falling**2 + 2.0 * GRAVITY * positive(poured.low - top))
    hard = step((u - k.soft_speed) / k.soft_spread)
    time = landing.times + k.carry
    arrives = landing.mass * hard + landing.leaving * (1.0 - hard)
    return arrives, poured.velocity[:, None, :2] * time[..., None] + landing.stop.pushed(time)


def _standing(
    tables: DropTables, spill: SpillTables, place: _Places, U: Array, W: Array, reach: Array, s: Array
) -> Float[Array, "n target"]:
    """Return D: P that contents hit targets at their landing place."""
    sums = np.cumsum(np.concatenate([np.zeros((len(U), 1)), U], axis=1), axis=1)
    weighed = np.cumsum(np.concatenate([np.zeros((len(W), 1, 2)), W], axis=1), axis=1)
    first, end = spill.stands.T
    U, W = sums[:, end] - sums[:, first], weighed[:, end] - weighed[:, first]
    x, y = place(W / (U + LEAST_MASS)[..., None], slice(None))
    a, b = tables.target_half.T
    return np.minimum(U, 1.0) * box(x, a + reach, s) * box(y, b + reach, s)


class _Places:
    """Transform points [n target 2] or [n 1 2], relative to m in W, to the axes of targets, seen from above."""

    def __init__(self, tables: DropTables, mouth: Float[Array, "n 3"]) -> None:
        self._mouth, self._centre, self._axis = mouth[:, None, :2], tables.target_centre, tables.target_axis

    def __call__(self, point: Array, here: slice) -> tuple[Array, Array]:
        away, (c, n) = self._mouth + point - self._centre[here], self._axis[here].T
        return c * away[..., 0] + n * away[..., 1], c * away[..., 1] - n * away[..., 0]
