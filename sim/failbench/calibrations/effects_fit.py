r"""Which way of failing a fault acts like: effects of `graceful_plan.FaultPrior`, fitted to failures.

Of one fault, the robot's body (B) and what it carries, with contents (C), touch an entity with the probabilities

.. math:: P_B = \sum_g a_g P_{Bg}, \qquad P_C = d P_{drop} + (1 - d) \Big( s P_{spill} + \sum_g a_g P_{Cg} \Big)

where the models of the generators say P. Given d, these are linear in s and a; given s and a, in d. So the one and the
others are fitted in turns (`mixture`), each time to the global maximum, from two sides. Events of one motion are alike:
intervals come from resamples of whole motions. They cannot see what no motion shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

import mujoco
import numpy as np
import yaml

import graceful_plan as gp
from failbench.basics.statistics import check_confidence, cluster_draws
from failbench.calibrations.calibrate import Progress, fetch, scenes_of
from failbench.calibrations.failures import Failures
from failbench.calibrations.fitting import Fitted
from failbench.calibrations.mixture import likely, log_likelihood, most_likely
from failbench.calibrations.skill import Figures, figures
from failbench.fault.fault import Fault
from failbench.fault.registry import faults
from graceful_plan import Scene, SettingError, ShapeError
from graceful_plan.array_types import Bool, Float
from graceful_plan.costs.fault_prior import ARM, GENERATORS

Array = np.ndarray

GeneratorModel = Callable[[Scene, Failures], Mapping[str, Float[Array, "n c e"]]]
"""P(component hits entity) by generator, for the states in which something failed, if that acts like the generator."""

_GAIN = 1e-3  # of the logarithm of the likelihood, below which turns end [nat]
_TURNS = 50
_DIGITS = 4
_DEFINED = {
    "gripper_failure": {
        name: Fitted(float(name == "drop"), float(name == "drop"), float(name == "drop")) for name in GENERATORS
    }
}
"""The drop model is about what this fault does."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultEvents:
    """Events that one fault may have caused.

    | field       | meaning                                                  | shape       |
    |-------------|----------------------------------------------------------|-------------|
    | probability | P_g of each of `GENERATORS`                              | n generator |
    | happened    | whether it did                                           | n           |
    | body        | whether it is a touch by the body, not by what it carries | n           |
    | motion      | which motion the robot failed on                         | n           |
    | scene       | name of the scene                                        | n           |
    """

    probability: Array
    happened: Array
    body: Array
    motion: Array
    scene: Array

    def __post_init__(self) -> None:
        # Not by annotations, so that users are told, too.
        n = len(self.probability)
        if self.probability.shape != (n, len(GENERATORS)):
            raise ShapeError("probability", self.probability.shape, f"(n, {len(GENERATORS)}), a column a generator")
        for name in ("happened", "body", "motion", "scene"):
            if getattr(self, name).shape != (n,):
                raise ShapeError(name, getattr(self, name).shape, f"({n},), as many as probabilities")
        if n and not (np.nanmin(self.probability) >= 0.0 and np.max(self.probability) <= 1.0):
            raise SettingError("probability", float(np.max(self.probability)), "numbers in [0, 1]")

    def __len__(self) -> int:
        return len(self.happened)

    def rows(self, chosen: Bool[Array, " n"]) -> FaultEvents:
        """Return some of the events."""
        return FaultEvents(
            probability=self.probability[chosen],
            happened=self.happened[chosen],
            body=self.body[chosen],
            motion=self.motion[chosen],
            scene=self.scene[chosen],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultEffect:
    """What one fault acts like.

    Args:
        shares: Probability of each generator; of "spill", if the object is not dropped.
        fitted: Figures of the predicted events that the shares were fitted on.
        held_out: The same, each scene predicted with shares that were fitted on the others; None with one scene.
        motions: Number of motions.
    """

    shares: Mapping[str, Fitted]
    fitted: Figures
    held_out: Figures | None
    motions: int


def fault_events(
    failures: Sequence[Failures], scenes: Mapping[tuple[str, str], Scene], model: GeneratorModel
) -> dict[str, FaultEvents]:
    """Put what models of the generators say beside what happened, by fault.

    Args:
        failures: Of any faults; each entry is one motion.
        scenes: By name of the scene and the task, with the object attached.
        model: The models; generators that it leaves out never happen.
    """
    found: dict[str, list[FaultEvents]] = {}
    for motion, part in enumerate(failures):
        said = model(scenes[part.scene, part.task], part)
        nothing = np.zeros(part.hit.shape)
        P = np.stack([said.get(generator, nothing) for generator in GENERATORS], axis=-1)[:, part.counted]
        hit = part.hit[:, part.counted]
        body = np.repeat([name == "body" for name in part.components], part.counted.sum(axis=1))
        for index in np.unique(part.fault):
            rows = part.fault == index
            count = hit[rows].size
            events = FaultEvents(
                probability=P[rows].reshape(count, len(GENERATORS)),
                happened=hit[rows].reshape(count),
                body=np.tile(body, int(rows.sum())),
                motion=np.full(count, motion),
                scene=np.full(count, part.scene),
            )
            found.setdefault(part.faults[index], []).append(events)
    return {fault: _joined(parts) for fault, parts in found.items()}


def fit_effects(
    events: Mapping[str, FaultEvents], *, resamples: int = 200, seed: int = 0, confidence: float = 0.95
) -> dict[str, FaultEffect]:
    """Fit the effects of faults.

    Args:
        events: By fault.
        resamples: For the intervals.
        seed: Of the resamples.
        confidence: Of the intervals.

    Raises:
        SettingError: If there are no events of a fault.
    """
    check_confidence(confidence)
    return {fault: _fit(fault, each, resamples, seed, confidence) for fault, each in events.items()}


def likeliest(
    events: FaultEvents, weight: Float[Array, " n"] | None = None, start: Float[Array, " generator"] | None = None
) -> Float[Array, " generator"]:
    """Return the shares of `GENERATORS` under which the events of a fault are likeliest.

    Args:
        events: What happened.
        weight: How often each event counts; once if None.
        start: Shares to begin with; from two sides if None.
    """
    if start is not None:
        return _turns(events, weight, start)
    found = [_turns(events, weight, np.eye(len(GENERATORS))[0] * dropped) for dropped in (0.1, 0.9)]
    return max(found, key=lambda shares: log_likelihood(predicted(events, shares), events.happened, weight))


def predicted(events: FaultEvents, shares: Float[Array, " generator"]) -> Float[Array, " n"]:
    """Return the probability of events of a fault with some shares."""
    d = np.where(events.body, 0.0, shares[0])
    return likely(d * events.probability[:, 0] + (1.0 - d) * (events.probability[:, 1:] @ shares[1:]))


def to_yaml(effects: Mapping[str, FaultEffect], *, degree: str, seed: int, about: Mapping[str, Any]) -> str:
    """Return effects as the text of `fault_effects.yaml`.

    Args:
        effects: Of all faults; those that a reader should know.
        degree: How bad the faults were.
        seed: Of the intervals.
        about: What else to put down: scenes, numbers of failures, how these were made.
    """
    provenance = {
        "method": "fitted",
        **about,
        "seed": seed,
        "versions": {"graceful_plan": gp.__version__, "mujoco": mujoco.__version__},
        "fitted": {fault: _document(effect.fitted) for fault, effect in effects.items()},
        "held_out": {fault: _document(x.held_out) for fault, x in effects.items() if x.held_out is not None},
        "intervals": {
            degree: {
                fault: {name: [_rounded(x.low), _rounded(x.high)] for name, x in effect.shares.items() if x.high > 0.0}
                for fault, effect in effects.items()
            }
        },
    }
    shares = {
        fault: {name: _rounded_down(x.value) for name, x in effect.shares.items() if _rounded_down(x.value) > 0.0}
        for fault, effect in effects.items()
    }
    head = (
        "# What comes of a fault: the probability that it acts like each generator of the interaction models; of spill,"
        " if nothing is dropped.\n"
        "# Written by failbench; do not edit. Intervals are 95 %, whole motions drawn with replacement.\n"
        "# held_out: each scene with effects that were fitted on the others.\n"
    )
    about_it = {"version": 1, "provenance": provenance}
    compact = yaml.safe_dump(about_it, sort_keys=False, default_flow_style=None, width=120)
    table = yaml.safe_dump({"effects": {degree: shares}}, sort_keys=False, default_flow_style=None, width=120)
    return head + compact + table


def write(file: str | FilePath, effects: Mapping[str, FaultEffect], **given: Any) -> None:
    """Write effects as YAML, see `to_yaml`."""
    FilePath(file).write_text(to_yaml(effects, **given), encoding="utf-8")


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectsCalibration:
    """Effects of faults, and why they are what they are. Made by `calibrate_effects`.

    Args:
        effects: By fault.
        degree: How bad the faults were.
        seed: Of everything random.
        about: Scenes, numbers of failures.
    """

    effects: Mapping[str, FaultEffect]
    degree: str
    seed: int
    about: Mapping[str, Any]

    def to_yaml(self) -> str:
        """Return it as YAML text like `fault_effects.yaml`."""
        return to_yaml(self.effects, degree=self.degree, seed=self.seed, about=self.about)

    def to_document(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return yaml.safe_load(self.to_yaml())

    def __str__(self) -> str:
        lines = [f"{'fault':<22} " + " ".join(f"{name:>9}" for name in GENERATORS) + "  held-out skill"]
        for fault, effect in self.effects.items():
            shares = " ".join(f"{x.value:9.3f}" for x in effect.shares.values())
            skill = "-" if effect.held_out is None else f"{effect.held_out.brier_skill:.3f}"
            lines.append(f"{fault:<22} {shares}  {skill}")
        return "\n".join(lines)


def generator_probabilities(scene: Scene, failures: Failures) -> Mapping[str, Float[Array, "n component entity"]]:
    """Return what `Footprint` says if the failure is like each generator, and nothing else."""
    batch, found = failures.states(scene), {}
    for generator in GENERATORS:
        prior = gp.FaultPrior({"it": 1.0}, {"it": {generator: 1.0}})
        found[generator] = gp.Footprint(faults=prior).probability(batch)
    return found


def calibrate_effects(
    scenes: Sequence[str],
    *,
    n: int = 30,
    repeats: int = 2,
    seed: int = 0,
    processes: int = 1,
    drops: str | FilePath | None = None,
    progress: Progress | None = None,
) -> EffectsCalibration:
    """Let every fault happen in bundled scenes, severe, or take failures from a file, and fit what they act like.

    Args:
        scenes: Names of bundled scenes.
        n: Failures along each motion.
        repeats: Motions of each kind for each task.
        seed: Of everything random.
        processes: How many to let fail in; the fit is done in this one.
        drops: File that the failures are kept in, or taken from if it is there. Then only those in `scenes` count.
        progress: Called after each motion.

    Raises:
        UnknownNameError: If there is no such scene.
        FormatError: If the file is there and holds something else.
    """

    def every() -> list[Fault]:
        return [cls(degree="severe") for cls in faults().values()]

    failures, _ = fetch(
        scenes, every, n=n, repeats=repeats, seed=seed, processes=processes, kept=drops, progress=progress
    )
    single = [part for part in (part.only(faults()) for part in failures) if len(part)]
    events = fault_events(single, scenes_of(single, gp.load_scene), generator_probabilities)
    about = {
        "scenes": sorted({part.scene for part in single}),
        "motions": len(single),
        "failures": sum(len(part) for part in single),
    }
    effects = fit_effects({name: _possible(name, events[name]) for name in faults() if name in events}, seed=seed)
    effects |= {name: replace(effects[name], shares=shares) for name, shares in _DEFINED.items() if name in effects}
    return EffectsCalibration(effects=effects, degree="severe", seed=seed, about=about)


def _possible(fault: str, events: FaultEvents) -> FaultEvents:
    """Leave arms alone where only the gripper fails: too few events would tell them from chance."""
    if faults()[fault].CATEGORY != "end_effector":
        return events
    arm = np.isin(GENERATORS, ARM)
    return replace(events, probability=np.where(arm, 0.0, events.probability))


# --- the fit ----------------------------------------------------------------------------------------------------------


def _fit(fault: str, events: FaultEvents, resamples: int, seed: int, confidence: float) -> FaultEffect:
    if not len(events):
        raise SettingError("events", len(events), f"at least one of {fault}")
    best = likeliest(events)
    drawn = np.zeros((resamples, len(GENERATORS)))
    for i, rows in enumerate(cluster_draws(events.motion, resamples, seed)):
        counts = np.bincount(rows, minlength=len(events)).astype(float)
        drawn[i] = likeliest(events, counts, best)
    ends = (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)
    low, high = np.quantile(drawn, ends, axis=0) if resamples else np.full((2, len(GENERATORS)), np.nan)
    return FaultEffect(
        shares={name: Fitted(float(best[i]), float(low[i]), float(high[i])) for i, name in enumerate(GENERATORS)},
        fitted=figures(predicted(events, best), events.happened),
        held_out=_held_out(events),
        motions=len(np.unique(events.motion)),
    )


def _turns(events: FaultEvents, weight: Float[Array, " n"] | None, start: Array) -> Float[Array, " generator"]:
    """Fit the share of drops and the other shares in turns."""
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
    """Judge each scene with shares that were fitted on the others."""
    names = np.unique(events.scene)
    if len(names) < 2:
        return None
    guessed = np.zeros(len(events))
    for name in names:
        own = events.scene == name
        guessed[own] = predicted(events.rows(own), likeliest(events.rows(~own)))
    return figures(guessed, events.happened)


def _joined(parts: Sequence[FaultEvents]) -> FaultEvents:
    return FaultEvents(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("probability", "happened", "body", "motion", "scene")
        }
    )


def _document(found: Figures) -> dict[str, Any]:
    return {name: value if isinstance(value, int) else _rounded(value) for name, value in found._asdict().items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _rounded_down(value: float) -> float:
    # So that shares never sum to more than 1.
    return float(np.floor(value * 10**_DIGITS) / 10**_DIGITS)
