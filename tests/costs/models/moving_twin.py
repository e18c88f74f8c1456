"""Probabilities that failures hit moving entities, in NumPy: the twin of the native models.

Symbols as in `costs.models.moving.drops`, which specifies it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import final

import numpy as np
from drop_twin import loose

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.functions import box, fall_time, part_reach, positive, step
from graceful_plan.costs.models.drop.landing import LEAST_MASS, Landing, land
from graceful_plan.costs.models.drop.release import Release, heights, release
from graceful_plan.costs.models.drop.sides import SideStop
from graceful_plan.costs.models.drop.tables import DropTables, drop_tables
from graceful_plan.costs.models.moving.outlines import outlines
from graceful_plan.costs.models.moving.position_samples import PLACES, cell_of, normal_places, path_times
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray

BODY_REACH, BODY_SPREAD = 0.15, 0.1
"""Reach of a collapsing arm beyond its links, and its standard deviation [m]."""
ROAM_TIME = 0.3
"""Time from landing until the object comes to rest or falls on [s]."""
_SHARP = 0.01
"""Entities with a smaller standard deviation are evaluated at one place [m]."""
_AT_ONCE = 200_000
"""Pairs times spheres per chunk, to bound memory."""
_LEVEL_SOFT = 0.01  # width of the step that compares a level with the entity's height [m]
_SIDE_SOFT = 0.02  # width of the step that lets the object pass above or below the entity [m]
_STANDS_ON = 0.1  # tops less than this above the entity's bottom are what it stands on [m]
_NOTHING = 1e-9  # negligible probability
_FAR = 8.0  # standard deviations beyond which nothing is hit
_STATES = 20_000  # states times targets per block
_CHUNK = 50_000  # pairs of states and times per chunk
_FOUR = np.pi * np.array([0.0, 0.5, 0.25, 0.75])
_LEAST_MOVE = 1e-9  # entities that move less have no direction [m]


def moving_probability(
    batch: StateBatch,
    settings: DropSettings,
    components: Collection[str] = ("carried", "contents", "body"),
    places: int = PLACES,
) -> Float[Array, "n component moving"]:
    """Return P(component hits moving entity) given that the gripper lets go, or for the body that the arm collapses.

    Args:
        batch: States; if they have times, these use the clock of the predictions.
        settings: Constants of the drop model.
        components: Which to compute; the others are 0.
        places: Number of places per time that sample an uncertain entity.
    """
    scene = batch.scene
    P = np.zeros((len(batch), len(scene.components), len(scene.moving)))
    if not P.size:
        return P
    rows = {name: row for row, name in enumerate(scene.components) if name in components}
    falling = [row for name, row in rows.items() if name != "body"]
    drops = _drops(batch, settings) if falling and scene.carried is not None else None
    for column, entity in enumerate(scene.moving.values()):
        times = path_times(entity)[None] if batch.time is None else batch.time[:, None]
        times = np.broadcast_to(times, (len(batch), times.shape[-1]))
        if drops is not None:
            P[:, falling, column] = _mean_hit(batch, drops, entity, times, places)[:, None]
        if "body" in rows:
            P[:, rows["body"], column] = mean_over_times(lambda *pairs: near_links(batch, *pairs), entity, times)
    return P


def mean_over_times(
    probability: Callable[[MovingEntity, Int[Array, " pair"], Float[Array, " pair"]], Float[Array, " pair"]],
    entity: MovingEntity,
    times: Float[Array, "n k"],
) -> Float[Array, " n"]:
    """Average a probability of pairs (state, time) over the times of each state."""
    state, flat = np.repeat(np.arange(len(times)), times.shape[1]), times.ravel()
    chunks = [slice(i, i + _CHUNK) for i in range(0, len(flat), _CHUNK)]
    return np.concatenate([probability(entity, state[c], flat[c]) for c in chunks]).reshape(times.shape).mean(axis=1)


def _mean_hit(
    batch: StateBatch, drops: _Drops, entity: MovingEntity, times: Float[Array, "n k"], places: int
) -> Float[Array, " n"]:
    """Return P that an entity is hit, averaged over each state's times and the entity's possible places."""
    P = np.zeros(len(batch))
    certain = entity.at(times.max(axis=1, initial=entity.t[0])).spread < _SHARP
    for alike in (certain, ~certain):
        rows = np.flatnonzero(alike)
        if len(rows):
            P[rows] = _mean_hit_alike(batch, drops, entity, rows, times[rows], places)
    return P


def _mean_hit_alike(
    batch: StateBatch,
    drops: _Drops,
    entity: MovingEntity,
    rows: Int[Array, " m"],
    times: Float[Array, "m k"],
    places: int,
) -> Float[Array, " m"]:
    who, whole = off_predictions(entity, times, batch.time is not None, places)
    shape, time = whole.shape, whole.ravel()
    state = np.repeat(rows, shape[1])
    chunks = [np.arange(i, min(i + _CHUNK, len(state))) for i in range(0, len(state), _CHUNK)]
    P = np.concatenate([drops.hit(who.only(c), state[c], time[c]) for c in chunks]).reshape(shape)
    if batch.time is None or shape[1] == 1:
        return P.mean(axis=1)
    free = np.ones(shape)
    met = np.flatnonzero(np.repeat(P.max(axis=1) > _NOTHING, shape[1]))
    for c in (met[i : i + _CHUNK] for i in range(0, len(met), _CHUNK)):
        free.ravel()[c] = ~touched(batch, who.only(c), state[c], time[c])
    free[~free.any(axis=1)] = 1.0  # the prediction contradicts the state: use all places
    return (P * free).sum(axis=1) / free.sum(axis=1)


# --- the object -------------------------------------------------------------------------------------------------------


def _drops(batch: StateBatch, settings: DropSettings) -> _Drops:
    return batch.kept.get(_Drops, settings, lambda: _Drops(batch, settings))


@final
class _Drops:
    """Drops from the states of a batch. What does not depend on the entity is computed once, on first use.

    Searches evaluate the same states at many times, so equal states are computed once.
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
        """Return P that an entity is hit, for pairs of a state and the time of the drop."""
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
        """Return for which pairs P may exceed about 1e-6."""
        k, release, size, entity = self.constants, self.state, self.tables.size, who.entity
        lowest = min(self.tables.target_height[:, 1].min(initial=np.inf), entity.lowest)
        height = np.maximum(release.c[:, 2] - lowest, 0.0)
        duration = fall_time(release.v[:, 2], height) + k.delay + 2.0 * ROAM_TIME
        speed = np.linalg.norm(release.v[:, :2], axis=1)
        blur = k.position_spread**2 + (k.velocity_spread * duration) ** 2 + (k.height_spread * height) ** 2
        blur = blur + (k.carry_spread * speed) ** 2 + (k.size_spread**2 + k.side_spread**2) * size**2
        blur = blur[state] + who.spread(time + duration[state]) ** 2
        reach = np.linalg.norm(entity.half_size[:2]) + 4.0 * size + _FAR * np.sqrt(blur)
        grown = np.linalg.norm(who.off, axis=1) * entity.growth  # growth of the offset from the prediction
        reach = reach + (entity.top_speed + grown + speed[state]) * duration[state]
        return np.linalg.norm(release.c[state, :2] - who.at(time), axis=1) < reach


@final
class _Fallen:
    """Landings of drops on the static scene, and the entities that they hit there."""

    def __init__(self, tables: DropTables, constants: DropConstants, state: Release) -> None:
        self.tables, self.constants, self.state = tables, constants, state
        self.landing, self.B, self.N = _landing(tables, constants, state)
        self.level = tables.target_height[tables.level_start[:-1], 1]
        self.bottom, self.top = heights(state, tables)
        self.low, self.high = self.bottom.min(axis=1), self.top.max(axis=1)

    def hit(self, who: OffPrediction, state: Int[Array, " pair"], time: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """Return P that an entity is hit, for pairs of a state and the time of the drop."""
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
        """Return P that an object falling off, beyond each wide top's edge, lands on the entity and no higher top."""
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
    """Return the landing, with B and N of the drop model; also where there is no surface to land on."""
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
        stop=SideStop(time=np.zeros(n), push=np.zeros((n, 2)), target=np.zeros(n, dtype=int), chance=np.zeros(n)),
        mass=np.zeros((n, 0)),
        times=np.zeros((n, 0)),
        leaving=np.zeros((n, 0)),
        away=np.zeros((n, 0, 2)),
    )
    return landing, none, np.zeros((n, 1, 2))


# --- possible places --------------------------------------------------------------------------------------------------


@final
@dataclass(frozen=True, eq=False)
class OffPrediction:
    """An entity at a fixed offset from its prediction, in standard deviations, at each pair of a state and a time.

    Args:
        entity: The moving entity.
        off: Offset in standard deviations.
        cell: Remaining standard deviation around the offset, as a share of the prediction's.
    """

    entity: MovingEntity
    off: Float[Array, "pair 2"]
    cell: float

    def at(self, time: Float[Array, " pair"]) -> Float[Array, "pair 2"]:
        """Return the entity's position seen from above [m]."""
        there = self.entity.at(time)
        return there.position[:, :2] + self.off * there.spread[:, None]

    def spread(self, time: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """Return the standard deviation of that position [m]."""
        return self.cell * self.entity.at(time).spread

    def only(self, rows: Int[Array, " m"]) -> OffPrediction:
        """Return a subset of the pairs."""
        return OffPrediction(self.entity, self.off[rows], self.cell)


def off_predictions(
    entity: MovingEntity, times: Float[Array, "n k"], each: bool, places: int = PLACES
) -> tuple[OffPrediction, Float[Array, "n place"]]:
    """Return possible places of an entity at the times of states, and the time of each place [s].

    Args:
        entity: The moving entity.
        times: Times of each state [s].
        each: Whether each time has all places; else a state's times take turns, repeated if needed.
        places: Number of places.
    """
    if entity.at(times.max(initial=entity.t[0])).spread < _SHARP:
        return OffPrediction(entity, np.zeros((times.size, 2)), 1.0), times
    count = places if each else -(-places // times.shape[1])
    whole = np.repeat(times, count, axis=1)
    z = normal_places(places)[np.arange(whole.shape[1]) % places]
    return OffPrediction(entity, np.tile(z, (len(times), 1)), cell_of(places)), whole


def touched(
    batch: StateBatch, who: OffPrediction, state: Int[Array, " pair"], time: Float[Array, " pair"]
) -> Bool[Array, " pair"]:
    """Return for which pairs moving links or the carried object touch the entity before the failure."""
    robot, half = batch.compiled.robot, who.entity.half_size
    here, there = who.at(time), who.entity.at(time)
    shape, height = outlines(who.entity, here, there.yaw), there.position[:, 2]
    reach = float(half[0]) if who.entity.is_round else float(np.hypot(half[0], half[1]))
    found = np.zeros(len(state), dtype=bool)
    for link in np.unique(robot.sphere_link[robot.sphere_link > 0]):
        poses, (*middle, bound) = batch.link_poses[:, link], robot.bound[link]
        centre = (poses[:, :2, :3] @ np.array(middle) + poses[:, :2, 3])[state]
        near = np.flatnonzero(~found & (np.linalg.norm(centre - here, axis=1) < bound + reach))
        spheres = robot.sphere[robot.sphere_link == link] - [0.0, 0.0, 0.0, robot.protrusion]
        for rows in np.array_split(near, -(-len(near) * len(spheres) // _AT_ONCE) or 1):
            found[rows] = outside(poses[state[rows]], spheres, shape[rows], height[rows], float(half[2])) < 0.0
    return found


def outside(
    X: Float[Array, "row 4 4"],
    balls: Float[Array, "ball 4"],
    shape: Float[Array, "row 7"],
    height: Float[Array, " row"],
    half: float,
) -> Float[Array, " row"]:
    """Compute the distance of a link's spheres from upright outlines [m].

    Args:
        X: Poses of the link in W.
        balls: Centres in the link, and radii [m].
        shape: An outline for each pose.
        height: Height of the centre of each outline [m].
        half: Half of the height of the outlines [m].
    """
    p = balls[:, :3] @ X[:, :3, :3].swapaxes(1, 2) + X[:, None, :3, 3]
    beside = _beside(p[..., :2], shape)
    above = np.maximum(np.abs(p[..., 2] - height[:, None]) - half, 0.0)
    away = np.where(above > 0.0, np.hypot(np.maximum(beside, 0.0), above), beside)
    return (away - balls[:, 3]).min(axis=1)


def _beside(p: Float[Array, "row ball 2"], shape: Float[Array, "row 7"]) -> Float[Array, "row ball"]:
    """Return the signed distance of points from outlines in top view [m]."""
    d, x, y = p - shape[:, None, :2], shape[:, 2, None], shape[:, 3, None]
    along = np.abs(x * d[..., 0] + y * d[..., 1]) - shape[:, 4, None]
    across = np.abs(x * d[..., 1] - y * d[..., 0]) - shape[:, 5, None]
    away = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return away + np.minimum(np.maximum(along, across), 0.0) - shape[:, 6, None]


# --- outlines ---------------------------------------------------------------------------------------------------------


@final
class Outline:
    """The outline of a moving entity seen from above, for pairs of a state and a time.

    Args:
        entity: The moving entity.
        yaw: Heading at each pair [rad].
    """

    def __init__(self, entity: MovingEntity, yaw: Float[Array, " pair"]) -> None:
        self.is_round, (self.a, self.b) = entity.is_round, entity.half_size[:2]
        self.yaw = np.zeros_like(yaw) if entity.is_round else yaw
        self.x = np.stack([np.cos(self.yaw), np.sin(self.yaw)], axis=-1)[:, None]
        self.y = np.stack([-np.sin(self.yaw), np.cos(self.yaw)], axis=-1)[:, None]

    def directions(self, move: Float[Array, "pair 2"]) -> Float[Array, "pair direction 2"]:
        """Return unit vectors along which to test the separation of two things with this relative displacement [m].

        A disc uses the directions along and across the displacement, and halfway between. A box uses its own axes and
        the direction across the displacement; without it, an object that passes diagonally would count as a hit.
        """
        along = np.where(np.linalg.norm(move, axis=1) > _LEAST_MOVE, np.arctan2(move[:, 1], move[:, 0]), self.yaw)
        angle = (along if self.is_round else self.yaw)[:, None] + _FOUR
        if not self.is_round:
            angle = np.concatenate([angle, along[:, None] + 0.5 * np.pi], axis=1)
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def reach(self, u: Float[Array, "pair direction 2"], margin: Array | float = 0.0) -> Float[Array, "pair direction"]:
        """Return the extent of the entity, enlarged by a margin, in directions [m]; at least 0.1 mm."""
        margin = np.asarray(margin)[..., None]
        if self.is_round:
            return np.maximum(self.a + margin, 1e-4) + 0.0 * u[..., 0]
        across = np.abs((u * self.x).sum(axis=-1)), np.abs((u * self.y).sum(axis=-1))
        return np.maximum((self.a + margin) * across[0] + (self.b + margin) * across[1], 1e-4)


def sweep(
    u: Float[Array, "pair direction 2"],
    ends: tuple[Float[Array, "pair 2"], Float[Array, "pair 2"]],
    reach: Float[Array, "pair direction"],
    spread: Float[Array, " pair"],
) -> Float[Array, " pair"]:
    """Return P that an object is within reach at some time while its relative position goes from end to end."""
    x0, x1 = ((u * end[:, None]).sum(axis=-1) for end in ends)
    each = box(0.5 * (x0 + x1), reach + 0.5 * np.abs(x1 - x0), spread[:, None])
    # The fifth direction is correlated with the other four, but still gives an upper bound.
    return np.minimum(each[:, :4].prod(axis=1), each[:, 4:].min(axis=1, initial=1.0))


# --- arms -------------------------------------------------------------------------------------------------------------


def moving_spheres(batch: StateBatch) -> tuple[Float[Array, "n sphere 3"], Float[Array, " sphere"]]:
    """Return centres and radii of the covering spheres of moving links and of the carried object [m]."""
    robot = batch.compiled.robot
    moves = np.flatnonzero(robot.sphere_link != 0)
    poses, sphere = batch.link_poses[:, robot.sphere_link[moves]], robot.sphere[moves]
    centre = np.einsum("nsij,sj->nsi", poses[..., :3, :3], sphere[:, :3]) + poses[..., :3, 3]
    return centre, sphere[:, 3]


def near_links(
    batch: StateBatch, entity: MovingEntity, state: Int[Array, " pair"], time: Float[Array, " pair"]
) -> Float[Array, " pair"]:
    """Return P that a collapsing arm reaches an entity: a heuristic by the nearest sphere of a moving link."""
    centre, radii = moving_spheres(batch)
    P = np.zeros(len(state))
    there = entity.at(time)
    turn = np.stack([np.cos(there.yaw), np.sin(there.yaw)], axis=-1)[:, None]
    spread = np.hypot(BODY_SPREAD, there.spread)
    for s in range(0, len(radii), 16):  # 16 spheres at a time, to bound memory
        here = centre[:, s : s + 16][state]
        away = here - there.position[:, None]
        x = (away[..., :2] * turn).sum(axis=-1)
        y = away[..., 1] * turn[..., 0] - away[..., 0] * turn[..., 1]
        if entity.is_round:
            distance = np.maximum(np.hypot(x, y) - entity.size[0], 0.0)
        else:
            a, b = entity.half_size[:2]
            distance = np.hypot(np.maximum(np.abs(x) - a, 0.0), np.maximum(np.abs(y) - b, 0.0))
        radius = radii[s : s + 16]
        reached = step((radius + BODY_REACH - distance) / spread[:, None])
        above = step((away[..., 2] + radius + entity.half_size[2]) / _SIDE_SOFT)
        np.maximum(P, (reached * above).max(axis=1), out=P)
    return P
