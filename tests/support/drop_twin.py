"""The drop model as a whole in NumPy: an oracle of the native kernel that is fast enough for many states.

It starts from the result of `landing`: entities touched, hit by a part that falls off, and swept from the side.
shares no code with either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from graceful_plan.array_types import Float
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.functions import box, positive, step
from graceful_plan.costs.models.drop.landing import Flight, Landing, fly
from graceful_plan.costs.models.drop.outlines import Targets
from graceful_plan.costs.models.drop.release import Release, heights, release
from graceful_plan.costs.models.drop.tables import DropTables, drop_tables

Array = np.ndarray

WIDE = 0.1
"""Narrower half size at which the probability of ending a fall is halfway between `catch` and 1 [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Dropped:
    """Results of a drop.

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


def dropped(batch: gp.StateBatch, settings: DropSettings | None = None) -> Dropped:
    """Return the results for the carried object of a scene, with shipped constants by default."""
    tables = drop_tables(batch.scene)
    constants = (settings or DropSettings.shipped()).of(tables.shape_class)
    entity = np.zeros((len(batch), len(batch.scene.entities)))
    if not len(tables.target_height):
        none = np.zeros((len(batch), 0))
        return Dropped(first=none, contact=none, hit=none, entity=entity)
    state = release(batch, tables)
    flight, landing = fly(tables, constants, state)
    C = _contact(flight)
    G, H = _falls(flight, constants, landing), _sides(flight, constants, landing, state, C)
    hit = 1.0 - (1.0 - C) * (1.0 - G) * (1.0 - H)
    first = np.zeros_like(entity)
    for k, owner in enumerate(tables.target_entity):
        if owner >= 0:
            np.maximum(entity[:, owner], hit[:, k], out=entity[:, owner])
            first[:, owner] += flight.F[:, k]
    np.maximum(entity, first, out=entity)
    return Dropped(first=flight.F, contact=C, hit=hit, entity=entity)


def _contact(flight: Flight) -> Float[Array, "n target"]:
    """Return C: P that a target is touched in the first contact."""
    missed = flight.targets.product(1.0 - flight.D)
    arrives = np.cumprod(np.concatenate([np.ones((len(missed), 1)), missed[:, :-1]], axis=1), axis=1)
    return flight.targets.spread(arrives) * flight.D


def _falls(flight: Flight, constants: DropConstants, landing: Landing) -> Float[Array, "n target"]:
    """Return G: P that a target is hit by an object that has left a higher one."""
    targets, tables = flight.targets, flight.targets.tables
    a, b = tables.target_half.T
    B, N = loose(tables, constants, landing)
    point = landing.falls_to(constants, tables.size, B[..., None], N)
    x, y = targets.place(point[:, targets.level])
    reach = constants.tumble_reach * tables.size
    return B[:, targets.level] * box(x, a + reach, landing.fall_spread) * box(y, b + reach, landing.fall_spread)


def catching(tables: DropTables, constants: DropConstants) -> Float[Array, " target"]:
    """Return P that each target ends a fall onto its middle."""
    narrow = tables.target_carries.min(axis=1)
    return constants.catch + (1.0 - constants.catch) * narrow**2 / (narrow**2 + WIDE**2)


def loose(
    tables: DropTables, constants: DropConstants, landing: Landing
) -> tuple[Float[Array, "n levels"], Float[Array, "n levels 2"]]:
    """Return B [n level+1] and N [n level+1 2]: the falling mass above each level, and last below all levels."""
    k, size, targets = constants, tables.size, Targets(tables)
    a_top, b_top = tables.target_carries.T
    catches = catching(tables, constants)
    B, N = [np.zeros((len(landing.point), 1))], [np.zeros((len(landing.point), 2))]
    for level, (first, last) in enumerate(zip(tables.level_start[:-1], tables.level_start[1:], strict=True)):

        def missed(place: Float[Array, "n 2"], here: slice = slice(first, last)) -> Float[Array, "n 1"]:
            """P that the level does not end a fall at a place."""
            x, y = (value[:, here] for value in targets.place(place))
            inside = box(x, positive(a_top[here] + k.catch_margin * size), landing.fall_spread)
            inside *= box(y, positive(b_top[here] + k.catch_margin * size), landing.fall_spread)
            return np.prod(1.0 - catches[here] * inside, axis=1, keepdims=True)

        keep, away = missed(landing.falls_to(k, size, B[-1], N[-1])), landing.away[:, level]
        M = landing.leaving[:, level, None] * missed(landing.goes_on(k.carry) + k.drift * size * away)
        B.append(B[-1] * keep + M)
        N.append(N[-1] * keep + M * away)
    return np.concatenate(B, axis=1), np.stack(N, axis=1)


def _sides(
    flight: Flight, constants: DropConstants, landing: Landing, state: Release, C: Float[Array, "n target"]
) -> Float[Array, "n target"]:
    """Return H: P that a target is swept from the side, if the object lands beside it."""
    targets, tables = flight.targets, flight.targets.tables
    k, size, place = constants, tables.size, flight.place
    below = np.maximum(targets.spread(np.cumsum(landing.mass[:, ::-1], axis=1)[:, ::-1]) - C, 0.0)
    leaves = landing.leaving.sum(axis=1, keepdims=True) / landing.total
    drift = np.einsum("nl,nli->ni", landing.leaving, landing.away) / landing.total
    x, y = targets.place(landing.goes_on(k.slide) + k.drift * size * drift)
    sd = np.sqrt(landing.blur + (k.side_spread * size) ** 2 + (k.size_spread * size * leaves) ** 2)
    reach = (k.side_reach + k.topple_reach * leaves) * size
    (a, b), bottom = tables.target_half.T, tables.target_height[:, 0]
    low, high = heights(state, tables)
    tall = high.max(axis=1, keepdims=True) - low.min(axis=1, keepdims=True)
    H = step((landing.height + tall - bottom) / k.side_height) * below
    H *= box(0.5 * (place[0] + x), a + 0.5 * np.sqrt((x - place[0]) ** 2 + 1e-6) + reach, sd)
    H *= box(0.5 * (place[1] + y), b + 0.5 * np.sqrt((y - place[1]) ** 2 + 1e-6) + reach, sd)
    met = landing.stop.met(landing.time[:, 0], landing.mass.sum(axis=1))
    row, side = np.arange(len(H)), landing.stop.target
    H[row, side] = np.maximum(H[row, side], met)
    return H
