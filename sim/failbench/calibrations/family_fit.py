"""Fit the constants of a `Family` to failures in many scenes, and evaluate each scene with the fit on the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

import graceful_plan as gp
from failbench.calibrations.calibrate import VERSION, Calibration, rounded, rounded_figures, scenes_of, versions
from failbench.calibrations.failures import Failures
from failbench.calibrations.fitting import Family, Fitted, Sample, fit, predictions, samples_of
from failbench.calibrations.skill import Figures, figures
from graceful_plan import Scene
from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.exceptions import SettingError


class States(NamedTuple):
    """States at onsets, for families without further preparation."""

    scene: Scene
    q: Float[Array, "n nq"]
    qd: Float[Array, "n nq"]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class FamilyCalibration(Calibration):
    """Fitted constants of a model, with their provenance. Made by `fit_family`.

    | field      | meaning                                                                     |
    |------------|-----------------------------------------------------------------------------|
    | model      | name of the model                                                           |
    | constants  | constants by shape class and name                                           |
    | units      | units of the constants, by name                                             |
    | shared     | names of the constants that all shape classes share                         |
    | fitted     | figures on the data of the fit                                              |
    | held_out   | figures on each scene, with constants fitted on all others; "all": over all scenes |
    | provenance | scenes, failures, seed, versions                                            |
    """

    ONE_A_LINE: ClassVar[tuple[str, ...]] = ("shared", "classes")

    model: str
    constants: Mapping[str, Mapping[str, Fitted]]
    units: Mapping[str, str]
    shared: tuple[str, ...]
    fitted: Figures
    held_out: Mapping[str, Figures]
    provenance: Mapping[str, Any]

    def to_document(self) -> dict[str, Any]:
        """Return the calibration as JSON values."""
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
                "fitted": rounded_figures(self.fitted),
                "held_out": {scene: rounded_figures(found) for scene, found in self.held_out.items()},
                "units": {name: unit for name, unit in self.units.items() if unit},
                "intervals": intervals,
            },
            "shared": {name: rounded(self.constants[shapes[0]][name].value) for name in self.shared},
            "classes": {shape: {name: rounded(self.constants[shape][name].value) for name in own} for shape in shapes},
        }

    def __str__(self) -> str:
        rows = [("fitted", self.fitted), *self.held_out.items()]
        lines = [f"{'scene':<24} {'events':>8} {'hits':>6} {'skill':>6} {'AUC':>6} {'ECE':>6} {'ratio':>6}"]
        lines += [
            f"{name:<24} {x.events:>8} {x.happened:>6} {x.brier_skill:>6.3f} {x.auc:>6.3f}"
            f" {x.calibration_error:>6.3f} {x.ratio:>6.2f}"
            for name, x in rows
        ]
        return "\n".join(lines)


def fit_family(
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
) -> FamilyCalibration:
    """Fit a model's constants to failures, and evaluate them on held-out scenes.

    Args:
        family: The model.
        failures: Failures in at least two scenes.
        model: Name of the model, for the record.
        load: Loads a scene by name.
        shapes: Shape classes that get constants even without data.
        trusts: Values of `trust` to try, see `fitting.fit`; the one with the least log loss on held-out scenes is used.
        seed: Seed of the intervals.
        iterations: Greatest number of iterations of each fit.
        about: Further provenance, for example how the failures were made.

    Raises:
        SettingError: If all failures are in one scene.
    """
    names = sorted({part.scene for part in failures})
    if len(names) < 2:
        raise SettingError("scenes", tuple(names), "at least two, to evaluate each with the fit on the others")
    failures = [part for whole in failures if len(part := whole.only(family.faults))]
    samples = samples_of(family, failures, scenes_of(failures, load))
    every = (*shapes, *(sample.shape for sample in samples))
    tried = {trust: _held_out(family, samples, trust, iterations, every) for trust in trusts}
    trust = min(tried, key=lambda x: tried[x]["all"].log_loss)
    constants = fit(family, samples, seed=seed, trust=trust, iterations=iterations, shapes=every)
    return FamilyCalibration(
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
            "trusts_tried": {str(x): rounded(found["all"].log_loss) for x, found in tried.items()},
            "seed": seed,
            "versions": versions(),
        },
    )


def _held_out(
    family: Family, samples: Sequence[Sample], trust: float, iterations: int, shapes: Sequence[str]
) -> dict[str, Figures]:
    """Evaluate each scene with constants fitted on all others, and "all" scenes together."""
    found: dict[str, Figures] = {}
    guessed: list[tuple[Array, Array]] = []
    for name in sorted({sample.scene for sample in samples}):
        others, own = ([s for s in samples if (s.scene == name) is mine] for mine in (False, True))
        constants = fit(family, others, resamples=2, trust=trust, iterations=iterations, shapes=shapes)
        guessed.append(events(predictions(family, own, _values(constants)), own))
        found[name] = figures(*guessed[-1])
    found["all"] = figures(np.concatenate([p for p, _ in guessed]), np.concatenate([hit for _, hit in guessed]))
    return found


def events(
    predicted: Sequence[Float[Array, "_ _"]], samples: Sequence[Sample]
) -> tuple[Float[Array, " n"], Bool[Array, " n"]]:
    """Return predicted probabilities and outcomes of all counted events."""
    pairs = [(p[sample.counted], sample.hit[sample.counted]) for p, sample in zip(predicted, samples, strict=True)]
    return np.concatenate([p for p, _ in pairs]), np.concatenate([hit for _, hit in pairs])


def _values(constants: Mapping[str, Mapping[str, Fitted]]) -> dict[str, dict[str, float]]:
    return {shape: {name: x.value for name, x in values.items()} for shape, values in constants.items()}


def _interval(x: Fitted) -> list[float]:
    return [rounded(x.low), rounded(x.high)]
