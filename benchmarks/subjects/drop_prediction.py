"""Predictions of the drop model against simulated drops, in scenes that no constant was fitted on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np

import graceful_plan as gp
from benchmarks import events as failures
from benchmarks import landing, report, suite, variants
from benchmarks.events import BINS, FIGURES, Events
from failbench.calibrations import skill
from failbench.calibrations.calibrate import scenes_of
from failbench.calibrations.failure_jobs import KINDS, FailureJob, failure_jobs
from failbench.calibrations.failures import Failures
from graceful_plan.costs.models.mixture.mixture import FailureMixture

Array = np.ndarray

TITLE = "Drop model: predicted and observed hits, event by event"
QUESTION = "Does the drop model predict the hits that simulated drops cause in scenes it was not fitted on?"
HEADLINE = "footprint, Brier skill"
DEPENDS_ON = (
    *suite.PLANNING,
    *suite.SIMULATION,
    "sim/failbench/calibrations",
    "benchmarks/events.py",
    "benchmarks/landing.py",
    "benchmarks/unseen",
    "benchmarks/variants.py",
    "benchmarks/variant_table.py",
)
TALL = 2.0
"""Height over width above which a carried object is tall: bottles, tall glasses, vases, cans."""
MEASURED = f"""\
Scenes: variants of the bundled ones (`benchmarks/variants.py`) with objects moved, turned, removed and added, other
ends of all tasks, and carried objects that no bundled task carries. Calibration has seen none of them. "Unseen": the
scenes of `benchmarks/unseen`, with other furniture and objects. Motions: by RRT-Connect, by the default planner with w
= 0.1, 0.3 and 1 ("optimised"), and over random via points, at 0.3 to 1.0 of the velocity limits. The gripper fails at a
random time; fingers hold the object where they can, otherwise a weld does. An event is a drop and an entity: did the
object touch the entity within one second? Touches among entities do not count. "Skill": Brier skill over the base rate
of the same events. "ECE": 20 bins of equal counts. "Ratio": predicted over observed hits. "Tall": the object as held at
the start is at least {TALL:g} times as high as wide. Intervals are 95 %, from resampled whole motions. "Aimed":
Algorithm 1 with the object moved to its ballistic landing point at the height of each entity.
"""
SEED = 2026
LEAST = {"brier_skill": 0.65, "auc": 0.96}
MOST_ECE = 0.02
RATIO = (0.9, 1.1)
RATIO_OPTIMISED = (0.8, 1.25)
"""Target on optimised motions, for each of `HIT`: planners may exploit hits that the model underrates."""
DROPS, SCENES = 1000, 6
DROPS_UNSEEN, LONG_DROPS_UNSEEN = 20, 30
"""Drops along each motion in the unseen scenes, in normal and long runs."""
HIT = ("things", "furniture", "floor")
"""Kinds of hit entities, by class; people and animals count as things."""
VARIANTS, UNSEEN = "variants", "unseen"
_SURFACES = {"table": "furniture", "floor": "floor"}
PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "reliability.png"

MODELS: Mapping[str, Callable[[gp.Scene, Array, Array], Array]] = {
    "mixture": lambda scene, q, qd: _carried(scene, gp.interaction_probability(q, scene, FailureMixture(), qd)),
    "Algorithm 1": lambda scene, q, qd: _carried(scene, gp.interaction_probability(q, scene, "box_overlap", qd)),
    "Algorithm 1, aimed": landing.landed_probability,
}
SEVERITIES = (
    ("0", -np.inf, 0.0),
    ("above 0, at most 1", 0.0, 1.0),
    ("above 1, at most 5", 1.0, 5.0),
    ("above 5", 5.0, np.inf),
)
"""Classes of events, by the severity of a touch of the entity by the object."""


def run(options: suite.Options) -> str:
    """Simulate drops, predict them and compare."""
    resamples = options.pick(1000, quick=20)
    drops, refused = drop_all(options)
    events = events_of(drops)
    others, others_refused = drop_unseen(options)
    unseen = events_of(others, {"mixture": MODELS["mixture"]}, suite.scene)
    if not options.quick:
        draw(events, PICTURE, resamples)
    dropped = {name: sum(len(x) for x in drops if x.scene == name) for name in dict.fromkeys(x.scene for x in drops)}
    grasps = ", ".join(
        f"{sum(len(x) for x in drops if x.grasp == grasp)} from {grasp}" for grasp in ("fingers", "weld")
    )
    lost = sum(x.lost for x in drops)
    parts = [
        MEASURED,
        f"{sum(dropped.values())} drops ({grasps}; {lost} diverged) along {len(drops)} motions:"
        f" {len(events.happened)} events.\n",
        f"In `benchmarks/unseen`: {sum(len(x) for x in others)} drops along {len(others)} motions.\n",
        *(f"No drops: {reason}.\n" for reason in (*refused, *others_refused)),
        report.targets(_targets(events, unseen, dropped, resamples)),
        report.table(_HEADER, _rows(events, dropped)),
        "By severity of the touch, all scenes:\n",
        report.table(_HEADER, _severity_rows(events)),
        "`footprint` by motion and by entity:\n",
        report.table(("scenes", "motions", "entity", *FIGURES), _hit_rows({VARIANTS: events, UNSEEN: unseen})),
        "![](../../docs/images/reliability.png)\n\nReliability of `footprint`, bins of equally many predicted hits:\n",
        report.table(("predicted", "observed", "95 %", "events"), _curve_rows(events, resamples)),
    ]
    return "\n".join(parts)


def drop_all(options: suite.Options) -> tuple[list[Failures], list[str]]:
    """Simulate drops in all variants; return the drops in job order, and the reasons of motions without drops."""
    least, scenes = options.pick((DROPS, len(variants.VARIANTS)), quick=(24, 2))
    jobs: list[FailureJob] = []
    for k, name in enumerate(list(variants.VARIANTS)[:scenes]):
        kinds = options.pick(KINDS, quick=KINDS[:1])
        motions = len(variants.load(name).tasks) * len(kinds)
        n = -(-least // motions) + (0 if options.quick else 2)  # spares: some rollouts diverge
        jobs += failure_jobs(variants.load, [name], n=n, seed=SEED + k, kinds=kinds)
    return failures.fail(jobs, options)


def drop_unseen(options: suite.Options) -> tuple[list[Failures], list[str]]:
    """Simulate drops in the scenes of `unseen/`, as `drop_all` does."""
    scenes = options.pick(suite.unseen_scenes(), quick=suite.unseen_scenes()[:1])
    kinds = options.pick(KINDS, quick=KINDS[1:2])
    n = options.pick(DROPS_UNSEEN, quick=2, long=LONG_DROPS_UNSEEN)
    jobs = [
        job
        for k, name in enumerate(scenes)
        for job in failure_jobs(suite.scene, [name], n=n, seed=SEED + 100 + k, kinds=kinds)
    ]
    return failures.fail(jobs, options)


def events_of(
    drops: Sequence[Failures],
    models: Mapping[str, Callable[..., Array]] = MODELS,
    load: Callable[[str], gp.Scene] = variants.load,
) -> Events:
    """Predict the events of drops with every model."""
    scenes = scenes_of(drops, load)
    columns: dict[str, list[Array]] = {name: [] for name in ("scene", "motion", "severity", "happened")}
    labels: dict[str, list[Array]] = {"made": [], "hit": [], "carried": []}
    predicted: dict[str, list[Array]] = {name: [] for name in models}
    for i, part in enumerate(drops):
        scene = scenes[part.scene, part.task]
        severity = np.array([entity.severity["carried"] for entity in scene.entities.values()])
        hit, counting = part.events(["carried"])
        counted = np.broadcast_to(counting, hit.shape)
        columns["scene"].append(np.full(counted.sum(), part.scene))
        columns["motion"].append(np.full(counted.sum(), i))
        columns["severity"].append(np.broadcast_to(severity, hit.shape)[counted])
        columns["happened"].append(hit[counted])
        labels["made"].append(np.full(counted.sum(), "optimised" if part.motion.startswith("auto") else "others"))
        what = np.array([_SURFACES.get(entity.category, "things") for entity in scene.entities.values()])
        labels["hit"].append(np.broadcast_to(what, hit.shape)[counted])
        labels["carried"].append(np.full(counted.sum(), "tall" if is_tall(scene, part.q[0]) else "others"))
        for name, model in models.items():
            predicted[name].append(model(scene, part.q, part.qd)[counted])
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    return Events(
        **joined,
        predicted={name: np.concatenate(parts) for name, parts in predicted.items()},
        labels={name: np.concatenate(parts) for name, parts in labels.items()},
    )


def is_tall(scene: gp.Scene, q: Array) -> bool:
    """Whether the carried object is tall, as held in a configuration."""
    data = scene.data_at(q)
    geoms = list(scene.components["carried"].geoms)
    half, middle = scene.model.geom_aabb[geoms, 3:], scene.model.geom_aabb[geoms, :3]
    R_WG = data.geom_xmat[geoms].reshape(-1, 3, 3)
    centre = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", R_WG, middle)
    reach = np.einsum("gij,gj->gi", np.abs(R_WG), half)
    size = (centre + reach).max(axis=0) - (centre - reach).min(axis=0)
    return bool(size[2] >= TALL * size[:2].max())


def _carried(scene: gp.Scene, probability: Array) -> Array:
    return probability[:, list(scene.components).index("carried")]


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = ("", "model", "drops", *FIGURES)


def _targets(events: Events, unseen: Events, dropped: Mapping[str, int], resamples: int) -> list[report.Target]:
    def estimate(statistic: Callable[[Array, Array], float], some: Events = events) -> skill.Estimate:
        p, y = some.predicted["mixture"], some.happened
        return skill.bootstrap(statistic, p, y, some.motion, resamples=min(200, resamples))

    enough = len(dropped) >= SCENES and min(dropped.values()) >= DROPS
    least = min(dropped.values())
    found = {
        "Brier skill": (estimate(skill.brier_skill), f">= {LEAST['brier_skill']}", LEAST["brier_skill"], np.inf),
        "AUC": (estimate(skill.auc), f">= {LEAST['auc']}", LEAST["auc"], np.inf),
        "ECE": (estimate(lambda a, b: skill.calibration_error(a, b, BINS)), f"<= {MOST_ECE}", 0.0, MOST_ECE),
        "predicted over observed hits": (estimate(skill.predicted_ratio), f"{RATIO[0]} to {RATIO[1]}", *RATIO),
    }
    optimised = {
        f"{scenes}, optimised motions, {what or 'all'}": _part(some, "optimised", what)
        for scenes, some in ((VARIANTS, events), (UNSEEN, unseen))
        for what in ("", *HIT)
    }
    found |= {
        f"{what}: predicted over observed hits": (
            estimate(skill.predicted_ratio, some),
            f"{RATIO_OPTIMISED[0]} to {RATIO_OPTIMISED[1]}",
            *RATIO_OPTIMISED,
        )
        for what, some in optimised.items()
        if some.happened.any()
    }
    rows = [
        report.Target(what=f"footprint, {what}", wanted=wanted, measured=str(x), met=low <= x.mean <= high)
        for what, (x, wanted, low, high) in found.items()
    ]
    counted = f"{len(dropped)} x {least}"
    return [
        *rows,
        report.Target(what="held-out scenes x drops", wanted=f">= {SCENES} x {DROPS}", measured=counted, met=enough),
    ]


def _rows(events: Events, dropped: Mapping[str, int]) -> list[Sequence[object]]:
    rows = []
    for name in [*dropped, ""]:
        chosen = events.only(events.scene == name) if name else events
        drops = dropped[name] if name else sum(dropped.values())
        rows += [(name or "all", model, drops, *chosen.figures(model)) for model in events.predicted]
    return rows


def _severity_rows(events: Events) -> list[Sequence[object]]:
    rows = []
    for label, low, high in SEVERITIES:
        chosen = events.only((events.severity > low) & (events.severity <= high))
        if len(chosen.happened) >= BINS:
            rows += [(label, model, "", *chosen.figures(model)) for model in events.predicted]
    return rows


def _hit_rows(events: Mapping[str, Events]) -> list[Sequence[object]]:
    rows: list[Sequence[object]] = []
    for scenes, made, what in product(events, ("optimised", "others"), ("", *HIT)):
        part = _part(events[scenes], made, what)
        if len(part.happened):
            rows.append((scenes, made, what or "all", *part.figures("mixture")))
    for scenes, what in product(events, ("", *HIT)):
        part = _part(events[scenes], "optimised", what)
        part = part.only(part.labels["carried"] == "tall")
        if len(part.happened):
            rows.append((f"{scenes}, tall things carried", "optimised", what or "all", *part.figures("mixture")))
    return rows


def _part(events: Events, made: str, what: str = "") -> Events:
    """Return the events of some motions with one kind of entity; with all entities if `what` is empty."""
    hit = events.labels["hit"]
    return events.only((events.labels["made"] == made) & ((hit == what) if what else True))


def _curve_rows(events: Events, resamples: int) -> list[Sequence[object]]:
    curve = _curve(events, "mixture", resamples)
    return [(f"{p:.4f}", f"{y:.4f}", f"{low:.4f} to {high:.4f}", n) for p, y, low, high, n in zip(*curve, strict=True)]


def _curve(events: Events, model: str, resamples: int) -> skill.Reliability:
    p = np.clip(events.predicted[model], 0.0, 1.0)
    return skill.reliability(p, events.happened, events.motion, bins=BINS, by_hits=True, resamples=resamples)


def draw(events: Events, file: Path, resamples: int) -> None:
    """Draw the reliability curves of all models, that of the drop model with its band."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.4, 5.0), dpi=160, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1, linestyle=":", label="as often as predicted")
    colours = dict(zip(events.predicted, ("#1f6f4a", "#b5532a", "#6a6fb0"), strict=False))
    for model, colour in colours.items():
        curve = _curve(events, model, resamples)
        axes.plot(curve.predicted, curve.observed, "o-", color=colour, markersize=3, linewidth=1.3, label=model)
        axes.fill_between(curve.predicted, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0)
    scenes = len(np.unique(events.scene))
    axes.set(xlim=(0, 1), ylim=(0, 1), xlabel="predicted probability of a hit", ylabel="share of hits")
    axes.set_title(f"{len(events.happened):,} events in {scenes} scenes that calibration never saw", fontsize=9)
    axes.legend(fontsize=8, loc="upper left")
    axes.set_aspect("equal")
    figure.savefig(file)
