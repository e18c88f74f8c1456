"""Calibration: let robots fail in many scenes, fit a model's constants, and write down where these come from.

The document holds, beside each constant and its interval, what failed where with which versions, and how good the
model is on each scene with constants that were fitted on all the others.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import mujoco
import numpy as np
import yaml

import graceful_plan as gp
from failbench.calibrations.failures import (
    DROP,
    FailureJob,
    Failures,
    do_job,
    failure_jobs,
    read_failures,
    write_failures,
)
from failbench.calibrations.fitting import Family, Fitted, Sample, fit, predictions, samples_of
from failbench.calibrations.skill import Figures, figures
from failbench.fault.fault import Fault
from failbench.rollouts.sampling import MOST, check_whole
from graceful_plan import Scene, SettingError, UnknownNameError
from graceful_plan.array_types import Bool, Float

Array = np.ndarray

VERSION = 1
HEAD = """\
# Written by `failbench calibrate`; do not edit. Intervals are 95 %, whole motions drawn with replacement.
# held_out: each scene with constants that were fitted on the others.
"""
_DIGITS = 5
"""Significant digits of what is written."""

Progress = Callable[[int, int], None]
"""Called with the number of motions done and the number of all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Constants of a model, and why they are what they are. Made by `calibrate`.

    | field      | meaning                                                                     |
    |------------|-----------------------------------------------------------------------------|
    | model      | name of the model                                                           |
    | constants  | by shape class and name                                                     |
    | units      | of the constants, by name                                                   |
    | shared     | names of the constants that all shape classes share                         |
    | fitted     | figures on what they were fitted on                                         |
    | held_out   | figures on each scene, with constants fitted on all others; "all" of them together |
    | provenance | scenes, failures, seed, versions                                               |
    """

    model: str
    constants: Mapping[str, Mapping[str, Fitted]]
    units: Mapping[str, str]
    shared: tuple[str, ...]
    fitted: Figures
    held_out: Mapping[str, Figures]
    provenance: Mapping[str, Any]

    def to_document(self) -> dict[str, Any]:
        """Return it as JSON values."""
        shapes = list(self.constants)
        own = [name for name in self.units if name not in self.shared]
        intervals = {
            "shared": {name: _interval(self.constants[shapes[0]][name]) for name in self.shared},
            "classes": {shape: {name: _interval(self.constants[shape][name]) for name in own} for shape in shapes},
        }
        return {
            "version": VERSION,
            "provenance": {
                "model": self.model,
                **self.provenance,
                "fitted": _figures(self.fitted),
                "held_out": {scene: _figures(found) for scene, found in self.held_out.items()},
                "units": {name: unit for name, unit in self.units.items() if unit},
                "intervals": intervals,
            },
            "shared": {name: _rounded(self.constants[shapes[0]][name].value) for name in self.shared},
            "classes": {shape: {name: _rounded(self.constants[shape][name].value) for name in own} for shape in shapes},
        }

    def to_yaml(self) -> str:
        """Return it as YAML text that `DropSettings.load` and its like read."""
        return to_yaml(self.to_document())

    def __str__(self) -> str:
        rows = [("fitted", self.fitted), *self.held_out.items()]
        lines = [f"{'scene':<24} {'events':>8} {'hits':>6} {'skill':>6} {'AUC':>6} {'ECE':>6} {'ratio':>6}"]
        lines += [
            f"{name:<24} {x.events:>8} {x.happened:>6} {x.brier_skill:>6.3f} {x.auc:>6.3f}"
            f" {x.calibration_error:>6.3f} {x.ratio:>6.2f}"
            for name, x in rows
        ]
        return "\n".join(lines)


def generate(
    scenes: Sequence[str],
    faults: Sequence[Fault] = DROP,
    *,
    load: Callable[[str], Scene] = gp.load_scene,
    n: int = 30,
    repeats: int = 2,
    seed: int = 0,
    processes: int = 1,
    progress: Progress | None = None,
) -> tuple[list[Failures], list[str]]:
    """Let a robot fail along several motions for every task of some scenes that carries something.

    Args:
        scenes: Names of scenes.
        faults: What fails.
        load: Loads a scene by name; a function of a module.
        n: Failures along each motion.
        repeats: Motions of each kind for each task.
        seed: Of everything random. What comes out depends on it alone, not on `processes`.
        processes: How many to work in.
        progress: Called after each motion.

    Returns:
        What happened, and why some motions have none.
    """
    jobs = failure_jobs(load, scenes, faults, n=n, seed=seed, repeats=repeats)
    found: list[Failures] = []
    refused: list[str] = []

    def take(outcome: Failures | str) -> None:
        found.append(outcome) if isinstance(outcome, Failures) else refused.append(outcome)
        if progress is not None:
            progress(len(found) + len(refused), len(jobs))

    if processes <= 1:
        for job in jobs:
            take(do_job(job))
    else:
        # Spawned, not forked: libraries below have threads.
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            for outcome in pool.imap(_do, jobs):
                take(outcome)
    return found, refused


def fetch(
    scenes: Sequence[str],
    faults: Callable[[], Sequence[Fault]],
    *,
    n: int,
    repeats: int,
    seed: int,
    processes: int,
    kept: str | FilePath | None,
    progress: Progress | None,
) -> tuple[list[Failures], list[str] | None]:
    """Let a robot fail in bundled scenes, or take failures from a file; see `generate`.

    Args:
        scenes: Names of bundled scenes.
        faults: Returns what fails; asked only if something is to be simulated.
        n: Failures along each motion.
        repeats: Motions of each kind for each task.
        seed: Of everything random.
        processes: How many to work in.
        kept: File that the failures are kept in, or taken from if it is there. Then only those in `scenes` count.
        progress: Called after each motion.

    Returns:
        What happened, and why some motions have none; None if it was taken from the file.

    Raises:
        UnknownNameError: If there is no such scene.
        SettingError: If there is nothing to do.
        FormatError: If the file is there and holds something else.
    """
    for name in scenes:
        if name not in gp.scenes():
            raise UnknownNameError("scene", name, gp.scenes())
    check_whole("n", n, 1, MOST)
    check_whole("repeats", repeats, 1, MOST)
    file = None if kept is None else FilePath(kept)
    if file is not None and file.exists():
        return [part for part in read_failures(file) if part.scene in scenes], None
    failures, refused = generate(
        scenes, faults(), n=n, repeats=repeats, seed=seed, processes=processes, progress=progress
    )
    if file is not None:
        write_failures(file, failures)
    return failures, refused


def _do(job: FailureJob) -> Failures | str:
    return do_job(job)


def calibrate(
    family: Family,
    failures: Sequence[Failures],
    *,
    model: str,
    load: Callable[[str], Scene] = gp.load_scene,
    shapes: Sequence[str] = (),
    trusts: Sequence[float] = (25.0, 100.0, 400.0),
    seed: int = 0,
    iterations: int = 30,
    about: Mapping[str, Any] | None = None,
) -> Calibration:
    """Fit a model's constants to failures, and judge them on scenes that they were not fitted on.

    Args:
        family: The model.
        failures: What happened, in two scenes at least.
        model: Its name, for the record.
        load: Loads a scene by name.
        shapes: Shape classes that get constants even if nothing of the kind was carried.
        trusts: To be tried, see `fitting.fit`; the one whose log loss on held-out scenes is least is taken.
        seed: Of the intervals.
        iterations: Of each fit, at most.
        about: What else to put down: how the failures were made.

    Raises:
        SettingError: If all failures are in one scene.
    """
    names = sorted({part.scene for part in failures})
    if len(names) < 2:
        raise SettingError("scenes", tuple(names), "at least two, to judge on each what was fitted on the others")
    failures = [part for whole in failures if len(part := whole.only(family.faults))]
    samples = samples_of(family, failures, scenes_of(failures, load))
    every = (*shapes, *(sample.shape for sample in samples))
    tried = {trust: _held_out(family, samples, trust, iterations, every) for trust in trusts}
    trust = min(tried, key=lambda x: tried[x]["all"].log_loss)
    constants = fit(family, samples, seed=seed, trust=trust, iterations=iterations, shapes=every)
    return Calibration(
        model=model,
        constants=constants,
        units={constant.name: constant.unit for constant in family.constants},
        shared=tuple(constant.name for constant in family.constants if constant.shared),
        fitted=figures(*events(predictions(family, samples, _values(constants)), samples)),
        held_out=tried[trust],
        provenance={
            "scenes": names,
            "tasks": len(samples),
            "motions": len(failures),
            "failures": sum(len(part) for part in failures),
            "grasps": {
                grasp: sum(len(part) for part in failures if part.grasp == grasp) for grasp in ("fingers", "weld")
            },
            "shapes": {shape: sum(len(s.hit) for s in samples if s.shape == shape) for shape in constants},
            **(about or {}),
            "trust": trust,
            "trusts_tried": {str(x): _rounded(found["all"].log_loss) for x, found in tried.items()},
            "seed": seed,
            "versions": {"graceful_plan": gp.__version__, "mujoco": mujoco.__version__},
        },
    )


def _held_out(
    family: Family, samples: Sequence[Sample], trust: float, iterations: int, shapes: Sequence[str]
) -> dict[str, Figures]:
    """Judge constants on each scene that were fitted on all others, and on "all" of these together."""
    found: dict[str, Figures] = {}
    guessed: list[tuple[Array, Array]] = []
    for name in sorted({sample.scene for sample in samples}):
        others, own = ([s for s in samples if (s.scene == name) is mine] for mine in (False, True))
        constants = fit(family, others, resamples=2, trust=trust, iterations=iterations, shapes=shapes)
        guessed.append(events(predictions(family, own, _values(constants)), own))
        found[name] = figures(*guessed[-1])
    found["all"] = figures(np.concatenate([p for p, _ in guessed]), np.concatenate([hit for _, hit in guessed]))
    return found


def scenes_of(failures: Sequence[Failures], load: Callable[[str], Scene]) -> dict[tuple[str, str], Scene]:
    """Load the scene of every scene's name and task's name, with the object attached."""
    loaded = {name: load(name) for name in sorted({part.scene for part in failures})}
    return {(part.scene, part.task): loaded[part.scene].tasks[part.task].scene for part in failures}


def events(
    predicted: Sequence[Float[Array, "_ _"]], samples: Sequence[Sample]
) -> tuple[Float[Array, " n"], Bool[Array, " n"]]:
    """Return predicted probabilities and outcomes of all events that count."""
    pairs = [(p[sample.counted], sample.hit[sample.counted]) for p, sample in zip(predicted, samples, strict=True)]
    return np.concatenate([p for p, _ in pairs]), np.concatenate([hit for _, hit in pairs])


def to_yaml(document: Mapping[str, Any]) -> str:
    """Format a calibration's document, each constant on a line of its own."""
    about = {key: document[key] for key in ("version", "provenance")}
    constants = {key: document[key] for key in ("shared", "classes")}
    compact = yaml.safe_dump(about, sort_keys=False, default_flow_style=None, width=120)
    return HEAD + compact + yaml.safe_dump(constants, sort_keys=False, default_flow_style=False)


def write(calibration: Calibration, file: str | FilePath) -> None:
    """Write a calibration as YAML."""
    FilePath(file).write_text(calibration.to_yaml(), encoding="utf-8")


def _values(constants: Mapping[str, Mapping[str, Fitted]]) -> dict[str, dict[str, float]]:
    return {shape: {name: x.value for name, x in values.items()} for shape, values in constants.items()}


def _interval(x: Fitted) -> list[float]:
    return [_rounded(x.low), _rounded(x.high)]


def _figures(found: Figures) -> dict[str, Any]:
    return {name: value if isinstance(value, int) else _rounded(value) for name, value in found._asdict().items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
