"""Whole tasks: harm per executed job of the planned sequence, and of other ways to choose the order."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks import report, store, suite
from benchmarks.jobs.runs import (
    ACTIONS,
    ACTIONS_EACH,
    BLIND,
    BLIND_ORDER,
    FRAGILE,
    METHODS,
    NEAREST,
    OURS,
    SPEED,
    Measured,
    Run,
    Way,
    measure,
)
from benchmarks.jobs.variants import ALL, FACTOR, GOAL_SHIFT, KINDS, LARGER, SHIFT

TITLE = "Jobs: harm of failures during whole tasks"
QUESTION = "How much less harm does a job do if the order of its actions is chosen by harm as well?"
HEADLINE = "harm per executed job"
DEPENDS_ON = (
    *suite.PLANNING,
    *suite.SIMULATION,
    "src/graceful_plan/job",
    "sim/failbench/job_validation.py",
    "benchmarks/jobs",
)
STORE = Path(__file__).resolve().parents[1] / "job_runs"
W = 1.0
"""Safety weight of all jobs: one unit of expected severity is worth 1 rad of joint motion."""
VARIANTS, LONG_VARIANTS = 3, 6
FAILURES, LONG_FAILURES = 200, 400
LARGER_VARIANTS, LONG_LARGER_VARIANTS = 3, 6
LARGER_FAILURES = 200
FIRST, EIGHT = 3.0, 10.0
"""Wanted times to a first complete plan with at most three, and with eight objects [s]."""
LESS, LONGER = 1.5, 0.15
"""Wanted harm relative to ours, and largest share by which ours may take longer."""
_MOST = 8
"""Number of objects of the largest job."""
MEASURED = f"""\
Five jobs of `benchmarks/jobs`, each as it is and with drawn poses (objects by up to {100 * SHIFT:g} cm, goals by up to
{100 * GOAL_SHIFT:g} cm) and severities (times or divided by up to {FACTOR:g}). w = {W:g}, at
{100 * SPEED:g} % of the velocity limits. Five ways to plan each:

- "{OURS}": `plan_job` at w, with all actions.
- "{BLIND}": `plan_job` at w = 0: order and motions know nothing of harm.
- "{BLIND_ORDER}": the order found at w = 0, without lids and clearing, motions planned at w. Compared with "{OURS}",
  this isolates the choice of the sequence.
- "{NEAREST}", "{FRAGILE}": the order of a hand that always takes the nearest object, and by severity; motions at w.

Three larger jobs are treated alike: a table is laid for a person (8 objects), a desk is cleared (7), and groceries are
stowed beside a child who walks along the counter (6).

Each search of a job plans the same number of actions: {ACTIONS}, or {ACTIONS_EACH} per object if that is more.
FailBench executes every job with {FAILURES} failures of the gripper (failure, weak grip, stuck), in larger jobs
{LARGER_FAILURES} (`--long`: {LONG_FAILURES}), uniform over the time of the job. Harm per job: failures come per hour.
"x less": harm over that of "{OURS}". "Refused": the healthy arm cannot follow a motion in simulation, since it moves
into the guest of `person`, who pushes it aside, or it harms something. "None": no sequence was found over the sampled
grasps and places.
"""


def run(options: suite.Options) -> str:
    """Measure the variants that are left, and report on all."""
    wanted = _wanted(options)
    until = time.monotonic() + (options.seconds or float("inf"))
    with store.folder_of(options, STORE) as folder:
        file = folder / "jobs.jsonl"
        have = {Run(**one.run) for one in _read(file)}
        todo = [one for one in wanted if one not in have]
        store.fill(file, todo, measure, processes=options.processes, label="jobs", until=until)
        found = [one for one in _read(file) if Run(**one.run) in wanted]
    if not found:
        raise report.NotMeasured("no variant was finished in time")
    found.sort(key=lambda one: (list(ALL).index(one.run["job"]), one.run["number"]))
    small, larger = ([one for one in found if one.run["job"] in kinds] for kinds in (KINDS, LARGER))
    harm = [*(_harm_row(one) for one in small), _median_row(small, "median")]
    if larger:
        harm += [*(_harm_row(one) for one in larger), _median_row(larger, "median of the larger jobs")]
    return "\n".join(
        [
            MEASURED,
            f"{len(found)} of {len(wanted)} variants were measured.\n",
            report.targets(targets(small, larger)),
            "Harm per executed job, relative to that of ours, with the duration in brackets:\n",
            report.table(("job", *METHODS, "interval of ours"), harm),
            "Sequences:\n",
            report.table(("job", OURS, BLIND_ORDER), (_sequence_row(one) for one in found), numbers=False),
            "Predicted impact (sum of P S over the job) and motion cost, gap to the lower bound, and "
            "times of the search:\n",
            report.table(_COST_HEADER, (_cost_row(one) for one in found)),
        ]
    )


def _wanted(options: suite.Options) -> list[Run]:
    """Return the variants of a run; a quick run has one, of a small job."""
    if options.quick:
        return [Run(job="order", number=0, w=W, failures=20)]
    count = options.pick(VARIANTS, quick=1, long=LONG_VARIANTS)
    failures = options.pick(FAILURES, quick=0, long=LONG_FAILURES)
    small = [Run(job=name, number=k, w=W, failures=failures) for k in range(count) for name in KINDS]
    count = options.pick(LARGER_VARIANTS, quick=0, long=LONG_LARGER_VARIANTS)
    failures = options.pick(LARGER_FAILURES, quick=0, long=LONG_FAILURES)
    larger = [Run(job=name, number=k, w=W, failures=failures) for k in range(count) for name in LARGER]
    return [*larger, *small]  # the longest first, so that no process waits for one of them in the end


def _read(file: Path) -> list[Measured]:
    found = []
    for line in store.read_lines(file):
        one = Measured(**line)
        one.ways = {name: Way(**way) for name, way in line["ways"].items()}
        found.append(one)
    return found


def less(one: Measured, method: str) -> float:
    """Return the harm per job of a method over that of ours; NaN if either was not measured or both are 0."""
    mine, theirs = one.ways[OURS].harm, one.ways[method].harm
    return theirs / mine if mine > 0.0 else np.nan


def longer(one: Measured, method: str) -> float:
    """Return the duration of ours over that of a method."""
    return one.ways[OURS].duration / one.ways[method].duration


def _median(found: Sequence[Measured], method: str) -> tuple[float, float]:
    """Return the medians of the harm of a method over that of ours, and of how much longer ours takes."""
    both = [one for one in found if np.isfinite(less(one, method))]
    if not both:
        return np.nan, np.nan
    ratios, times = [less(one, method) for one in both], [longer(one, method) for one in both]
    return float(np.median(ratios)), float(np.median(times)) - 1.0


def targets(found: Sequence[Measured], larger: Sequence[Measured]) -> Iterator[report.Target]:
    """Yield the targets of the five jobs, then those of the larger ones."""
    changed = [one for one in found if one.ways[OURS].steps != one.ways[BLIND_ORDER].steps]
    several = f"the same over the {len(changed)} variants whose sequence differs"
    yield _less_harm(f'{HEADLINE}, ours against "{BLIND_ORDER}", median', found)
    yield _less_harm(several, changed)
    small = [one for one in found if np.isfinite(one.least)]
    yield report.all_done(
        "jobs in which exhaustive search finds nothing cheaper",
        sum(one.found <= one.least * (1.0 + 1e-9) for one in small),
        len(small),
    )
    planned = [one for one in found if np.isfinite(one.first_seconds)]
    worst = max((one.first_seconds for one in planned), default=np.inf)
    yield report.Target(
        what=f"time to a first complete plan, at most 3 objects, worst of the {len(planned)} that have one in 60 s",
        wanted=f"<= {FIRST:g} s",
        measured=_first(worst, max((one.first_cpu for one in planned), default=np.inf)),
        met=worst <= FIRST,
    )
    yield _executed("jobs that are planned and executed", found)
    yield _less_harm(f'larger jobs: {HEADLINE}, ours against "{BLIND_ORDER}", median', larger)
    eight = next((one for one in larger if one.objects == _MOST), None)
    yield report.Target(
        what=f"time to a first complete plan, {_MOST} objects",
        wanted=f"<= {EIGHT:g} s",
        measured="none" if eight is None else _first(eight.first_seconds, eight.first_cpu),
        met=None if eight is None else eight.first_seconds <= EIGHT,
    )
    yield _executed("larger jobs that are planned and executed", larger)


def _first(seconds: float, cpu: float) -> str:
    return f"{seconds:.1f} s ({cpu:.1f} s of processor time)"


def _less_harm(what: str, some: Sequence[Measured]) -> report.Target:
    ratio, more = _median(some, BLIND_ORDER)
    return report.Target(
        what=what,
        wanted=f"{LESS:g} x less, <= {100 * LONGER:g} % longer",
        measured=f"{report.quantity(ratio)} x less, {100 * more:+.1f} %",
        met=ratio >= LESS and more <= LONGER if np.isfinite(ratio) else None,
    )


def _executed(what: str, some: Sequence[Measured]) -> report.Target:
    done = sum(way.status == "SOLVED" and not way.refused for one in some for way in one.ways.values())
    of = sum(len(one.ways) for one in some)
    return report.Target(what=what, wanted="all", measured=f"{done} of {of}", met=done == of if of else None)


def _cell(one: Measured, method: str) -> str:
    way = one.ways[method]
    if way.status != "SOLVED":
        return "none"
    harm = way.harm if method == OURS else less(one, method)
    return f"{'refused' if way.refused else report.quantity(harm)} ({way.duration:.1f} s)"


def _harm_row(one: Measured) -> Sequence[object]:
    ours = one.ways[OURS]
    cells = [_cell(one, OURS)]
    cells += [_cell(one, method) for method in METHODS[1:]]
    return (_name(one), *cells, f"{report.quantity(ours.low)} to {report.quantity(ours.high)}")


def _median_row(found: Sequence[Measured], name: str) -> Sequence[object]:
    medians = [_median(found, method) for method in METHODS[1:]]
    return (name, "", *(f"{report.quantity(ratio)} (ours {100 * more:+.1f} %)" for ratio, more in medians), "")


def _sequence_row(one: Measured) -> Sequence[object]:
    return _name(one), *(", ".join(one.ways[method].steps) or one.ways[method].status for method in (OURS, BLIND_ORDER))


_COST_HEADER = (
    "job",
    "impact, ours",
    "order of w = 0",
    "motion, ours [rad]",
    "order of w = 0",
    "gap",
    "first plan [s]",
    "grasps",
    "stances",
    "checks",
    "plan()",
    "rest",
)


def _cost_row(one: Measured) -> Sequence[object]:
    ours, theirs = one.ways[OURS], one.ways[BLIND_ORDER]
    total = one.shares["total_time"]
    parts = [one.shares[name] / total for name in ("grasps", "stances", "checks", "plan")]
    return (
        _name(one),
        *(report.quantity(x) for x in (ours.impact, theirs.impact, ours.motion, theirs.motion)),
        report.percent(one.gap, 0),
        f"{one.first_seconds:.1f}",
        *(report.percent(share, 0) for share in (*parts, 1.0 - sum(parts))),
    )


def _name(one: Measured) -> str:
    return f"{one.run['job']} {one.run['number']}"
