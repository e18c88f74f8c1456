"""Spills, collapsing and stuck arms: is what the model predicts what happens, in scenes that it never saw?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import report, suite, variants
from failbench import skill
from failbench.calibrate import scenes_of
from failbench.failures import KINDS, FailureJob, Failures, do_job, failure_jobs
from failbench.faults import faults

Array = np.ndarray

TITLE = "Spill and body models: predicted and observed hits, event by event"
MEASURED = """\
Scenes and motions as in `drop_prediction`, with other seeds. Faults are severe, at random times. An event is a failure
and an entity: did one of the components touch it within one second? "Spill, dropped": contents after a failure of the
gripper. "Spill, held": contents after faults of the arm. "Collapse": body after a loss of power. "Joint": body and
carried object after the shutdown of a random joint. "Stuck": the same after a random joint has seized. "Stray": after
faults of sensors. The model is told which faults are feared, not which joint fails. "Skill": Brier skill over the base
rate of the same events; "ratio": predicted hits over observed ones; intervals are 95 %, whole motions drawn with
replacement.
"""
SEED = 3111
LEAST_SKILL = 0.4
RATIO = (0.7, 1.4)
BINS = 20
OURS, PUBLISHED = "footprint", "Algorithm 1"


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Events of one kind."""

    faults: tuple[str, ...]
    components: tuple[str, ...]
    judged: bool = True
    """Whether there is a bar for them."""


_GRIPPER = ("gripper_failure", "weak_grip", "stuck_gripper")
EVENTS: Mapping[str, Kind] = {
    "spill, dropped": Kind(faults=_GRIPPER, components=("contents",)),
    "spill, held": Kind(
        faults=("complete_shutdown", "loose_joint", "power_loss", "dropout", "noise"), components=("contents",)
    ),
    "collapse": Kind(faults=("power_loss",), components=("body",)),
    "joint": Kind(faults=("complete_shutdown",), components=("body", "carried")),
    "stuck": Kind(faults=("stuck_position",), components=("body", "carried")),
    "stray": Kind(
        faults=("noise", "bias_drift", "scale_error", "dead_zone", "dropout", "control_delay"),
        components=("body", "carried"),
        judged=False,
    ),
}
NAMES = tuple(dict.fromkeys(name for kind in EVENTS.values() for name in kind.faults))


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How much."""

    each: int
    """Failures of each fault along each motion."""
    repeats: int
    """Motions of each kind of each task."""
    scenes: int | None
    kinds: int | None
    resamples: int


FULL = Sizes(each=6, repeats=1, scenes=None, kinds=None, resamples=1000)
QUICK = Sizes(each=2, repeats=1, scenes=2, kinds=1, resamples=20)


@dataclass(frozen=True, kw_only=True, eq=False)
class Events:
    """Events of one kind, one a row."""

    scene: Array
    motion: Array
    happened: Array
    predicted: Mapping[str, Array]


def run(options: suite.Options) -> str:
    """Fail, predict and compare."""
    sizes = QUICK if options.quick else FULL
    failures, refused = fail_all(sizes, options)
    events = {name: events_of(failures, kind) for name, kind in EVENTS.items()}
    return "\n".join(
        [
            MEASURED,
            f"{sum(len(x) for x in failures)} failures along {len(failures)} motions.\n",
            *(f"Not in: {reason}.\n" for reason in refused),
            report.targets(_targets(events, sizes)),
            report.table(_HEADER, [_row(name, model, x) for name, x in events.items() for model in x.predicted]),
        ]
    )


def fail_all(sizes: Sizes, options: suite.Options) -> tuple[list[Failures], list[str]]:
    """Fail in all variants; return the failures in the order of their jobs, and why some motions have none."""
    feared = [faults()[name](degree="severe") for name in NAMES]
    jobs: list[tuple[int, FailureJob]] = []
    for k, name in enumerate(list(variants.VARIANTS)[: sizes.scenes]):
        found = failure_jobs(
            variants.load,
            [name],
            feared,
            n=sizes.each * len(feared),
            seed=SEED + k,
            kinds=KINDS[: sizes.kinds],
            repeats=sizes.repeats,
        )
        jobs += list(enumerate(found, start=len(jobs)))
    outcomes = dict(suite.spread(_numbered, jobs, options.processes, "motions"))
    ordered = [outcomes[i] for i in range(len(jobs))]
    return [x for x in ordered if isinstance(x, Failures)], [x for x in ordered if isinstance(x, str)]


def _numbered(job: tuple[int, FailureJob]) -> tuple[int, Failures | str]:
    return job[0], do_job(job[1])


def events_of(failures: Sequence[Failures], kind: Kind) -> Events:
    """Predict the events of one kind with both models."""
    ours = gp.Footprint(faults=gp.FaultPrior(dict.fromkeys(kind.faults, 1.0)))
    models: Mapping[str, Callable[..., Array]] = {OURS: ours.probability, PUBLISHED: gp.BoxOverlap().probability}
    scenes = scenes_of(failures, variants.load)
    columns: dict[str, list[Array]] = {name: [] for name in ("scene", "motion", "happened", *models)}
    for i, whole in enumerate(failures):
        part, scene = whole.only(kind.faults), scenes[whole.scene, whole.task]
        strikers = [name for name in kind.components if name in part.components]
        if not strikers or not len(part):
            continue
        hit, counting = part.events(strikers)
        counted = np.broadcast_to(counting, hit.shape)
        columns["scene"].append(np.full(counted.sum(), part.scene))
        columns["motion"].append(np.full(counted.sum(), i))
        columns["happened"].append(hit[counted])
        batch = part.states(scene)
        rows = [list(scene.components).index(name) for name in strikers]
        for name, model in models.items():
            each = np.clip(model(batch)[:, rows], 0.0, 1.0)
            columns[name].append((1.0 - np.prod(1.0 - each, axis=1))[counted])
    joined = {name: np.concatenate(parts) if parts else np.zeros(0) for name, parts in columns.items()}
    return Events(
        scene=joined["scene"],
        motion=joined["motion"],
        happened=joined["happened"].astype(bool),
        predicted={name: joined[name] for name in models},
    )


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = ("events", "model", "events", "hits", "skill", "AUC", "ECE", "ratio", "log loss")


def _targets(events: Mapping[str, Events], sizes: Sizes) -> list[report.Target]:
    rows = []
    for name, x in events.items():
        if not EVENTS[name].judged:
            continue

        def estimate(statistic: Callable[[Array, Array], float], x: Events = x) -> skill.Estimate | None:
            if not x.happened.any():
                return None
            return skill.bootstrap(statistic, x.predicted[OURS], x.happened, x.motion, resamples=sizes.resamples)

        won, ratio = estimate(skill.brier_skill), estimate(skill.predicted_ratio)
        other = skill.brier_skill(x.predicted[PUBLISHED], x.happened) if x.happened.any() else np.nan
        rows += [
            report.Target(
                what=f"{name}: Brier skill",
                wanted=f">= {LEAST_SKILL}, above Algorithm 1",
                measured=f"{won}; Algorithm 1 {other:.2f}",
                met=None if won is None else won.mean >= LEAST_SKILL and won.mean > other,
            ),
            report.Target(
                what=f"{name}: predicted over observed hits",
                wanted=f"{RATIO[0]} to {RATIO[1]}",
                measured=str(ratio),
                met=None if ratio is None else RATIO[0] <= ratio.mean <= RATIO[1],
            ),
        ]
    return rows


def _row(name: str, model: str, events: Events) -> Sequence[object]:
    if not events.happened.any():
        return (name, model, len(events.happened), 0, *(["-"] * 5))
    found = skill.figures(events.predicted[model], events.happened, min(BINS, len(events.happened)))
    numbers = (found.brier_skill, found.auc, found.calibration_error, found.ratio, found.log_loss)
    return (name, model, found.events, found.happened, *(f"{x:.3f}" for x in numbers))
