"""Plan and monitor, together and alone: harm of all faults per executed task on unseen tasks. Part of `policies`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks import store, suite
from benchmarks.monitored_runs import CONDITIONS, HEALTHY, PERIOD, RATE, ROBOTS, SEED, SENSORS, Episodes, MonitorJob, do
from benchmarks.report import Target, targets
from benchmarks.store import read_lines
from failbench.basics.statistics import Estimate, cluster_bootstrap, estimate_probability

TASKS, LONG_TASKS = 14, 23
WATCHED = "plan, monitor"
OTHER_DEGREES, DEGREE_TASKS, LONG_DEGREE_TASKS = ("minor", "moderate", "critical"), 4, 8
"""Further degrees of faults for the table of notices, on the first tasks with the condition `WATCHED`."""
MEASURED = f"""\
**Monitor.** The motion runs by the clock, with a reading every {1e3 * PERIOD:g} ms. The limits come from healthy runs
of two tasks of each of {len(HEALTHY)} bundled scenes, by {ROBOTS} robots each, for {RATE:g} false alarm an hour; no
fault was used. Harm is measured on tasks in `unseen/`. Robots differ from their model: each mass, inertia and friction
by up to 20 %. Readings have noise (positions {SENSORS.position:g} rad, speeds {SENSORS.speed:g} rad/s, torques
{SENSORS.torque:g} N m), time stamps are wrong by up to {1e3 * SENSORS.jitter:g} ms, samples arrive
{1e3 * SENSORS.delay:g} ms late, and {SENSORS.lost:.1%} are lost. A notice starts `StopOnFailure()`. Episodes of all
conditions have the same robots, quantiles of onsets and seeds, and last 1 s longer than the motion. Harm per task is
that of a failed episode times the duration of the motion, since faults come per hour.
Intervals are 95 %, from a bootstrap over tasks.
"""


def chosen_tasks(options: suite.Options) -> list[str]:
    """Return tasks in `unseen/`, evenly over its scenes."""
    by_scene: dict[str, list[str]] = {}
    for name in suite.unseen_task_names():
        by_scene.setdefault(name.split("/")[0], []).append(name)
    order = sorted((place, scene, name) for scene, names in by_scene.items() for place, name in enumerate(names))
    return [name for _, _, name in order][: options.pick(TASKS, quick=1, long=LONG_TASKS)]


def report(options: suite.Options, folder: Path, until: float) -> Iterator[str]:
    """Do the jobs that are left, and yield the tables."""
    file = folder / f"monitored.{SEED}.jsonl"
    have = [Episodes(**line) for line in read_lines(file)]
    done = {(one.task, one.condition, one.robot, one.degree) for one in have}
    robots = options.pick(1, quick=1, long=4)
    tasks = chosen_tasks(options)
    jobs = [
        MonitorJob(task=task, condition=condition, robot=robot)
        for robot in range(robots)
        for task in tasks
        for condition in options.pick(tuple(CONDITIONS), quick=("w = 0",))  # limits take half a minute
    ]
    jobs += [
        MonitorJob(task=task, condition=WATCHED, robot=0, degree=degree)
        for degree in options.pick(OTHER_DEGREES, quick=())
        for task in tasks[: options.pick(DEGREE_TASKS, quick=0, long=LONG_DEGREE_TASKS)]
    ]
    jobs = [job for job in jobs if (job.task, job.condition, job.robot, job.degree) not in done]
    store.fill(file, jobs, do, processes=options.processes, label="monitored", until=until)
    yield MEASURED
    yield from tables([Episodes(**line) for line in read_lines(file)])


def tables(done: Sequence[Episodes]) -> Iterator[str]:
    """Yield the tables of the robots and tasks for which all conditions are finished."""
    by = {(one.task, one.robot, one.condition): one for one in done if one.degree == "severe"}
    finished = sorted({(task, robot) for task, robot, _ in by if all((task, robot, c) in by for c in CONDITIONS)})
    unsolved = [one for one in finished if not all(by[*one, c].harm for c in CONDITIONS)]
    harmful = [
        one
        for one in finished
        if one not in unsolved
        and any(by[*one, c].healthy > 0.0 for c, (_, watched) in CONDITIONS.items() if not watched)
    ]
    whole = [one for one in finished if one not in unsolved and one not in harmful]
    if not whole:
        yield "No task is finished yet.\n"
        return
    rows = {c: [by[task, robot, c] for task, robot in whole] for c in CONDITIONS}
    tasks = [task for task, _ in whole]
    per_task = {c: _by_task(tasks, [_harm(one) for one in row]) for c, row in rows.items()}
    durations = {c: _by_task(tasks, [one.duration for one in row]) for c, row in rows.items()}
    seconds = sum(one.seconds for one in done)
    yield f"{len(set(tasks))} tasks, {len(whole)} robots; {seconds:.0f} s of processor time.\n"
    if unsolved:
        yield f"Left out, because the planner finds no motion: {_names(unsolved)}.\n"
    if harmful:
        stopped = [stop for task, robot in harmful for c in CONDITIONS for stop in by[task, robot, c].stopped]
        yield (
            f"Left out, because the robot does harm without a failure and a monitor: {_names(harmful)}. The monitor"
            f" stops {sum(stopped)} of {len(stopped)} robots without a failure there.\n"
        )
    base = per_task["w = 0"]
    yield targets(_targets(base, per_task[WATCHED], durations["w = 0"], durations[WATCHED], rows))
    yield "| condition | harm of a failed episode | duration | harm per task, of w = 0 | less by | median of tasks |"
    yield "|---|---:|---:|---:|---:|---:|"
    for c, row in rows.items():
        harm = float(np.mean([_mean(one.harm.values()) for one in row]))
        less = _ratio(base, per_task[c])
        duration = np.mean([one.duration for one in row])
        yield (
            f"| {c} | {harm:.2f} | {duration:.2f} s | {1.0 / less.mean:.2f} "
            f"| {less.mean:.2f} [{less.low:.2f}, {less.high:.2f}] "
            f"| {_median_of_ratios(base, per_task[c])} |"
        )
    yield ""
    yield from _stops(rows)
    yield from _by_fault(rows)
    yield from _by_degree([one for one in done if one.condition == WATCHED and (one.task, one.robot) in whole])
    yield "Task by task, harm of a failed episode times duration:\n"
    yield f"| task | {' | '.join(CONDITIONS)} | plan, longer |"
    yield "|---|" + "---:|" * (len(CONDITIONS) + 1)
    for i, task in enumerate(sorted(set(tasks))):
        harms = " | ".join(f"{per_task[c][i]:.2f}" for c in CONDITIONS)
        yield f"| {task} | {harms} | {100.0 * (durations[WATCHED][i] / durations['w = 0'][i] - 1.0):+.0f} % |"
    yield ""


def _names(found: Sequence[tuple[str, int]]) -> str:
    return ", ".join(f"`{task}`" for task, _ in found)


def _targets(
    base: np.ndarray,
    both: np.ndarray,
    fastest: np.ndarray,
    duration: np.ndarray,
    rows: Mapping[str, Sequence[Episodes]],
) -> Iterator[Target]:
    less = _median_of_ratios(base, both)
    yield Target(
        what="plan and monitor: x less harm of mixed faults per task than w = 0, median of tasks",
        wanted=">= 3",
        measured=str(less),
        met=less.mean >= 3.0,
    )
    stopped = [stop for row in rows.values() for one in row for stop in one.stopped]
    yield Target(
        what="healthy tasks stopped by a false alarm",
        wanted="<= 0.01",
        measured=str(estimate_probability(stopped)),
        met=bool(np.mean(stopped) <= 0.01),
    )
    longer = _median_of_ratios(duration, fastest)
    yield Target(
        what="plan: duration over that of w = 0, median of tasks",
        wanted="<= 1.05",
        measured=str(longer),
        met=longer.mean <= 1.05,
    )


def _stops(rows: Mapping[str, Sequence[Episodes]]) -> Iterator[str]:
    watched = [stopped for row in rows.values() for one in row for stopped in one.stopped]
    share = estimate_probability(watched)
    yield f"Healthy tasks stopped by a false alarm: {sum(watched)} of {len(watched)}, {share}.\n"


def _by_fault(rows: Mapping[str, Sequence[Episodes]]) -> Iterator[str]:
    yield f"| fault | noticed | after [s] | by | {' | '.join(f'harm, {c}' for c in rows)} |"
    yield "|---|---:|---:|---|" + "---:|" * len(rows)
    watched = [one for c, row in rows.items() if CONDITIONS[c][1] for one in row]
    for fault in watched[0].harm:
        delays = np.array([one.delay[fault] for one in watched], dtype=float)
        kinds = [one.kind[fault] for one in watched if one.kind[fault]]
        often = max(sorted(set(kinds)), key=kinds.count) if kinds else "-"
        seen = np.isfinite(delays)
        after = f"{np.median(delays[seen]):.2f}" if seen.any() else "-"
        harms = " | ".join(f"{_mean(one.harm[fault] for one in row):.1f}" for row in rows.values())
        yield f"| {fault.split('/')[0]} | {seen.sum()} of {len(seen)} | {after} | {often} | {harms} |"
    yield ""


def _by_degree(watched: Sequence[Episodes]) -> Iterator[str]:
    """Yield the share of noticed faults and the median time to the notice, by fault and degree."""
    degrees = ("minor", "moderate", "severe", "critical")
    tasks = {one.task for one in watched if one.degree != "severe"}
    if not tasks:
        return
    yield f"Noticed, and after how many seconds in the median, on {len(tasks)} tasks with the plan:\n"
    yield f"| fault | {' | '.join(degrees)} |"
    yield "|---|" + "---:|" * len(degrees)
    names = list(dict.fromkeys(fault.split("/")[0] for one in watched for fault in one.harm))
    for name in names:
        cells = []
        for degree in degrees:
            delays = np.array(
                [
                    delay
                    for one in watched
                    if one.degree == degree and one.task in tasks and one.robot == 0
                    for fault, delay in one.delay.items()
                    if fault.split("/")[0] == name
                ],
                dtype=float,
            )
            seen = np.isfinite(delays)
            after = f", {np.median(delays[seen]):.2f} s" if seen.any() else ""
            cells.append(f"{seen.sum()} of {len(seen)}{after}")
        yield f"| {name} | {' | '.join(cells)} |"
    yield ""


def _mean(values: Iterable[float]) -> float:
    return float(np.nanmean(list(values)))


def _harm(one: Episodes) -> float:
    """Return a number in proportion to the harm of faults per executed task."""
    return _mean(one.harm.values()) * one.duration


def _by_task(tasks: Sequence[str], values: Sequence[float]) -> np.ndarray:
    return np.array(
        [np.mean([v for t, v in zip(tasks, values, strict=True) if t == task]) for task in sorted(set(tasks))]
    )


def _ratio(first: np.ndarray, second: np.ndarray) -> Estimate:
    """Return the ratio of the means with an interval from a bootstrap over tasks."""

    def ratio(pairs: np.ndarray) -> float:
        return float(pairs[:, 0].sum() / max(pairs[:, 1].sum(), 1e-12))

    return cluster_bootstrap(np.stack([first, second], axis=1), np.arange(len(first)), ratio, resamples=2000)


def _median_of_ratios(first: np.ndarray, second: np.ndarray) -> Estimate:
    """Return the median over tasks of the ratio, with an interval from a bootstrap over tasks; 0 / 0 is left out."""
    some = first > 0.0
    ratios = first[some] / np.maximum(second[some], 1e-12)
    return cluster_bootstrap(ratios, np.arange(len(ratios)), lambda rows: float(np.median(rows)), resamples=2000)
