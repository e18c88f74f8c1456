"""Robots that drive: are motions rolled, does what the coast model predicts happen, and what does it prevent?"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.mobile import standing
from failbench.mobile.coasting import coasted, drawn
from failbench.mobile.driving import drive_base
from failbench.mobile.wheeled import wheeled
from graceful_plan.costs.cost import moving_batch
from graceful_plan.mobile.coast.coast import Coast
from graceful_plan.mobile.coast.constants import CoastSettings

Array = np.ndarray

TITLE = "Robots that drive: rolling, what a failing base hits, and what is prevented"
WEIGHTS = (0.0, 0.03, 0.1, 0.3, 1.0)
DEFAULT = 0.3
ROOMS, FAILURES, SECONDS = 30, 60, 2.0
SIZE = (10.0, 8.0)
"""Of a room [m]."""
CLASSES = ("adult", "child", "pet", "heirloom", "glass")
SEED = 16
BESIDE = 1.2
"""How far from the straight line between start and goal they are at most [m]."""
MEASURED = f"""\
{ROOMS} rooms of {SIZE[0]:g} x {SIZE[1]:g} m made at random, with six boxes as obstacles and five things that can be
harmed, one of each of {", ".join(CLASSES)}: cylinders, at most {BESIDE:g} m beside the straight line between start and
goal, which are at least 6 m apart. A Jackal crosses each at up to 2 m/s, planned in {SECONDS:g} s with each weight. No
constant was fitted to these rooms: those of the coast model are assumptions (but for `harmless`, which says nothing of
what a harmful failure does), and failures are drawn from the same
assumptions, so that this measures closed forms and geometry, not how real bases fail. None goes astray (`astray` of
`coast.yaml`): no moment decides what that does. In MuJoCo the base stands on four
wheels that turn (armature 0.1, effective track 1.5 times the real one), fails at a random moment of its motion with the
speed that it has there, and is watched until it rests. Harm of a failure: sum over what it touches of severity times
min(1, (speed / 1 m/s)^2), speeds along the normal. **Per task**: failures come per hour, so harm per executed task is
mean harm x duration. "Rolled": the motion is followed by a controller (Kanayama 1990) from its start to its end,
without failure.
"""


@dataclass(frozen=True, kw_only=True)
class Driven:
    """What came of one motion."""

    room: int
    w: float
    status: str
    seconds: float = np.nan
    duration: float = np.nan
    length: float = np.nan
    sideways: float = np.nan
    limits: float = np.nan
    error: float = np.nan
    touched: tuple[str, ...] = ()
    harm: tuple[float, ...] = ()
    predicted: tuple[float, ...] = ()
    events: tuple[tuple[float, float], ...] = ()
    """Predicted and observed worth of every failure and entity."""


RADIUS = {"adult": 0.25, "child": 0.18, "pet": 0.15, "heirloom": 0.15, "glass": 0.1}
"""Of the cylinders that stand for them [m]."""


def room(seed: int) -> tuple[gp.Scene, Array, Array]:
    """Make a room with a start and a goal; drawn again until both are free."""
    rng, half = np.random.default_rng((SEED, seed)), 0.5 * np.array(SIZE)
    while True:
        ends = np.column_stack([rng.uniform(-0.9, 0.9, (2, 2)) * half, rng.uniform(-np.pi, np.pi, 2)])
        way = ends[1, :2] - ends[0, :2]
        if np.linalg.norm(way) < 6.0:
            continue
        bodies = "".join([*_walls(half), *_boxes(rng, half), *_entities(rng, ends[0, :2], way)])
        scene = standing(bodies, entities={name: name for name in CLASSES})
        if (gp.clearance(ends, scene) > 0.05).all():
            return scene, ends[0], ends[1]


def _walls(half: Array) -> Iterator[str]:
    (x, y), thin = half, 0.05
    for a, b, c, d in ((0, y, x, thin), (0, -y, x, thin), (x, 0, thin, y), (-x, 0, thin, y)):
        yield f'<body pos="{a} {b} .5"><geom type="box" size="{c} {d} .5"/></body>'


def _boxes(rng: np.random.Generator, half: Array) -> Iterator[str]:
    for k in range(6):
        (x, y), turn, (a, b) = rng.uniform(-0.8, 0.8, 2) * half, rng.uniform(0, np.pi), rng.uniform(0.2, 0.7, 2)
        geom = f'<geom type="box" size="{a} {b} .4"/>'
        yield f'<body name="box{k}" pos="{x} {y} .4" euler="0 0 {turn}">{geom}</body>'


def _entities(rng: np.random.Generator, start: Array, way: Array) -> Iterator[str]:
    across = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    for name in CLASSES:
        x, y = start + rng.uniform(0.15, 0.85) * way + rng.uniform(-BESIDE, BESIDE) * across
        yield f'<body name="{name}" pos="{x} {y} .5"><geom type="cylinder" size="{RADIUS[name]} .5"/></body>'


def examine(job: tuple[int, float, int]) -> Driven:
    """Plan in a room, roll, fail."""
    number, w, failures = job
    scene, start, goal = room(number)
    gp.plan(start, goal, scene, w=w, iterations=1)  # compiles
    began = time.perf_counter()
    result = gp.plan(start, goal, scene, w=w, time_limit=SECONDS)
    seconds = time.perf_counter() - began
    if result.trajectory is None:
        return Driven(room=number, w=w, status=result.status.name, seconds=seconds)
    trajectory, wheels = result.trajectory, wheeled(scene)
    state = trajectory.at(np.linspace(0.0, trajectory.duration, 20_000))
    c, s = np.cos(state.q[:, 2]), np.sin(state.q[:, 2])
    rolled = drive_base(trajectory, scene)
    rng = np.random.default_rng((SEED, number, 1))
    shipped = CoastSettings.shipped()
    model = Coast(shipped.only(*shipped.ways))  # what is drawn; nobody goes astray
    severity = np.array([entity.severity["body"] for entity in scene.entities.values()])
    unit = shipped.reference_speed
    harm, predicted, events = [], [], []
    at = trajectory.at(rng.uniform(size=failures) * trajectory.duration)
    P = model.probability(moving_batch(scene, at.q, at.qd))[:, 0]
    for k in range(failures):
        worth = np.zeros(len(severity))
        for hit in coasted(wheels, at.q[k], at.qd[k], drawn(model.settings, rng)):
            worth[hit.entity] = min(1.0, (hit.speed / unit) ** 2)
        harm.append(float(severity @ worth))
        predicted.append(float(severity @ P[k]))
        events += [(float(p), float(x)) for p, x in zip(P[k], worth, strict=True)]
    checks = result.verdict.checks if result.verdict is not None else {}
    return Driven(
        room=number,
        w=w,
        status=result.status.name,
        seconds=seconds,
        duration=trajectory.duration,
        length=result.cost.motion,
        sideways=float(np.abs(-state.qd[:, 0] * s + state.qd[:, 1] * c).max()),
        limits=float(checks["drive_limits"].worst or 0.0),
        error=float(rolled.error.max()),
        touched=tuple(rolled.touched),
        harm=tuple(harm),
        predicted=tuple(predicted),
        events=tuple(events),
    )


def run(options: suite.Options) -> str:
    """Measure all rooms with all weights."""
    rooms, failures = (3, 10) if options.quick else (ROOMS, FAILURES)
    jobs = [(k, w, failures) for k in range(rooms) for w in WEIGHTS]
    found = list(suite.spread(examine, jobs, options.processes, "drives"))
    header = ("w", "solved", "harm per failure", "harm per task, x less", "geometric mean", "duration", "worse")
    rows = [_row(w, found) for w in WEIGHTS]
    return f"{MEASURED}\n{report.targets(_targets(found))}\n{report.table(header, rows)}"


def _of(w: float, found: Sequence[Driven]) -> dict[int, Driven]:
    return {one.room: one for one in found if one.w == w and one.harm}


def _pairs(w: float, found: Sequence[Driven]) -> list[tuple[float, float]]:
    """Harm per task at w = 0 over that at w, and durations likewise; where nothing is hit, one hit of 0.1 counts."""
    plain, ours = _of(0.0, found), _of(w, found)
    pairs = []
    for number in plain.keys() & ours.keys():
        a, b = plain[number], ours[number]
        least = 0.1 / len(a.harm)
        harm = [max(float(np.mean(one.harm)), least) * one.duration for one in (a, b)]
        pairs.append((harm[0] / harm[1], b.duration / a.duration))
    return pairs


def _worse(w: float, found: Sequence[Driven]) -> int:
    """Rooms with more harm per task than at w = 0, beyond twice the standard error."""
    plain, ours, n = _of(0.0, found), _of(w, found), 0
    for number in plain.keys() & ours.keys():
        a, b = (np.array(one.harm) * one.duration for one in (plain[number], ours[number]))
        n += b.mean() - a.mean() > 2.0 * np.hypot(a.std(), b.std()) / np.sqrt(len(a))
    return int(n)


def _row(w: float, found: Sequence[Driven]) -> list[str]:
    own = [one for one in found if one.w == w]
    solved = [one for one in own if one.harm]
    harm = float(np.mean([np.mean(one.harm) for one in solved]))
    if w == 0.0:
        return [f"{w:g}", f"{len(solved)}/{len(own)}", f"{harm:.3f}", "", "", "", ""]
    ratio, longer = np.array(_pairs(w, found)).T
    return [
        f"{w:g}",
        f"{len(solved)}/{len(own)}",
        f"{harm:.3f}",
        f"{np.median(ratio):.2f}",
        f"{np.exp(np.log(ratio).mean()):.2f}",
        f"{100 * (np.median(longer) - 1):+.1f} %",
        str(_worse(w, found)),
    ]


def _targets(found: Sequence[Driven]) -> Iterator[report.Target]:
    solved = [one for one in found if one.harm]
    yield report.all_done("motions planned", len(solved), len(found), "100 %")
    side = max(one.sideways for one in solved)
    yield report.Target(
        what="fastest sideways, of all motions", wanted="<= 1 mm/s", measured=f"{1e3 * side:.2g} mm/s", met=side <= 1e-3
    )
    most = max(one.limits for one in solved)
    yield report.Target(
        what="limits of base and wheels, of all motions", wanted="<= 1.01", measured=f"{most:.3f}", met=most <= 1.01
    )
    error = max(one.error for one in solved)
    yield report.Target(
        what="rolled in MuJoCo: farthest off, of all motions (2 m/s)",
        wanted="<= 30 mm",
        measured=f"{1e3 * error:.0f} mm (median {1e3 * float(np.median([one.error for one in solved])):.0f})",
        met=error <= 0.03,
    )
    touched = sum(bool(one.touched) for one in solved)
    yield report.none_of("rolled in MuJoCo: motions that touch something", touched)
    p, x = np.array([event for one in solved for event in one.events]).T
    skill = 1.0 - float(((p - x) ** 2).sum() / ((x - x.mean()) ** 2).sum())
    yield report.Target(
        what="coast model, share of the severity by failure and entity: skill over the mean",
        wanted=">= 0.6",
        measured=f"{skill:.3f} ({len(p)} events, {int((x > 0).sum())} hits)",
        met=skill >= 0.6,
    )
    ratio = float(p.sum() / x.sum())
    yield report.Target(
        what="coast model, predicted over observed",
        wanted="0.95 to 1.05",
        measured=f"{ratio:.3f}",
        met=0.95 <= ratio <= 1.05,
    )
    less, longer = np.array(_pairs(DEFAULT, found)).T
    yield report.Target(
        what=f"harm per task at w = {DEFAULT:g} against w = 0, median",
        wanted="5 x less, <= 15 % longer",
        measured=f"{np.median(less):.2f} x less, {100 * (np.median(longer) - 1):+.1f} %",
        met=bool(np.median(less) >= 5.0 and np.median(longer) <= 1.15),
    )
    worse = _worse(DEFAULT, found)
    yield report.none_of("worse than w = 0", worse, "none")
