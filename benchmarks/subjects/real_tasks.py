"""Bundled tasks as robot code calls them: first verified motion, time limits, J over time, and when to stop."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite

Array = np.ndarray

TITLE = "Real tasks: first verified motion, limits of time, J over time, and when to stop"
QUESTION = "How long do the bundled tasks take to a first verified motion, and how fast does the cost J converge?"
HEADLINE = "J above the best known at .3 s"
DEPENDS_ON = suite.PLANNING
CLASSES = ("block", "dry object", "open vessel", "stew")
WEIGHTS = (0.0, None)
"""None is the default."""
LIMITS = (0.05, 0.1)
"""Time limits within which a call has to return a motion [s]."""
TIMES = (0.3, 1.0)
"""Time limits at which J is compared with the best-known J [s]."""
BEST, LONG_BEST = (8.0, (101,)), (20.0, (101, 102, 103))
"""Time limit [s] and seeds of the calls that give the best-known J, in normal and long runs."""
TABLE_BEST, LONG_TABLE_BEST = 2.0, 5.0
"""Time limit of these calls on table tasks, which converge within a second, in normal and long runs [s]."""
FIRST_WANTED = {"block": 4.0, "dry object": 6.0, "open vessel": 10.0, "stew": 15.0}
"""Median time to the first verified motion at w = 0 [ms]."""
DEFAULT_TIMES = 1.5
"""Largest ratio of that time at the default weight over w = 0."""
MEASURED = """\
One process, one call at a time; scenes are compiled and warm. Classes: "block" are the table tasks; "dry object" are
household tasks with nothing to spill; "open vessel" are those with contents that can spill; "stew" is
`dining_table/serve_stew`, a pan that is nearly full. "First" is `plan(stop="first")`: the whole call to its verified
motion. "After the search" is its part after the first path: descent, timing, cost, verification. "Gap" is the relative
excess of J over the best known, which is the least J of {seeds} calls of {best:g} s (table tasks {table:g} s) and of
all other calls here. The weight is the default, unless a row says w = 0.
"""


@dataclass(frozen=True, kw_only=True)
class Call:
    """Result of one call: status, times [s] and cost."""

    solved: bool
    seconds: float
    searched: float
    total: float
    stats: dict[str, float]
    trace: tuple[gp.TracePoint, ...]


def run(options: suite.Options) -> str:
    """Measure calls of each class."""
    names = suite.task_names(options)
    household = [name for name in names if not suite.is_tabletop(name)]
    seeds = range(options.pick(5, quick=1))
    first = {(name, w): [_call(name, seed, w=w, stop="first") for seed in seeds] for name in names for w in WEIGHTS}
    kept = {
        (limit, w): [(_call(name, seed, w=w, time_limit=limit), limit) for name in names for seed in seeds]
        for limit in LIMITS
        for w in WEIGHTS
    }
    few = range(options.pick(2, quick=1, long=3))
    timed = {(name, t): [_call(name, seed, time_limit=t) for seed in few] for name in names for t in TIMES}
    until = {name: [_call(name, seed, stop="converged", time_limit=5.0) for seed in few] for name in names}
    seconds, best_seeds = options.pick(BEST, quick=(0.5, (101,)), long=LONG_BEST)
    table = min(seconds, options.pick(TABLE_BEST, quick=TABLE_BEST, long=LONG_TABLE_BEST))
    longest = {name: seconds if name in household else table for name in names}
    long = {name: [_call(name, seed, time_limit=longest[name]) for seed in best_seeds] for name in names}
    best = {
        name: min(call.total for calls in (long[name], until[name], *(timed[name, t] for t in TIMES)) for call in calls)
        for name in names
    }
    replanned = _replanned(options.pick(40, quick=4))
    rows = [
        *_first_targets(first),
        *_limit_targets(kept),
        *_gap_targets(timed, best, household),
        report.Target(
            what="replanning with a cup, one obstacle moved, first verified motions a second",
            wanted=">= 50",
            measured=f"{1.0 / replanned:.0f}",
            met=1.0 / replanned >= 50.0,
        ),
    ]
    return "\n".join(
        [
            MEASURED.format(best=seconds, table=table, seeds=len(best_seeds)),
            report.targets(rows),
            "### First verified motion [ms], medians over tasks and seeds\n",
            report.table(("class", "w", "median", "95 %", "search", "after the search"), _first_rows(first)),
            "### J above the best known, medians of seeds\n",
            report.table(
                ("task", "best J", *(f"{t:g} s" for t in TIMES), "converged", "after [s]"),
                _gap_rows(timed, until, best),
            ),
            "### When to stop: medians of calls of 1 s by class\n",
            report.table(
                ("class", "first [ms]", "within 5 % [ms]", "within 1 % [ms]", '`stop="converged"` [ms]', "its gap"),
                _stop_rows(first, timed, until, best),
            ),
        ]
    )


def class_of(name: str) -> str:
    """Return the class of a task."""
    if suite.is_tabletop(name):
        return "block"
    if name.endswith("serve_stew"):
        return "stew"
    return "open vessel" if "contents" in suite.task(name).scene.components else "dry object"


def _call(name: str, seed: int, *, w: float | None = None, **settings: object) -> Call:
    """Plan a task, after a warm-up call if it is the first of this task in the process."""
    task = suite.task(name)
    if name not in _WARM:
        _WARM.add(name)
        gp.plan(task.start, task.goal, task.scene, w=w, stop="first")
    began = time.perf_counter()
    result = gp.plan(task.start, task.goal, task.scene, w=w, seed=seed, **settings)  # type: ignore[arg-type]
    return Call(
        solved=result.status is gp.PlanStatus.SOLVED,
        seconds=time.perf_counter() - began,
        searched=result.stats.get("search_time", np.nan),
        total=result.cost.total,
        stats=dict(result.stats),
        trace=result.trace,
    )


_WARM: set[str] = set()


def _replanned(count: int) -> float:
    """Return the median time of a first verified motion with a cup after a small box has moved [s]."""
    task = suite.task("desk/bring_coffee")
    scene = task.scene.add_box("crate", [0.03, 0.03, 0.03], [0.3, -0.5, 0.9])
    seconds = []
    for k in range(count):
        scene = scene.edit(move={"crate": [0.3, -0.5 + 0.005 * k, 0.9]})
        began = time.perf_counter()
        gp.plan(task.start, task.goal, scene, stop="first", seed=k).unwrap()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds[1:]))


# --- targets and tables -----------------------------------------------------------------------------------------------


def _of_class(first: dict[tuple[str, float | None], list[Call]], kind: str, w: float | None) -> list[Call]:
    return [call for (name, at), calls in first.items() if at == w and class_of(name) == kind for call in calls]


def _first_targets(first: dict[tuple[str, float | None], list[Call]]) -> list[report.Target]:
    rows = []
    for kind in CLASSES:
        zero, default = (_median(_of_class(first, kind, w), lambda call: call.seconds) for w in WEIGHTS)
        if np.isnan(zero):
            continue
        wanted = FIRST_WANTED[kind]
        rows.append(_at_most(f"first verified motion, {kind}, w = 0", 1e3 * zero, wanted, "ms"))
        rows.append(_at_most(f"the same at the default weight, {kind}, over w = 0", default / zero, DEFAULT_TIMES, ""))
    return rows


def _limit_targets(kept: dict[tuple[float, float | None], list[tuple[Call, float]]]) -> list[report.Target]:
    rows = []
    for (limit, w), calls in kept.items():
        words = f"`time_limit={limit:g}`, {'default weight' if w is None else 'w = 0'}"
        rows.append(report.all_done(f"{words}: SOLVED", sum(call.solved for call, _ in calls), len(calls)))
        over = 1e3 * float(np.percentile([call.seconds - at for call, at in calls], 99))
        rows.append(_at_most(f"{words}: overrun, 99 %", over, 5.0, "ms"))
    return rows


def _gap_targets(
    timed: dict[tuple[str, float], list[Call]], best: dict[str, float], household: Sequence[str]
) -> list[report.Target]:
    gaps = {t: [_gap(timed[name, t], best[name]) for name in household] for t in TIMES}
    return [
        _at_most("J above the best known at .3 s, median of household tasks", 100.0 * np.median(gaps[0.3]), 10.0, "%"),
        _at_most("the same at 1 s", 100.0 * np.median(gaps[1.0]), 3.0, "%"),
        _at_most("the same at 1 s, worst task", 100.0 * np.max(gaps[1.0]), 15.0, "%"),
    ]


def _first_rows(first: dict[tuple[str, float | None], list[Call]]) -> list[tuple[str, ...]]:
    rows = []
    for kind in CLASSES:
        for w in WEIGHTS:
            calls = _of_class(first, kind, w)
            if calls:
                ms = 1e3 * np.array([(call.seconds, call.searched) for call in calls])
                rows.append(
                    (
                        kind,
                        "0" if w == 0.0 else "default",
                        f"{np.median(ms[:, 0]):.1f}",
                        f"{np.percentile(ms[:, 0], 95):.1f}",
                        f"{np.median(ms[:, 1]):.1f}",
                        f"{np.median(ms[:, 0] - ms[:, 1]):.1f}",
                    )
                )
    return rows


def _gap_rows(
    timed: dict[tuple[str, float], list[Call]], until: dict[str, list[Call]], best: dict[str, float]
) -> list[tuple[str, ...]]:
    return [
        (
            name,
            f"{best[name]:.3f}",
            *(report.percent(_gap(timed[name, t], best[name])) for t in TIMES),
            report.percent(_gap(until[name], best[name])),
            f"{_median(until[name], lambda call: call.seconds):.2f}",
        )
        for name in best
    ]


def _stop_rows(
    first: dict[tuple[str, float | None], list[Call]],
    timed: dict[tuple[str, float], list[Call]],
    until: dict[str, list[Call]],
    best: dict[str, float],
) -> list[tuple[str, ...]]:
    rows = []
    for kind in CLASSES:
        names = [name for name in best if class_of(name) == kind]
        if not names:
            continue
        within = {
            share: [_reached(call, (1.0 + share) * best[name]) for name in names for call in timed[name, TIMES[-1]]]
            for share in (0.05, 0.01)
        }
        ended = [call for name in names for call in until[name]]
        rows.append(
            (
                kind,
                f"{1e3 * _median(_of_class(first, kind, None), lambda call: call.seconds):.0f}",
                *(report.quantity(1e3 * float(np.median(within[share]))) for share in (0.05, 0.01)),
                f"{1e3 * _median(ended, lambda call: call.seconds):.0f}",
                report.percent(float(np.median([_gap(until[name], best[name]) for name in names]))),
            )
        )
    return rows


def _reached(call: Call, total: float) -> float:
    """Return the time at which a verified motion first reached a total cost [s]; infinite if none did."""
    since = call.stats.get("first_motion_time", np.inf)
    return min((max(point.time, since) for point in call.trace if point.total <= total), default=np.inf)


def _gap(calls: Sequence[Call], best: float) -> float:
    return float(np.median([call.total for call in calls])) / best - 1.0


def _median(calls: Sequence[Call], of: Callable[[Call], float]) -> float:
    return float(np.median([of(call) for call in calls])) if calls else np.nan


def _at_most(what: str, value: float, wanted: float, unit: str) -> report.Target:
    words = f"{value:.2g} {unit}".strip() if value < 10.0 else f"{value:.0f} {unit}".strip()
    return report.Target(what=what, wanted=f"<= {wanted:g} {unit}".strip(), measured=words, met=value <= wanted)
