"""Paths of bases on maps of floors: how long curves and searches of the state lattice take."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import distance_transform_edt

from benchmarks import report, suite
from graceful_plan.mobile.floor.lattice import LatticeSettings, LatticeStatus, StateLattice
from graceful_plan.mobile.floor.reeds_shepp import Steering, shortest_curves

Array = np.ndarray

TITLE = "State lattice: Reeds-Shepp curves and paths over (x, y, heading)"
CELLS, RESOLUTION, HEADINGS = 384, 0.05, 72
FLOORS, PAIRS, ENTITIES, CURVES = 10, 10, 20, 100_000
WEIGHT = 3.0
MOST = 100_000
SEARCHES = ((1.2, ()), (1.5, ()), (2.0, ()), (1.5, (2.0,)))
"""Lead, and inflations."""
SEED = 16
DISCS = np.array([[-0.127, 0.0, 0.25], [0.127, 0.0, 0.25]])
"""Two discs over a Jackal's outline, 0.508 x 0.430 m."""
STEERING = {
    "car": Steering(radius=0.5),
    "turns in place": Steering(radius=0.5, yaw_length=0.3, reverse_penalty=1.5),
}
MEASURED = f"""\
{FLOORS} floors of {CELLS} x {CELLS} cells of {RESOLUTION} m made at random, rooms with doors 1.2 m wide and 40 boxes,
{PAIRS} pairs of free poses each, at least 6 m apart; {HEADINGS} headings, a Jackal's outline as two discs, curves of
0.5 m at the tightest. "Impact": {ENTITIES} entities, each a bell of 0.8 m width that counts twice for driving towards
it and not at all for driving away, forward or backwards, a stand-in for a model; w = {WEIGHT:g}. "Searches": led by the
estimate with its weight (lead 1.5 is the default and the only one), then by the bound with its own; at most {MOST}
expansions each. "Bound": the cost is at most so many times the best, median and 95th percentile. Times are those of the
processor for a call, without making the lattice, on one thread; median and 95th percentile. OMPL: the same curves, one
call each from Python.
"""


@dataclass(frozen=True, kw_only=True)
class Searched:
    """What came of searches with one setting."""

    name: str
    impact: bool
    lead: float
    inflations: tuple[float, ...]
    status: tuple[str, ...]
    seconds: tuple[float, ...]
    expansions: tuple[int, ...]
    cost: tuple[float, ...]
    bound: tuple[float, ...]

    @property
    def median(self) -> float:
        """[ms]."""
        return 1e3 * float(np.median(self.seconds))


def floor(seed: int) -> Array:
    """Make a floor: walls every 4.8 m with doors, and boxes; true where something stands."""
    rng = np.random.default_rng((SEED, seed))
    occupied = np.zeros((CELLS, CELLS), dtype=bool)
    door = round(1.2 / RESOLUTION)
    for wall in range(96, CELLS, 96):
        occupied[wall : wall + 3] = occupied[:, wall : wall + 3] = True
    for wall in range(96, CELLS, 96):
        for room in range(0, CELLS, 96):
            for across in (False, True):
                at = room + rng.integers(6, 90 - door)
                view = occupied.T if across else occupied
                view[wall : wall + 3, at : at + door] = False
    for _ in range(40):
        (y, x), (h, w) = rng.integers(0, CELLS, 2), rng.integers(4, 16, 2)
        occupied[y : y + h, x : x + w] = True
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return occupied


def distance(occupied: Array) -> Array:
    """Return distances to obstacles, half a cell's diagonal less than those between centres."""
    return np.maximum(distance_transform_edt(~occupied) - np.sqrt(0.5), 0.0).astype(np.float32) * RESOLUTION


@lru_cache(maxsize=FLOORS)
def impact(seed: int) -> Array:
    """Return the impact of entities at random places, per cell and heading."""
    rng = np.random.default_rng((SEED, seed, 1))
    y, x = (np.indices((CELLS, CELLS), dtype=np.float32) + 0.5) * RESOLUTION
    yaw = np.arange(HEADINGS, dtype=np.float32) * 2 * np.pi / HEADINGS
    field = np.zeros((CELLS, CELLS, HEADINGS), dtype=np.float32)
    for ex, ey in rng.uniform(0, CELLS * RESOLUTION, (ENTITIES, 2)):
        bell = np.exp(-((x - ex) ** 2 + (y - ey) ** 2) / (2 * 0.8**2))
        near = bell > 1e-4
        towards = np.arctan2(ey - y[near], ex - x[near])
        field[near] += bell[near, None] * (1.0 + np.cos(yaw - towards[:, None]))
    return field


def pairs(lattice_distance: Array, seed: int) -> Array:
    """Draw starts and goals where the outline is free in all headings."""
    rng, found = np.random.default_rng((SEED, seed, 2)), []
    while len(found) < PAIRS:
        ends = rng.uniform([0, 0, -np.pi], [CELLS * RESOLUTION, CELLS * RESOLUTION, np.pi], (2, 3))
        column, row = (ends[:, :2] / RESOLUTION).astype(int).T
        if lattice_distance[row, column].min() > 0.45 and np.hypot(*(ends[1] - ends[0])[:2]) > 6.0:
            found.append(ends)
    return np.array(found)


def searched(name: str, with_impact: bool, searches: tuple[float, tuple[float, ...]], floors: int) -> Searched:
    """Search on all floors."""
    lead, inflations = searches
    settings = LatticeSettings(
        steering=STEERING[name], headings=HEADINGS, lead=lead, inflations=inflations, max_expansions=MOST
    )
    rows = []
    for seed in range(floors):
        field, harm = distance(floor(seed)), impact(seed) if with_impact else None
        lattice = StateLattice(
            distance=field,
            resolution=RESOLUTION,
            discs=DISCS,
            settings=settings,
            impact=harm,
            impact_back=None if harm is None else np.roll(harm, HEADINGS // 2, axis=2),
        )
        for start, goal in pairs(field, seed):
            began = time.thread_time()
            path = lattice.path(start, goal, WEIGHT if with_impact else 0.0)
            rows.append((path.status.name, time.thread_time() - began, path.expansions, path.cost, path.bound))
    status, seconds, expansions, cost, bound = zip(*rows, strict=True)
    return Searched(
        name=name,
        impact=with_impact,
        lead=lead,
        inflations=inflations,
        status=status,
        seconds=seconds,
        expansions=expansions,
        cost=cost,
        bound=bound,
    )


def curves_per_second(n: int) -> tuple[float, float, float]:
    """Time curves, and OMPL's lengths; and the greatest difference between them [m]."""
    from ompl import base as ob

    rng = np.random.default_rng(SEED)
    a, b = rng.uniform([-4, -4, -np.pi], [4, 4, np.pi], (2, n, 3))
    began = time.perf_counter()
    cost = shortest_curves(a, b, STEERING["car"]).cost
    ours = time.perf_counter() - began
    space = ob.ReedsSheppStateSpace(STEERING["car"].radius)
    one, two = space.allocState(), space.allocState()
    theirs, worst = 0.0, 0.0
    for p, q, c in zip(a.tolist(), b.tolist(), cost, strict=True):
        for state, (x, y, yaw) in ((one, p), (two, q)):
            state.setXY(x, y)
            state.setYaw(yaw)
        began = time.perf_counter()
        length = space.distance(one, two)
        theirs += time.perf_counter() - began
        worst = max(worst, abs(length - c))
    return n / ours, n / theirs, worst


def run(options: suite.Options) -> str:
    """Measure all."""
    floors = 2 if options.quick else FLOORS
    ours, theirs, worst = curves_per_second(1000 if options.quick else CURVES)
    found = [
        searched(name, with_impact, searches, floors)
        for name in STEERING
        for with_impact in (False, True)
        for searches in SEARCHES
    ]
    header = ("base", "impact", "searches", "solved", "median ms", "95 % ms", "expansions", "cost m", "bound")
    curves = report.table(
        ("Reeds-Shepp curves", "thousand/s"),
        [["ours, with their pieces", f"{ours / 1e3:.0f}"], ["OMPL", f"{theirs / 1e3:.0f}"]],
    )
    rows = [_row(one) for one in found]
    return f"{MEASURED}\n{report.targets(_targets(found, worst))}\n{curves}\n{report.table(header, rows)}"


def _row(one: Searched) -> list[str]:
    solved = [status == LatticeStatus.SOLVED.name for status in one.status]
    cost, bound = (np.array(values)[solved] for values in (one.cost, one.bound))
    return [
        one.name,
        "yes" if one.impact else "no",
        " then ".join([f"lead {one.lead:g}", *(f"x {value:g}" for value in one.inflations)]),
        f"{sum(solved)}/{len(solved)}",
        f"{one.median:.2f}",
        f"{1e3 * float(np.quantile(one.seconds, 0.95)):.1f}",
        f"{int(np.median(one.expansions))}",
        f"{np.median(cost):.2f}",
        f"{np.median(bound):.2f}, {np.quantile(bound, 0.95):.2f}",
    ]


def _targets(found: list[Searched], worst: float) -> Iterator[report.Target]:
    yield report.Target(
        what="Reeds-Shepp, farthest from OMPL's lengths",
        wanted="<= 1e-6 m",
        measured=f"{worst:.1g} m",
        met=worst <= 1e-6,
    )
    for one in found:
        if one.inflations or one.lead != 1.5:
            continue
        most = 50.0 if one.impact else 5.0
        yield report.Target(
            what=f"{one.name}, {f'{ENTITIES} entities' if one.impact else 'w = 0'}, first path: median",
            wanted=f"<= {most:g} ms",
            measured=f"{one.median:.2f} ms",
            met=one.median <= most,
        )
