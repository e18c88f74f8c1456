"""The bound of prevention: many motions of one task, and the harm that the best of them prevents.

A motion is chosen on one set of failures and judged on another one, so that luck in the choice does not count. One line
of JSON per task.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.prevention.runs import NONE, SEED, kinds, least_severity
from benchmarks.store import read_lines, tasks_left
from failbench import ExecutionRefused, SimSettings
from failbench.basics.statistics import Estimate, cluster_bootstrap

Array = np.ndarray

SECONDS = 1.0
SPEED, OTHER_SPEEDS = 0.5, (0.35, 0.65)
"""Fractions of the velocity limits."""
PRIORS: Mapping[str, gp.ImpactCost] = MappingProxyType(
    {
        "default": gp.ImpactCost(),
        "service": gp.ImpactCost(model=gp.FailureMixture(faults="service_robot")),
        "arm": gp.ImpactCost(model=gp.FailureMixture(faults="arm")),
    }
)
WEIGHTS = (0.3, 1.0, 3.0)
SEEDS, PLANNERS = (1, 2), ("rrt_star", "prm_star")
DISTINCT = 6
"""Candidates of the calls at the default weight."""
TASKS = (
    "bedside/bring_pills",
    "desk/bring_coffee",
    "workbench/bring_chisel",
    "tabletop_l3/corner_to_blue",
    "bathroom/rinse_mug",
    "dining_table/serve_cake",
    "lab_bench/move_plate",
    "kitchen_counter/move_oil",
    "play_table/pass_ball",
    "tabletop/green_to_blue",
    "reading_corner/move_candlestick",
    "desk/return_stapler",
    "breakfast_bar/pass_milk",
    "dining_table/move_bottle",
)
"""Half of them unseen, in the order of a run that time may end early."""
SIZES = {"drops": (40, 100), "mixed": (57, 95)}
"""Failures of every motion that choose, and of the judged motions that judge."""
LONG_SIZES = {"drops": (400, 400), "mixed": (228, 228)}
MEASURED = """\
How much less harm could any choice among many motions do? Each task is planned in 1 s per call with the default, the
service and the arm prior at w = 0.3, 1 and 3, with other seeds, planners and speeds, and with `candidates=`. Every
motion fails in the same ways. "Best": the motion with the least harm per executed task on some failures. It is judged
on other failures, as all motions of the tables are. **Share of what is attainable**: the relative reduction of harm per
task against w = 0, summed over the tasks, over that of the best motion. The choice of the best is noisy, so shares may
exceed 1. Intervals (95 %) come from resampled tasks. Harm and failures are those of `prevention`, damage to the carried
object included.
"""


@dataclass(frozen=True, kw_only=True)
class BoundJob:
    """A task, and the numbers of failures of each kind: to choose, and to judge."""

    task: str
    sizes: Mapping[str, tuple[int, int]]


@dataclass(frozen=True, kw_only=True)
class Bound:
    """The motions of a task.

    Args:
        task: "scene/task".
        duration: Duration by motion [s].
        first: Harm per failure on the failures that choose, by kind of failures, then by motion.
        second: The same on the failures that judge, for the named motions and for those that were chosen.
        best: The chosen motion, by kind.
    """

    task: str
    duration: Mapping[str, float]
    first: Mapping[str, Mapping[str, float]]
    second: Mapping[str, Mapping[str, float]]
    best: Mapping[str, str]

    def less(self, kind: str, name: str) -> float:
        """Return the relative reduction of harm per executed task against w = 0, on the failures that judge."""
        return 1.0 - self._per_task(kind, name) / self._per_task(kind, NONE)

    def _per_task(self, kind: str, name: str) -> float:
        return self.second[kind][name] * self.duration[name]


def name_of(prior: str, w: float) -> str:
    """Return the label of a motion."""
    return f"{prior}, w = {w:g}"


NAMED = (NONE, *(name_of(prior, w) for w in WEIGHTS for prior in PRIORS))
"""Motions that are always judged."""


def do_bound(job: BoundJob) -> Bound:
    """Plan a task in all ways, choose the best motion on some failures, and judge it on others."""
    task = suite.task(job.task)
    motions, grasp = _executable(dict(_planned(task)), task)
    settings = SimSettings(grasp=grasp)

    def harm(name: str, kind: str, n: int, seed: int) -> float:
        found = fb.validate(
            motions[name], task.scene, kinds(task)[kind], n=n, seed=seed, threads=1, settings=settings
        ).observed
        return max(found.mean, least_severity(task.scene) / found.n)  # one hit counts if there is none

    first: dict[str, dict[str, float]] = {}
    second: dict[str, dict[str, float]] = {}
    best: dict[str, str] = {}
    duration = {name: motion.duration for name, motion in motions.items()}
    for kind, (choosing, judging) in job.sizes.items():
        harms = first[kind] = {name: harm(name, kind, choosing, SEED + 1) for name in motions}
        best[kind] = min(harms, key=lambda name: harms[name] * duration[name])
        judged = dict.fromkeys([*(name for name in NAMED if name in motions), best[kind]])
        second[kind] = {name: harm(name, kind, judging, SEED + 2) for name in judged}
    return Bound(task=job.task, duration=duration, first=first, second=second, best=best)


def _planned(task: gp.Task) -> Iterator[tuple[str, gp.Trajectory]]:
    """Yield motions by name."""
    gp.prepare(task.scene)

    def planned(impact: gp.ImpactCost, w: float, **settings: object) -> gp.PlanResult:
        objective = gp.Objective(impact=impact, w=w)
        asked = {"time_limit": SECONDS, "seed": SEED, "speed": SPEED, **settings}
        return gp.plan(task.start, task.goal, task.scene, objective=objective, **asked)  # type: ignore[arg-type]

    usual = PRIORS["default"]
    calls = {NONE: (usual, 0.0, {})}
    calls |= {name_of(prior, w): (impact, w, {}) for w in WEIGHTS for prior, impact in PRIORS.items()}
    calls |= {f"w = 1, seed {seed}": (usual, 1.0, {"seed": SEED + seed}) for seed in SEEDS}
    calls |= {f"w = 1, {planner}": (usual, 1.0, {"planner": planner}) for planner in PLANNERS}
    calls |= {f"w = 0.3, speed {speed:g}": (usual, 0.3, {"speed": speed}) for speed in OTHER_SPEEDS}
    for name, (impact, w, settings) in calls.items():
        several = DISTINCT if w == WEIGHTS[0] and not settings else 1
        result = planned(impact, w, candidates=several, **settings)
        if result.trajectory is not None:
            yield name, result.trajectory
        for k, other in enumerate(result.candidates[1:], 1):
            yield f"{name}, candidate {k}", other.unwrap()


def _executable(motions: Mapping[str, gp.Trajectory], task: gp.Task) -> tuple[dict[str, gp.Trajectory], str]:
    """Return the motions that the healthy robot can execute, and the grasp.

    The grasp is a weld if fingers lose the object at w = 0 or with the default.
    """
    can: dict[str, gp.Trajectory] = {}
    for grasp in ("fingers", "weld"):
        world = fb.build_world(task.scene, SimSettings(grasp=grasp))
        can = {name: motion for name, motion in motions.items() if _executes(motion, world)}
        if {NONE, name_of("default", WEIGHTS[0])} <= can.keys():
            return can, grasp
    return can, "weld"


def _executes(motion: gp.Trajectory, world: fb.World) -> bool:
    try:
        return fb.execute(motion, world).healthy.harmless
    except ExecutionRefused:
        return False


def bound_sizes(options: suite.Options) -> Mapping[str, tuple[int, int]]:
    """Return the numbers of failures of each kind: to choose, and to judge."""
    return options.pick(SIZES, quick={"drops": (8, 8), "mixed": (19, 19)}, long=LONG_SIZES)


def bound_jobs(file: Path, options: suite.Options) -> list[BoundJob]:
    """Return the jobs that are left."""
    return [BoundJob(task=name, sizes=bound_sizes(options)) for name in tasks_left(file, TASKS, options)]


def read_bounds(file: Path) -> list[Bound]:
    """Return the finished tasks in which w = 0 and the default motion can be executed."""
    found = (Bound(**line) for line in read_lines(file))
    return [one for one in found if {NONE, name_of("default", WEIGHTS[0])} <= one.duration.keys()]


# --- tables -----------------------------------------------------------------------------------------------------------


def bound_table(found: Sequence[Bound], sizes: Mapping[str, tuple[int, int]]) -> str:
    """Return the document of the bound."""
    if not found:
        return f"{MEASURED}\nNo task is finished yet.\n"
    unseen = sum(one.task.split("/")[0] in suite.unseen_scenes() for one in found)
    counts = [len(one.duration) for one in found]
    told = "; ".join(f"{kind}: {a} failures of each motion choose, {b} judge" for kind, (a, b) in sizes.items())
    parts = [
        MEASURED,
        f"{len(found)} of {len(TASKS)} tasks, {unseen} of them unseen, with {min(counts)} to {max(counts)} motions."
        f" {told}.\n",
        report.targets(_targets(found)),
    ]
    for kind in sizes:
        names = [name for name in NAMED[1:] if all(name in one.second[kind] for one in found)]
        parts += [
            f"Named motions, {kind}:\n",
            report.table(_SHARES, [_share_row(found, kind, name) for name in (*names, "best")]),
        ]
    parts += [
        f"A heavier weight, against w = {WEIGHTS[0]:g} with the same prior:\n",
        report.table(
            _HEAVIER, [row for kind in sizes for prior in PRIORS for row in _heavier_rows(found, kind, prior)]
        ),
    ]
    parts += ["Task by task, times less harm per executed task than at w = 0:\n"]
    parts += [report.table(_TASKS, [_task_row(one, kind) for kind in sizes for one in found])]
    return "\n".join(parts)


_SHARES = ("motion", "harm per task, x less, median", "geometric mean", "share of what is attainable", "duration")
_HEAVIER = ("failures", "prior", "w", "harm per task, x less, geometric mean", "worse", "better", "duration")
_TASKS = (
    "task", "failures", "motions", "default", "service", "arm", "default, w = 1", "w = 3", "best", "which", "duration"
)  # fmt: skip


def _targets(found: Sequence[Bound]) -> Iterator[report.Target]:
    for kind in found[0].second:
        for prior in PRIORS:
            share = share_of(found, kind, name_of(prior, WEIGHTS[0]))
            yield report.Target(
                what=f"{kind}: {prior} prior at w = {WEIGHTS[0]:g}, share of what is attainable",
                wanted=">= 0.9",
                measured=str(share),
                met=share.mean >= 0.9,
            )


def share_of(found: Sequence[Bound], kind: str, name: str) -> Estimate:
    """Return the summed reduction of a motion over that of the best one, with an interval from resampled tasks.

    Tasks without this motion are left out.
    """
    reductions = np.array(
        [[one.less(kind, name), one.less(kind, one.best[kind])] for one in found if name in one.second[kind]]
    )

    def share(rows: Array) -> float:
        return float(rows[:, 0].sum() / max(rows[:, 1].sum(), 1e-9))

    return cluster_bootstrap(reductions, np.arange(len(reductions)), share, resamples=2000)


def _share_row(found: Sequence[Bound], kind: str, name: str) -> Sequence[object]:
    chosen = [one.best[kind] if name == "best" else name for one in found]
    ratio = [1.0 / (1.0 - one.less(kind, which)) for one, which in zip(found, chosen, strict=True)]
    longer = np.median([one.duration[which] / one.duration[NONE] for one, which in zip(found, chosen, strict=True)])
    share = "" if name == "best" else str(share_of(found, kind, name))
    geometric = float(np.exp(np.mean(np.log(ratio))))
    return name, f"{np.median(ratio):.2f}", f"{geometric:.2f}", share, f"{100.0 * (longer - 1.0):+.0f} %"


def _heavier_rows(found: Sequence[Bound], kind: str, prior: str) -> Iterator[Sequence[object]]:
    light = name_of(prior, WEIGHTS[0])
    for w in WEIGHTS[1:]:
        heavy = name_of(prior, w)
        both = [one for one in found if {light, heavy} <= one.second[kind].keys()]
        if not both:
            continue
        logs = np.array([np.log((1.0 - one.less(kind, light)) / (1.0 - one.less(kind, heavy))) for one in both])
        found_ratio = cluster_bootstrap(logs, np.arange(len(logs)), resamples=2000)
        mean, low, high = np.exp([found_ratio.mean, found_ratio.low, found_ratio.high])
        longer = np.median([one.duration[heavy] / one.duration[light] for one in both])
        sides = (np.count_nonzero(logs < 0.0), np.count_nonzero(logs > 0.0))
        yield kind, prior, f"{w:g}", f"{mean:.2f} [{low:.2f}, {high:.2f}]", *sides, f"{100.0 * (longer - 1.0):+.0f} %"


def _task_row(one: Bound, kind: str) -> Sequence[object]:
    best = one.best[kind]

    def ratio(name: str) -> str:
        return f"{1.0 / (1.0 - one.less(kind, name)):.2f}" if name in one.second[kind] else "-"

    named = [ratio(name_of(prior, WEIGHTS[0])) for prior in PRIORS]
    heavier = [ratio(name_of("default", w)) for w in WEIGHTS[1:]]
    longer = f"{100.0 * (one.duration[best] / one.duration[NONE] - 1.0):+.0f} %"
    return one.task, kind, len(one.duration), *named, *heavier, ratio(best), best, longer
