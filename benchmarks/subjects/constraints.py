"""Constraints: contents that carried vessels keep and the extra duration, grasps, and planning upright."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks import report, store, suite
from benchmarks.constrained import contents, held, upright
from benchmarks.constrained.contents import DEFAULT, NOTHING, ContentsJob, Kept
from benchmarks.constrained.held import Held, HeldJob
from benchmarks.constrained.upright import OMPL, PROJECTION, REJECTION, UprightFigures, UprightJob
from benchmarks.store import read_lines

TITLE = "Constraints: contents and grasp are kept, and planning upright"
QUESTION = "Do carried vessels keep their contents and fingers their object, and how much longer are these motions?"
HEADLINE = "healthy motions that lose more than 1 % by FailBench"
DEPENDS_ON = (
    *suite.PLANNING,
    *suite.SIMULATION,
    "benchmarks/constrained",
    "benchmarks/vessels",
    "benchmarks/motion_problems.py",
)
MEASURED = f"""\
**Contents.** All bundled tasks that carry a vessel with contents, and six of `benchmarks/vessels/`: a bowl of soup
filled to 90 %, a wine glass held from the side, a tray with three cups, a ladle, a bucket on its handle, a pan with
oil. A carried object has one vessel: of the three cups it is the one farthest from the grip. The handle of the bucket
is fixed. `plan` with its defaults except for w and `constraints`, at full speed. "Lost, FailBench": share of the
contents that is missing after FailBench's healthy robot has executed the motion, by its own model of containers. "Lost,
pendulum": largest share that the judge's pendulum has above the rim, also for unconstrained motions. Fingers hold the
vessel; "fingers lose it" counts motions that need a weld instead, "not carried out" those that leave the joint
tolerance (0.05 rad) even then. "Longer": duration of a constrained motion over that of the unconstrained motion with
the same task, w and seed.

**Held.** All bundled tasks, `plan` with its defaults within {held.SECONDS:g} s, executed by FailBench's healthy robot
at full speed. Fingers hold the object by friction, without a weld.

**Upright.** `Upright(15 degrees)` on all bundled tasks and on problems of the MotionBenchMaker type from
`benchmarks/motion_problems.py`. Two of its seven kinds reach from above ("box", "table_pick"), so the gripper can be
upright at both ends; only such problems count. "Solved": `plan` at the default w within {upright.SECONDS:g} s. "First
path": RRT-Connect with w = 0 from the call to the first path within {upright.SECONDS:g} s, scene compiled, first call
not counted. "{PROJECTION}" is the library's method; "{REJECTION}" uses the same trees, kernels and edge checks without
projection. "{OMPL}" is its RRTConnect in a ProjectedStateSpace with default settings; the equation is the distance of a
configuration from the constraint (0 inside). Its callbacks are Python with our kernels, so its times are those of a
user of its Python module. "Gap": excess of J of `plan` with {upright.SOON:g} s over the least J of all runs, including
long ones with other seeds.
"""
_CONTENTS, _HELD = 0.4, 0.25
"""Shares of a limited time for contents and for grasps; the rest is for planning upright."""
STORE = Path(__file__).resolve().parents[1] / "constrained_runs"
"""One line per finished job, so an interrupted run can resume. Remove the folder to measure again."""
LOST = 0.01
"""Share of the contents above which they count as lost."""
LONGER = 0.3
FIRST_WITHIN = 0.005
GAP = 0.02
_SIZES = {"normal": (2.0, 1, 2), "quick": (1.5, 1, 2), "long": (10.0, 3, 5)}
"""Upright: duration of a long run [s], number of long runs, number of other seeds."""


def run(options: suite.Options) -> str:
    """Do the jobs that are left, and report on all finished ones."""
    size = options.pick("normal", quick="quick", long="long")
    began, seconds = time.monotonic(), math.inf if options.seconds is None else options.seconds
    with store.folder_of(options, STORE) as folder:
        kept_file, held_file, upright_file = (
            folder / f"{name}.jsonl" for name in ("contents", "held", f"upright_{size}")
        )
        wanted = contents.jobs(options)
        have = {kept.job for kept in read_kept(kept_file)}
        # One process where durations or times are compared: planning has a limit in seconds and uses two threads.
        left = [job for job in wanted if job not in have]
        until = began + _CONTENTS * seconds
        store.fill(kept_file, left, contents.examine, processes=1, label="contents", until=until)
        motions = held.jobs(options)
        have = {one.job for one in read_held(held_file)}
        until = began + (_CONTENTS + _HELD) * seconds
        left = [job for job in motions if job not in have]
        store.fill(held_file, left, held.examine, processes=options.processes, label="held", until=until)
        groups = upright.names(options)
        done = {figures.name for figures in read_upright(upright_file)}
        names = [name for group in groups.values() for name in group if name not in done]
        long, long_seeds, seeds = _SIZES[size]
        questions = [UprightJob(name=name, seeds=seeds, long=long, long_seeds=long_seeds) for name in names]
        store.fill(upright_file, questions, upright.examine, processes=1, label="upright", until=began + seconds)
        asked = set(wanted)
        kept = [x for x in read_kept(kept_file) if x.job in asked]
        gripped = [x for x in read_held(held_file) if x.job in set(motions)]
        found = {x.name: x for x in read_upright(upright_file)}
    figures = {group: [found[name] for name in all_of if name in found] for group, all_of in groups.items()}
    left = (
        len(wanted)
        - len(kept)
        + len(motions)
        - len(gripped)
        + sum(map(len, groups.values()))
        - sum(map(len, figures.values()))
    )
    unfinished = f"\n**Not finished: {left} jobs are left.**\n" if left else ""
    return "\n".join(
        [
            MEASURED + unfinished,
            report.targets(_targets(kept, gripped, figures)),
            *_contents(kept),
            *_held(gripped),
            *_upright(figures),
        ]
    )


# --- finished jobs --------------------------------------------------------------------------------------------------


def read_kept(file: Path) -> Iterator[Kept]:
    """Yield the finished jobs on contents."""
    for x in read_lines(file):
        yield Kept(**{**x, "job": ContentsJob(**x["job"])})


def read_held(file: Path) -> Iterator[Held]:
    """Yield the finished jobs on grasps."""
    for x in read_lines(file):
        yield Held(**{**x, "job": HeldJob(**x["job"])})


def read_upright(file: Path) -> Iterator[UprightFigures]:
    """Yield the finished jobs on planning upright."""
    for x in read_lines(file):
        first = {method: tuple(times) for method, times in x["first"].items()}
        lists = {key: tuple(value) for key, value in x.items() if isinstance(value, list)}
        yield UprightFigures(**{**x, **lists, "first": first})


# --- contents --------------------------------------------------------------------------------------------------------


def _targets(
    kept: Sequence[Kept], gripped: Sequence[Held], figures: dict[str, list[UprightFigures]]
) -> Iterator[report.Target]:
    mine = [x for x in kept if x.job.constraints == DEFAULT]
    for observer, lost in (("FailBench", [x.lost for x in mine]), ("the pendulum", [x.swung for x in mine])):
        bad, unknown = sum(x > LOST for x in lost), sum(not math.isfinite(x) for x in lost)
        yield report.Target(
            what=f"healthy motions that lose more than 1 % by {observer}",
            wanted="0",
            measured=f"{bad} of {len(lost)}; {unknown} not planned or not carried out",
            met=not bad and not unknown,
        )
    dropped = sum(bool(x.lost_grip) for x in mine)
    yield report.Target(
        what="healthy motions that lose the vessel", wanted="0", measured=f"{dropped} of {len(mine)}", met=not dropped
    )
    longer = [x for x in ratios(y for y in kept if y.job.fill is None).values() if math.isfinite(x)]
    median = _median(longer)
    yield report.Target(
        what="longer than unconstrained, median",
        wanted=f"<= {report.percent(LONGER, 0)}",
        measured=f"{report.percent(median - 1.0)} ({len(longer)} pairs)",
        met=median - 1.0 <= LONGER,
    )
    lost, other = sum(bool(x.lost) for x in gripped), sum(bool(x.refused) or x.status != "SOLVED" for x in gripped)
    yield report.Target(
        what="bundled tasks, held by friction at full speed: motions that lose the object",
        wanted="0",
        measured=f"{lost} of {len(gripped)}; {other} not planned or not carried out",
        met=not lost and not other if gripped else None,
    )
    touching = sum(x.harm > 0.0 for x in gripped)
    yield report.Target(
        what="healthy motions of bundled tasks that do any harm",
        wanted="0",
        measured=f"{touching} of {len(gripped)}",
        met=not touching if gripped else None,
    )
    yield from _upright_targets(figures)


def _held(gripped: Sequence[Held]) -> Iterator[str]:
    header = (
        "held by fingers",
        "motions",
        "lost",
        "not planned or not followed",
        "do harm",
        "slip, median",
        "slip, worst",
    )
    rows = []
    for name in dict.fromkeys(x.job.task for x in gripped):
        of = [x for x in gripped if x.job.task == name]
        slips = [1e3 * x.slip for x in of if math.isfinite(x.slip)]
        rows.append(
            [
                name,
                str(len(of)),
                str(sum(bool(x.lost) for x in of)),
                str(sum(bool(x.refused) or x.status != "SOLVED" for x in of)),
                str(sum(x.harm > 0.0 for x in of)),
                report.quantity(_median(slips), " mm"),
                report.quantity(max(slips, default=math.nan), " mm"),
            ]
        )
    yield report.table(header, rows)
    problems = Counter((x.job.task, x.lost or x.refused or x.harm_text or x.status) for x in gripped if not _is_well(x))
    if problems:
        yield report.table(("what happens", "how", "motions"), [[*key, str(n)] for key, n in sorted(problems.items())])


def _is_well(x: Held) -> bool:
    return x.status == "SOLVED" and not (x.lost or x.refused or x.harm_text)


def ratios(kept: Iterable[Kept]) -> dict[ContentsJob, float]:
    """Return the duration of each constrained motion over that of its unconstrained twin; NaN if one is missing."""
    duration = {(x.job.task, x.job.w, x.job.seed, x.job.fill, x.job.constraints): x.duration for x in kept}
    found: dict[ContentsJob, float] = {}
    for task, w, seed, fill, constraints in duration:
        if constraints == DEFAULT:
            job = ContentsJob(task=task, w=w, seed=seed, fill=fill, constraints=DEFAULT)
            key = (task, w, seed, fill)
            found[job] = duration[*key, DEFAULT] / duration.get((*key, NOTHING), math.nan)
    return found


def _contents(kept: Sequence[Kept]) -> Iterator[str]:
    usual, filled = ([x for x in kept if (x.job.fill is not None) == given] for given in (False, True))
    header = ("constraints", "motions", "planned", "carried out", "fingers lose it", "lose > 1 %, FailBench",
              "lost, mean", "worst", "lose > 1 %, pendulum")  # fmt: skip
    rows = []
    for constraints in (DEFAULT, NOTHING):
        for w in sorted({x.job.w for x in usual}):
            of = [x for x in usual if x.job.constraints == constraints and x.job.w == w]
            rows.append([f"`{constraints}`, w = {w:g}", *_losses(of)])
    yield report.table(header, rows)
    longer = ratios(usual)
    weights = sorted({x.job.w for x in usual})
    rows = [_task_row(name, [x for x in usual if x.job.task == name], longer, weights) for name in _tasks(usual)]
    columns = ("fill", *(f"longer, w = {w:g}" for w in weights), "duration, constrained", "unconstrained",
               "lost, constrained", "unconstrained", "fingers lose it", "not planned")  # fmt: skip
    yield report.table(("task", *columns), rows)
    longer = ratios(filled)
    rows = []
    for name in _tasks(filled):
        for fill in sorted({x.job.fill or 0.0 for x in filled if x.job.task == name}):
            of = [x for x in filled if x.job.task == name and x.job.fill == fill and x.job.constraints == DEFAULT]
            times = [longer[x.job] for x in of]
            row = [f"{name}, {report.percent(fill, 0)}", _times(times), _seconds(of), report.percent(_worst(of))]
            rows.append(row)
    yield report.table(("fill (w = 0.3)", "longer", "duration", "lost, worst"), rows)
    failed = Counter((x.job.task, x.job.constraints, _short(x)) for x in kept if x.status != "SOLVED" or x.refused)
    if failed:
        rows = [[f"{task}, `{c}`", why, str(n)] for (task, c, why), n in sorted(failed.items())]
        yield report.table(("not planned or not carried out", "why", "motions"), rows)


def _losses(of: Sequence[Kept]) -> list[str]:
    planned = [x for x in of if x.status == "SOLVED"]
    lost = [x.lost for x in planned if math.isfinite(x.lost)]
    return [
        str(len(of)),
        str(len(planned)),
        str(len(lost)),
        str(sum(bool(x.lost_grip) for x in planned)),
        str(sum(x > LOST for x in lost)),
        report.percent(float(np.mean(lost))) if lost else "none",
        report.percent(max(lost, default=math.nan)),
        str(sum(x.swung > LOST for x in planned)),
    ]


def _task_row(name: str, of: Sequence[Kept], longer: dict[ContentsJob, float], weights: Sequence[float]) -> list[str]:
    mine, plain = ([x for x in of if x.job.constraints == c] for c in (DEFAULT, NOTHING))
    return [
        name,
        report.percent(contents.fill_of(name), 0),
        *(_times([longer[x.job] for x in mine if x.job.w == w]) for w in weights),
        _seconds(mine),
        _seconds(plain),
        report.percent(_worst(mine)),
        report.percent(_worst(plain)),
        str(sum(bool(x.lost_grip) for x in mine)),
        str(sum(x.status != "SOLVED" for x in mine)),
    ]


def _tasks(kept: Sequence[Kept]) -> list[str]:
    return list(dict.fromkeys(x.job.task for x in kept))


def _short(x: Kept) -> str:
    return f"{x.status}: {x.detail}"[:160] if x.status != "SOLVED" else x.refused.split(" at ")[0]


def _times(values: Sequence[float]) -> str:
    return report.quantity(_median(values))


def _seconds(of: Sequence[Kept]) -> str:
    return report.quantity(_median([x.duration for x in of]), " s")


def _worst(of: Sequence[Kept]) -> float:
    return max((x.lost for x in of if math.isfinite(x.lost)), default=math.nan)


def _median(values: Iterable[float]) -> float:
    known = [x for x in values if not math.isnan(x)]
    return float(np.median(known)) if known else math.nan


# --- upright ---------------------------------------------------------------------------------------------------------


def _upright_targets(figures: dict[str, list[UprightFigures]]) -> Iterator[report.Target]:
    able = [x for of in figures.values() for x in of if not x.objection]
    statuses = [status for x in able for status in x.statuses]
    solved = sum(status == "SOLVED" for status in statuses)
    yield report.Target(
        what=f"upright: solved within {upright.SECONDS:g} s",
        wanted="100 %",
        measured=f"{solved} of {len(statuses)}, {len(able)} problems",
        met=solved == len(statuses) if statuses else None,
    )
    first = {method: _median(_all_first(able, method)) for method in (PROJECTION, REJECTION, OMPL)}
    others = ", ".join(f"{method} {_milliseconds(first[method])} ms" for method in (REJECTION, OMPL))
    yield report.Target(
        what="upright: first path, median",
        wanted=f"< {1e3 * FIRST_WITHIN:g} ms",
        measured=f"{_milliseconds(first[PROJECTION])} ms; {others}",
        met=first[PROJECTION] < FIRST_WITHIN if statuses else None,
    )
    gaps = _gaps(able)
    yield report.Target(
        what=f"upright: gap to the best known at {upright.SOON:g} s, median",
        wanted=f"<= {report.percent(GAP, 0)}",
        measured=report.percent(_median(gaps)),
        met=_median(gaps) <= GAP if gaps else None,
    )


def _upright(figures: dict[str, list[UprightFigures]]) -> Iterator[str]:
    methods = (PROJECTION, REJECTION, OMPL)
    header = ("problems", "examined", "ends upright", "solved", *(f"first path, {m} [ms]" for m in methods),
              *(f"without one, {m}" for m in methods), "gap, median", "worst")  # fmt: skip
    yield report.table(header, [_group_row(group, of) for group, of in figures.items()])
    header = ("problem", "solved", *(f"first path, {m} [ms]" for m in methods), "gap, median", "best J")
    able = [x for of in figures.values() for x in of if not x.objection]
    yield report.table(header, map(_problem_row, able))
    lacking = [[x.name, x.objection] for of in figures.values() for x in of if x.objection]
    if lacking:
        yield report.table(("ends not upright", "why"), lacking)
    failed = Counter((x.name, detail[:160]) for x in able for detail in x.details)
    if failed:
        yield report.table(("not solved", "why", "seeds"), [[*key, str(n)] for key, n in failed.items()])


def _group_row(group: str, of: Sequence[UprightFigures]) -> list[str]:
    able = [x for x in of if not x.objection]
    statuses = [status for x in able for status in x.statuses]
    first = {method: _all_first(able, method) for method in (PROJECTION, REJECTION, OMPL)}
    gaps = _gaps(able)
    return [
        group,
        str(len(of)),
        str(len(able)),
        f"{sum(status == 'SOLVED' for status in statuses)}/{len(statuses)}",
        *(_milliseconds(_median(times)) for times in first.values()),
        *(f"{sum(map(math.isinf, times))}/{len(times)}" for times in first.values()),
        report.percent(_median(gaps)),
        report.percent(max(gaps, default=math.nan)),
    ]


def _problem_row(x: UprightFigures) -> list[str]:
    return [
        x.name,
        f"{sum(status == 'SOLVED' for status in x.statuses)}/{len(x.statuses)}",
        *(_milliseconds(_median(x.first[method])) for method in (PROJECTION, REJECTION, OMPL)),
        report.percent(_median(_gaps([x]))),
        report.quantity(x.best, digits=5),
    ]


def _all_first(able: Sequence[UprightFigures], method: str) -> list[float]:
    return [seconds for x in able for seconds in x.first[method]]


def _gaps(able: Sequence[UprightFigures]) -> list[float]:
    return [total / x.best - 1.0 for x in able for total in x.soon if math.isfinite(x.best) and x.best > 0.0]


def _milliseconds(seconds: float) -> str:
    return report.quantity(1e3 * seconds)
