"""Roadmaps: how long they take to build and to ask, and how good their paths are before and after refinement."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

import graceful_plan as gp
from benchmarks import planning, report, suite
from graceful_plan.core.kernels import COST_STEP
from graceful_plan.planners.roadmaps.graph import Graph
from graceful_plan.roadmap.answers import QueryResult
from graceful_plan.roadmap.exposure import EXPOSURE_STEP, Exposure

Array = np.ndarray
Answer = TypeVar("Answer")

TITLE = "Roadmaps: build once, ask in milliseconds"
BUILD_WITHIN, QUERY_WITHIN, FRONT_WITHIN = 2.0, 0.010, 1.0
MEASURED = f"""\
For every task a roadmap of the scene with what is carried, of the default size. "Build": wall clock, and processor
seconds over all threads. "New w": the same start and goal with another weight; "new severity": another severity of one
entity; "new ends": both ends 0.05 rad aside, all of it with checks of the ends by exact geometry. Medians of the
repetitions. "Front": with epsilon = 1 %, and exact. "Gap": total cost at w = 1 above that of the best known motion, of
the roadmap's path, both as paths without time, which a roadmap charges; and of `plan` for one second with the default
planner, both timed.
"Exposure": how far the stored impact of the roadmap's edges, sampled every {EXPOSURE_STEP:g} rad, is from that at
{COST_STEP:g} rad, root mean square over edges, relative to the mean. "Exact": fronts of random graphs of 7 nodes
beside the enumeration of all their paths.
"""


@dataclass(frozen=True, kw_only=True)
class RoadmapFigures:
    """What came of one task."""

    task: str
    build: float
    processor: float
    edges: int
    weight: float
    severity: float
    ends: float
    front: float
    points: int
    exact_front: float
    exact_points: int
    error: float
    gap: float
    default: float


def run(options: suite.Options) -> str:
    """Measure every task, in one process: builds use all cores."""
    seconds = options.seconds or (0.3 if options.quick else 1.0)
    repetitions = 3 if options.quick else 15
    jobs = [(name, repetitions, seconds) for name in suite.task_names(options)]
    findings = list(suite.spread(examine, jobs, 1, "roadmap"))
    graphs = 50 if options.quick else 2000
    equal = sum(front_is_exact(seed) for seed in range(graphs))
    header = (
        "task", "build [s]", "processor [s]", "edges", "new w [ms]", "new severity [ms]", "new ends [ms]",
        "front [ms]", "points", "exact [ms]", "points", "exposure", "gap", f"default planner, {seconds:g} s",
    )  # fmt: skip
    rows = [_row(finding) for finding in findings]
    parts = (MEASURED, report.targets(_targets(findings, equal, graphs)), report.table(header, rows), _gaps(findings))
    return "\n".join(parts)


def examine(job: tuple[str, int, float]) -> RoadmapFigures:
    """Measure one task."""
    name, repetitions, seconds = job
    task = suite.task(name)
    scene = task.scene
    gp.Roadmap.build(scene, nodes=20)  # everything loaded and compiled
    processor, wall = time.process_time(), time.perf_counter()
    roadmap = gp.Roadmap.build(scene)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    rng = np.random.default_rng(0)
    entity = next(iter(scene.entities))
    roadmap.query(task.start, task.goal)
    front_seconds, points = _timed(lambda _: roadmap.front(task.start, task.goal), 3)
    exact_seconds, exact_points = _timed(lambda _: roadmap.front(task.start, task.goal, epsilon=0.0), 3)
    return RoadmapFigures(
        task=name,
        build=wall,
        processor=processor,
        edges=len(roadmap.edges),
        weight=_timed(lambda k: roadmap.query(task.start, task.goal, w=1.0 + k), repetitions)[0],
        severity=_timed(lambda k: roadmap.query(task.start, task.goal, severity={entity: 1.0 + k}), repetitions)[0],
        ends=_timed(lambda _: roadmap.query(*_aside(task, rng)), repetitions)[0],
        front=front_seconds,
        points=len(points),
        exact_front=exact_seconds,
        exact_points=len(exact_points),
        error=_error(roadmap),
        gap=_path_gap(name, roadmap.query(task.start, task.goal, w=1.0)),
        default=_gap(name, _planned(task, seconds)),
    )


def front_is_exact(seed: int) -> bool:
    """Compare the front of a random graph with all of its paths; whole costs, so that sums do not round."""
    rng = np.random.default_rng(seed)
    n, m = 7, 24
    tail, head = rng.integers(n, size=(2, m))
    cost = rng.integers(0, 9, size=(m, 2)).astype(float)
    out = [[(int(head[e]), cost[e]) for e in np.flatnonzero(tail == i)] for i in range(n)]
    every: set[tuple[float, float]] = set()

    def extend(node: int, seen: frozenset[int], total: Array) -> None:
        if node == n - 1:
            every.add((float(total[0]), float(total[1])))
            return
        for other, price in out[node]:
            if other not in seen:
                extend(other, seen | {other}, total + price)

    extend(0, frozenset({0}), np.zeros(2))
    expected = sorted(p for p in every if not any(o != p and o[0] <= p[0] and o[1] <= p[1] for o in every))
    return [tuple(row) for row in Graph(n, tail, head).front(cost, 0, [n - 1]).cost.tolist()] == expected


def _timed(work: Callable[[int], Answer], repetitions: int) -> tuple[float, Answer]:
    """Median seconds of some questions, and the answer to the last."""
    seconds, answers = [], []
    for k in range(repetitions):
        started = time.perf_counter()
        answers = [work(k)]
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds)), answers[0]


def _aside(task: gp.Task, rng: np.random.Generator) -> tuple[Array, Array]:
    lower, upper = task.scene.limits.position.T
    ends = np.stack([task.start, task.goal[0]])
    step = rng.normal(size=ends.shape)
    start, goal = np.clip(ends + 0.05 * step / np.linalg.norm(step, axis=1, keepdims=True), lower, upper)
    return start, goal


def _error(roadmap: gp.Roadmap) -> float:
    chosen = np.random.default_rng(0).permutation(len(roadmap.edges))[:1000]
    severity = roadmap.severity()
    q0, q1 = roadmap.q[roadmap.edges.tail[chosen]], roadmap.q[roadmap.edges.head[chosen]]
    fine = Exposure(roadmap.objective, roadmap.scene, COST_STEP).price(q0, q1).impact(severity)
    stored = roadmap.edges.prices.impact(severity)[chosen]
    return float(np.sqrt(np.mean((stored - fine) ** 2)) / max(fine.mean(), 1e-12))


def _planned(task: gp.Task, seconds: float) -> float:
    result = gp.plan(task.start, task.goal, task.scene, w=1.0, time_limit=seconds)
    return result.cost.total if result.status is gp.PlanStatus.SOLVED else np.inf


def _path_gap(name: str, found: QueryResult) -> float:
    task = suite.task(name)
    best = planning.BEST.load(name, task)
    if best is None:
        return np.nan
    path = gp.Path(best.trajectory(task.scene.joints).q)
    return found.cost.total / gp.evaluate(path, task.scene, gp.Objective(w=1.0)).total - 1.0


def _gap(name: str, total: float) -> float:
    best = planning.BEST.load(name, suite.task(name))
    return np.nan if best is None else total / best.total - 1.0


def _row(f: RoadmapFigures) -> tuple[str, ...]:
    times = [report.quantity(1e3 * s, digits=2) for s in (f.weight, f.severity, f.ends, f.front, f.exact_front)]
    gaps = [report.percent(gap, 0) for gap in (f.error, f.gap, f.default)]
    build = report.quantity(f.build, digits=2), report.quantity(f.processor, digits=2), str(f.edges)
    fronts = times[3], str(f.points), times[4], str(f.exact_points)
    return f.task, *build, *times[:3], *fronts, *gaps


def _targets(findings: list[RoadmapFigures], equal: int, graphs: int) -> list[report.Target]:
    limits = (("build", BUILD_WITHIN), ("weight", QUERY_WITHIN), ("front", FRONT_WITHIN))
    words = {"build": "slowest build", "weight": "slowest median query for a new w", "front": "slowest front, 1 %"}
    found = []
    for name, limit in limits:
        worst = max(getattr(f, name) for f in findings)
        scale, unit = (1.0, " s") if limit >= 1.0 else (1e3, " ms")
        measured = report.quantity(scale * worst, unit, digits=2)
        found.append(
            report.Target(what=words[name], wanted=f"< {scale * limit:g}{unit}", measured=measured, met=worst < limit)
        )
    exact = f"{equal} of {graphs}"
    return [*found, report.Target(what="fronts equal to all paths", wanted="all", measured=exact, met=equal == graphs)]


def _gaps(findings: list[RoadmapFigures]) -> str:
    medians = [report.percent(float(np.nanmedian([getattr(f, k) for f in findings])), 0) for k in ("gap", "default")]
    return "Median gap: {} of the roadmap's paths, {} of the default planner's.\n".format(*medians)
