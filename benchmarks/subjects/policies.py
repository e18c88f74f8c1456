"""Policies under all faults: success and harm in closed loop, with and without recovery; speed of environments."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import monitored, store, suite
from benchmarks.store import read_lines
from failbench import Estimate
from failbench.basics.statistics import estimate_mean, estimate_probability, estimate_ratio
from failbench.policies import (
    PolicyFactory,
    PolicySettings,
    PolicyTask,
    Recovery,
    ReplanOnFailure,
    StopOnFailure,
    evaluate,
    planned,
    policy_task,
    reach,
    scripted,
)
from failbench.policies.batch import EpisodeBatch
from failbench.report import FAILURES_PER_HOUR

TITLE = "Policies in closed loop: success and harm under 19 faults, and what recovery is worth"
QUESTION = "How much harm do five controllers cause in closed loop under 19 faults, and how much do recoveries save?"
HEADLINE = "Harm of a failed episode at w = 0"
DEPENDS_ON = (
    *suite.PLANNING,
    *suite.SIMULATION,
    "sim/failbench/policies",
    "src/graceful_plan/monitor",
    "benchmarks/unseen",
    "benchmarks/monitored.py",
    "benchmarks/monitored_runs.py",
)
SEED = 77
TASKS = ("tabletop/green_to_blue", "unseen/bedside/bring_water")
BLOCK = 3
"""Episodes per job and fault."""
WANTED, LONG_WANTED = 12, 500
"""Episodes per fault and controller on all tasks together, in normal and long runs."""
SEVERE = "*/*/severe"
STORE = Path(__file__).resolve().parents[1] / "policy_runs"
"""One line per finished job, so an interrupted run can resume. Remove the folder to measure again."""
MEASURED = f"""\
An episode lasts at most three times the duration of the straight path plus 1 s, at half of the joint speeds, with an
action every 20 ms. Starts are the task's with noise of 0.02 rad. Each controller meets every fault, severe, in the same
episodes in which it meets none. A fault begins at a fraction of the duration of its healthy twin. Success: the tool is
within 2 cm and 0.1 rad of its goal in time and at the end, with the object in the gripper. Harm: severities of all hits
in the episode, which lasts at least 1 s after the onset; **added**: less the harm of the healthy twin. All controllers
have the same starts, fractions and seeds of faults. Intervals are 95 %; they ignore that episodes of a job are
stratified. Per task: {FAILURES_PER_HOUR:g} failures per hour during the healthy motion, plus its own harm.

Controllers: **plan, w = 0** and **plan** (default w) follow their motion by the clock. **plan, replan** is the second
with a recovery: 0.1 s after the onset it stops, plans for 0.5 s of simulated time from the current state and continues,
or brakes if a joint does not respond. **script** lifts, crosses and lowers along tool poses. **reach** is a network
trained with PPO on joints alone, without perception of its surroundings, for three motions of `tabletop_l1`; one is
that of the first task. A recovery detects every fault after a fixed delay. Recoveries, and **none** for comparison, are
simulated for the whole time, even if the goal is reached, so early arrival avoids no later harm. Planners have
iterations instead of seconds, and all draws have seeds, so the figures do not depend on the load of the machine.
"""


@dataclass(frozen=True)
class Controller:
    """A policy, and the recovery that takes over after a fault."""

    factory: PolicyFactory
    recovery: Recovery | None = None
    delay: float = 0.1
    whole: bool = False
    """Whether episodes last for the whole time, even if the goal is reached."""


PLAN = planned()
CONTROLLERS: Mapping[str, Controller] = {
    "plan, w = 0": Controller(planned(0.0)),
    "plan": Controller(PLAN),
    "plan, replan": Controller(PLAN, ReplanOnFailure()),
    "script": Controller(scripted),
    "reach": Controller(reach),
}
RECOVERIES: Mapping[str, Controller] = {
    "none": Controller(PLAN, whole=True),
    "stop after 0.1 s": Controller(PLAN, StopOnFailure(), 0.1, whole=True),
    "stop after 0.5 s": Controller(PLAN, StopOnFailure(), 0.5, whole=True),
    "replan after 0.1 s": Controller(PLAN, ReplanOnFailure(), 0.1, whole=True),
    "replan after 0.5 s": Controller(PLAN, ReplanOnFailure(), 0.5, whole=True),
}
ALL: Mapping[str, Controller] = CONTROLLERS | RECOVERIES
LATE = ("stop after 0.5 s", "replan after 0.5 s")
"""Recoveries of long runs only."""


@dataclass(frozen=True, kw_only=True)
class PolicyJob:
    """A block of episodes of one controller on one task."""

    task: str
    controller: str
    block: int
    faults: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Block:
    """Result of a job: (success, harm) of each episode by kind, healthy first; mean duration and processor time [s]."""

    task: str
    controller: str
    block: int
    rows: Mapping[str, Sequence[tuple[bool, float]]]
    duration: float
    seconds: float


def run(options: suite.Options) -> str:
    """Do the jobs that are left, and report on all finished ones."""
    tasks, blocks, faults = options.pick((TASKS, _blocks(options), (SEVERE,)), quick=(TASKS[:1], 1, ("drop/*/severe",)))
    file = STORE / f"blocks.{SEED}.{BLOCK}.jsonl"
    until = math.inf if options.seconds is None else time.monotonic() + options.seconds
    if options.quick:
        done = [do(PolicyJob(task=t, controller=c, block=0, faults=faults)) for t in tasks for c in ("plan", "script")]
    else:
        fill(file, tasks, blocks, options, until)
        done = [read(line) for line in read_lines(file)]
    with store.folder_of(options, STORE) as folder:
        watched = list(monitored.report(options, folder, until))
    return "\n".join([MEASURED, *tables(done, _wanted(options)), *watched, *speed(options)])


def _blocks(options: suite.Options) -> int:
    return math.ceil(_wanted(options) / (BLOCK * len(TASKS)))


def _wanted(options: suite.Options) -> int:
    return options.pick(WANTED, quick=BLOCK, long=LONG_WANTED)


def fill(file: Path, tasks: Sequence[str], blocks: int, options: suite.Options, until: float) -> None:
    """Do jobs, round by round over controllers and tasks, until the time is over."""
    have = {(done.task, done.controller, done.block) for done in map(read, read_lines(file))}
    names = [name for name in ALL if options.long or name not in LATE]
    wanted = [(task, name, block) for block in range(blocks) for task in tasks for name in names]
    jobs = [
        PolicyJob(task=task, controller=name, block=block, faults=(SEVERE,))
        for task, name, block in wanted
        if (task, name, block) not in have
    ]
    store.fill(file, jobs, do, processes=options.processes, label="policies", until=until)


def do(job: PolicyJob) -> Block:
    """Do one block."""
    began, controller = time.process_time(), ALL[job.controller]
    task = ready(job.task, whole=controller.whole)
    found = evaluate(
        task,
        controller.factory,
        job.faults,
        n=BLOCK,
        seed=SEED + 1000 * job.block,
        recovery=controller.recovery,
        delay=controller.delay,
        threads=1,
    )
    kinds = {"healthy": found.healthy_rollouts, **found.rollouts}
    rows = {name: [(r.success, r.harm(task.scene)) for r in rollouts] for name, rollouts in kinds.items()}
    return Block(
        task=job.task,
        controller=job.controller,
        block=job.block,
        rows=rows,
        duration=found.duration,
        seconds=time.process_time() - began,
    )


@cache
def ready(task: str, *, whole: bool) -> PolicyTask:
    """Prepare a task, once per process."""
    if not whole:
        return policy_task(path_of(task))
    limit = ready(task, whole=False).limit
    return policy_task(path_of(task), PolicySettings(limit=limit, horizon=limit))


def path_of(task: str) -> str:
    """Return a task's name as `policy_task` takes it; scenes in `unseen/` are named by their file."""
    _, *unseen = task.split("unseen/")
    if not unseen:
        return task
    scene, _, name = unseen[0].partition("/")
    return f"{suite.UNSEEN / scene}.yaml/{name}"


def read(line: Mapping[str, Any]) -> Block:
    """Read a line that `fill` wrote."""
    rows = {name: [(bool(success), float(harm)) for success, harm in row] for name, row in line["rows"].items()}
    return Block(**{**line, "rows": rows})


# --- tables ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Sum:
    """All blocks of a controller: success and harm of each episode, by kind."""

    success: Mapping[str, np.ndarray]
    harm: Mapping[str, np.ndarray]
    duration: float
    most: float
    """The largest harm of any episode of any controller, which bounds the intervals."""

    def added(self, name: str) -> np.ndarray:
        """Return the harm that a fault adds in each episode."""
        return self.harm[name] - self.harm["healthy"]

    @property
    def faults(self) -> list[str]:
        """Names of the faults."""
        return [name for name in self.harm if name != "healthy"]

    def mixed(self, what: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return episodes with all faults, in one order for all controllers."""
        return np.concatenate([what[name] for name in self.faults])


def sums(done: Sequence[Block]) -> dict[str, Sum]:
    """Add up the blocks that every controller has finished."""
    controllers = list(dict.fromkeys(block.controller for block in done))
    by = {(block.task, block.block, block.controller): block for block in done}
    whole = sorted({(t, b) for t, b, _ in by if all((t, b, name) in by for name in controllers)})
    most = max((harm for b in done for row in b.rows.values() for _, harm in row if math.isfinite(harm)), default=0.0)
    found = {}
    for name in controllers:
        mine = [by[t, b, name] for t, b in whole]
        if not mine:
            continue
        columns = {
            kind: np.array([row for block in mine for row in block.rows[kind]], dtype=float) for kind in mine[0].rows
        }
        found[name] = Sum(
            success={kind: rows[:, 0] > 0.5 for kind, rows in columns.items()},
            harm={kind: rows[:, 1] for kind, rows in columns.items()},
            duration=float(np.mean([block.duration for block in mine])),
            most=most,
        )
    return found


def mean(values: np.ndarray, most: float) -> Estimate:
    """Estimate the mean of harm, or of added harm, where an episode has at most `most`."""
    valid = values[np.isfinite(values)]
    return estimate_mean(valid, (-most if valid.min(initial=0.0) < 0.0 else 0.0, most))


def tables(done: Sequence[Block], wanted: int) -> Iterator[str]:
    """Yield the tables."""
    found = sums(done)
    if not found:
        yield "Nothing is measured yet.\n"
        return
    n = len(next(iter(found.values())).harm["healthy"])
    cpu = sum(block.seconds for block in done)
    tasks = ", ".join(f"`{task}`" for task in dict.fromkeys(block.task for block in done))
    yield (
        f"Tasks: {tasks}. {n} episodes of each controller with each fault, of {wanted} wanted; "
        f"{cpu:.0f} s of processor time.\n"
    )
    yield from overview({name: found[name] for name in CONTROLLERS if name in found})
    yield from by_fault({name: found[name] for name in CONTROLLERS if name in found})
    recoveries = {name: found[name] for name in RECOVERIES if name in found}
    if "none" in recoveries:
        yield from recovery(recoveries)
        yield from by_fault(recoveries)


def overview(found: Mapping[str, Sum]) -> Iterator[str]:
    """Yield the table of controllers."""
    columns = ("controller", "healthy: success", "harm", "at goal after", "failed: success", "harm added")
    yield f"| {' | '.join(columns)} | harm per million tasks |"
    yield "|---|---|---|---|---|---|---|"
    for name, s in found.items():
        added = np.concatenate([s.added(fault) for fault in s.faults])
        failures = FAILURES_PER_HOUR * s.duration / 3600.0
        per_task = 1e6 * (np.nanmean(s.harm["healthy"]) + failures * np.nanmean(added))
        healthy = f"{estimate_probability(s.success['healthy'])} | {mean(s.harm['healthy'], s.most)}"
        failed = f"{estimate_probability(s.mixed(s.success))} | {mean(added, s.most)}"
        yield f"| {name} | {healthy} | {s.duration:.2f} s | {failed} | {per_task:.3g} |"
    yield ""
    if {"plan, w = 0", "plan"} <= set(found):
        a, b = (found[name].mixed(found[name].harm) for name in ("plan, w = 0", "plan"))
        valid = np.isfinite(a) & np.isfinite(b)
        ratio = estimate_ratio(a[valid], b[valid], (0.0, found["plan"].most))
        slower = found["plan"].duration / found["plan, w = 0"].duration
        yield (
            f"Harm of a failed episode at w = 0 over that at the default w, in closed loop: {ratio}; "
            f"per task, {slower:.2f} times as long exposed: {ratio.mean / slower:.3g}.\n"
        )


def by_fault(found: Mapping[str, Sum]) -> Iterator[str]:
    """Yield success and harm by fault."""
    yield f"| success; harm | {' | '.join(found)} |"
    yield "|---|" + "---|" * len(found)
    for fault in next(iter(found.values())).harm:
        cells = [f"{estimate_probability(s.success[fault])}; {mean(s.harm[fault], s.most)}" for s in found.values()]
        yield f"| {fault.split('/')[0]} | {' | '.join(cells)} |"
    yield ""


def recovery(found: Mapping[str, Sum]) -> Iterator[str]:
    """Yield the table of recoveries of the default plan."""
    columns = ("recovery of **plan**", "success", "harm of a failed episode", "less than without (paired)")
    yield f"| {' | '.join(columns)} | faults with less, more |"
    yield "|---|---|---|---|---|"
    none = found["none"]
    for name, s in found.items():
        spared = none.mixed(none.harm) - s.mixed(s.harm)
        signs = [mean(none.harm[fault] - s.harm[fault], s.most) for fault in s.faults]
        less, more = sum(e.low > 0.0 for e in signs), sum(e.high < 0.0 for e in signs)
        shown = "" if name == "none" else f"{mean(spared, s.most)} | {less}, {more}"
        success, harm = estimate_probability(s.mixed(s.success)), mean(s.mixed(s.harm), s.most)
        yield f"| {name} | {success} | {harm} | {shown or ' | '} |"
    yield ""


def speed(options: suite.Options) -> Iterator[str]:
    """Yield the speed of environments in actions per second."""
    task = policy_task(TASKS[0], PolicySettings(noise=0.0, limit=60.0))
    count = options.pick(1000, quick=50)
    yield f"Actions of 20 ms a second, state observed, `{TASKS[0]}` ({len(task.scene.entities)} objects), no fault:\n"
    yield "| simulations side by side | per second of processor time | per second of the clock |"
    yield "|---|---|---|"
    for sims in (1, 8):
        processor, clock = paced(task, sims, count // sims)
        yield f"| {sims} | {processor:.0f} | {clock:.0f} |"
    yield ""


def paced(task: PolicyTask, sims: int, steps: int) -> tuple[float, float]:
    """Return actions a second of processor time, all threads, and of the clock."""
    batch = EpisodeBatch(task, sims)
    episodes = [batch.begin(i, np.random.default_rng(i)) for i in range(sims)]

    def act(n: int) -> None:
        for _ in range(n):
            seen = [episode.observation for episode in episodes]
            vectors = [one.vector for one in seen]
            assert len(vectors) == sims
            batch.advance({i: ("joint_velocity", 0.3 * (one.goal - one.q)) for i, one in enumerate(seen)})

    act(20)
    clock, processor = time.perf_counter(), time.process_time()
    act(steps)
    return sims * steps / (time.process_time() - processor), sims * steps / (time.perf_counter() - clock)
