"""Does the drop model put motions in the right order, and on the right scale? Predicted and observed impact of each."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import graceful_plan as gp
from benchmarks import landing, report, suite, variants
from benchmarks.store import read_lines
from failbench.calibrations import skill
from failbench.calibrations.failure_jobs import KINDS, FailureJob, do_job, failure_jobs
from failbench.calibrations.failures import Failures

Array = np.ndarray

TITLE = "Drop model: predicted and observed impact, motion by motion"
MEASURED = """\
Scenes, motions and drops as in `drop_prediction`, with other seeds; motions of all kinds of a scene are mixed.
Observed: mean over the drops of a motion of the severities of what the object and its contents touched, summed over
components and entities. Predicted: mean of the same over the onsets. "Spearman", "Kendall": rank correlations within
a scene; "slope" and "Pearson" of the line of observed over predicted. "Halves": Spearman's correlation of the impacts
observed in two halves of the drops, stepped up to all of them (Spearman-Brown): no prediction can be expected to exceed
its square root. Intervals are 95 %, motions drawn with replacement.
"""
STORE = Path(__file__).resolve().parents[1] / "trajectory_drops"
"""A file for each scene and seed, a line for each motion that is done; an interrupted run goes on where it was."""
SEED = 4052
LEAST_SPEARMAN = 0.9
SLOPE = (0.85, 1.15)
MOTIONS, SCENES, DROPS = 200, 6, 400


@dataclass(frozen=True, kw_only=True)
class JudgedMotion:
    """A motion that is done."""

    number: int
    """In its scene."""
    label: str
    drops: int
    observed: float
    error: float
    """Standard error of what was observed."""
    halves: tuple[float, float]
    """Observed in the drops with even and with odd numbers."""
    predicted: Mapping[str, float]
    """By model."""


def run(options: suite.Options) -> str:
    """Do what is left to do, at most for `options.seconds`, and report on all that is done."""
    # The wanted MOTIONS and DROPS take about an hour and a half on two cores that do nothing else.
    motions, drops = options.pick((60, 100), quick=(6, 8))
    resamples, scenes = options.pick((1000, len(variants.VARIANTS)), quick=(50, 1))
    names = list(variants.VARIANTS)[:scenes]
    with tempfile.TemporaryDirectory() as scratch:  # a quick run has nothing to keep
        files = {
            name: (Path(scratch) if options.quick else STORE) / f"{name}.{SEED}.{motions}x{drops}.jsonl"
            for name in names
        }
        # Each scene gets its share of the time that is left.
        until = None if options.seconds is None else time.monotonic() + options.seconds
        for i, (name, file) in enumerate(files.items()):
            left = np.inf if until is None else (until - time.monotonic()) / (len(files) - i)
            go_on(file, jobs_of(name, motions, drops), options, time.monotonic() + left)
        done = {name: list(read(file)) for name, file in files.items()}
    counted = {name: found for name, found in done.items() if len(found) >= 3}
    dropped = sum(x.drops for found in counted.values() for x in found)
    return "\n".join(
        [
            MEASURED,
            f"{sum(len(found) for found in counted.values())} motions, {dropped} drops.\n",
            report.targets(_targets(counted, len(names))),
            report.table(_HEADER, _rows(counted, resamples)),
        ]
    )


def jobs_of(name: str, motions: int, drops: int) -> list[FailureJob]:
    """Return the jobs of a scene, at least so many motions, kinds and tasks in turn."""
    tasks = len(variants.load(name).tasks)
    repeats = -(-motions // (tasks * len(KINDS)))
    number = list(variants.VARIANTS).index(name)
    return failure_jobs(variants.load, [name], n=drops, seed=SEED + number, repeats=repeats)


def go_on(file: Path, jobs: Sequence[FailureJob], options: suite.Options, until: float) -> None:
    """Do jobs that are not in a file yet, and add them to it, until a time of the monotonic clock [s]."""
    found = list(read(file))
    have = {x.number for x in found}
    file.parent.mkdir(exist_ok=True)
    file.write_text("".join(_line(x) for x in found), encoding="utf-8")  # less a line that was cut off
    # In random order, so that what is done when time is up is a fair sample.
    order = np.random.default_rng(SEED).permutation(len(jobs)).tolist()
    todo = [(i, jobs[i]) for i in order if i not in have]
    size = 4 * max(1, options.processes)
    for first in range(0, len(todo), size):
        if time.monotonic() > until:
            return
        with file.open("a", encoding="utf-8") as out:
            for x in suite.spread(_do, todo[first : first + size], options.processes, f"{file.stem}, {first}"):
                if x is not None:
                    out.write(_line(x))
                    out.flush()


def _line(done: JudgedMotion) -> str:
    return json.dumps(vars(done), allow_nan=False) + "\n"


def read(file: Path) -> Iterator[JudgedMotion]:
    """Yield what is done."""
    for document in read_lines(file):
        yield JudgedMotion(**(document | {"halves": tuple(document["halves"])}))


def _do(job: tuple[int, FailureJob]) -> JudgedMotion | None:
    number, what = job
    drops = do_job(what)
    if isinstance(drops, str):
        return None
    scene = what.load(what.scene).tasks[what.task].scene
    severity = gp.ImpactCost().severity(scene) * drops.counted
    impact = (drops.hit * severity).sum(axis=(1, 2))
    return JudgedMotion(
        number=number,
        label=f"{what.task}, {what.kind}",
        drops=len(drops),
        observed=float(impact.mean()),
        error=float(impact.std(ddof=1) / np.sqrt(len(impact))),
        halves=(float(impact[::2].mean()), float(impact[1::2].mean())),
        predicted={name: expected(model(scene, drops), severity) for name, model in MODELS.items()},
    )


def expected(P: Array, severity: Array) -> float:
    """Mean over states of the sum over components and entities, as planners charge it.

    Args:
        P: Of contacts [n, component, entity].
        severity: Of contacts [component, entity].
    """
    return float(np.einsum("nce,ce->n", P, severity).mean())


def _aimed(scene: gp.Scene, drops: Failures) -> Array:
    falling = np.array([name in ("carried", "contents") for name in scene.components])
    return landing.landed_probability(scene, drops.q, drops.qd)[:, None] * falling[None, :, None]


MODELS: Mapping[str, Callable[[gp.Scene, Failures], Array]] = {
    "mixture": lambda scene, drops: gp.FailureMixture().probability(drops.states(scene)),
    "Algorithm 1": lambda scene, drops: gp.interaction_probability(drops.q, scene, "box_overlap", drops.qd),
    "Algorithm 1, aimed": _aimed,
}
"""P by component and entity, given that the gripper lets go."""


# --- tables ----------------------------------------------------------------------------------------------------------

_HEADER = ("scene", "model", "motions", "Spearman", "95 %", "Kendall", "Pearson", "slope", "95 %", "ratio", "halves")


def _targets(done: Mapping[str, Sequence[JudgedMotion]], scenes: int) -> list[report.Target]:
    ranks = {name: skill.spearman(*_pairs(found, "mixture")) for name, found in done.items()}
    slopes = {name: skill.slope(*_pairs(found, "mixture")) for name, found in done.items()}
    least = min((len(found) for found in done.values()), default=0)
    drops = min((x.drops for found in done.values() for x in found), default=0)
    worst = min(ranks, key=lambda name: ranks[name], default="none")
    all_done = len(done) == scenes
    return [
        report.Target(
            what="footprint, Spearman within each scene",
            wanted=f">= {LEAST_SPEARMAN}",
            measured=f"at least {ranks.get(worst, np.nan):.3f} ({worst})",
            met=all_done and min(ranks.values()) >= LEAST_SPEARMAN if ranks else None,
        ),
        report.Target(
            what="footprint, slope of observed over predicted in each scene",
            wanted=f"{SLOPE[0]} to {SLOPE[1]}",
            measured=", ".join(f"{x:.2f}" for x in slopes.values()),
            met=all_done and all(SLOPE[0] <= x <= SLOPE[1] for x in slopes.values()) if slopes else None,
        ),
        report.Target(
            what="scenes x motions x drops",
            wanted=f">= {SCENES} x {MOTIONS} x {DROPS}",
            measured=f"{len(done)} x {least} x {drops}",
            met=len(done) >= SCENES and least >= MOTIONS and drops >= DROPS - 2,
        ),
    ]


def _rows(done: Mapping[str, Sequence[JudgedMotion]], resamples: int) -> Iterator[Sequence[object]]:
    for name, found in done.items():
        halves = skill.spearman(*np.array([x.halves for x in found]).T)
        for model in MODELS:
            yield _row(name, model, found, 2.0 * halves / (1.0 + halves), resamples)


def _row(name: str, model: str, found: Sequence[JudgedMotion], halves: float, resamples: int) -> Sequence[object]:
    p, y = _pairs(found, model)

    def interval(statistic: Callable[[Array, Array], float]) -> str:
        x = skill.bootstrap(statistic, p, y, resamples=resamples)
        return f"{x.low:.2f} to {x.high:.2f}"

    return (
        name,
        model,
        len(found),
        f"{skill.spearman(p, y):.3f}",
        interval(skill.spearman),
        f"{skill.kendall(p, y):.3f}",
        f"{np.corrcoef(p, y)[0, 1]:.3f}" if np.ptp(p) and np.ptp(y) else "-",
        f"{skill.slope(p, y):.2f}",
        interval(skill.slope),
        report.quantity(float(p.sum() / y.sum()) if y.any() else np.nan),
        f"{halves:.3f}",
    )


def _pairs(found: Sequence[JudgedMotion], model: str) -> tuple[Array, Array]:
    return np.array([x.predicted[model] for x in found]), np.array([x.observed for x in found])
