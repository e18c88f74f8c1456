"""Does a network that has learned from generated scenes predict better than the drop model, and does planning gain?"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

import failbench as fb
import graceful_plan as gp
from benchmarks import report, suite, variants
from benchmarks.events import BINS, Events, fail
from benchmarks.prevention.runs import SEED, SPEED
from failbench.calibrations import skill
from failbench.calibrations.calibrate import scenes_of
from failbench.calibrations.failure_jobs import FailureJob, failure_jobs
from failbench.calibrations.failures import DROP, Failures
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, drop_kernel
from graceful_plan.costs.models.drop.network import DropNetwork

Array = np.ndarray
Load = Callable[[str], gp.Scene]

TITLE = "Learned drops: a network that corrects the drop model, in scenes that it never saw"
MEASURED = """\
The shipped network (`docs/learned-drops.md`) was trained on generated scenes and chosen by drops in the bundled ones,
on which the constants of the drop model were fitted. Unseen: `benchmarks/unseen`, with which neither has anything to
do. Variants: bundled scenes with things moved, taken away and added, and others carried (`benchmarks/variants.py`).
Motions as in `drop_prediction`, with other seeds; an event is a drop and an entity. "Severe": severities of the touches
that were predicted over those of the touches that happened. Gain: differences of the network less the drop model on
the same events; intervals are 95 %, whole motions drawn with replacement.

Harm: motions planned at the default weight with either model, with the same time limit, seed and speed, then dropped
from with the same random numbers; the harm of failures per million executed tasks at one failure in 1000 h, and beside
it, per task, what the healthy robot does harm to on the way. Pairs: millions of a configuration and an entity per
second of processor time, at random configurations and velocities.
"""
SEEDS = 7100
DROPS, HARM_DROPS, TASKS = 20, 400, 12
SECONDS = 1.0
"""Time limit of a plan."""
PLAIN, LEARNED = "mixture", "network"
UNSEEN, VARIANTS = "unseen", "variants"
FIGURES = ("events", "hits", "skill", "AUC", "ECE", "ratio", "log loss", "severe")


def models() -> Mapping[str, gp.FailureMixture]:
    """Return both models by name."""
    return {PLAIN: gp.FailureMixture(), LEARNED: gp.FailureMixture(network=DropNetwork.shipped())}


def run(options: suite.Options) -> str:
    """Predict, time and plan."""
    resamples = options.pick(1000, quick=20)
    events, told = {}, []
    for label, load, scenes, seed in (
        (UNSEEN, suite.scene, suite.unseen_scenes(), SEEDS),
        (VARIANTS, variants.load, tuple(variants.VARIANTS), SEEDS + 100),
    ):
        drops, refused = fail(_jobs(load, scenes, seed, options), options)
        told += [f"No drops: {reason}.\n" for reason in refused]
        events[label] = events_of(drops, load)
    gains = {label: gains_of(found, resamples) for label, found in events.items()}
    speeds = _speeds(options)
    harms = list(suite.spread(do_task, _tasks(options), options.processes, "tasks"))
    return "\n".join(
        [
            MEASURED,
            *told,
            report.targets(_targets(events, gains, harms)),
            report.table(("scenes", "model", *FIGURES), _rows(events)),
            "Gains:\n",
            report.table(("scenes", "skill", "log loss [nat]", "severe, distance from 1"), _gain_rows(gains)),
            "Pairs:\n",
            report.table(("scene", *(f"{model}, {what}" for what in WAYS for model in models())), speeds),
            "Harm per million tasks:\n",
            report.table(
                ("task", PLAIN, LEARNED, "ratio", "95 %", f"length, {PLAIN}", LEARNED, "healthy"), _harm_rows(harms)
            ),
        ]
    )


# --- prediction -------------------------------------------------------------------------------------------------------


def _jobs(load: Load, scenes: Sequence[str], seed: int, options: suite.Options) -> list[FailureJob]:
    scenes = scenes[: options.pick(len(scenes), quick=1)]
    n = options.drops or options.pick(DROPS, quick=2)
    jobs = [job for k, name in enumerate(scenes) for job in failure_jobs(load, [name], n=n, seed=seed + k)]
    return jobs[:: options.pick(1, quick=9)]


def events_of(drops: Sequence[Failures], load: Load) -> Events:
    """Predict the events of drops with both models."""
    scenes = scenes_of(drops, load)
    columns: dict[str, list[Array]] = {name: [] for name in ("scene", "motion", "severity", "happened")}
    predicted: dict[str, list[Array]] = {name: [] for name in models()}
    for i, part in enumerate(drops):
        scene = scenes[part.scene, part.task]
        hit, counting = part.events(["carried"])
        counted = np.broadcast_to(counting, hit.shape)
        severity = np.array([entity.severity["carried"] for entity in scene.entities.values()])
        columns["scene"].append(np.full(counted.sum(), part.scene))
        columns["motion"].append(np.full(counted.sum(), i))
        columns["severity"].append(np.broadcast_to(severity, hit.shape)[counted])
        columns["happened"].append(hit[counted])
        row = list(scene.components).index("carried")
        for name, model in models().items():
            predicted[name].append(model.probability(part.states(scene))[:, row][counted])
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return Events(**joined, predicted={name: np.concatenate(parts) for name, parts in predicted.items()})


def severe_ratio(events: Events, model: str) -> float:
    """Return severities of predicted touches over those of touches that happened."""
    return float(events.severity @ events.predicted[model] / (events.severity @ events.happened))


def gains_of(events: Events, resamples: int) -> Mapping[str, skill.Estimate]:
    """Return what the network gains on the drop model: more skill, less loss, a severe ratio nearer to 1."""
    order = np.argsort(events.motion, kind="stable")
    bounds = np.flatnonzero(np.append(True, np.diff(events.motion[order]) != 0))
    rows = np.split(order, bounds[1:])
    drawn = np.random.default_rng(SEEDS).integers(len(rows), size=(resamples, len(rows)))

    def gain(chosen: Events) -> dict[str, float]:
        of = {model: np.clip(chosen.predicted[model], 0.0, 1.0) for model in (PLAIN, LEARNED)}
        figures = {
            model: (skill.brier_skill(p, chosen.happened), skill.log_loss(p, chosen.happened))
            for model, p in of.items()
        }
        off = {model: abs(np.log(severe_ratio(chosen, model))) for model in (PLAIN, LEARNED)}
        return {
            "skill": figures[LEARNED][0] - figures[PLAIN][0],
            "loss": figures[LEARNED][1] - figures[PLAIN][1],
            "severe": off[LEARNED] - off[PLAIN],
        }

    found = gain(events)
    again = [gain(events.only(np.concatenate([rows[i] for i in draw]))) for draw in drawn]
    return {
        name: skill.Estimate(value, *np.nanquantile([x[name] for x in again], (0.025, 0.975)).tolist(), n=len(rows))
        for name, value in found.items()
    }


# --- speed ------------------------------------------------------------------------------------------------------------

WAYS = ("P S", "gradient")


def _speeds(options: suite.Options) -> list[Sequence[object]]:
    rows = []
    for name in suite.unseen_scenes()[: options.pick(7, quick=1)]:
        task = next(iter(suite.scene(name).tasks.values()))
        rows.append(
            (name, *(report.quantity(1e-6 * rate) for rate in rates(task.scene, options.pick(4000, quick=200))))
        )
    return rows


def rates(scene: gp.Scene, n: int) -> list[float]:
    """Return pairs per second of processor time: values and gradients, of either model in turn."""
    rng = np.random.default_rng(0)
    q = rng.uniform(*scene.limits.position.T, size=(n, len(scene.joints)))
    qd = rng.uniform(-1.0, 1.0, size=q.shape) * scene.limits.velocity
    severity = np.ones((len(ROWS), len(scene.entities))) * (np.arange(len(ROWS)) == 0)[:, None]
    kernels = [drop_kernel(scene, DropSettings.shipped(), network=model.network) for model in models().values()]
    calls: list[Callable[[], object]] = [lambda k=k: k.impact(q, severity, qd) for k in kernels]
    calls += [lambda k=k: k.gradient(q, severity, qd) for k in kernels]
    return [n * len(scene.entities) / min(_seconds(call) for _ in range(4)) for call in calls]


def _seconds(call: Callable[[], object]) -> float:
    started = time.process_time()
    call()
    return time.process_time() - started


# --- harm -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class TaskHarm:
    """Harm of failures per executed task of motions planned with either model, and their lengths [rad]."""

    task: str
    harm: Mapping[str, float]
    healthy: Mapping[str, float]
    """What the healthy robot does harm to on the way, such as by spilling: no failure's."""
    length: Mapping[str, float]
    ratio: tuple[float, float, float]
    """Of the network's motion over that of the drop model, with its interval."""
    refused: str = ""


def _tasks(options: suite.Options) -> list[tuple[str, int]]:
    names = [name for name in suite.unseen_task_names() if suite.task(name).object_name is not None]
    count = options.pick(TASKS, quick=1)
    names = [names[i * len(names) // count] for i in range(count)]  # of all scenes
    return [(name, (options.drops and 20 * options.drops) or options.pick(HARM_DROPS, quick=16)) for name in names]


def do_task(job: tuple[str, int]) -> TaskHarm:
    """Plan with both models, and drop the object along both motions alike."""
    name, n = job
    task, nothing = suite.task(name), (float("nan"),) * 3
    found = TaskHarm(task=name, harm={}, healthy={}, length={}, ratio=nothing)
    results = {
        label: gp.plan(
            task.start, task.goal, task.scene, objective=gp.Objective(impact=gp.ImpactCost(model=model)),
            time_limit=SECONDS, seed=SEED, speed=SPEED,
        )
        for label, model in models().items()
    }  # fmt: skip
    for grasp in ("fingers", "weld"):
        try:
            reports = {
                label: fb.validate(
                    result, task.scene, DROP, n=n, seed=SEED, threads=1, settings=fb.SimSettings(grasp=grasp)
                )
                for label, result in results.items()
            }
        except (fb.ExecutionRefused, gp.GracefulPlanError) as error:
            found = replace(found, refused=str(error))
            continue
        plain, learned = reports[PLAIN], reports[LEARNED]
        ratio, longer = fb.harm_ratio(learned, plain, per="failure"), learned.duration / plain.duration
        lengths = {
            label: float(np.linalg.norm(np.diff(result.trajectory.q, axis=0), axis=1).sum())
            for label, result in results.items()
            if result.trajectory is not None
        }
        return replace(
            found,
            refused="",
            harm={label: one.observed.scaled(one.failures_per_task).mean for label, one in reports.items()},
            healthy={label: one.healthy.harm for label, one in reports.items()},
            length=lengths,
            ratio=(longer * ratio.mean, longer * ratio.low, longer * ratio.high),
        )
    return found


# --- tables -----------------------------------------------------------------------------------------------------------


def _targets(
    events: Mapping[str, Events], gains: Mapping[str, Mapping[str, skill.Estimate]], harms: Sequence[TaskHarm]
) -> list[report.Target]:
    rows = []
    for label in events:
        gain = gains[label]["skill"]
        rows.append(
            report.Target(
                what=f"{label}: Brier skill of the network less that of the drop model",
                wanted="> 0, interval too",
                measured=f"{gain.mean:.4f} ({gain.low:.4f} to {gain.high:.4f})",
                met=gain.low > 0.0,
            )
        )
    for label, found in events.items():
        ratios = {model: severe_ratio(found, model) for model in (PLAIN, LEARNED)}
        rows.append(
            report.Target(
                what=f"{label}: severity-weighted ratio",
                wanted="nearer to 1 than the drop model's",
                measured=f"{ratios[LEARNED]:.3f}, {ratios[PLAIN]:.3f}",
                met=abs(np.log(ratios[LEARNED])) < abs(np.log(ratios[PLAIN])),
            )
        )
    done = [x for x in harms if x.harm]
    if done:
        total = {model: sum(x.harm[model] for x in done) for model in (PLAIN, LEARNED)}
        rows.append(
            report.Target(
                what=f"harm of {len(done)} tasks, planned with the network over planned with the drop model",
                wanted="< 1",
                measured=report.quantity(total[LEARNED] / total[PLAIN]),
                met=total[LEARNED] < total[PLAIN],
            )
        )
    return rows


def _rows(events: Mapping[str, Events]) -> list[Sequence[object]]:
    rows: list[Sequence[object]] = []
    for label, found in events.items():
        for scene in ("", *np.unique(found.scene).tolist()):
            part = found.only(found.scene == scene) if scene else found
            if len(part.happened) < BINS or not part.happened.any():
                continue
            for model in (PLAIN, LEARNED):
                rows.append((scene or f"{label}, all", model, *part.figures(model), f"{severe_ratio(part, model):.3f}"))
    return rows


def _gain_rows(gains: Mapping[str, Mapping[str, skill.Estimate]]) -> list[Sequence[object]]:
    def cell(x: skill.Estimate) -> str:
        return f"{x.mean:+.4f} ({x.low:+.4f} to {x.high:+.4f})"

    return [(label, *(cell(found[name]) for name in ("skill", "loss", "severe"))) for label, found in gains.items()]


def _harm_rows(harms: Sequence[TaskHarm]) -> list[Sequence[object]]:
    rows: list[Sequence[object]] = []
    for x in harms:
        if not x.harm:
            rows.append((x.task, x.refused, *["-"] * 6))
            continue
        numbers = [report.quantity(1e6 * x.harm[model]) for model in (PLAIN, LEARNED)]
        interval = f"{report.quantity(x.ratio[1])} to {report.quantity(x.ratio[2])}"
        lengths = [f"{x.length[model]:.2f}" for model in (PLAIN, LEARNED)]
        rows.append((x.task, *numbers, report.quantity(x.ratio[0]), interval, *lengths, _healthy(x)))
    done = [x for x in harms if x.harm]
    if done:
        plain, learned = (sum(x.harm[model] for x in done) for model in (PLAIN, LEARNED))
        numbers = [report.quantity(1e6 * total) for total in (plain, learned)]
        rows.append(("all", *numbers, report.quantity(learned / plain), "", "", "", ""))
    return rows


def _healthy(x: TaskHarm) -> str:
    return (
        ", ".join(report.quantity(x.healthy[model]) for model in (PLAIN, LEARNED)) if any(x.healthy.values()) else "0"
    )
