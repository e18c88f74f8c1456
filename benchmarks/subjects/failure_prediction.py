"""Predictions of the spill and body models against simulated failures, in scenes they were not fitted on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import graceful_plan as gp
from benchmarks import events as failing
from benchmarks import report, suite, variants
from benchmarks.events import FIGURES, Events
from failbench.calibrations import skill
from failbench.calibrations.calibrate import scenes_of
from failbench.calibrations.failure_jobs import KINDS, FailureJob, failure_jobs
from failbench.calibrations.failures import Failures
from failbench.fault.fault import Fault
from failbench.fault.registry import faults
from graceful_plan.costs.models.body.body import BodyModel, mode_names
from graceful_plan.costs.models.body.tables import ROWS

Array = np.ndarray

TITLE = "Spill and body models: predicted and observed hits, event by event"
QUESTION = "Do the spill and body models predict the hits of spills and failing arms in scenes they were not fitted on?"
HEADLINE = "collapse: Brier skill"
DEPENDS_ON = (
    *suite.PLANNING,
    *suite.SIMULATION,
    "sim/failbench/calibrations",
    "benchmarks/events.py",
    "benchmarks/variants.py",
    "benchmarks/variant_table.py",
)
MEASURED = """\
Scenes and motions as in `drop_prediction`, with other seeds. Faults are severe and begin at random times. An event is a
failure and an entity: did one of the listed components touch the entity within one second? "Spill, dropped": contents
after a gripper failure. "Spill, held": contents after arm faults that spill some of them; the state does not show
whether they do. "Collapse": body after a power loss. "Joint": body and carried object after the shutdown of one joint.
"Stuck": the same after one joint has seized. "Stray": the same after sensor faults. The model gets the kind of failure,
the joint for single-joint faults, and the planned motion. A weak grip lets go about 0.3 s after its onset, so the model
predicts from the planned state at that time. "Skill": Brier skill over the base rate of the same events. "Ratio":
predicted over observed hits. Intervals are 95 %, from resampled whole motions.
"""
SEED = 3111
LEAST_SKILL = 0.4
RATIO = (0.7, 1.4)
OURS, PUBLISHED = "mixture", "Algorithm 1"


@dataclass(frozen=True, kw_only=True)
class FailureKind:
    """Events of one kind."""

    generator: str
    faults: tuple[str, ...]
    """Names of the faults."""
    components: tuple[str, ...]
    single: bool = False
    """Whether the faults concern one known joint."""
    spilled: bool = False
    """Whether only failures with spilled contents count."""
    judged: bool = True
    """Whether there is a target."""


_GRIPPER = ("gripper_failure", "weak_grip", "stuck_gripper")
_ARM = ("loose_joint", "power_loss", "dropout", "noise", "dead_zone")
_SENSORS = ("noise", "bias_drift", "scale_error", "dead_zone", "dropout", "control_delay")
EVENTS: Mapping[str, FailureKind] = {
    "spill, dropped": FailureKind(generator="drop", faults=_GRIPPER, components=("contents",)),
    "spill, held": FailureKind(generator="spill", faults=_ARM, components=("contents",), spilled=True),
    "collapse": FailureKind(generator="collapse", faults=("power_loss",), components=("body",)),
    "joint": FailureKind(generator="joint", faults=("complete_shutdown",), components=("body", "carried"), single=True),
    "stuck": FailureKind(generator="stuck", faults=("stuck_position",), components=("body", "carried"), single=True),
    "stray": FailureKind(generator="stray", faults=_SENSORS, components=("body", "carried"), judged=False),
}


def run(options: suite.Options) -> str:
    """Simulate failures, predict them and compare."""
    failures, refused = fail_all(options)
    events = {name: events_of(failures, kind) for name, kind in EVENTS.items()}
    rows = [(name, model, *x.figures(model)) for name, x in events.items() for model in x.predicted]
    return "\n".join(
        [
            MEASURED,
            f"{sum(len(x) for x in failures)} failures along {len(failures)} motions.\n",
            *(f"Not in: {reason}.\n" for reason in refused),
            report.targets(_targets(events, options.pick(1000, quick=20))),
            report.table(_HEADER, rows),
        ]
    )


def fail_all(options: suite.Options) -> tuple[list[Failures], list[str]]:
    """Simulate failures in all variants; return them in job order, and the reasons of motions without failures."""
    each, scenes = options.pick((1, len(variants.VARIANTS)), quick=(1, 2), long=(3, len(variants.VARIANTS)))
    jobs: list[FailureJob] = []
    for k, name in enumerate(list(variants.VARIANTS)[:scenes]):
        chosen = faults_of(variants.load(name))
        kinds = options.pick(KINDS, quick=KINDS[:1])
        jobs += failure_jobs(variants.load, [name], chosen, n=each * len(chosen), seed=SEED + k, kinds=kinds)
    return failing.fail(jobs, options)


def faults_of(scene: gp.Scene) -> list[Fault]:
    """Return all simulated faults, those of single joints for each joint."""
    every: dict[Fault, None] = {}
    for kind in EVENTS.values():
        for name in kind.faults:
            for targets in [(joint,) for joint in scene.joints] if kind.single else [()]:
                every[faults()[name](degree="severe", targets=targets)] = None
    return list(every)


def events_of(failures: Sequence[Failures], kind: FailureKind) -> Events:
    """Predict the events of one kind with both models."""
    scenes = scenes_of(failures, variants.load)
    columns: dict[str, list[Array]] = {name: [] for name in ("scene", "motion", "happened", OURS, PUBLISHED)}
    for i, whole in enumerate(failures):
        scene = scenes[whole.scene, whole.task]
        part = whole.only(_labels(kind, scene))
        part = part.where(part.spilled > 0.0) if kind.spilled else part
        strikers = [name for name in kind.components if name in part.components]
        if not strikers or not len(part):
            continue
        hit, counting = part.events(strikers)
        counted = np.broadcast_to(counting, hit.shape)
        columns["scene"].append(np.full(counted.sum(), part.scene))
        columns["motion"].append(np.full(counted.sum(), i))
        columns["happened"].append(hit[counted])
        rows = [list(scene.components).index(name) for name in strikers]
        for name, P in ((OURS, _ours(kind, scene, part)), (PUBLISHED, _published(scene, part))):
            each = np.clip(P[:, rows], 0.0, 1.0)
            columns[name].append((1.0 - np.prod(1.0 - each, axis=1))[counted])
    joined = {name: np.concatenate(parts) if parts else np.zeros(0) for name, parts in columns.items()}
    return Events(
        scene=joined["scene"],
        motion=joined["motion"],
        happened=joined["happened"].astype(bool),
        predicted={name: joined[name] for name in (OURS, PUBLISHED)},
    )


def _labels(kind: FailureKind, scene: gp.Scene) -> list[str]:
    return [f"{name} {joint}" for name in kind.faults for joint in scene.joints] if kind.single else list(kind.faults)


def _ours(kind: FailureKind, scene: gp.Scene, part: Failures) -> Array:
    batch = part.states(scene)
    if not kind.single:
        prior = gp.FaultPrior({"it": 1.0}, {"it": {kind.generator: 1.0}})
        return gp.FailureMixture(faults=prior).probability(batch)
    P = np.zeros((len(part), len(scene.components), len(scene.entities)))
    modes, names = BodyModel().modes(batch, batch.ahead), mode_names(scene)
    struck = [names.index(f"{kind.generator}/{part.faults[i].split(' ')[1]}") for i in part.fault]
    for row, component in enumerate(scene.components):
        if component in ROWS:
            P[:, row] = modes[np.arange(len(part)), struck, ROWS.index(component)]
    return P


def _published(scene: gp.Scene, part: Failures) -> Array:
    return gp.interaction_probability(part.q, scene, "box_overlap", part.qd)


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = ("events", "model", *FIGURES)


def _targets(events: Mapping[str, Events], resamples: int) -> list[report.Target]:
    rows = []
    for name, x in events.items():
        if not EVENTS[name].judged:
            continue

        def estimate(statistic: Callable[[Array, Array], float], x: Events = x) -> skill.Estimate | None:
            if not x.happened.any():
                return None
            return skill.bootstrap(statistic, x.predicted[OURS], x.happened, x.motion, resamples=resamples)

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
