"""Does planning with the impact prevent damage? What failures do along motions planned with it and without."""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from benchmarks.store import read_lines
from failbench.basics.errors import ExecutionRefused
from failbench.calibrations.failures import DROP
from failbench.fault.fault import Fault
from failbench.report import ValidationReport
from failbench.scenario import usual_grasp
from failbench.simulated.world import SimSettings
from failbench.validation import chosen_faults, compare, validate

Array = np.ndarray

TITLE = "Damage prevented: failures along motions planned with and without regard for them"
MEASURED = """\
Every task of every bundled scene, planned in 1 s at half of the velocity limits: with w = 0, with Algorithm 1 and with
the default model, both at w = 1. Then the robot fails: "drops", the gripper lets go; "mixed", each of the 19 faults,
severe, equally often. All motions of a task have the same faults at the same fractions of their time, with the same
random numbers; fingers hold the object where they can, otherwise a weld. Impact: sum of the severities of what is
touched within 1 s, each entity once. "Motion": joint length, relative to w = 0. "Reduction": impact at w = 0 over that
of the model. "Rises": tasks with more impact than at w = 0, beyond the 95 % interval of the paired difference.
Constants were fitted on rollouts in these scenes, along other motions.
"""
STORE = Path(__file__).resolve().parents[1] / "prevented"
"""A line for each task that is done; an interrupted run goes on where it was."""
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "prevention.png"
SEED = 77
SPEED, SECONDS = 0.5, 1.0
REDUCTION, MOTION = 5.0, 0.15
DROPS, MIXED = 1000, 500
WEIGHTS = (0.03, 0.1, 0.3, 1.0, 3.0)
NONE, PUBLISHED, OURS = "w = 0", "Algorithm 1", "default"
PLANNED: Mapping[str, gp.Objective] = {
    NONE: gp.Objective(w=0.0),
    PUBLISHED: gp.Objective(impact=gp.ImpactCost(model="aabb")),
    OURS: gp.Objective(),
}


@dataclass(frozen=True, kw_only=True)
class MotionHarm:
    """What failures do along one motion."""

    motion: float
    """Joint length [rad]."""
    predicted: float
    """Impact of a drop that the default model predicts, or of the mixed faults if nothing is carried."""
    drops: float | None
    mixed: float | None
    """Observed impacts; None if not asked, or nothing is carried."""
    rises: Mapping[str, tuple[float, float, float]]
    """Paired difference to w = 0, with its interval, for "drops" and "mixed"."""


@dataclass(frozen=True, kw_only=True)
class TaskHarm:
    """A task that is done."""

    task: str
    refused: str
    """Why there is nothing, if so."""
    planned: Mapping[str, MotionHarm]
    over_w: Mapping[str, MotionHarm]
    """By weight, for the default model."""


def run(options: suite.Options) -> str:
    """Do what is left to do, and report on all that is done."""
    drops, mixed = options.pick((DROPS, MIXED), quick=(16, 19))
    tasks = suite.task_names(options)
    with tempfile.TemporaryDirectory() as scratch:  # a quick run has nothing to keep
        file = (Path(scratch) if options.quick else STORE) / f"tasks.{SEED}.{drops}.{mixed}.jsonl"
        have = {done.task for done in read(file)}
        file.parent.mkdir(exist_ok=True)
        todo = [(task, options.quick) for task in tasks if task not in have]
        until = math.inf if options.seconds is None else time.monotonic() + options.seconds
        with file.open("a", encoding="utf-8") as out:
            for done in suite.spread(_do, todo, options.processes, "prevention"):
                out.write(json.dumps(asdict(done)) + "\n")
                out.flush()
                if time.monotonic() > until:
                    break
        found = sorted(read(file), key=lambda done: tasks.index(done.task))
    if not options.quick:
        draw(found, PICTURE)
    kept = [done for done in found if not done.refused]
    refused = [f"{done.task}: {done.refused}" for done in found if done.refused]
    return "\n".join(
        [
            MEASURED,
            f"{len(kept)} of {len(tasks)} tasks; {drops} drops, {mixed} mixed failures or more a motion.\n",
            *(f"Not in: {line}\n" for line in refused),
            report.targets(_targets(kept, len(tasks), drops, mixed)),
            report.table(_SUMMARY_HEADER, _summary(kept)),
            report.table(_HEADER, (_row(done) for done in kept)),
            report.table(_WEIGHT_HEADER, _over_w(kept)),
            "" if options.quick else f"![impact over motion](../docs/images/{PICTURE.name})\n",
        ]
    )


def read(file: Path) -> Iterator[TaskHarm]:
    """Yield what is done."""
    for x in read_lines(file):
        groups = {key: {name: MotionHarm(**y) for name, y in x[key].items()} for key in ("planned", "over_w")}
        yield TaskHarm(task=x["task"], refused=x["refused"], **groups)


def _do(job: tuple[str, bool]) -> TaskHarm:
    name, quick = job
    why = ""
    for grasp in dict.fromkeys((usual_grasp(*name.split("/")), "weld")):
        try:
            return _done(name, quick, SimSettings(grasp=grasp))
        except (ExecutionRefused, gp.PlanningFailed) as error:
            why = str(error)
    return TaskHarm(task=name, refused=why, planned={}, over_w={})


def _done(name: str, quick: bool, settings: SimSettings) -> TaskHarm:
    options = suite.Options(quick=quick)
    drops, mixed = options.pick((DROPS, MIXED), quick=(16, 19))
    weights, per_weight = options.pick((WEIGHTS, 100), quick=((1.0,), 8))
    planned: dict[str, MotionHarm] = {}
    over_w: dict[str, MotionHarm] = {}
    reference: dict[str, ValidationReport] = {}
    for label, objective in PLANNED.items():
        planned[label] = _outcome(name, objective, {"drops": drops, "mixed": mixed}, settings, reference)
    for w in weights:
        own = planned[OURS] if w == PLANNED[OURS].w else None
        over_w[f"{w:g}"] = own or _outcome(name, gp.Objective(w=w), {"drops": per_weight}, settings, None)
    return TaskHarm(task=name, refused="", planned=planned, over_w=over_w)


def _outcome(
    name: str,
    objective: gp.Objective,
    counts: Mapping[str, int],
    settings: SimSettings,
    reference: dict[str, ValidationReport] | None,
) -> MotionHarm:
    """Plan and fail; the first motion is what `reference` comes to hold, and later ones are compared with."""
    task = suite.task(name)
    result = gp.plan(
        task.start, task.goal, task.scene, objective=_at_pace(objective), time_limit=SECONDS, seed=SEED, speed=SPEED
    )
    result.unwrap()
    assert result.cost is not None
    found: dict[str, ValidationReport] = {}
    for kind, faults in _kinds(task).items():
        if kind in counts:
            found[kind] = validate(result, task.scene, faults, n=counts[kind], seed=SEED, threads=1, settings=settings)
    rises: dict[str, tuple[float, float, float]] = {}
    if reference:
        for kind, own in found.items():
            rise = compare(own, reference[kind])
            rises[kind] = (rise.mean, rise.low, rise.high)
    elif reference is not None:
        reference.update(found)
    return MotionHarm(
        motion=result.cost.motion,
        predicted=next(iter(found.values())).predicted if found else math.nan,
        drops=found["drops"].observed.mean if "drops" in found else None,
        mixed=found["mixed"].observed.mean if "mixed" in found else None,
        rises=rises,
    )


def _at_pace(objective: gp.Objective) -> gp.Objective:
    return replace(objective, pace=objective.pace * SPEED)


def _kinds(task: gp.Task) -> dict[str, Sequence[Fault]]:
    drop = {} if task.object_name is None else {"drops": DROP}
    return {**drop, "mixed": chosen_faults("*/*/severe")}


# --- tables ----------------------------------------------------------------------------------------------------------

_SUMMARY_HEADER = (
    "model",
    "median motion",
    "median reduction, drops",
    "mixed",
    "sum of impacts, drops",
    "mixed",
    "rises",
)
_HEADER = (
    "task",
    "motion, Algorithm 1",
    "motion, default",
    "drops, w = 0",
    "Algorithm 1",
    "default",
    "predicted",
    "mixed, w = 0",
    "Algorithm 1",
    "default",
)
_WEIGHT_HEADER = ("w", "median motion", "median reduction, drops", "sum of impacts, drops")


def reduction(before: float, after: float) -> float:
    """Return how many times less harm there is; 1 if there was none before."""
    if after == 0.0:
        return 1.0 if before == 0.0 else math.inf
    return before / after


def _reductions(done: Sequence[TaskHarm], label: str, kind: str) -> list[float]:
    pairs = [(getattr(x.planned[NONE], kind), getattr(x.planned[label], kind)) for x in done]
    return [reduction(before, after) for before, after in pairs if before is not None]


def _motions(done: Sequence[TaskHarm], label: str) -> list[float]:
    return [x.planned[label].motion / x.planned[NONE].motion - 1.0 for x in done]


def _rising(done: Sequence[TaskHarm], label: str) -> list[str]:
    return [f"{x.task} ({kind})" for x in done for kind, (_, low, _) in x.planned[label].rises.items() if low > 0.0]


def _total(done: Sequence[TaskHarm], label: str, kind: str) -> float:
    return math.fsum(getattr(x.planned[label], kind) or 0.0 for x in done)


def _targets(done: Sequence[TaskHarm], tasks: int, drops: int, mixed: int) -> list[report.Target]:
    if not done:
        return []
    reductions = {kind: float(np.median(_reductions(done, OURS, kind))) for kind in ("drops", "mixed")}
    motion = float(np.median(_motions(done, OURS)))
    rising = _rising(done, OURS)
    totals = {label: _total(done, label, "drops") + _total(done, label, "mixed") for label in PLANNED}
    enough = len(done) == tasks and drops >= DROPS and mixed >= MIXED
    return [
        *(
            report.Target(
                what=f"median reduction of the observed impact, {kind}",
                wanted=f">= {REDUCTION:g}",
                measured=report.quantity(value) if math.isfinite(value) else "all of it",
                met=enough and value >= REDUCTION,
            )
            for kind, value in reductions.items()
        ),
        report.Target(
            what="median motion increase",
            wanted=f"<= {report.percent(MOTION, 0)}",
            measured=report.percent(motion),
            met=enough and motion <= MOTION,
        ),
        report.Target(
            what="tasks where the impact rises beyond its interval",
            wanted="none",
            measured=", ".join(rising) or "none",
            met=enough and not rising,
        ),
        report.Target(
            what="sum of impacts over all tasks, drops and mixed",
            wanted="clearly less than with Algorithm 1",
            measured=f"{totals[OURS]:.1f}; Algorithm 1 {totals[PUBLISHED]:.1f}; w = 0 {totals[NONE]:.1f}",
            met=enough and totals[OURS] < 0.8 * totals[PUBLISHED],
        ),
        report.Target(
            what="tasks x drops x mixed failures",
            wanted=f"{tasks} x {DROPS} x {MIXED}",
            measured=f"{len(done)} x {drops} x {mixed}",
            met=enough,
        ),
    ]


def _summary(done: Sequence[TaskHarm]) -> Iterator[Sequence[object]]:
    for label in PLANNED:
        if not done:
            return
        yield (
            label,
            f"{100.0 * float(np.median(_motions(done, label))):+.1f} %",
            *(_times(np.median(_reductions(done, label, kind))) for kind in ("drops", "mixed")),
            *(f"{_total(done, label, kind):.1f}" for kind in ("drops", "mixed")),
            len(_rising(done, label)),
        )


def _row(done: TaskHarm) -> Sequence[object]:
    base = done.planned[NONE]

    def cell(label: str, kind: str) -> str:
        value = getattr(done.planned[label], kind)
        if value is None:
            return "-"
        rise = done.planned[label].rises.get(kind)
        mark = "" if rise is None or rise[1] <= 0.0 <= rise[2] else " +" if rise[1] > 0.0 else " *"
        return f"{value:.2f}{mark}"

    return (
        done.task,
        *(f"{100.0 * (done.planned[label].motion / base.motion - 1.0):+.0f} %" for label in (PUBLISHED, OURS)),
        *(cell(label, "drops") for label in PLANNED),
        f"{done.planned[OURS].predicted:.2f}",
        *(cell(label, "mixed") for label in PLANNED),
    )


def _over_w(done: Sequence[TaskHarm]) -> Iterator[Sequence[object]]:
    carried = [x for x in done if x.planned[NONE].drops is not None]
    for w in carried[0].over_w if carried else ():
        motions = [x.over_w[w].motion / x.planned[NONE].motion - 1.0 for x in carried]
        pairs = [(x.planned[NONE].drops or 0.0, x.over_w[w].drops or 0.0) for x in carried]
        yield (
            w,
            f"{100.0 * float(np.median(motions)):+.1f} %",
            _times(np.median([reduction(*pair) for pair in pairs])),
            f"{math.fsum(after for _, after in pairs):.1f}",
        )


def _times(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "all of it"


def draw(done: Sequence[TaskHarm], file: Path) -> None:
    """Draw observed impact against path length over w, a panel for each scene, a line for each task."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(x.task.split("/")[0] for x in done if not x.refused))
    figure = Figure(figsize=(12, 7), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, -(-len(scenes) // 2), squeeze=False)
    for axis, scene in zip(axes.flat, scenes, strict=False):
        for x in done:
            if x.refused or x.task.split("/")[0] != scene or x.planned[NONE].drops is None:
                continue
            points = [x.planned[NONE], *x.over_w.values()]
            length = [point.motion / points[0].motion for point in points]
            (line,) = axis.plot(
                length, [point.drops or 0.0 for point in points], "o-", ms=3, label=x.task.split("/")[1]
            )
            published = x.planned[PUBLISHED]
            axis.plot(published.motion / points[0].motion, published.drops, "x", color=line.get_color())
        axis.set(title=scene, xlabel="path length over that at w = 0", ylabel="impact of a drop")
        axis.set_yscale("symlog", linthresh=0.1)
        axis.legend(fontsize=7)
    for axis in axes.flat[len(scenes) :]:
        axis.set_visible(False)
    figure.suptitle("Observed impact of drops over w = 0, 0.03 ... 3 (crosses: Algorithm 1 at w = 1)")
    figure.savefig(file)
