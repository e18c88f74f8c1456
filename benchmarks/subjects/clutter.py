"""Cluttered courses driven by the dynamic window approach: do they arrive without touching anything, and how fast?"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt, uniform_filter

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.mobile import standing
from failbench.mobile.driving import drive_base
from graceful_plan.mobile.control.drive_state import DriveState
from graceful_plan.mobile.control.dwa import DWA, seen
from graceful_plan.mobile.floor.lattice import LatticeSettings, StateLattice
from graceful_plan.mobile.floor.reeds_shepp import Steering
from graceful_plan.scene.mobile.known_bases import known_base

Array = np.ndarray

TITLE = "Cluttered courses by the dynamic window approach"
COURSES, SEED = 50, 1998
RADIUS, CELL, LENGTH, WIDTH = 0.075, 0.15, 10.0, 4.5
"""Of the cylinders, the cells on which they stand, and the field [m]."""
FILL, SMOOTHINGS, MARGIN = (0.18, 0.32), (1, 4), 0.06
SPEED = 1.0
"""Greatest speed in the courses [m/s]."""
RUN_UP = 1.5
"""Free floor before and behind the field [m]."""
MAP = 0.05
MEASURED = f"""\
{COURSES} courses made at random as those of the BARN challenge are (D. Perille et al., 2020): a field of {LENGTH:g} x
{WIDTH:g} m on whose cells of {CELL:g} m cylinders with a radius of {RADIUS:g} m stand, filled to {FILL[0]:g} to
{FILL[1]:g} and smoothed {SMOOTHINGS[0]} to {SMOOTHINGS[1]} times by a cellular automaton, walls at its sides,
{RUN_UP:g} m of free floor before and behind; only those count through which the base's outline gets with {
    1e2 * MARGIN:g} cm to spare. A Jackal on four wheels that turn, in MuJoCo, drives through them at up to {
    SPEED:g} m/s, along
the shortest path of the state lattice with such room, by `gp.DWA` with its defaults. Arrived: it stands within 8 cm of
the end. **Lower bound of the time**: length of that path at {SPEED:g} m/s, with the base's acceleration from and to
rest. Nothing is fitted to the courses; the DWA's weights were chosen on courses of other seeds. The rate is that of
whole calls of `choose` along the way, with four people in the surroundings who count.
"""


@dataclass(frozen=True, kw_only=True)
class Course:
    """A field to cross."""

    scene: gp.Scene
    path: Array
    density: float


@dataclass(frozen=True, kw_only=True)
class Crossed:
    """What came of a course."""

    course: int
    density: float
    length: float
    bound: float
    duration: float
    arrived: bool
    touched: tuple[str, ...]
    stops: int
    off: float
    rate: float


def occupied(rng: np.random.Generator) -> Array:
    """Fill cells at random and smooth them: a cell is full if most of its neighbours are."""
    rows, columns = round(WIDTH / CELL), round(LENGTH / CELL)
    full = rng.random((rows, columns)) < rng.uniform(*FILL)
    for _ in range(int(rng.integers(*SMOOTHINGS, endpoint=True))):
        around = np.round(9.0 * uniform_filter(full.astype(float), 3, mode="constant")) - full
        full = np.where(around >= 5, True, np.where(around <= 1, False, full))
    return full


def course(seed: int, base_seed: int = SEED) -> Course:
    """Make a course that can be crossed; drawn again until there is one."""
    rng = np.random.default_rng((base_seed, seed))
    while True:
        full = occupied(rng)
        if full.sum() < 20:
            continue
        row, column = np.nonzero(full)
        centres = np.column_stack([RUN_UP + (column + 0.5) * CELL, (row + 0.5) * CELL - 0.5 * WIDTH])
        path = _path(centres)
        if path is not None:
            return Course(scene=_scene(centres), path=path, density=float(full.mean()))


def _path(centres: Array) -> Array | None:
    """Find the shortest path of the lattice from one side to the other; None if there is none."""
    whole = LENGTH + 2.0 * RUN_UP
    rows, columns = round((WIDTH + 0.4) / MAP), round(whole / MAP)
    y, x = np.meshgrid(
        (np.arange(rows) + 0.5) * MAP - 0.2 - 0.5 * WIDTH, (np.arange(columns) + 0.5) * MAP, indexing="ij"
    )
    free = np.abs(y) < 0.5 * WIDTH
    for cx, cy in centres:
        free &= (x - cx) ** 2 + (y - cy) ** 2 > RADIUS**2
    distance = MAP * np.maximum(distance_transform_edt(free) - 0.71, 0.0)
    discs = np.array([[-0.06, 0.0, 0.215], [0.06, 0.0, 0.215], [0.12, 0.0, 0.2], [-0.12, 0.0, 0.2]])
    lattice = StateLattice(
        distance=distance,
        resolution=MAP,
        discs=discs + np.array([0.0, 0.0, MARGIN]),
        settings=LatticeSettings(steering=Steering(radius=0.4, yaw_length=0.3, reverse=False), headings=32),
    )
    shift = np.array([0.0, 0.2 + 0.5 * WIDTH, 0.0])
    start, goal = np.array([0.5, 0.0, 0.0]) + shift, np.array([whole - 0.5, 0.0, 0.0]) + shift
    found = lattice.path(start, goal)
    if found.curve is None:
        return None
    return np.asarray(found.curve.sampled(0.05))[:, :2] - shift[:2]


def _scene(centres: Array) -> gp.Scene:
    posts = "".join(
        f'<geom name="post{k}" type="cylinder" size="{RADIUS} .3" pos="{x} {y} .3"/>'
        for k, (x, y) in enumerate(centres)
    )
    whole = LENGTH + 2.0 * RUN_UP
    walls = "".join(
        f'<geom type="box" size="{0.5 * whole} .05 .3" pos="{0.5 * whole} {side * (0.5 * WIDTH + 0.05)} .3"/>'
        for side in (-1, 1)
    )
    base = replace(known_base("jackal"), v_max=SPEED)
    return standing(f'<body name="posts">{posts}</body><body name="walls">{walls}</body>', base=base)


def cross(job: tuple[int, int, DWA]) -> Crossed:
    """Drive through one course."""
    number, base_seed, settings = job
    made = course(number, base_seed)
    window = settings.bind(made.scene)
    length = float(np.linalg.norm(np.diff(made.path, axis=0), axis=1).sum())
    bound = length / SPEED + SPEED / known_base("jackal").a_max
    driven = drive_base(made.path, made.scene, window, seconds=4.0 * bound)
    return Crossed(
        course=number,
        density=made.density,
        length=length,
        bound=bound,
        duration=driven.duration,
        arrived=driven.arrived,
        touched=tuple(driven.touched),
        stops=driven.chosen[1],
        off=float(driven.across.max()),
        rate=_rate(made, settings, driven.pose[:: max(1, len(driven.pose) // 50)]),
    )


def _rate(made: Course, settings: DWA, poses: Array) -> float:
    """Commands per second along the way, four people beside it counting with what happens to them if it fails."""
    window, around = settings.bind(made.scene), seen(made.scene)
    people = made.path[np.linspace(0, len(made.path) - 1, 6).astype(int)[1:-1]] + np.array([0.0, 0.7])
    rows = np.column_stack([people, np.ones(4), np.zeros((4, 3)), np.full(4, 0.2)])
    around = type(around)(
        np.concatenate([around.shape, rows]),
        np.concatenate([around.entity, np.arange(4)]),
        np.concatenate([around.velocity, np.tile([0.5, 0.0], (4, 1))]),
        np.full(4, 50.0),
    )
    began = time.process_time()
    for x, y, yaw in poses:
        window.choose(DriveState(x, y, yaw, 0.8 * SPEED, 0.2), made.path, around)
    return len(poses) / (time.process_time() - began)


def run(options: suite.Options) -> str:
    """Drive through all courses."""
    jobs = [(k, SEED, DWA()) for k in range(4 if options.quick else COURSES)]
    found = list(suite.spread(cross, jobs, options.processes, "courses"))
    ratio = np.array([one.duration / one.bound for one in found if good(one)])
    rows = [
        ["arrived without contact", f"{sum(map(good, found))} of {len(found)}"],
        ["did not arrive", str(sum(not one.arrived for one in found))],
        ["touched something", str(sum(bool(one.touched) for one in found))],
        ["share of cells that are full, median", f"{np.median([one.density for one in found]):.3f}"],
        ["length of the path, median and most", _pair([one.length for one in found], " m")],
        ["time over its lower bound, median and most", _pair(ratio, "")],
        ["farthest off the path, median and most", _pair([one.off for one in found], " m")],
        ["emergency stops, median and most", _pair([one.stops for one in found], "")],
    ]
    return f"{MEASURED}\n{report.targets(_targets(found))}\n{report.table(('of all courses', ''), rows)}"


def good(one: Crossed) -> bool:
    """Whether it arrived and touched nothing."""
    return one.arrived and not one.touched


def _pair(values: Sequence[float] | Array, unit: str) -> str:
    return f"{np.median(values):.2f}, {np.max(values):.2f}{unit}"


def _targets(found: Sequence[Crossed]) -> Iterator[report.Target]:
    share = sum(map(good, found)) / len(found)
    yield report.Target(
        what="courses driven without contact", wanted=">= 95 %", measured=f"{100 * share:.0f} %", met=share >= 0.95
    )
    ratio = float(np.median([one.duration / one.bound for one in found if good(one)]))
    yield report.Target(
        what="time over its lower bound, median", wanted="<= 1.3", measured=f"{ratio:.2f}", met=ratio <= 1.3
    )
    rate = float(np.median([one.rate for one in found]))
    yield report.Target(
        what="commands with impact, median of courses",
        wanted=">= 1 kHz",
        measured=f"{1e-3 * rate:.2f} kHz",
        met=rate >= 1e3,
    )
