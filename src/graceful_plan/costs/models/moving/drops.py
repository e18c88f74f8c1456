r"""Whom of those that move the carried object hits if the gripper lets go here, at this velocity, at this time.

The drop model (the docstring of `costs.models.drop` specifies it), with its constants, applied to a moving entity: an
upright box or cylinder with half sizes a, b, top Z and bottom B, that is at p(t) in W with standard deviation sigma(t).
Four directions u_i, seen from above, stand for its shape: its axes and those halfway between them; A_i is how far it
reaches in each.

.. code-block:: text

    t            when the gripper lets go;  T1 = fall(bottom - Z) + delay, T2: when it comes down on what is static
    W            P that it comes down on something lower than Z, or on nothing
    sweep(x0, x1, A, s) = product over i of box(u_i . (x0 + x1)/2, A_i + |u_i . (x1 - x0)|/2, s)
                 the object is within A of the entity at some time while its place relative to it goes from x0 to x1

    1. Flight    D = max over parts of sweep(r(T1), r(T2), A + part, s) S((top of the part - B)/0.02)
                 r(T) = c + o + (v + w x o) T - p(t + T),  s^2 = s0^2 + (sv T)^2 + sigma^2
    2. Falls     G = B_l sweep(L' - p(t + T2 + 0.15), L' - p(t + T2 + 0.45), A + kb size, (sd^2 + sigma^2)^(1/2))
                 B_l, L': what left supports higher than B and whereto, caught by wide tops as in the drop model
    3. Sides     H = (W' - W D) S((zs + height - B)/sh) sweep(..., A + (kl + tk Tm) size, ...)
                 from where it comes down to where it comes to rest, 0.3 s later
    P(carried) = 1 - (1 - W D)(1 - G)(1 - H);  P(contents) = P(carried), as they fall together

While the object falls, the entity goes on. What is static and higher than the entity catches the object by the mass of
its level, wherever that stands: a shelf beside a person hides as much of her as one above her. Nothing is known of what
is hit first if several entities are in its way, nor of those that step aside, or onto what lies on the floor.

P(body) is a rule of thumb that was never fitted: near a moving link, within 0.15 m, give or take 0.1 m, and not above
it. It says where a collapsing arm could reach somebody, not how likely it does.

Without a time, P is the mean over the predicted path, with equal weights in time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import final

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.drop.constants import DropConstants, DropSettings
from graceful_plan.costs.models.drop.functions import box, fall_time, part_reach, step
from graceful_plan.costs.models.drop.landing import LEAST_MASS, Landing, land, loose
from graceful_plan.costs.models.drop.release import Release, heights, release
from graceful_plan.costs.models.drop.sides import no_stop
from graceful_plan.costs.models.drop.tables import DropTables, drop_tables
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray

ROAM_TIME = 0.3
"""How long the object takes from where it comes down to where it comes to rest, or to fall on [s]."""
BODY_REACH, BODY_SPREAD = 0.15, 0.1
"""How far from the links a collapsing arm reaches somebody, and how uncertain that is [m]."""
MOST_SAMPLES = 64
"""Places that stand for a predicted path."""
_SAMPLE_STEP = 0.025, 0.1  # least and greatest distance between those places [m]
_LEVEL_SOFT = 0.01  # how sharply a level counts as no higher than the entity [m]
_SIDE_SOFT = 0.02  # how sharply the object passes above or below it [m]
_STANDS_ON = 0.1  # what is less than this above an entity's bottom is what it stands on [m]
_FAR = 8.0  # standard deviations beyond which nothing is hit
_STATES = 20_000  # states times targets that are worked on at once
_CHUNK = 50_000  # pairs of states and times that are worked on at once


def moving_probability(
    batch: StateBatch, settings: DropSettings, components: Collection[str] = ("carried", "contents", "body")
) -> Float[Array, "n component moving"]:
    """Return P(component hits moving entity) given that the gripper lets go, or for the body that the arm collapses.

    Args:
        batch: States; their times, if they have any, are on the clock of the predictions.
        settings: Constants of the drop model.
        components: Which to compute; the others are 0.
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
            P[:, falling, column] = mean_over_times(drops.hit, entity, times)[:, None]
        if "body" in rows:
            P[:, rows["body"], column] = mean_over_times(lambda *pairs: _near_links(batch, *pairs), entity, times)
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


# --- the entity, seen from above --------------------------------------------------------------------------------------


@final
class _Outline:
    """Four directions in which an entity's reach is known, at each pair of a state and a time."""

    def __init__(self, entity: MovingEntity, yaw: Float[Array, " pair"]) -> None:
        # One set of directions for all pairs is much less work than one for each.
        self.turns = not entity.is_round and bool(np.ptp(entity.yaw) > 0.0)
        angle = (yaw if self.turns else yaw[:1] * (not entity.is_round))[:, None]
        angle = angle + np.pi * np.array([0.0, 0.5, 0.25, 0.75])
        self.u = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        a, b = entity.half_size[:2]
        diagonal = a if entity.is_round else (a + b) / np.sqrt(2.0)
        self.reach = np.array([a, b, diagonal, diagonal])
        corner = (a + b) / np.sqrt(2.0)
        self.square = np.array([a, b, corner, corner])

    def part(
        self, axes: Float[Array, "n 3 3"], half: Float[Array, " 3"], kind: int, state: Int[Array, " pair"]
    ) -> Float[Array, "pair 4"]:
        """How far a part of the object reaches in these directions."""
        return (
            part_reach(axes[state], half, kind, self.u)
            if self.turns
            else part_reach(axes, half, kind, self.u[0])[state]
        )

    def around(self, margin: Array) -> Float[Array, "pair 4"]:
        """How far a rectangle reaches that leaves a margin on each side of the entity."""
        return np.maximum(self.square + margin[:, None] * [1.0, 1.0, np.sqrt(2.0), np.sqrt(2.0)], 1e-4)

    def sweep(
        self, start: Float[Array, "pair 2"], end: Float[Array, "pair 2"], reach: Array, spread: Float[Array, " pair"]
    ) -> Float[Array, " pair"]:
        """P that something is within reach at some time while its place relative to the entity changes."""
        x0, x1 = ((self.u[..., :2] * x[:, None]).sum(axis=-1) for x in (start, end))
        return box(0.5 * (x0 + x1), reach + 0.5 * np.abs(x1 - x0), spread[:, None]).prod(axis=1)


# --- the object -------------------------------------------------------------------------------------------------------


def _drops(batch: StateBatch, settings: DropSettings) -> _Drops:
    return batch.kept.get(_Drops, settings, lambda: _Drops(batch, settings))


@final
class _Drops:
    """Drops from the states of a batch; what does not depend on who moves is computed once, where it is needed."""

    def __init__(self, batch: StateBatch, settings: DropSettings) -> None:
        self.tables = drop_tables(batch.scene)
        self.constants = settings.of(self.tables.shape_class)
        self.state = release(batch, self.tables)
        self.size = max(1, _STATES // max(1, len(self.tables.target_entity)))
        self.fallen: dict[int, _Fallen] = {}

    def hit(
        self, entity: MovingEntity, state: Int[Array, " pair"], time: Float[Array, " pair"]
    ) -> Float[Array, " pair"]:
        """P that an entity is hit, for pairs of a state and the time of the drop."""
        found = np.zeros(len(state))
        near = np.flatnonzero(self._near(entity, state, time))
        block = state[near] // self.size
        for b in np.unique(block).tolist():
            if b not in self.fallen:
                rows = np.arange(b * self.size, min((b + 1) * self.size, len(self.state.c)))
                self.fallen[b] = _Fallen(self.tables, self.constants, self.state.only(rows))
            pairs = near[block == b]
            found[pairs] = self.fallen[b].hit(entity, state[pairs] - b * self.size, time[pairs])
        return found

    def _near(self, entity: MovingEntity, state: Int[Array, " pair"], time: Float[Array, " pair"]) -> Array:
        """Tell for which pairs P may be more than some 1e-6."""
        k, release, size = self.constants, self.state, self.tables.size
        lowest = min(self.tables.target_height[:, 1].min(initial=np.inf), entity.lowest)
        height = np.maximum(release.c[:, 2] - lowest, 0.0)
        duration = fall_time(release.v[:, 2], height) + k.delay + 2.0 * ROAM_TIME
        speed = np.linalg.norm(release.v[:, :2], axis=1)
        blur = k.position_spread**2 + (k.velocity_spread * duration) ** 2 + (k.height_spread * height) ** 2
        blur = blur + (k.carry_spread * speed) ** 2 + (k.size_spread**2 + k.side_spread**2) * size**2
        blur = blur[state] + entity.at(time + duration[state]).spread ** 2
        reach = np.linalg.norm(entity.half_size[:2]) + 4.0 * size + _FAR * np.sqrt(blur)
        reach = reach + ((entity.top_speed + speed) * duration)[state]
        return np.linalg.norm(release.c[state, :2] - entity.at(time).position[:, :2], axis=1) < reach


@final
class _Fallen:
    """What becomes of drops among what is static, and of those who walk into them."""

    def __init__(self, tables: DropTables, constants: DropConstants, state: Release) -> None:
        self.tables, self.constants, self.state = tables, constants, state
        self.landing, self.B, self.N = _landing(tables, constants, state)
        self.level = tables.target_height[tables.level_start[:-1], 1]
        self.bottom, self.top = heights(state, tables)
        self.low, self.high = self.bottom.min(axis=1), self.top.max(axis=1)

    def hit(
        self, entity: MovingEntity, state: Int[Array, " pair"], time: Float[Array, " pair"]
    ) -> Float[Array, " pair"]:
        """P that an entity is hit, for pairs of a state and the time of the drop."""
        there = entity.at(time)
        outline, Z = _Outline(entity, there.yaw), there.position[:, 2] + entity.half_size[2]
        lower = self.landing.mass[state] * step((Z[:, None] - self.level) / _LEVEL_SOFT + 2.0)
        nothing = np.clip(1.0 - self.landing.mass.sum(axis=1), 0.0, 1.0)[state]
        bottom = Z - 2.0 * entity.half_size[2]
        fallen = fall_time(self.state.v[state, 2], self.low[state] - bottom) + self.constants.delay
        W = lower.sum(axis=1)
        down = ((lower * self.landing.times[state]).sum(axis=1) + nothing * fallen) / (W + nothing + LEAST_MASS)
        D = (W + nothing) * self._flight(entity, outline, state, time, (bottom, Z), down)
        G = self._falls(entity, outline, state, time, bottom, Z)
        H = np.maximum(W - D, 0.0) * self._sides(entity, outline, state, time, bottom)
        return np.clip(1.0 - (1.0 - D) * (1.0 - G) * (1.0 - H), 0.0, 1.0)

    def _flight(
        self,
        entity: MovingEntity,
        outline: _Outline,
        state: Int[Array, " pair"],
        time: Float[Array, " pair"],
        height: tuple[Float[Array, " pair"], Float[Array, " pair"]],
        down: Float[Array, " pair"],
    ) -> Float[Array, " pair"]:
        k, release, tables = self.constants, self.state, self.tables
        D = np.zeros(len(state))
        for p in range(release.offset.shape[1]):
            start = release.c[:, :2] + release.offset[:, p, :2]
            v = (release.v + np.cross(release.w, release.offset[:, p]))[state, :2]
            first = fall_time(release.v[state, 2], self.bottom[state, p] - height[1]) + k.delay
            last = np.maximum(down, first)
            middle = 0.5 * (first + last)
            s = np.sqrt(k.position_spread**2 + (k.velocity_spread * middle) ** 2 + entity.at(time + middle).spread ** 2)
            r1, r2 = (start[state] + v * T[:, None] - entity.at(time + T).position[:, :2] for T in (first, last))
            reach = outline.reach + outline.part(
                release.axes[:, p], tables.part_half[p], int(tables.part_kind[p]), state
            )
            over = step((self.top[state, p] - height[0]) / _SIDE_SOFT)
            np.maximum(D, outline.sweep(r1, r2, reach, s) * over, out=D)
        return D

    def _falls(
        self,
        entity: MovingEntity,
        outline: _Outline,
        state: Int[Array, " pair"],
        time: Float[Array, " pair"],
        bottom: Float[Array, " pair"],
        top: Float[Array, " pair"],
    ) -> Float[Array, " pair"]:
        k, size = self.constants, self.tables.size
        higher = np.searchsorted(-self.level, -np.minimum(top, bottom + _STANDS_ON))
        point = self.landing.falls_to(k, size, self.B[..., None], self.N)[state, higher]
        t = time + self.landing.time[state, 0] + ROAM_TIME
        r1, r2 = (point - entity.at(t + dt).position[:, :2] for dt in (-0.5 * ROAM_TIME, 0.5 * ROAM_TIME))
        spread = np.hypot(self.landing.fall_spread[state, 0], entity.at(t).spread)
        return self.B[state, higher] * outline.sweep(
            r1, r2, outline.around(np.full(len(state), k.tumble_reach * size)), spread
        )

    def _sides(
        self,
        entity: MovingEntity,
        outline: _Outline,
        state: Int[Array, " pair"],
        time: Float[Array, " pair"],
        bottom: Float[Array, " pair"],
    ) -> Float[Array, " pair"]:
        k, size, L = self.constants, self.tables.size, self.landing
        leaves = L.leaving.sum(axis=1) / L.total[:, 0]
        drift = np.einsum("nl,nli->ni", L.leaving, L.away) / L.total
        down = time + L.time[state, 0]
        rest = (L.goes_on(k.slide) + k.drift * size * drift)[state]
        r1, r2 = L.point[state] - entity.at(down).position[:, :2], rest - entity.at(down + ROAM_TIME).position[:, :2]
        spread = L.blur[:, 0] + (k.side_spread * size) ** 2 + (k.size_spread * size * leaves) ** 2
        spread = np.sqrt(spread[state] + entity.at(down + ROAM_TIME).spread ** 2)
        reach = outline.around(((k.side_reach + k.topple_reach * leaves) * size)[state])
        above = (L.height[:, 0] + self.high - self.low)[state] - bottom
        return step(above / k.side_height) * outline.sweep(r1, r2, reach, spread)


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


# --- the arm ----------------------------------------------------------------------------------------------------------


def _near_links(
    batch: StateBatch, entity: MovingEntity, state: Int[Array, " pair"], time: Float[Array, " pair"]
) -> Float[Array, " pair"]:
    """P that a collapsing arm reaches an entity: a rule of thumb, from the nearest sphere of a link that moves."""
    robot = batch.compiled.robot
    moves = np.flatnonzero(robot.sphere_link != 0)
    poses, sphere = batch.link_poses[:, robot.sphere_link[moves]], robot.sphere[moves]
    centre = np.einsum("nsij,sj->nsi", poses[..., :3, :3], sphere[:, :3]) + poses[..., :3, 3]
    P = np.zeros(len(state))
    there = entity.at(time)
    turn = np.stack([np.cos(there.yaw), np.sin(there.yaw)], axis=-1)[:, None]
    spread = np.hypot(BODY_SPREAD, there.spread)
    for s in range(0, len(moves), 16):  # a few spheres at a time, to bound memory
        here = centre[:, s : s + 16][state]
        away = here - there.position[:, None]
        x = (away[..., :2] * turn).sum(axis=-1)
        y = away[..., 1] * turn[..., 0] - away[..., 0] * turn[..., 1]
        if entity.is_round:
            distance = np.maximum(np.hypot(x, y) - entity.size[0], 0.0)
        else:
            a, b = entity.half_size[:2]
            distance = np.hypot(np.maximum(np.abs(x) - a, 0.0), np.maximum(np.abs(y) - b, 0.0))
        radius = sphere[s : s + 16, 3]
        reached = step((radius + BODY_REACH - distance) / spread[:, None])
        above = step((away[..., 2] + radius + entity.half_size[2]) / _SIDE_SOFT)
        np.maximum(P, (reached * above).max(axis=1), out=P)
    return P
