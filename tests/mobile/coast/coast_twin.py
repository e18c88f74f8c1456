"""The coast model in NumPy, by its docstring: independent of the core, and slow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.special import erfc

from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import StateBatch, moving_batch
from graceful_plan.mobile.coast.constants import CoastSettings
from graceful_plan.mobile.coast.four_wheel import one_sided_trajectories
from graceful_plan.mobile.coast.native import SKIDS
from graceful_plan.mobile.coast.tables import CoastTables

SPACING, SAMPLES = 0.1, 64
HARMS = 0.05
_STILL = 1e-6


def hits(batch: StateBatch, tables: CoastTables, settings: CoastSettings, turns_on: float) -> np.ndarray:
    """Return P for each entity; `turns_on` is the angle by rate squared once wheels are let go."""
    total = _stopping(batch, tables, settings, turns_on, (0.0, 0.0))
    return np.minimum(1.0, total + _astray(batch, tables, settings))


def carried_hits(batch: StateBatch, tables: CoastTables, settings: CoastSettings, turns_on: float) -> np.ndarray:
    """Return P for each entity of hits by the object on the arm, which is a disc and harms in full at any speed."""
    found, scene = np.zeros((len(batch.q), len(batch.scene.entities))), batch.scene
    boxes = compile_scene(scene).impact_tables
    mine = boxes.part_component == list(scene.components).index("carried")
    (link,), box = set(boxes.part_link[mine]), boxes.part_box[mine]
    reach = (np.abs(box[:, :9].reshape(-1, 3, 3)) @ box[:, 12:, None])[..., 0]
    low, high = (box[:, 9:12] - reach).min(axis=0), (box[:, 9:12] + reach).max(axis=0)
    for k, q in enumerate(batch.q):
        X = compile_scene(scene).kernels.core.link_poses(q[None])[0, link]
        place, up = X[:3, :3] @ (0.5 * (low + high)) + X[:3, 3], X[2, :3]
        radius = np.sqrt((0.25 * (high - low) ** 2 * (1.0 - up**2)).sum() / 2.0)
        tall = np.abs(up) @ (0.5 * (high - low))
        (bottom, top), (c, s) = tables.high_range.T, (np.cos(q[2]), np.sin(q[2]))
        near = (bottom < place[2] + tall) & (top > place[2] - tall)
        seen = replace(
            tables, outline=np.array([[0, 0, 1, 0, 0, 0, radius]]), entity=tables.high_entity[near],
            shape=tables.high_shape[near],
        )  # fmt: skip
        x, y = place[:2] - q[:2]
        one = moving_batch(scene, batch.q[k : k + 1], batch.qd[k : k + 1])
        at = c * x + s * y, c * y - s * x
        found[k] = _stopping(one, seen, replace(settings, reference_speed=HARMS), turns_on, at)[0]
    return np.minimum(1.0, found)


def _stopping(batch, tables, settings, turns_on, at):
    """All bases that do not drift; `at` is where what is examined is in the frame of the base."""
    stops, total = settings.stops(batch.scene.base.load), _one_sided(batch, tables, settings, at)
    weak = settings.unable_to_turn() if batch.scene.base.slip > SKIDS else np.zeros((0, 3))
    p, a, delay = weak.T
    weak = np.column_stack([p, a, 0 * p, delay, 0 * p, 0 * p])
    every = np.concatenate([stops, weak])
    for released, bend in sorted(set(map(tuple, stops[:, 4:]))):
        chosen = stops[(stops[:, 4] == released) & (stops[:, 5] == bend)]
        most = turns_on * batch.qd[:, 2] ** 2 if released else np.full(len(batch.q), np.inf)
        total += _family(batch, tables, settings, chosen, (every, bend, most), at)
    if len(weak):  # straight on, as often as it should turn
        straight = every, 0.0, 0.0 * batch.q[:, 2]
        total += np.abs(batch.qd[:, 2:3]) * _family(batch, tables, settings, weak, straight, at)
    return total


def _astray(batch, tables, settings, step=0.05):
    """Return P of new contacts after the next step, for a base with drifted odometry."""
    q, total = batch.q, np.zeros((len(batch.q), len(batch.scene.entities)))
    v = batch.qd[:, 0] * np.cos(q[:, 2]) + batch.qd[:, 1] * np.sin(q[:, 2])
    speed, sign = np.abs(v), np.sign(v)
    moves = speed > _STILL
    worth, turns = (
        speed**2 / settings.reference_speed**2,
        np.where(moves, batch.qd[:, 2], 0.0) / np.where(moves, speed, 1),
    )
    lost, weights = settings.astray, sum(way.weight for way in settings.ways.values())
    weights += settings.astray.weight + settings.weak.weight
    bend = lost.misread / (batch.scene.base.track * batch.scene.base.slip)
    for side in (-1.0, 1.0):
        for moment in (0.125, 0.375, 0.625, 0.875):
            gone = lost.pace * batch.scene.base.v_max * lost.lasts * moment
            aside, yaw = side * bend * gone**2 / 2.0, q[:, 2] + sign * side * bend * gone
            share = (1.0 - settings.harmless) * lost.weight / weights * lost.lasts / 8.0
            spread = np.hypot(settings.position_spread, lost.spread * aside)
            x, y = q[:, 0] - aside * np.sin(q[:, 2]), q[:, 1] + aside * np.cos(q[:, 2])
            middle = yaw + 0.5 * turns * step
            then = x + sign * step * np.cos(middle), y + sign * step * np.sin(middle), yaw + turns * step
            before, after = _apart(tables, x, y, yaw), _apart(tables, *then)
            half = _apart(tables, 0.5 * (q[:, 0] + x), 0.5 * (q[:, 1] + y), q[:, 2])
            touch = [0.5 * erfc(d / spread / np.sqrt(2.0)) for d in (half, before, after)]
            along = _along_the_normal((before - after) / step, tables, spread)
            new = np.maximum(touch[2] - touch[1], 0.0) * np.minimum(1.0, along * worth[:, None])
            wall = np.maximum(touch[0], touch[1])[:, tables.entity < 0].max(axis=1, initial=0.0)
            for entity in range(total.shape[1]):
                most = new[:, tables.entity == entity].max(axis=1, initial=0.0)
                total[:, entity] += moves * share * speed / step * (1.0 - wall) * most
    return total


def _apart(tables, x, y, yaw):
    return np.min([_between(part, (x, y, np.cos(yaw), np.sin(yaw)), tables.shape) for part in tables.outline], axis=0)


def _along_the_normal(closing, tables, spread):
    """Return the energy share along the normal; half for entities that are small compared with the spread."""
    unknown = spread**2 / (spread**2 + (np.hypot(tables.shape[:, 4], tables.shape[:, 5]) + tables.shape[:, 6]) ** 2)
    return (1.0 - unknown) * np.clip(closing, 0.0, 1.0) ** 2 + 0.5 * unknown


def _one_sided(batch, tables, settings, load):
    """Interpolate poses in the tables, one state after the other."""
    ways = one_sided_trajectories(tables.body, settings)
    table = RegularGridInterpolator((ways.speeds, ways.rates), ways.places, bounds_error=False, fill_value=None)
    total = np.zeros((len(batch.q), len(batch.scene.entities)))
    for i, (q, qd) in enumerate(zip(batch.q, batch.qd, strict=True)):
        c, s = np.cos(q[2]), np.sin(q[2])
        v = qd[0] * c + qd[1] * s
        if abs(v) <= _STILL and (load == (0.0, 0.0) or qd[2] == 0.0):
            continue
        sign = -1.0 if v < 0.0 else 1.0
        at = np.clip([abs(v), qd[2]], [0.0, ways.rates[0]], [ways.speeds[-1], ways.rates[-1]])
        x, y, turned, speed, time = np.moveaxis(table(at)[0], -1, 0)
        x, y = sign * x, sign * y
        ch, sh = np.cos(q[2] + turned), np.sin(q[2] + turned)
        place, gone = (q[0] + c * x - s * y, q[1] + s * x + c * y, ch, sh), speed[:, 1:] * np.diff(time, axis=1)
        touch, along = _touch(tables, *_moved(place, gone, load), settings, np.hypot(x, y))
        wall = np.maximum.accumulate(touch[..., tables.entity < 0].max(axis=-1, initial=0.0), axis=1)
        worth = np.minimum(1.0, speed[..., None] ** 2 * along / settings.reference_speed**2)
        for entity in range(total.shape[1]):
            before = np.maximum(wall, _met_before(touch * along, tables.entity, entity))
            own = (worth * touch)[..., tables.entity == entity].max(axis=-1, initial=0.0)
            total[i, entity] += ways.share @ ((1.0 - before) * own).max(axis=1)
    return total


def _moved(place, gone, load):
    """Return places of the carried object, and how far it moves between them."""
    if load == (0.0, 0.0):
        return place, gone
    x, y, c, s = place
    x, y = x + c * load[0] - s * load[1], y + s * load[0] + c * load[1]
    return (x, y, c, s), np.hypot(np.diff(x, axis=1), np.diff(y, axis=1))


def _touch(tables, at, gone, settings, way):
    """Return P that each pose touches each shape, and the energy share along the normal there."""
    d = np.full((*np.shape(at[0]), len(tables.shape)), np.inf)
    for part in tables.outline:
        d = np.minimum(d, _between(part, at, tables.shape))
    spread = np.hypot(settings.position_spread, settings.drift * way)[..., None]
    closing = -np.diff(d, axis=1) / np.maximum(gone, 1e-9)[..., None]
    along = _along_the_normal(np.concatenate([closing[:, :1], closing], axis=1), tables, spread)
    return 0.5 * erfc(d / spread / np.sqrt(2.0)), along


def _family(batch, tables, settings, stops, which, load):
    every, added, most = which
    q, qd = batch.q[:, :3], batch.qd[:, :3]
    c, s = np.cos(q[:, 2]), np.sin(q[:, 2])
    v = qd[:, 0] * c + qd[:, 1] * s
    speed = np.abs(v)[:, None]
    if speed.max() <= _STILL:
        return np.zeros((len(q), len(batch.scene.entities)))
    free, braked = stopping_distances(speed, every)
    far = (free + braked).max(axis=1)
    free, braked = stopping_distances(speed, stops)
    places = min(SAMPLES, 1 + int(np.ceil(far.max(initial=0.0) / SPACING)))
    way = np.minimum(far[:, None], SPACING * np.arange(places))
    # A shape touched at a place may have been hit anywhere since the previous place.
    met = np.concatenate([way[:, :1], 0.5 * (way[:, :-1] + way[:, 1:])], axis=1)
    left = 1.0 - (met[:, :, None] - free[:, None]) / np.maximum(braked, 1e-12)[:, None]
    energy = np.clip(left, 0.0, 1.0) * (speed**2)[:, :, None] / settings.reference_speed**2
    moves, sign = np.abs(v) > _STILL, np.sign(v)[:, None]
    bend = (np.where(moves, qd[:, 2], 0.0) / np.where(moves, v, 1.0))[:, None] * sign + added
    arc = np.where(bend != 0.0, most[:, None] / np.where(bend != 0.0, np.abs(bend), 1.0), np.inf)
    curved = np.minimum(way, arc)
    turned, straight = bend * curved, way - curved
    chord = sign * curved * np.sinc(0.5 * turned / np.pi)
    middle, heading = q[:, 2:3] + 0.5 * turned, q[:, 2:3] + turned
    ch, sh = np.cos(heading), np.sin(heading)
    x = q[:, 0:1] + chord * np.cos(middle) + sign * straight * ch
    y = q[:, 1:2] + chord * np.sin(middle) + sign * straight * sh
    touch, along = _touch(tables, *_moved((x, y, ch, sh), np.diff(way, axis=1), load), settings, way)
    worth = np.minimum(1.0, energy[:, :, None] * along[..., None]) * touch[..., None]
    wall = np.maximum.accumulate(touch[:, :, tables.entity < 0].max(axis=2, initial=0.0), axis=1)
    P = np.zeros((len(q), len(batch.scene.entities)))
    for entity in range(P.shape[1]):
        before = np.maximum(wall, _met_before(touch * along, tables.entity, entity))
        own = worth[:, :, tables.entity == entity].max(axis=2, initial=0.0)
        P[:, entity] = ((1.0 - before)[:, :, None] * own).max(axis=1) @ stops[:, 0]
    return P


def _met_before(touch, owner, entity):
    """Return P that another entity has taken the base's energy before each place."""
    others = touch[..., (owner >= 0) & (owner != entity)].max(axis=-1, initial=0.0)
    met = np.maximum.accumulate(others, axis=-1)
    return np.concatenate([np.zeros_like(met[..., :1]), met[..., :-1]], axis=-1)


def stopping_distances(speed, stops):
    """Return the distances at full speed and while slowing down."""
    _, a, k, delay, *_ = stops.T
    with np.errstate(divide="ignore", invalid="ignore"):
        dragged = speed / k - a / k**2 * np.log1p(k * speed / a)
    return speed * delay, np.where(k > 0.0, dragged, speed**2 / (2.0 * a))


def _between(part, at, shape):
    """Return the signed distance of a part of the base to rounded rectangles: by corners, or by overlap."""
    x, y, ch, sh = (np.asarray(value)[..., None] for value in at)
    own = _sides(x + ch * part[0] - sh * part[1], y + sh * part[0] + ch * part[1], ch * part[2] - sh * part[3],
                 sh * part[2] + ch * part[3], part[4], part[5])  # fmt: skip
    other = _sides(*shape[:, :6].T)
    corners = np.minimum(_nearest(own, other), _nearest(other, own))
    overlap = np.maximum(_gap(own, other), _gap(other, own))
    point = ~part[4:6].any() | ~shape[:, 4:6].any(axis=1)
    return np.where(point | (overlap > 0.0), corners, overlap) - part[6] - shape[:, 6]


def _sides(x, y, ux, uy, a, b):
    return {"centre": (x, y), "axes": ((ux, uy), (-uy, ux)), "half": (a, b)}


def _along(one, dx, dy):
    return [np.abs(ux * dx + uy * dy) for ux, uy in one["axes"]]


def _nearest(one, other):
    """Return the least signed distance of the other's corners from one."""
    found = np.inf
    (x, y), ((ux, uy), (wx, wy)), (a, b) = other["centre"], other["axes"], other["half"]
    for s in (-1.0, 1.0):
        for t in (-1.0, 1.0):
            way = x + s * a * ux + t * b * wx - one["centre"][0], y + s * a * uy + t * b * wy - one["centre"][1]
            ex, ey = (far - half for far, half in zip(_along(one, *way), one["half"], strict=True))
            outside = np.hypot(np.maximum(ex, 0.0), np.maximum(ey, 0.0))
            found = np.minimum(found, outside + np.minimum(np.maximum(ex, ey), 0.0))
    return found


def _gap(one, other):
    """Return the separation along the sides of one."""
    way = other["centre"][0] - one["centre"][0], other["centre"][1] - one["centre"][1]
    wide = [
        sum(h * abs(ux * vx + uy * vy) for h, (vx, vy) in zip(other["half"], other["axes"], strict=True))
        for ux, uy in one["axes"]
    ]
    apart = [far - half - w for far, half, w in zip(_along(one, *way), one["half"], wide, strict=True)]
    return np.maximum(*apart)
