r"""Effects of faults for `graceful_plan.FaultPrior`: the generator that each fault acts like, fitted to failures.

Under one fault, the robot's body (B) and the carried object with its contents (C) touch an entity with probabilities

.. math:: P_B = \sum_g a_g P_{Bg}, \qquad P_C = d P_{drop} + (1 - d) \Big( s P_{spill} + \sum_g a_g P_{Cg} \Big)

where the generators' models give the P on the right. They are linear in s and a for fixed d, and linear in d for fixed
s and a. The two parts are fitted alternately (`mixture`), each to its global maximum, from two starts. Events of one
motion are correlated, so intervals resample whole motions. They cannot account for effects that no motion shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

import graceful_plan as gp
from failbench.basics.statistics import check_confidence, cluster_draws
from failbench.calibrations.calibrate import VERSION, Calibration, Recipe, rounded, rounded_figures, scenes_of, versions
from failbench.calibrations.failures import Failures
from failbench.calibrations.fault_events import FaultEvents, fault_events, generator_probabilities
from failbench.calibrations.fitting import Fitted
from failbench.calibrations.mixture import likely, log_likelihood, most_likely
from failbench.calibrations.skill import Figures, figures
from failbench.fault.fault import Fault
from failbench.fault.registry import faults
from graceful_plan import Scene
from graceful_plan.array_types import Array, Float
from graceful_plan.costs.fault_prior import ARM, FAILURES
from graceful_plan.exceptions import SettingError

_GAIN = 1e-3  # gain of the log-likelihood below which the alternation ends [nat]
_TURNS = 50
_DIGITS = 4
_DEGREE = "severe"
_DEFINED = {
    "gripper_failure": {
        name: Fitted(float(name == "drop"), float(name == "drop"), float(name == "drop")) for name in FAILURES
    }
}
"""Effects that hold by definition: the drop model is the model of this fault."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultEffect:
    """Effect of one fault.

    Args:
        shares: Probability of each generator; for "spill", given that the object is not dropped.
        fitted: Figures on the events of the fit.
        held_out: Figures over all scenes, each predicted with shares fitted on the others; None with one scene.
        motions: Number of motions.
    """

    shares: Mapping[str, Fitted]
    fitted: Figures
    held_out: Figures | None
    motions: int


def fit_effects(
    events: Mapping[str, FaultEvents], *, resamples: int = 200, seed: int = 0, confidence: float = 0.95
) -> dict[str, FaultEffect]:
    """Fit the effects of faults.

    Args:
        events: Events by fault.
        resamples: Number of resamples for the intervals.
        seed: Seed of the resamples.
        confidence: Confidence level of the intervals.

    Raises:
        SettingError: If a fault has no events.
    """
    check_confidence(confidence)
    return {fault: _fit(fault, each, resamples, seed, confidence) for fault, each in events.items()}


def likeliest(
    events: FaultEvents, weight: Float[Array, " n"] | None = None, start: Float[Array, " generator"] | None = None
) -> Float[Array, " generator"]:
    """Return the shares of `FAILURES` with the greatest likelihood of a fault's events.

    Args:
        events: The events.
        weight: Weight of each event; 1 if None.
        start: Initial shares; two starts if None.
    """
    if start is not None:
        return _turns(events, weight, start)
    found = [_turns(events, weight, np.eye(len(FAILURES))[0] * dropped) for dropped in (0.1, 0.9)]
    return max(found, key=lambda shares: log_likelihood(predicted(events, shares), events.happened, weight))


def predicted(events: FaultEvents, shares: Float[Array, " generator"]) -> Float[Array, " n"]:
    """Return the probability of a fault's events for given shares."""
    d = np.where(events.body, 0.0, shares[0])
    return likely(d * events.probability[:, 0] + (1.0 - d) * (events.probability[:, 1:] @ shares[1:]))


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class EffectsCalibration(Calibration):
    """Fitted effects of faults, with their provenance. Made by `fit_faults`.

    Args:
        effects: Effects by fault.
        degree: Degree of the faults.
        seed: Seed of all random numbers.
        about: Scenes and numbers of failures.
    """

    ABOUT: ClassVar[str] = (
        "# What comes of a fault: the probability that it acts like each generator of the interaction models; of spill,"
        " if nothing is dropped.\n"
    )

    effects: Mapping[str, FaultEffect]
    degree: str
    seed: int
    about: Mapping[str, Any]

    def to_document(self) -> dict[str, Any]:
        """Return the calibration as JSON values."""
        held_out = {fault: x.held_out for fault, x in self.effects.items() if x.held_out is not None}
        intervals = {
            fault: {
                name: [rounded(x.low, _DIGITS), rounded(x.high, _DIGITS)]
                for name, x in effect.shares.items()
                if x.high > 0.0
            }
            for fault, effect in self.effects.items()
        }
        shares = {
            fault: {name: _rounded_down(x.value) for name, x in effect.shares.items() if _rounded_down(x.value) > 0.0}
            for fault, effect in self.effects.items()
        }
        provenance = {
            "method": "fitted",
            **self.about,
            "seed": self.seed,
            "versions": versions(),
            "fitted": {fault: rounded_figures(x.fitted, _DIGITS) for fault, x in self.effects.items()},
            "held_out": {fault: rounded_figures(x, _DIGITS) for fault, x in held_out.items()},
            "intervals": {self.degree: intervals},
        }
        return {"version": VERSION, "provenance": provenance, "effects": {self.degree: shares}}

    def __str__(self) -> str:
        lines = [f"{'fault':<22} " + " ".join(f"{name:>9}" for name in FAILURES) + "  held-out skill"]
        for fault, effect in self.effects.items():
            shares = " ".join(f"{x.value:9.3f}" for x in effect.shares.values())
            skill = "-" if effect.held_out is None else f"{effect.held_out.brier_skill:.3f}"
            lines.append(f"{fault:<22} {shares}  {skill}")
        return "\n".join(lines)


def faults_of(scene: Scene) -> list[Fault]:
    """Return all faults at degree "severe", the same for all robots."""
    del scene
    return [cls(degree=_DEGREE) for cls in faults().values()]


def fit_faults(failures: Sequence[Failures], *, about: Mapping[str, Any], seed: int = 0) -> EffectsCalibration:
    """Fit the effects of severe faults; failures of other faults are ignored."""
    single = [part for part in (part.only(faults()) for part in failures) if len(part)]
    events = fault_events(single, scenes_of(single, gp.load_scene), generator_probabilities)
    effects = fit_effects({name: _possible(name, events[name]) for name in faults() if name in events}, seed=seed)
    effects |= {name: replace(effects[name], shares=shares) for name, shares in _DEFINED.items() if name in effects}
    numbers = {
        "scenes": sorted({part.scene for part in single}),
        "motions": len(single),
        "failures": sum(len(part) for part in single),
    }
    return EffectsCalibration(effects=effects, degree=_DEGREE, seed=seed, about={**numbers, **about})


RECIPE = Recipe(faults_of, fit_faults)


def _possible(fault: str, events: FaultEvents) -> FaultEvents:
    """Exclude generators of the arm for faults of the gripper, which have too few events to reject them."""
    if faults()[fault].CATEGORY != "end_effector":
        return events
    arm = np.isin(FAILURES, ARM)
    return replace(events, probability=np.where(arm, 0.0, events.probability))


# --- the fit ----------------------------------------------------------------------------------------------------------


def _fit(fault: str, events: FaultEvents, resamples: int, seed: int, confidence: float) -> FaultEffect:
    if not len(events):
        raise SettingError("events", len(events), f"at least one of {fault}")
    best = likeliest(events)
    drawn = np.zeros((resamples, len(FAILURES)))
    for i, rows in enumerate(cluster_draws(events.motion, resamples, seed)):
        counts = np.bincount(rows, minlength=len(events)).astype(float)
        drawn[i] = likeliest(events, counts, best)
    ends = (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)
    low, high = np.quantile(drawn, ends, axis=0) if resamples else np.full((2, len(FAILURES)), np.nan)
    return FaultEffect(
        shares={name: Fitted(float(best[i]), float(low[i]), float(high[i])) for i, name in enumerate(FAILURES)},
        fitted=figures(predicted(events, best), events.happened),
        held_out=_held_out(events),
        motions=len(np.unique(events.motion)),
    )


def _turns(events: FaultEvents, weight: Float[Array, " n"] | None, start: Array) -> Float[Array, " generator"]:
    """Fit the share of drops and the other shares alternately."""
    p, y, held = events.probability, events.happened, ~events.body
    w = np.ones(len(y)) if weight is None else weight
    shares, here = start.copy(), -np.inf
    for _ in range(_TURNS):
        d = np.where(held, shares[0], 0.0)
        others = shares[1:] if shares[1:].any() else None
        shares[1:] = most_likely((1.0 - d)[:, None] * p[:, 1:], y, w, offset=d * p[:, 0], start=others)[0]
        either = np.column_stack([p[held, 0], p[held, 1:] @ shares[1:]])
        if either[:, 0].any():
            given = np.array([shares[0], 1.0 - shares[0]])
            shares[0] = most_likely(either, y[held], w[held], start=given, harmless=False)[0][0]
        else:
            shares[0] = 0.0
        before, here = here, log_likelihood(predicted(events, shares), y, w)
        if here - before <= _GAIN:
            break
    return shares


def _held_out(events: FaultEvents) -> Figures | None:
    """Return figures over all scenes, each predicted with shares fitted on the others."""
    names = np.unique(events.scene)
    if len(names) < 2:
        return None
    guessed = np.zeros(len(events))
    for name in names:
        own = events.scene == name
        guessed[own] = predicted(events.rows(own), likeliest(events.rows(~own)))
    return figures(guessed, events.happened)


def _rounded_down(value: float) -> float:
    # So that the sum of shares never exceeds 1.
    return float(np.floor(value * 10**_DIGITS) / 10**_DIGITS)
