"""Plan a variant in several ways, execute the jobs with failures, and compare with all sequences."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

import failbench
import graceful_plan as gp
from benchmarks.jobs.variants import Variant, variant
from failbench.fault.registry import faults
from graceful_plan.job.job_planning import JobSession
from graceful_plan.job.job_result import JobResult, JobStatus
from graceful_plan.job.search import Node, SequenceSearch

OURS, BLIND, BLIND_ORDER, NEAREST, FRAGILE = (
    "ours",
    "w = 0",
    "order of w = 0",
    "nearest first",
    "fragile last",
)
METHODS = (OURS, BLIND, BLIND_ORDER, NEAREST, FRAGILE)
ACTIONS, ACTIONS_EACH, GRASPS = 20, 6, 3
"""Planned actions of a search, at least and per object, and grasps of each object to choose from."""
SPEED = 0.5
"""Fraction of the velocity limits: near full speed, the simulated arm lags by just more than FailBench allows."""
FAULTS = ("gripper_failure", "weak_grip", "stuck_gripper")
DEGREE = "severe"
_NO_HARM = 1e-9
"""Harm of a healthy arm in one motion that is far below that of its failures per job."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """What to do for one variant."""

    job: str
    number: int
    w: float
    failures: int
    seed: int = 0


@dataclass(kw_only=True)
class Way:
    """A variant planned in one way, and its harm."""

    status: str
    steps: list[str] = field(default_factory=list)
    """Such as "clear laptop", without "pick"."""
    motion: float = np.nan
    impact: float = np.nan
    duration: float = np.nan
    harm: float = np.nan
    """Harm per executed job."""
    low: float = np.nan
    high: float = np.nan
    refused: str = ""
    """Why the healthy arm cannot execute it, or which harm it does; then the harm of failures is not compared."""


@dataclass(kw_only=True)
class Measured:
    """Everything that was measured for one variant."""

    run: dict[str, Any]
    objects: int
    ways: dict[str, Way] = field(default_factory=dict)
    first_seconds: float = np.nan
    """Time to the first complete plan [s]."""
    first_cpu: float = np.nan
    """Processor time until then [s]."""
    shares: dict[str, float] = field(default_factory=dict)
    """Time in grasps, stances, checks and `plan`, and in all [s]."""
    gap: float = np.nan
    """Share by which a sequence over the choices of ours may be cheaper at most, by its lower bound."""
    found: float = np.nan
    """Cost of the first motions of the best sequence, with one grasp of each object."""
    least: float = np.nan
    """The least cost of all sequences over the same choices, by exhaustive search."""


def measure(run: Run) -> Measured:
    """Plan a variant in all ways and simulate its failures."""
    one = variant(run.job, run.number)
    measured = Measured(run=asdict(run), objects=one.objects)
    measured.first_seconds, measured.first_cpu = first_plan(one, run.w)
    plans = planned(one, run.w, run.seed)
    measured.shares, measured.gap = dict(plans[OURS].stats), plans[OURS].gap
    known: dict[int, Way] = {}
    for name, result in plans.items():
        if id(result) not in known:
            known[id(result)] = _executed(result, run)
        measured.ways[name] = known[id(result)]
    if one.kind.is_small:
        search = _search(one, run.w, grasps=1)
        search.run(lambda _: False)
        measured.found = np.inf if search.best is None else search.best.cost
        measured.least = cheapest(search, Node(state=search.start))
    return measured


def planned(one: Variant, w: float, seed: int) -> dict[str, JobResult]:
    """Plan a variant in all ways; ways with the same order share a result."""
    actions = max(ACTIONS, ACTIONS_EACH * one.objects)

    def plan(job: gp.Job, weight: float) -> JobResult:
        return gp.plan_job(job, weight, grasps=GRASPS, iterations=actions, seed=seed, speed=SPEED)

    ours, blind = plan(one.job(), w), plan(one.job(), 0.0)
    bare = plan(one.job(extras=False), w)
    orders = {BLIND_ORDER: blind.order, NEAREST: nearest_first(one), FRAGILE: fragile_last(one)}
    by_order = {bare.order: bare}
    found = {OURS: ours, BLIND: blind}
    for name, order in orders.items():
        if not order:  # of a job that was not solved
            found[name] = blind
            continue
        goals = tuple(body for body in order if body in (*one.goals, *one.kind.on_tray))
        if goals not in by_order:
            again = bare.why(order=goals, iterations=actions).other
            by_order[goals] = again
        found[name] = by_order[goals]
    return found


def first_plan(one: Variant, w: float) -> tuple[float, float]:
    """Return wall and processor time to the first complete plan [s], including the choices; infinite without one."""
    started, busy = time.perf_counter(), time.process_time()
    search = _search(one, w, grasps=4)
    search.motions.limited = True
    search.run(lambda _: search.best is not None or time.perf_counter() - started > 60.0)
    if search.best is None:
        return np.inf, np.inf
    return time.perf_counter() - started, time.process_time() - busy


def cheapest(search: SequenceSearch, node: Node) -> float:
    """Return the cost of the cheapest sequence by trying all of them, without bounds."""
    if search.is_complete(node.state):
        return node.cost
    children = (search.child(edge) for edge in search.edges(node))
    return min((cheapest(search, child) for child in children if child is not None), default=np.inf)


def nearest_first(one: Variant) -> tuple[str, ...]:
    """Return the goal objects in the order in which a hand that takes the nearest one next would carry them."""
    data = one.scene.data_at(one.scene.keyframes["ready"])
    goals = {**one.goals, **dict.fromkeys(one.kind.on_tray, one.goals.get("tray", np.zeros(3)))}
    at, order = data.site(one.scene.tool).xpos.copy(), []
    while len(order) < len(goals):
        left = [name for name in goals if name not in order]
        order.append(min(left, key=lambda name: float(np.linalg.norm(data.body(name).xpos - at))))
        at = goals[order[-1]]
    return tuple(order)


def fragile_last(one: Variant) -> tuple[str, ...]:
    """Return the goal objects by their severity as entities, the least first."""
    names = [*one.goals, *one.kind.on_tray]
    return tuple(sorted(names, key=lambda name: one.scene.entities[name].severity["body"]))


def _search(one: Variant, w: float, *, grasps: int) -> SequenceSearch:
    return JobSession(one.job(), gp.Objective(w=w), grasps=grasps, speed=SPEED).search()


def _executed(result: JobResult, run: Run) -> Way:
    way = Way(status=result.status.name)
    if result.status is not JobStatus.SOLVED:
        return way
    way.steps = [f"{step.kind} {step.name}" for step in result.steps if step.kind != "pick"]
    way.motion, way.impact, way.duration = result.cost.motion, result.cost.impact, result.duration
    try:
        report = failbench.validate_job(result, _faults(), n=run.failures, seed=run.seed, threads=1)
    except failbench.ExecutionRefused as refused:
        way.refused = str(refused)
        return way
    healthy = [one.report.healthy for one in report.motions if one.report.healthy.harm > _NO_HARM]
    if healthy:
        way.refused = "; ".join(map(str, healthy))
        return way
    way.harm, way.low, way.high = report.observed.mean, report.observed.low, report.observed.high
    return way


def _faults() -> Sequence[failbench.Fault]:
    return [faults()[name](degree=DEGREE) for name in FAULTS]
