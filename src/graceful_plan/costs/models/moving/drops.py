r"""Whom of those that move the carried object hits if the gripper lets go here, at this velocity, at this time.

The drop model (the docstring of `costs.models.drop` specifies it), with its constants, applied to a moving entity: an
upright box or cylinder with half sizes a, b, top Z and bottom B. It is at p(t) in W, off its prediction by as many
standard deviations sigma(t) all the while: P is the mean over some places of equal weight (`whereabouts.py`), without
those where robot or object would have touched it before anything failed. Directions u_i, seen from above, stand for
its shape (`outline.py`); A_i is how far it reaches in each. A disc has four, turned to how object and entity pass each
other; a box has those of its own and, as a bound, the one across that passage.

.. code-block:: text

    t            when the gripper lets go;  T1 = fall(bottom - Z) + delay, T2: when it comes down on what is static
    W            P that it comes down on something lower than Z, or on nothing
    sweep(x0, x1, A, s) = product over i of box(u_i . (x0 + x1)/2, A_i + |u_i . (x1 - x0)|/2, s)
                 the object is within A of the entity at some time while its place relative to it goes from x0 to x1
    sp           standard deviation of what one place stands for; all of sigma where there is but one place

    1. Flight    D = max over parts of sweep(r(T1), r(T2), A + part, s) S((top of the part - B)/0.02)
                 r(T) = c + o + (v + w x o) T - p(t + T),  s^2 = s0^2 + (sv T)^2 + sp^2
    2. Falls     G = min(B_l sweep(L' - p(t + T2 + 0.15), L' - p(t + T2 + 0.45), A + kb size, (sd^2 + sp^2)^(1/2)),
                         M_l P(it comes down on the entity, and not where a wide top above it is))
                 B_l, L': what left supports higher than B and whereto, caught by wide tops as in the drop model; M_l
                 what left them, caught or not: nothing falls through a table on whom it covers, only over its edge
    3. Sides     H = (W' - W D) S((zs + height - B)/sh) sweep(..., A + (kl + tk Tm) size, ...)
                 from where it comes down to where it comes to rest, 0.3 s later
    P(carried) = 1 - (1 - W D)(1 - G)(1 - H);  P(contents) = P(carried), as they fall together

While the object falls, the entity goes on. What is static and higher than the entity catches the object by the mass of
its level, wherever that stands: a shelf beside a person hides as much of her as one above her. Nothing is known of what
is hit first if several entities are in its way, nor of those that step aside, or onto what lies on the floor.

P(body) is a rule of thumb (`arm.py`): near a moving link, within 0.15 m, give or take 0.1 m, and not above it. It says
where a collapsing arm could reach somebody, not how likely it does.

Without a time, P is the mean over the predicted path, with equal weights in time; the places take turns along it, and
none of them is taken for touched.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import final

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.functions import box, fall_time, part_reach, positive, step
from graceful_plan.costs.models.drop.landing import LEAST_MASS, Landing, land, loose
from graceful_plan.costs.models.drop.release import Release, heights, release
from graceful_plan.costs.models.drop.sides import no_stop
from graceful_plan.costs.models.drop.tables import DropTables, drop_tables
from graceful_plan.costs.models.moving.arm import near_links
from graceful_plan.costs.models.moving.outline import Outline, sweep
from graceful_plan.costs.models.moving.whereabouts import PLACES, OffPrediction, off_predictions, touched
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray

ROAM_TIME = 0.3
"""How long the object takes from where it comes down to where it comes to rest, or to fall on [s]."""
MOST_SAMPLES = 64
"""Places that stand for a predicted path."""
_SAMPLE_STEP = 0.025, 0.1  # least and greatest distance between those places [m]
_LEVEL_SOFT = 0.01  # how sharply a level counts as no higher than the entity [m]
_SIDE_SOFT = 0.02  # how sharply the object passes above or below it [m]
_STANDS_ON = 0.1  # what is less than this above an entity's bottom is what it stands on [m]
_NOTHING = 1e-9  # probability that does not count
_FAR = 8.0  # standard deviations beyond which nothing is hit
_STATES = 20_000  # states times targets that are worked on at once
_CHUNK = 50_000  # pairs of states and times that are worked on at once


def moving_probability(
    batch: StateBatch,
    settings: DropSettings,
    components: Collection[str] = ("carried", "contents", "body"),
    places: int = PLACES,
) -> Float[Array, "n component moving"]:
    """Return P(component hits moving entity) given that the gripper lets go, or for the body that the arm collapses.

    Args:
        batch: States; their times, if they have any, are on the clock of the predictions.
        settings: Constants of the drop model.
        components: Which to compute; the others are 0.
        places: How many stand for where somebody may be who is expected somewhere.
    """
    scene = batch.scene
    P = np.zeros((len(batch), len(scene.components), len(scene.moving)))
    if not P.size:
        return P
    rows = {name: row for row, name in enumerate(scene.components) if name in components}
    falling = [row for name, row in rows.items() if name != "body"]
    drops = _drops(batch, settings) if falling and scene.carried is not None else None
    for column, entity in enumerate(scene.moving.values()):
        times = path_times(entity) if batch.time is None else batch.time[:, None]
        times = np.broadcast_to(times, (len(batch), times.shape[-1]))
        if drops is not None:
            P[:, falling, column] = _mean_hit(batch, drops, entity, times, places)[:, None]
        if "body" in rows:
            P[:, rows["body"], column] = mean_over_times(lambda *pairs: near_links(batch, *pairs), entity, times)
    return P


def path_times(entity: MovingEntity) -> Float[Array, "1 k"]:
    """Return the middles of equal intervals of the predicted path [s]."""
    duration = entity.t[-1] - entity.t[0]
    length = np.linalg.norm(np.diff(entity.position, axis=0), axis=1).sum() + entity.growth * duration
    length += np.abs(np.diff(entity.yaw)).sum() * np.linalg.norm(entity.half_size[:2])
    step = np.clip(0.5 * entity.half_size[:2].min(), *_SAMPLE_STEP)
    count = int(np.clip(np.ceil(length / step), 1, MOST_SAMPLES))
    return entity.t[:1, None] + duration * (np.arange(count)[None] + 0.5) / count


def mean_over_times(
    probability: Callable[[MovingEntity, Int[Array, " pair"], Float[Array, " pair"]], Float[Array, " pair"]],
    entity: MovingEntity,
    times: Float[Array, "n k"],
) -> Float[Array, " n"]:
    """Return the mean over each state's times of a probability that is asked for pairs of states and times."""
    state, flat = np.repeat(np.arange(len(times)), times.shape[1]), times.ravel()
    chunks = [slice(i, i + _CHUNK) for i in range(0, len(flat), _CHUNK)]
    return np.concatenate([probability(entity, state[c], flat[c]) for c in chunks]).reshape(times.shape).mean(axis=1)


def _mean_hit(
    batch: StateBatch, drops: _Drops, entity: MovingEntity, times: Float[Array, "n k"], places: int
) -> Float[Array, " n"]:
    """Return P that an entity is hit, the mean over each state's times and over where it may be then."""
    who, whole = off_predictions(entity, times, batch.time is not None, places)
    shape, time = whole.shape, whole.ravel()
    state = np.repeat(np.arange(len(whole)), shape[1])
    chunks = [np.arange(i, min(i + _CHUNK, len(state))) for i in range(0, len(state), _CHUNK)]
    P = np.concatenate([drops.hit(who.only(c), state[c], time[c]) for c in chunks]).reshape(shape)
    if batch.time is None or shape[1] == 1:
        return P.mean(axis=1)
    free = np.ones(shape)
    met = np.flatnonzero(np.repeat(P.max(axis=1) > _NOTHING, shape[1]))
    for c in (met[i : i + _CHUNK] for i in range(0, len(met), _CHUNK)):
        free.ravel()[c] = ~touched(batch, who.only(c), state[c], time[c])
    free[~free.any(axis=1)] = 1.0  # then the prediction is wrong, and nothing better is known
    return (P * free).sum(axis=1) / free.sum(axis=1)


# --- the object -------------------------------------------------------------------------------------------------------


def _drops(batch: StateBatch, settings: DropSettings) -> _Drops:
    return batch.kept.get(_Drops, settings, lambda: _Drops(batch, settings))


@final
class _Drops:
    """Drops from the states of a batch; what does not depend on who moves is computed once, where it is needed.

    Searches ask for the same states at many times: what is equal is computed once.
    """

    def __init__(self, batch: StateBatch, settings: DropSettings) -> None:
        self.tables = drop_tables(batch.scene)
        self.constants = settings.of(self.tables.shape_class)
        _, first, self.equal = np.unique(
            np.concatenate([batch.q, batch.qd], axis=1), axis=0, return_index=True, return_inverse=True
        )
        self.state = release(batch, self.tables).only(first)
        self.size = max(1, _STATES // max(1, len(self.tables.target_entity)))
        self.fallen: dict[int, _Fallen] = {}

    def hit(self, who: OffPrediction, state: Int[Array, " pair"], time: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """P that an entity is hit, for pairs of a state and the time of the drop."""
        found, state = np.zeros(len(state)), self.equal[state]
        near = np.flatnonzero(self._near(who, state, time))
        block = state[near] // self.size
        for b in np.unique(block).tolist():
            if b not in self.fallen:
                rows = np.arange(b * self.size, min((b + 1) * self.size, len(self.state.c)))
                self.fallen[b] = _Fallen(self.tables, self.constants, self.state.only(rows))
            pairs = near[block == b]
            found[pairs] = self.fallen[b].hit(who.only(pairs), state[pairs] - b * self.size, time[pairs])
        return found

    def _near(self, who: OffPrediction, state: Int[Array, " pair"], time: Float[Array, " pair"]) -> Array:
        """Tell for which pairs P may be more than some 1e-6."""
        k, release, size, entity = self.constants, self.state, self.tables.size, who.entity
        lowest = min(self.tables.target_height[:, 1].min(initial=np.inf), entity.lowest)
        height = np.maximum(release.c[:, 2] - lowest, 0.0)
        duration = fall_time(release.v[:, 2], height) + k.delay + 2.0 * ROAM_TIME
        speed = np.linalg.norm(release.v[:, :2], axis=1)
        blur = k.position_spread**2 + (k.velocity_spread * duration) ** 2 + (k.height_spread * height) ** 2
        blur = blur + (k.carry_spread * speed) ** 2 + (k.size_spread**2 + k.side_spread**2) * size**2
        blur = blur[state] + who.spread(time + duration[state]) ** 2
        reach = np.linalg.norm(entity.half_size[:2]) + 4.0 * size + _FAR * np.sqrt(blur)
        grown = np.linalg.norm(who.off, axis=1) * entity.growth  # off ever farther
        reach = reach + (entity.top_speed + grown + speed[state]) * duration[state]
        return np.linalg.norm(release.c[state, :2] - who.at(time), axis=1) < reach


@final
class _Fallen:
    """What becomes of drops among what is static, and of those who walk into them."""

    def __init__(self, tables: DropTables, constants: DropConstants, state: Release) -> None:
        self.tables, self.constants, self.state = tables, constants, state
        self.landing, self.B, self.N = _landing(tables, constants, state)
        self.level = tables.target_height[tables.level_start[:-1], 1]
        self.bottom, self.top = heights(state, tables)
        self.low, self.high = self.bottom.min(axis=1), self.top.max(axis=1)

    def hit(self, who: OffPrediction, state: Int[Array, " pair"], time: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """P that an entity is hit, for pairs of a state and the time of the drop."""
        entity, there = who.entity, who.entity.at(time)
        outline, Z = Outline(entity, there.yaw), there.position[:, 2] + entity.half_size[2]
        lower = self.landing.mass[state] * step((Z[:, None] - self.level) / _LEVEL_SOFT + 2.0)
        nothing = np.clip(1.0 - self.landing.mass.sum(axis=1), 0.0, 1.0)[state]
        bottom = Z - 2.0 * entity.half_size[2]
        fallen = fall_time(self.state.v[state, 2], self.low[state] - bottom) + self.constants.delay
        W = lower.sum(axis=1)
        down = ((lower * self.landing.times[state]).sum(axis=1) + nothing * fallen) / (W + nothing + LEAST_MASS)
        D = (W + nothing) * self._flight(who, outline, state, time, (bottom, Z), down)
        G = self._falls(who, outline, state, time, bottom, Z)
        H = np.maximum(W - D, 0.0) * self._sides(who, outline, state, time, bottom)
        return np.clip(1.0 - (1.0 - D) * (1.0 - G) * (1.0 - H), 0.0, 1.0)

    def _flight(
        self,
        who: OffPrediction,
        outline: Outline,
        state: Int[Array, " pair"],
        time: Float[Array, " pair"],
        height: tuple[Float[Array, " pair"], Float[Array, " pair"]],
        down: Float[Array, " pair"],
    ) -> Float[Array, " pair"]:
        k, release, tables = self.constants, self.state, self.tables
        D = np.zeros(len(state))
        u = outline.directions(release.v[state, :2] * down[:, None] - who.at(time + down) + who.at(time))
        u3 = np.concatenate([u, np.zeros((*u.shape[:2], 1))], axis=-1)
        body = outline.reach(u)
        for p in range(release.offset.shape[1]):
            start = release.c[:, :2] + release.offset[:, p, :2]
            v = (release.v + np.cross(release.w, release.offset[:, p]))[state, :2]
            first = fall_time(release.v[state, 2], self.bottom[state, p] - height[1]) + k.delay
            last = np.maximum(down, first)
            middle = 0.5 * (first + last)
            s = np.sqrt(k.position_spread**2 + (k.velocity_spread * middle) ** 2 + who.spread(time + middle) ** 2)
            ends = tuple(start[state] + v * T[:, None] - who.at(time + T) for T in (first, last))
            reach = body + part_reach(release.axes[state, p], tables.part_half[p], int(tables.part_kind[p]), u3)
            over = step((self.top[state, p] - height[0]) / _SIDE_SOFT)
            np.maximum(D, sweep(u, (ends[0], ends[1]), reach, s) * over, out=D)
        return D

    def _falls(
        self,
        who: OffPrediction,
        outline: Outline,
        state: Int[Array, " pair"],
        time: Float[Array, " pair"],
        bottom: Float[Array, " pair"],
        top: Float[Array, " pair"],
    ) -> Float[Array, " pair"]:
        k, size = self.constants, self.tables.size
        higher = np.searchsorted(-self.level, -np.minimum(top, bottom + _STANDS_ON))
        B = self.B[state, higher]
        if not (B > _NOTHING).any():
            return np.zeros(len(state))
        point = self.landing.falls_to(k, size, self.B[..., None], self.N)[state, higher]
        t = time + self.landing.time[state, 0] + ROAM_TIME
        r1, r2 = (point - who.at(t + dt) for dt in (-0.5 * ROAM_TIME, 0.5 * ROAM_TIME))
        spread = np.hypot(self.landing.fall_spread[state, 0], who.spread(t))
        u = outline.directions(r2 - r1)
        G = B * sweep(u, (r1, r2), outline.reach(u, np.full(len(state), k.tumble_reach * size)), spread)
        left = np.concatenate([np.zeros((len(self.B), 1)), np.cumsum(self.landing.leaving, axis=1)], axis=1)
        return np.minimum(G, left[state, higher] * self._beyond(outline, (r1, r2), point, spread, higher))

    def _beyond(
        self,
        outline: Outline,
        ends: tuple[Float[Array, "pair 2"], Float[Array, "pair 2"]],
        point: Float[Array, "pair 2"],
        spread: Float[Array, " pair"],
        higher: Int[Array, " pair"],
    ) -> Float[Array, " pair"]:
        """P that what falls off comes down on the entity, and not on what is above it: beyond each wide top's edge."""
        tables, margin = self.tables, self.constants.catch_margin * self.tables.size
        centre, move = point - 0.5 * (ends[0] + ends[1]), np.abs(ends[1] - ends[0])
        beyond = np.ones(len(point))
        for k in np.flatnonzero(tables.target_carries.min(axis=1) > tables.size):
            c, s = tables.target_axis[k]
            axes = np.array([[c, s], [-s, c]])
            u = np.broadcast_to(axes, (len(point), 2, 2))
            reach = outline.reach(u, np.full(len(point), self.constants.tumble_reach * tables.size))
            reach = reach + 0.5 * move @ np.abs(axes).T
            entity = (centre - tables.target_centre[k]) @ axes.T
            there = (point - tables.target_centre[k]) @ axes.T
            edge = positive(tables.target_carries[k] + margin)
            low, high = np.maximum(entity - reach, -edge), np.minimum(entity + reach, edge)
            whole = box(there - entity, reach, spread[:, None]).prod(axis=1)
            covered = box(there - 0.5 * (low + high), 0.5 * (high - low), spread[:, None]).prod(axis=1)
            covered = np.where((high > low).all(axis=1), covered, 0.0)
            above = np.searchsorted(tables.level_start, k, side="right") - 1 < higher
            np.minimum(beyond, np.where(above, np.maximum(whole - covered, 0.0), 1.0), out=beyond)
        return beyond

    def _sides(
        self,
        who: OffPrediction,
        outline: Outline,
        state: Int[Array, " pair"],
        time: Float[Array, " pair"],
        bottom: Float[Array, " pair"],
    ) -> Float[Array, " pair"]:
        k, size, L = self.constants, self.tables.size, self.landing
        leaves = L.leaving.sum(axis=1) / L.total[:, 0]
        drift = np.einsum("nl,nli->ni", L.leaving, L.away) / L.total
        down = time + L.time[state, 0]
        rest = (L.goes_on(k.slide) + k.drift * size * drift)[state]
        ends = L.point[state] - who.at(down), rest - who.at(down + ROAM_TIME)
        spread = L.blur[:, 0] + (k.side_spread * size) ** 2 + (k.size_spread * size * leaves) ** 2
        spread = np.sqrt(spread[state] + who.spread(down + ROAM_TIME) ** 2)
        u = outline.directions(ends[1] - ends[0])
        reach = outline.reach(u, ((k.side_reach + k.topple_reach * leaves) * size)[state])
        above = (L.height[:, 0] + self.high - self.low)[state] - bottom
        return step(above / k.side_height) * sweep(u, ends, reach, spread)


def _landing(
    tables: DropTables, constants: DropConstants, state: Release
) -> tuple[Landing, Float[Array, "n levels"], Float[Array, "n levels 2"]]:
    """Return where the object comes down, with B and N of the drop model; also where there is nothing to land on."""
    if len(tables.target_height):
        landing = land(tables, constants, state)
        return landing, *loose(tables, constants, landing)
    n, none = len(state.c), np.zeros((len(state.c), 1))
    spread = np.full((n, 1), constants.position_spread)
    landing = Landing(
        point=state.c[:, :2],
        total=none + LEAST_MASS,
        height=none,
        time=none,
        blur=spread**2,
        fall_spread=spread,
        velocity=state.v[:, :2],
        stop=no_stop(n),
        mass=np.zeros((n, 0)),
        times=np.zeros((n, 0)),
        leaving=np.zeros((n, 0)),
        away=np.zeros((n, 0, 2)),
    )
    return landing, none, np.zeros((n, 1, 2))
