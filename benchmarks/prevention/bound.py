"""The bound of prevention: many motions of one task, and the harm that the best of them prevents.

A motion is chosen on one set of failures and judged on another one, so that luck in the choice does not count. The
model's predictions for all motions tell whether the model, the search or the weight keeps the planner from the best
one. One line of JSON per task.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from types import MappingProxyType

import numpy as np
from scipy.stats import rankdata

import failbench as fb
import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.prevention.runs import NONE, SEED, kinds, least_severity
from benchmarks.store import read_lines, tasks_left
from failbench import ExecutionRefused, SimSettings
from failbench.basics.statistics import Estimate, cluster_bootstrap
from failbench.fault.fault import Fault
from failbench.rollouts.sampling import make_requests

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
DISTINCT, MOST = 4, 44
"""Candidates of each call with w > 0, and motions of a task; first motions of calls come before further candidates."""
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
SIZES = {"drops": (40, 96), "mixed": (38, 76)}
"""Failures of every motion that choose, and of the judged motions that judge."""
LONG_SIZES = {"drops": (400, 400), "mixed": (228, 228)}
PRIOR_OF = {"drops": "default", "mixed": "service"}
"""The prior that predicts each kind of failures."""
PLACES = 50
"""Positions along a motion that are compared."""
SURE = 1.1
"""The best motion of a task counts as better if it does this much less harm than the planner's."""
MEASURED = f"""\
How much less harm could any choice among many motions do? Each task is planned in {SECONDS:g} s per call with the
default, the service and the arm prior at w = 0.3, 1 and 3, with other seeds, planners and speeds. Each call returns up
to {DISTINCT} distinct motions (`candidates={DISTINCT}`), of which up to {MOST} a task count. Every motion fails in the
same ways. "Best": the motion with the least harm per executed task on some failures. It is judged on other failures, as
all motions of the tables are. **Share of what is attainable**: the relative reduction of harm per task against w = 0,
summed over the tasks, over that of the best motion. "At the same speed": over that of the best motion among those at
{SPEED:g} of the velocity limits, the speed of the named motions. The choice of the best is noisy, so shares may exceed
1. Intervals (95 %) come from resampled tasks. Harm and failures are those of `prevention`, damage to the carried object
included; "others only" leaves it out.
"""


@dataclass(frozen=True, kw_only=True)
class BoundJob:
    """A task, and the numbers of failures of each kind: to choose, and to judge."""

    task: str
    sizes: Mapping[str, tuple[int, int]]


@dataclass(frozen=True, kw_only=True)
class Modelled:
    """A motion as the planner's model sees it.

    Args:
        motion: Motion cost V.
        impact: Time integral of the impact along the motion, by prior; the predicted harm per executed task without the
            rate of failures.
        height: Mean height of the carried object, or of the tool [m].
        aside: Greatest horizontal distance of the object from the default motion's object at equal shares of the
            duration [m].
        end: Distance of the last configuration from that of the default motion [rad].
    """

    motion: float
    impact: Mapping[str, float]
    height: float
    aside: float
    end: float

    def cost(self, prior: str, w: float) -> float:
        """Return J with a prior."""
        return self.motion + w * self.impact[prior]


@dataclass(frozen=True, kw_only=True)
class Bound:
    """The motions of a task.

    Args:
        task: "scene/task".
        duration: Duration by motion [s].
        modelled: The model's view, by motion.
        first: Harm per failure on the failures that choose, by kind of failures, then by motion.
        second: Harm per failure on the failures that judge, for the named motions and for those that were chosen.
        others: The part of `second` that is not the loss of the carried object.
        best: The chosen motion, by kind.
        best_at_speed: The chosen motion among those at `SPEED`, by kind.
    """

    task: str
    duration: Mapping[str, float]
    modelled: Mapping[str, Modelled]
    first: Mapping[str, Mapping[str, float]]
    second: Mapping[str, Mapping[str, float]]
    others: Mapping[str, Mapping[str, float]]
    best: Mapping[str, str]
    best_at_speed: Mapping[str, str]

    def less(self, kind: str, name: str, *, others: bool = False) -> float:
        """Return the relative reduction of harm per executed task against w = 0, on the failures that judge."""
        return 1.0 - self.per_task(kind, name, others=others) / self.per_task(kind, NONE, others=others)

    def less_first(self, kind: str, name: str) -> float:
        """Return the same on the failures that choose, for a motion that was chosen without them."""
        a, b = (self.first[kind][which] * self.duration[which] for which in (name, NONE))
        return 1.0 - a / b

    def least(self, prior: str, w: float) -> str:
        """Return the motion at `SPEED` of least J; with an infinite weight, of least predicted harm per task."""
        if math.isinf(w):
            return min(self._at_speed, key=lambda name: self.modelled[name].impact[prior])
        return min(self._at_speed, key=lambda name: self.modelled[name].cost(prior, w))

    @property
    def _at_speed(self) -> list[str]:
        return [name for name in self.duration if at_speed(name)]

    def per_task(self, kind: str, name: str, *, others: bool = False) -> float:
        """Return the harm per executed task, without the rate of failures."""
        return (self.others if others else self.second)[kind][name] * self.duration[name]


def name_of(prior: str, w: float) -> str:
    """Return the label of a motion."""
    return f"{prior}, w = {w:g}"


def at_speed(name: str) -> bool:
    """Return whether a motion is planned at `SPEED`."""
    return "speed" not in name


NAMED = (
    NONE,
    *(name_of(prior, WEIGHTS[0]) for prior in PRIORS),
    *(name_of("default", w) for w in WEIGHTS[1:]),
    name_of("service", WEIGHTS[2]),
)
"""Motions that are always judged."""
DEFAULT = name_of("default", WEIGHTS[0])


def do_bound(job: BoundJob) -> Bound:
    """Plan a task in all ways, choose the best motion on some failures, and judge it on others."""
    task = suite.task(job.task)
    executions = _executed(dict(islice(_planned(task), MOST)), task)
    motions = {name: execution.trajectory for name, execution in executions.items()}
    first: dict[str, dict[str, float]] = {}
    second: dict[str, dict[str, float]] = {}
    others: dict[str, dict[str, float]] = {}
    best: dict[str, str] = {}
    best_at_speed: dict[str, str] = {}
    for kind, (choosing, judging) in job.sizes.items() if {NONE, DEFAULT} <= motions.keys() else ():
        faults = kinds(task)[kind]
        first[kind] = {name: _harm(one, faults, choosing, SEED + 1)[0] for name, one in executions.items()}
        ranked = sorted(motions, key=lambda name: first[kind][name] * motions[name].duration)
        best[kind] = ranked[0]
        best_at_speed[kind] = next(name for name in ranked if at_speed(name))
        second[kind], others[kind] = {}, {}
        for name in dict.fromkeys([*NAMED, best[kind], best_at_speed[kind]]):
            if name in executions:
                second[kind][name], others[kind][name] = _harm(executions[name], faults, judging, SEED + 2)
    return Bound(
        task=job.task,
        duration={name: motion.duration for name, motion in motions.items()},
        modelled=_modelled(motions, task) if first else {},
        first=first,
        second=second,
        others=others,
        best=best,
        best_at_speed=best_at_speed,
    )


def _harm(execution: fb.Execution, faults: Sequence[Fault], n: int, seed: int) -> tuple[float, float]:
    """Return the harm per failure, and without the loss of the carried object; one hit counts if there is none."""
    jobs = make_requests(faults, execution.trajectory.duration, n=n, seed=seed)
    rollouts = [one for one in fb.run_rollouts(execution, jobs, threads=1) if one.status == "completed"]
    scene = execution.world.scene
    least = least_severity(scene) / len(jobs)
    own = float(np.mean([fb.own_loss(one, scene) for one in rollouts]))
    whole = float(np.mean([fb.observed_impact(one, scene) for one in rollouts]))
    return max(whole, least), max(whole - own, least)


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
    results = {
        name: planned(impact, w, candidates=DISTINCT if w > 0.0 else 1, **settings)
        for name, (impact, w, settings) in calls.items()
    }
    for name, result in results.items():
        if result.trajectory is not None:
            yield name, result.trajectory
    for k in range(1, DISTINCT):
        for name, result in results.items():
            if k < len(result.candidates):
                yield f"{name}, candidate {k}", result.candidates[k].unwrap()


def _modelled(motions: Mapping[str, gp.Trajectory], task: gp.Task) -> dict[str, Modelled]:
    places = {name: _places(motion, task.scene) for name, motion in motions.items()}
    around, end = places[DEFAULT], motions[DEFAULT].q[-1]
    found: dict[str, Modelled] = {}
    for name, motion in motions.items():
        costs = {
            prior: gp.evaluate(motion, task.scene, gp.Objective(impact=impact, w=1.0))
            for prior, impact in PRIORS.items()
        }
        found[name] = Modelled(
            motion=costs["default"].motion,
            impact={prior: cost.impact for prior, cost in costs.items()},
            height=float(places[name][:, 2].mean()),
            aside=float(np.linalg.norm((places[name] - around)[:, :2], axis=1).max()),
            end=float(np.linalg.norm(motion.q[-1] - end)),
        )
    return found


def _places(motion: gp.Trajectory, scene: gp.Scene) -> Array:
    """Return the object's (or the tool's) positions in W at equal shares of the duration [n, 3] [m]."""
    times = np.linspace(motion.t[0], motion.t[-1], PLACES)
    batch = gp.StateBatch(scene, np.stack([np.interp(times, motion.t, q) for q in motion.q.T], axis=1))
    return (batch.tool_poses if scene.carried is None else batch.object_poses)[:, :3, 3]


def _executed(motions: Mapping[str, gp.Trajectory], task: gp.Task) -> dict[str, fb.Execution]:
    """Return the executions of the motions that the healthy robot can execute without harm.

    Fingers hold the object, or a weld if they lose it at w = 0 or with the default.
    """
    can: dict[str, fb.Execution] = {}
    for grasp in ("fingers", "weld"):
        world = fb.build_world(task.scene, SimSettings(grasp=grasp))
        tried = {name: _execution(motion, world) for name, motion in motions.items()}
        can = {name: one for name, one in tried.items() if one is not None}
        if {NONE, DEFAULT} <= can.keys():
            break
    return can


def _execution(motion: gp.Trajectory, world: fb.World) -> fb.Execution | None:
    """Return the execution of a motion; None if the healthy robot cannot execute it or does harm."""
    try:
        execution = fb.execute(motion, world)
    except ExecutionRefused:
        return None
    return execution if execution.healthy.harmless else None


def bound_sizes(options: suite.Options) -> Mapping[str, tuple[int, int]]:
    """Return the numbers of failures of each kind: to choose, and to judge."""
    return options.pick(SIZES, quick={"drops": (8, 8), "mixed": (19, 19)}, long=LONG_SIZES)


def bound_jobs(file: Path, options: suite.Options) -> list[BoundJob]:
    """Return the jobs that are left."""
    return [BoundJob(task=name, sizes=bound_sizes(options)) for name in tasks_left(file, TASKS, options)]


def read_bounds(file: Path) -> list[Bound]:
    """Return the finished tasks in which w = 0 and the default motion can be executed."""
    found = (
        replace(Bound(**line), modelled={name: Modelled(**one) for name, one in line["modelled"].items()})
        for line in read_lines(file)
    )
    return [one for one in found if {NONE, DEFAULT} <= one.duration.keys()]


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
            report.table(_SHARES, [_share_row(found, kind, name) for name in (*names, BEST, BEST_AT_SPEED)]),
            f"The motion that the model ranks first among all at the same speed, {kind}, {PRIOR_OF[kind]} prior, on the"
            " failures that choose, which it does not know:\n",
            report.table(_PICKS, [_pick_row(found, kind, w) for w in (*WEIGHTS, math.inf)]),
        ]
    parts += [
        f"A heavier weight, against w = {WEIGHTS[0]:g} with the same prior:\n",
        report.table(
            _HEAVIER, [row for kind in sizes for prior in PRIORS for row in _heavier_rows(found, kind, prior)]
        ),
    ]
    parts += ["Task by task, times less harm per executed task than at w = 0:\n"]
    parts += [report.table(_TASKS, [_task_row(one, kind) for kind in sizes for one in found])]
    parts += [_COMPARED]
    parts += [report.table(_LIMITS, [_limit_row(one, kind) for kind in sizes for one in found])]
    parts += [_limits_told(found, kind) for kind in sizes]
    return "\n".join(parts)


BEST, BEST_AT_SPEED = "best", "best at the same speed"
_SHARES = (
    "motion", "harm per task, x less, median", "geometric mean", "share of what is attainable", "at the same speed",
    "duration",
)  # fmt: skip
_PICKS = (
    "least", "harm per task, x less, median", "geometric mean", "share of what is attainable at the same speed",
    "duration", "J over that of the planner's own motion, median",
)  # fmt: skip
_HEAVIER = (
    "failures", "prior", "w", "harm per task, x less, geometric mean", "others only", "worse", "better", "duration"
)  # fmt: skip
_TASKS = (
    "task", "failures", "motions", "default", "service", "arm", "default, w = 1", "w = 3", "best at the same speed",
    "best", "which", "duration",
)  # fmt: skip
_COMPARED = f"""\
What keeps the planner from the best motion? The planner's motion at w = {WEIGHTS[0]:g} (drops: default prior, mixed:
service prior) against the best one at the same speed. "Observed": its harm per task over that of the best; "predicted":
the same ratio by the model. "J": cost of the best motion over that of the planner's at w = {WEIGHTS[0]:g}. Geometry of
the best against the default motion: mean height of the carried object, greatest horizontal distance, and distance of
the last configuration. "Rank": Spearman's correlation of predicted and observed harm per task over all motions, on the
failures that choose. Limit, if the best does {SURE:g} times less harm: **search** if the best has less J, so that the
planner missed it; **weight** if the model knows that it is safer, but it is not worth its motion; **model** if the
model predicts more harm for it than for the planner's.
"""
_LIMITS = (
    "task", "failures", "best at the same speed", "observed", "predicted", "J", "duration", "height", "aside", "end",
    "rank", "limit",
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


def share_of(found: Sequence[Bound], kind: str, name: str, *, same_speed: bool = False) -> Estimate:
    """Return the summed reduction of a motion over that of the best one, with an interval from resampled tasks.

    Tasks without this motion are left out.

    Args:
        found: The tasks.
        kind: Kind of failures.
        name: The motion.
        same_speed: Whether to compare with the best motion at the same speed.
    """
    having = [one for one in found if name in one.second[kind]]
    best = [(one.best_at_speed if same_speed else one.best)[kind] for one in having]
    return _share(
        np.array([one.less(kind, name) for one in having]),
        np.array([one.less(kind, which) for one, which in zip(having, best, strict=True)]),
    )


def _share_row(found: Sequence[Bound], kind: str, name: str) -> Sequence[object]:
    chosen = [{BEST: one.best[kind], BEST_AT_SPEED: one.best_at_speed[kind]}.get(name, name) for one in found]
    ratio = [1.0 / (1.0 - one.less(kind, which)) for one, which in zip(found, chosen, strict=True)]
    longer = np.median([one.duration[which] / one.duration[NONE] for one, which in zip(found, chosen, strict=True)])
    shares = (
        ("", "")
        if name in (BEST, BEST_AT_SPEED)
        else tuple(str(share_of(found, kind, name, same_speed=same)) for same in (False, True))
    )
    geometric = float(np.exp(np.mean(np.log(ratio))))
    return name, f"{np.median(ratio):.2f}", f"{geometric:.2f}", *shares, f"{100.0 * (longer - 1.0):+.0f} %"


def _pick_row(found: Sequence[Bound], kind: str, w: float) -> Sequence[object]:
    """Return the harm that a perfect search over these motions would prevent."""
    prior = PRIOR_OF[kind]
    picks = [one.least(prior, w) for one in found]
    less = np.array([one.less_first(kind, pick) for one, pick in zip(found, picks, strict=True)])
    best = np.array([one.less(kind, one.best_at_speed[kind]) for one in found])
    longer = np.median([one.duration[pick] / one.duration[NONE] for one, pick in zip(found, picks, strict=True)])
    own = name_of(prior, w)
    gaps = [
        one.modelled[pick].cost(prior, w) / one.modelled[own].cost(prior, w)
        for one, pick in zip(found, picks, strict=True)
        if own in one.modelled
    ]
    return (
        "predicted harm" if math.isinf(w) else f"J at w = {w:g}",
        f"{np.median(1.0 / (1.0 - less)):.2f}",
        f"{np.exp(np.mean(-np.log(1.0 - less))):.2f}",
        str(_share(less, best)),
        f"{100.0 * (longer - 1.0):+.0f} %",
        f"{np.median(gaps):.2f}" if gaps else "",
    )


def _share(reduction: Array, best: Array) -> Estimate:
    """Return a summed reduction over that of the best motion, with an interval from resampled tasks.

    At least nothing is attainable in a task: the motion at w = 0 is one of the motions.
    """
    attainable = np.maximum(best, 0.0)

    def share(rows: Array) -> float:
        return float(rows[:, 0].sum() / max(rows[:, 1].sum(), 1e-9))

    return cluster_bootstrap(np.stack([reduction, attainable], axis=1), np.arange(len(best)), share, resamples=2000)


def _heavier_rows(found: Sequence[Bound], kind: str, prior: str) -> Iterator[Sequence[object]]:
    light = name_of(prior, WEIGHTS[0])
    for w in WEIGHTS[1:]:
        heavy = name_of(prior, w)
        both = [one for one in found if {light, heavy} <= one.second[kind].keys()]
        if heavy not in NAMED or not both:  # others are judged only where they were chosen
            continue
        logs = _log_ratios(both, kind, light, heavy, others=False)
        told = [_geometric(_log_ratios(both, kind, light, heavy, others=others)) for others in (False, True)]
        longer = np.median([one.duration[heavy] / one.duration[light] for one in both])
        sides = (np.count_nonzero(logs < 0.0), np.count_nonzero(logs > 0.0))
        yield kind, prior, f"{w:g}", *told, *sides, f"{100.0 * (longer - 1.0):+.0f} %"


def _log_ratios(found: Sequence[Bound], kind: str, light: str, heavy: str, *, others: bool) -> Array:
    return np.array(
        [np.log(one.per_task(kind, light, others=others) / one.per_task(kind, heavy, others=others)) for one in found]
    )


def _geometric(logs: Array) -> str:
    """Return the geometric mean of ratios with an interval from resampled tasks."""
    estimate = cluster_bootstrap(logs, np.arange(len(logs)), resamples=2000)
    mean, low, high = np.exp([estimate.mean, estimate.low, estimate.high])
    return f"{mean:.2f} [{low:.2f}, {high:.2f}]"


def _task_row(one: Bound, kind: str) -> Sequence[object]:
    best = one.best[kind]

    def ratio(name: str) -> str:
        return f"{1.0 / (1.0 - one.less(kind, name)):.2f}" if name in one.second[kind] else "-"

    named = [ratio(name_of(prior, WEIGHTS[0])) for prior in PRIORS]
    heavier = [ratio(name_of("default", w)) for w in WEIGHTS[1:]]
    longer = f"{100.0 * (one.duration[best] / one.duration[NONE] - 1.0):+.0f} %"
    bests = (ratio(one.best_at_speed[kind]), ratio(best))
    return one.task, kind, len(one.duration), *named, *heavier, *bests, best, longer


def _limit_row(one: Bound, kind: str) -> Sequence[object]:
    own, best = name_of(PRIOR_OF[kind], WEIGHTS[0]), one.best_at_speed[kind]
    if own not in one.second[kind]:
        return one.task, kind, best, *["-"] * 9
    a, b = one.modelled[own], one.modelled[best]
    default = one.modelled[DEFAULT]
    prior = PRIOR_OF[kind]
    return (
        one.task,
        kind,
        best,
        f"{one.per_task(kind, own) / one.per_task(kind, best):.2f}",
        f"{_ratio(a.impact[prior], b.impact[prior]):.2f}",
        f"{b.cost(prior, WEIGHTS[0]) / a.cost(prior, WEIGHTS[0]):.2f}",
        f"{100.0 * (one.duration[best] / one.duration[own] - 1.0):+.0f} %",
        f"{100.0 * (b.height - default.height):+.0f} cm",
        f"{100.0 * b.aside:.0f} cm",
        f"{b.end:.1f} rad",
        f"{rank_of(one, kind):.2f}",
        limit_of(one, kind),
    )


def _ratio(a: float, b: float) -> float:
    return a / max(b, 1e-12) if a > 0.0 else float(b <= 0.0)


def rank_of(one: Bound, kind: str) -> float:
    """Return Spearman's correlation of predicted and observed harm per task over the motions of a task.

    NaN if either is constant.
    """
    observed = {name: harm * one.duration[name] for name, harm in one.first[kind].items()}
    predicted = [one.modelled[name].impact[PRIOR_OF[kind]] for name in observed]
    if np.ptp(predicted) == 0.0 or np.ptp(list(observed.values())) == 0.0:
        return math.nan
    return float(np.corrcoef(rankdata(predicted), rankdata(list(observed.values())))[0, 1])


def limit_of(one: Bound, kind: str) -> str:
    """Return what keeps the planner from the best motion at its speed: "search", "weight", "model", or "" if little."""
    prior = PRIOR_OF[kind]
    own, best = name_of(prior, WEIGHTS[0]), one.best_at_speed[kind]
    if own not in one.second[kind] or one.per_task(kind, own) < SURE * one.per_task(kind, best):
        return ""
    a, b = one.modelled[own], one.modelled[best]
    if b.cost(prior, WEIGHTS[0]) < a.cost(prior, WEIGHTS[0]):
        return "search"
    return "weight" if b.impact[prior] < a.impact[prior] else "model"


def _limits_told(found: Sequence[Bound], kind: str) -> str:
    limits = [limit_of(one, kind) for one in found]
    told = ", ".join(f"{limit or 'none'} {limits.count(limit)}" for limit in ("search", "weight", "model", ""))
    ranks = [rank for one in found if not math.isnan(rank := rank_of(one, kind))]
    return f"{kind}: {told}; median rank correlation {np.median(ranks) if ranks else math.nan:.2f}.\n"
