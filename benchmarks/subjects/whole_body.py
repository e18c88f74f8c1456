"""Base and arm together: what moving the arm on the way spares, and poses of a tool with the base free."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.mobile import standing

Array = np.ndarray

TITLE = "Base and arm together: posture along the way, and poses of a tool with the base free"
CARRIED = ("carry_bottle", "carry_left", "carry_pan", "bring_tea")
"""Tasks of the hallway."""
WEIGHTS = (0.0, 0.3, 1.0, 3.0)
OURS = (0.3, 1.0)
CORRIDORS, SEEDS, KNOWN = 4, 50, 10
"""Corridors made at random, and poses in the kitchen; of the latter, so many have a best known motion."""
SECONDS, LONG = 2.0, 5.0
"""For motions that carry something, and for best known ones [s]."""
SAME = 1.02
"""Durations that are the same, as a ratio."""
SEED = 16
LENGTH, WIDTH = 9.0, 2.4
"""Of a corridor [m]."""
ARM = (0.10, 0.0, 1.1978, 0.0, -2.0269, 0.0, 0.8292, 0.0)
"""Lift and arm of the Fetch, the hand level in front."""
MEASURED = f"""\
**Posture.** The Fetch carries something in the hallway, and through {CORRIDORS} corridors of {LENGTH:g} x {WIDTH:g} m
made at random, with four people along the walls and hot oil in a pan; {SECONDS:g} s a plan. "Arm fixed" is the same
planner with `DriveLattice(moves_arm=False)`: its base takes the lateral offset that J asks for, its arm stays as it is
at the start. It is planned at the weights {", ".join(f"{w:g}" for w in WEIGHTS)}, and of all these motions the one with
the least impact is compared that takes at most {100 * (SAME - 1):.0f} % longer than ours. Impact is the predicted harm
of failures over the motion: all of it, what happens to the carried thing itself included; and what others suffer.

**Poses.** In the kitchen, the Fetch with empty hands, the tool where a random free configuration of base and arm has
it, at least 0.4 m high: {SEEDS} of these. "First verified motion": the whole call if it ends with the first path that
was found, compiled before. "Gap": J after 1 s over the least of that and of a plan of {LONG:g} s with another seed, on
the first {KNOWN}, at the default weight; nothing is carried, so that J is mostly length, and whom a failing base hits.
"""


@dataclass(frozen=True, kw_only=True)
class Carried:
    """What came of one plan that carries something."""

    place: str
    moves_arm: bool
    w: float
    status: str
    duration: float = np.inf
    impact: float = np.inf
    others: float = np.inf
    total: float = np.inf


@dataclass(frozen=True, kw_only=True)
class Reached:
    """What came of one pose."""

    seed: int
    status: str
    first: float
    seconds: float
    total: float = np.inf
    known: float = np.nan


@cache
def corridor(seed: int) -> tuple[gp.Scene, Array, Array]:
    """Make a corridor along x with four people by its walls and a Fetch that carries a pan of hot oil."""
    rng = np.random.default_rng((SEED, seed))
    side = rng.choice([-1.0, 1.0], 4)
    x, y = np.linspace(1.6, LENGTH - 1.6, 4) + rng.uniform(-0.5, 0.5, 4), side * rng.uniform(0.75, 0.95, 4)
    people = "".join(
        f'<body name="person{k}" pos="{x[k]} {y[k]} .85"><geom type="cylinder" size=".2 .85"/></body>' for k in range(4)
    )
    walls = "".join(
        f'<body pos="{LENGTH / 2} {s * (WIDTH / 2 + 0.05)} 1"><geom type="box" size="{LENGTH / 2 + 1} .05 1"/></body>'
        for s in (-1, 1)
    )
    pan = (
        '<body name="pan" pos="-.6 -.9 0"><freejoint/><geom type="cylinder" size=".12 .03" pos="0 0 .03" mass="1"/>'
        '<geom type="box" size=".09 .012 .012" pos="-.2 0 .045" mass=".15"/>'
        '<geom name="pan_contents" type="cylinder" size=".11 .02" pos="0 0 .025" contype="0" conaffinity="0" mass="0"/>'
        "</body>"
    )
    entities = {**{f"person{k}": "adult" for k in range(4)}, "pan": "robust"}
    scene = standing(f"{walls}{people}{pan}", "fetch", entities=entities)
    X_TO = np.eye(4)
    X_TO[:3, :3] = [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    X_TO[:3, 3] = 0.045, 0.0, 0.23
    held = scene.attach(
        "pan", X_TO=X_TO, contents=gp.Liquid(0.5, temperature=180.0), object_class="heavy", fingers=0.0125
    )
    return held, np.array([0.0, 0.0, 0.0, *ARM]), np.array([LENGTH, 0.0, 0.0, *ARM])


def carry(job: tuple[str, bool, float, float]) -> Carried:
    """Plan one motion that carries something."""
    place, moves_arm, w, seconds = job
    if place.startswith("corridor"):
        scene, start, goal = corridor(int(place.split()[1]))
    else:
        task = suite.scene("hallway").tasks[place]
        scene, start, goal = task.scene, task.start, task.goal
    gp.plan(start, goal, scene, w=w, iterations=1)  # compiles
    result = gp.plan(start, goal, scene, w=w, planner=gp.DriveLattice(moves_arm=moves_arm), time_limit=seconds)
    found = Carried(place=place, moves_arm=moves_arm, w=w, status=result.status.name)
    if result.trajectory is None or scene.carried is None:
        return found
    own = result.cost.impact_by_entity.get(scene.carried.body, 0.0)
    return replace(
        found,
        duration=result.trajectory.duration,
        impact=result.cost.impact,
        others=result.cost.impact - own,
        total=result.cost.total,
    )


def pose(seed: int) -> tuple[gp.Scene, Array, gp.PoseGoal]:
    """Draw a pose of the tool in the kitchen that some free configuration reaches."""
    scene, rng = suite.scene("kitchen"), np.random.default_rng((SEED, 1, seed))
    while True:
        q = rng.uniform(*scene.limits.position.T)
        q[2] = rng.uniform(-np.pi, np.pi)
        if gp.clearance(q, scene) > 0.02:
            goal = gp.PoseGoal.from_tool(q, scene)
            if goal.X_WT[2, 3] > 0.4:
                return scene, scene.keyframes["ready"], goal


def reach(job: tuple[int, float]) -> Reached:
    """Plan to one pose: until the first verified motion, for a second, and for longer if that is asked for."""
    seed, longer = job
    scene, start, goal = pose(seed)
    gp.plan(start, start, scene, iterations=1)  # compiles
    began = time.perf_counter()
    quick = gp.plan(start, goal, scene, time_limit=10.0, callback=lambda _: True)
    first = time.perf_counter() - began if quick.status is gp.PlanStatus.SOLVED else np.inf
    began = time.perf_counter()
    result = gp.plan(start, goal, scene, time_limit=1.0)
    seconds = time.perf_counter() - began
    found = Reached(seed=seed, status=result.status.name, first=first, seconds=seconds)
    if result.trajectory is None:
        return found
    known = np.nan
    if longer:
        best = gp.plan(start, goal, scene, time_limit=longer, seed=1)
        known = min(result.cost.total, np.inf if best.trajectory is None else best.cost.total)
    return replace(found, total=result.cost.total, known=known)


def run(options: suite.Options) -> str:
    """Measure both."""
    corridors, seeds, known = (1, 4, 2) if options.quick else (CORRIDORS, SEEDS, KNOWN)
    places = (*(CARRIED[:1] if options.quick else CARRIED), *(f"corridor {k}" for k in range(corridors)))
    seconds = options.seconds or SECONDS
    jobs = [(place, False, w, seconds) for place in places for w in WEIGHTS]
    jobs += [(place, True, w, seconds) for place in places for w in OURS]
    carried = list(suite.spread(carry, jobs, options.processes, "motions"))
    asked = [(seed, LONG if seed < known else 0.0) for seed in range(seeds)]
    reached = list(suite.spread(reach, asked, options.processes, "poses"))
    header = (
        "where",
        "w",
        "duration",
        "impact",
        "arm fixed",
        "x less",
        "others suffer",
        "arm fixed",
        "x less",
        "J, arm fixed",
    )
    targets = [*_posture_targets(carried), *_pose_targets(reached)]
    return f"{MEASURED}\n{report.targets(targets)}\n{report.table(header, list(_rows(carried)))}"


def compared(ours: Carried, carried: Sequence[Carried]) -> Carried | None:
    """Return the motion with the arm fixed that does least harm and is not much longer than ours."""
    fixed = [one for one in carried if one.place == ours.place and not one.moves_arm]
    same = [one for one in fixed if one.duration <= SAME * ours.duration]
    return min(same, key=lambda one: one.impact, default=None)


def _pairs(carried: Sequence[Carried]) -> Iterator[tuple[Carried, Carried]]:
    for one in carried:
        other = compared(one, carried) if one.moves_arm and one.status == "SOLVED" else None
        if other is not None:
            yield one, other


def _rows(carried: Sequence[Carried]) -> Iterator[list[str]]:
    for one, other in _pairs(carried):
        at_w = next(c for c in carried if c.place == one.place and c.w == one.w and not c.moves_arm)
        yield [
            one.place,
            f"{one.w:g}",
            f"{one.duration:.2f} s ({100 * (one.duration / other.duration - 1):+.1f} %)",
            f"{one.impact:.2f}",
            f"{other.impact:.2f}",
            f"{other.impact / one.impact:.2f}",
            f"{one.others:.3f}",
            f"{other.others:.3f}",
            f"{other.others / one.others:.2f}",
            f"{one.total:.2f}, {at_w.total:.2f}",
        ]


def _posture_targets(carried: Sequence[Carried]) -> Iterator[report.Target]:
    solved = sum(one.status == "SOLVED" for one in carried)
    yield report.all_done("motions that carry something", solved, len(carried))
    for what, of in (("all impact", lambda one: one.impact), ("what others suffer", lambda one: one.others)):
        ratios = [of(other) / of(one) for one, other in _pairs(carried)]
        yield report.Target(
            what=f"arm fixed over ours at the same duration, {what}: median (least to most)",
            wanted=">= 3",
            measured=f"{np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})",
            met=bool(np.median(ratios) >= 3.0),
        )


def _pose_targets(reached: Sequence[Reached]) -> Iterator[report.Target]:
    solved = sum(one.status == "SOLVED" for one in reached)
    yield report.all_done("poses in the kitchen, reached in 1 s", solved, len(reached), "100 %")
    first = np.array([one.first for one in reached])
    yield report.Target(
        what="first verified motion: median, 95 %, longest",
        wanted="<= 100 ms",
        measured=", ".join(f"{1e3 * x:.0f}" for x in (np.median(first), np.quantile(first, 0.95), first.max())) + " ms",
        met=bool(first.max() <= 0.1),
    )
    gaps = np.array([one.total / one.known - 1.0 for one in reached if np.isfinite(one.known)])
    yield report.Target(
        what="gap to the best known after 1 s: mean, median, most",
        wanted="<= 2 %",
        measured=", ".join(f"{100 * x:.1f}" for x in (gaps.mean(), np.median(gaps), gaps.max())) + " %",
        met=bool(gaps.mean() <= 0.02),
    )
