"""Fit the margins of the body model to failures, by maximum likelihood.

The motion of a failing arm is physics and is not fitted. Its uncertainty is: an offset and a spread for each generator
and row. Joints fail one at a time and the failing joint is known, so each event has exactly one cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, final

import numpy as np

import graceful_plan as gp
from failbench.calibrations.body_margins import REACH, FittedMargin, MarginEvents, fit_touches
from failbench.calibrations.calibrate import VERSION, Calibration, Recipe, rounded, rounded_figures, scenes_of, versions
from failbench.calibrations.failures import Failures
from failbench.fault.fault import Fault
from failbench.fault.registry import PowerLoss, faults
from graceful_plan import Scene, StateBatch
from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost import AHEAD
from graceful_plan.costs.models.body.body import FAR, BodyModel, mode_names
from graceful_plan.costs.models.body.constants import GENERATORS, MOTION, BodySettings, Margin
from graceful_plan.costs.models.body.tables import ROWS
from graceful_plan.exceptions import SettingError

SINGLE: Mapping[str, str] = {"complete_shutdown": "joint", "stuck_position": "stuck"}
"""Faults of one joint, and the generators fitted to them."""
WHOLE: Mapping[str, str] = {
    "power_loss": "collapse",
    **dict.fromkeys(("noise", "bias_drift", "control_delay", "dead_zone", "dropout"), "stray"),
}
"""Faults that do not strike one joint, and the generators fitted to them."""
_DIGITS = 4
_RESAMPLES = 100


def faults_of(scene: Scene) -> list[Fault]:
    """Return the faults that the model is fitted to; the gripper is self-locking, so that it keeps its object."""
    known = faults()
    single = [known[name](degree="severe", targets=(joint,)) for name in SINGLE for joint in scene.joints]
    whole = [known[name](degree="severe") for name in WHOLE if name != PowerLoss.NAME]
    return [*single, PowerLoss(degree="severe", grip="kept"), *whole]


# --- distances -------------------------------------------------------------------------------------------------------


def wide(settings: BodySettings) -> BodySettings:
    """Return settings whose margins cut off no distance below `REACH`."""
    margin = Margin(offset=0.0, spread=REACH / FAR)
    return replace(settings, **{g: replace(getattr(settings, g), body=margin, carried=margin) for g in GENERATORS})


def fit_distances(
    settings: BodySettings, batch: StateBatch, ahead: Float[Array, "n step nq"] | None = None
) -> Float[Array, "n mode row entity"]:
    """Return the distances of all failure modes, up to `REACH`, that margins are fitted to."""
    return BodyModel(wide(settings)).distances(batch, ahead)


def touches(
    settings: BodySettings, failures: Sequence[Failures], scenes: Mapping[tuple[str, str], Scene]
) -> dict[tuple[str, str], MarginEvents]:
    """Return the model's distances to entities with the observed hits, by generator and component.

    Objects dropped during a collapse are left out of "carried": the drop model predicts where they land.

    Args:
        settings: Constants of the motion and of its stopping; the step must be that of `AHEAD`.
        failures: Failures along each motion, of any faults; faults without a generator are ignored.
        scenes: Scenes with the object attached, by name of the scene and the task.

    Raises:
        SettingError: If the settings have another step.
    """
    if not np.isclose(settings.step, AHEAD[0]):
        raise SettingError("step", settings.step, f"{AHEAD[0]:g} s, the step of the stored motion")
    found: dict[tuple[str, str], list[MarginEvents]] = {}
    for motion, whole in enumerate(failures):
        scene = scenes[whole.scene, whole.task]
        modes = mode_names(scene)
        told = {index: mode for index, label in enumerate(whole.faults) if (mode := _mode(label)) in modes}
        part = whole.where(np.isin(whole.fault, list(told)))
        if not len(part):
            continue
        batch = part.states(scene)
        d = fit_distances(settings, batch, batch.ahead)
        mode = np.array([modes.index(told[index]) for index in part.fault])
        for name in {told[index].split("/")[0] for index in part.fault}:
            mine = np.array([told[index].split("/")[0] == name for index in part.fault])
            for row, component in enumerate(ROWS):
                if component not in part.components:
                    continue
                held = ~part.dropped if (name, component) == ("collapse", "carried") else True
                rows, of = np.flatnonzero(mine & held), part.components.index(component)
                near, hit = d[rows, mode[rows], row][:, part.counted[of]], part.hit[rows, of][:, part.counted[of]]
                n = near.size
                here = MarginEvents(near.ravel(), hit.ravel(), np.full(n, motion), np.full(n, part.scene))
                found.setdefault((name, component), []).append(here)
    return {key: MarginEvents(*map(np.concatenate, zip(*parts, strict=True))) for key, parts in found.items()}


def _mode(label: str) -> str | None:
    """Return the name of the failure mode that a fault corresponds to, as in `mode_names`."""
    name, *targets = label.split()
    if name in SINGLE and len(targets) == 1:
        return f"{SINGLE[name]}/{targets[0]}"
    return WHOLE.get(name) if not targets else None


# --- calibration -----------------------------------------------------------------------------------------------------


@final
@dataclass(frozen=True, kw_only=True)
class BodyCalibration(Calibration):
    """Fitted margins of the body model, with their provenance. Made by `fit_body`.

    Args:
        base: Constants of the motion and of its stopping, which are not fitted.
        margins: Margins by generator and row; those without data keep the margin of `base`.
        provenance: Scenes, failures, seed, versions.
    """

    base: BodySettings
    margins: Mapping[tuple[str, str], FittedMargin]
    provenance: Mapping[str, Any]

    def settings(self) -> BodySettings:
        """Return the constants as the model's settings."""
        fitted: dict[str, Any] = {g: getattr(self.base, g) for g in GENERATORS}
        for (generator, row), found in self.margins.items():
            fitted[generator] = replace(fitted[generator], **{row: found.margin})
        return replace(self.base, **fitted)

    def to_document(self) -> dict[str, Any]:
        """Return the calibration as JSON values."""
        settings = self.settings()
        named = {f"{generator}.{row}": found for (generator, row), found in self.margins.items()}
        intervals = {
            name: {
                of: [rounded(x.low, _DIGITS), rounded(x.high, _DIGITS)]
                for of, x in (("offset", m.offset), ("spread", m.spread))
            }
            for name, m in named.items()
        }
        provenance = {
            **self.provenance,
            "fitted": {name: rounded_figures(m.fitted, _DIGITS) for name, m in named.items()},
            "held_out": {
                name: rounded_figures(m.held_out, _DIGITS) for name, m in named.items() if m.held_out is not None
            },
            "intervals": intervals,
        }
        margins = {name: _rounded(asdict(getattr(settings, name))) for name in GENERATORS}
        motion = {name: getattr(settings, name) for name in MOTION}
        return {"version": VERSION, "provenance": provenance, "motion": motion, "margins": margins}

    def __str__(self) -> str:
        lines = [f"{'held-out scenes':<18} {'events':>8} {'hits':>6} {'skill':>6} {'AUC':>6} {'ECE':>6} {'ratio':>6}"]
        for (generator, row), found in self.margins.items():
            x = found.fitted if found.held_out is None else found.held_out
            lines.append(
                f"{f'{generator}, {row}':<18} {x.events:>8} {x.happened:>6} {x.brier_skill:>6.3f} {x.auc:>6.3f}"
                f" {x.calibration_error:>6.3f} {x.ratio:>6.2f}"
            )
        return "\n".join(lines)


def fit_body(
    failures: Sequence[Failures],
    scenes: Mapping[tuple[str, str], Scene] | None = None,
    *,
    base: BodySettings | None = None,
    about: Mapping[str, Any] | None = None,
    seed: int = 0,
    resamples: int | None = None,
) -> BodyCalibration:
    """Fit the margins to failures.

    Args:
        failures: Failures of the faults in `SINGLE`, each with its joint, and in `WHOLE`.
        scenes: Scenes by name of the scene and the task; the bundled ones if None.
        base: Constants that are not fitted; the shipped ones if None.
        about: Further provenance, for example how the failures were made.
        seed: Seed of the intervals.
        resamples: Number of resamples for the intervals; 100 if None.
    """
    draws = _RESAMPLES if resamples is None else resamples
    base = BodySettings.shipped() if base is None else base
    events = touches(base, failures, scenes_of(failures, gp.load_scene) if scenes is None else scenes)
    order = [(generator, row) for generator in GENERATORS for row in ROWS if (generator, row) in events]
    told = [key for key in order if 0 < events[key].hit.sum() < len(events[key].hit)]
    return BodyCalibration(
        base=base,
        margins={key: fit_touches(events[key], resamples=draws, seed=seed) for key in told},
        provenance={
            "model": "body",
            "faults": [*SINGLE, *WHOLE],
            "scenes": sorted({part.scene for part in failures}),
            "motions": len(failures),
            "failures": sum(len(part) for part in failures),
            **(about or {}),
            "seed": seed,
            "versions": versions(),
        },
    )


RECIPE = Recipe(faults_of, fit_body)


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    return {name: _rounded(x) if isinstance(x, dict) else rounded(x, _DIGITS) for name, x in values.items()}
