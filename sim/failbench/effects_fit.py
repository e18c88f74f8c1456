r"""Which way of failing a fault acts like: effects of `graceful_plan.FaultPrior`, fitted to failures.

Of one fault, an event (one failure, one component, one entity) happens with the probability

.. math:: P = \epsilon + (1 - 2 \epsilon) \sum_g \theta_g P_g, \qquad \theta_g \ge 0, \quad \sum_g \theta_g \le 1

where the models of the generators say P_g, and epsilon is the least that counts. The logarithm of the likelihood of
independent events is concave in theta, so its maximum is global; Newton steps, each the exact solution of a quadratic
problem over all active sets, find it, and the Frank-Wolfe gap bounds how much is missing. Events of one motion are
alike: intervals come from resamples of whole motions. They cannot see what no motion shows.

References:
    [Jaggi2013] Revisiting Frank-Wolfe, for the gap.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path as FilePath
from typing import Any

import mujoco
import numpy as np
import yaml

import graceful_plan as gp
from failbench.failures import Failures
from failbench.fitting import Fitted
from failbench.skill import SMALLEST, Figures, figures
from failbench.statistics import check_confidence, cluster_draws
from graceful_plan import Scene, SettingError, ShapeError
from graceful_plan.array_types import Bool, Float
from graceful_plan.fault_prior import GENERATORS

Array = np.ndarray

GeneratorModel = Callable[[Scene, Failures], Mapping[str, Float[Array, "n c e"]]]
"""P(component hits entity) by generator, for the states in which something failed, if that acts like the generator."""

_GAP = 1e-4  # how much of the logarithm of the likelihood may be missing [nat]
_STEPS = 100
_RIDGE = 1e-9  # of the curvature; keeps generators that say the same where they are
_NOTHING = 1e-7
_DIGITS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultEvents:
    """Events that one fault may have caused.

    | field       | meaning                                                  | shape       |
    |-------------|----------------------------------------------------------|-------------|
    | probability | P_g of each of `GENERATORS`                              | n generator |
    | happened    | whether it did                                           | n           |
    | motion      | which motion the robot failed on                         | n           |
    | scene       | name of the scene                                        | n           |
    """

    probability: Array
    happened: Array
    motion: Array
    scene: Array

    def __post_init__(self) -> None:
        # Not by annotations, so that users are told, too.
        n = len(self.probability)
        if self.probability.shape != (n, len(GENERATORS)):
            raise ShapeError("probability", self.probability.shape, f"(n, {len(GENERATORS)}), a column a generator")
        for name in ("happened", "motion", "scene"):
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
            motion=self.motion[chosen],
            scene=self.scene[chosen],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultEffect:
    """What one fault acts like.

    Args:
        shares: Probability of each generator.
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
        for index in np.unique(part.fault):
            rows = part.fault == index
            count = hit[rows].size
            events = FaultEvents(
                probability=P[rows].reshape(count, len(GENERATORS)),
                happened=hit[rows].reshape(count),
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


def most_likely(
    probability: Float[Array, "n generator"],
    happened: Bool[Array, " n"],
    weight: Float[Array, " n"] | None = None,
    start: Float[Array, " generator"] | None = None,
) -> tuple[Float[Array, " generator"], float]:
    """Return the shares of generators under which events are most likely, and a bound of what is missing [nat].

    Args:
        probability: P_g.
        happened: Whether each event happened.
        weight: How often each event counts; once if None.
        start: Shares to begin with.
    """
    w = np.ones(len(happened)) if weight is None else weight
    # What nobody expects and did not happen says nothing; a generator that never says anything has no share.
    telling = (w > 0.0) & (happened | (probability > _NOTHING).any(axis=1))
    speaks = np.asarray((probability[telling] > _NOTHING).any(axis=0))
    p, y, w = probability[telling][:, speaks], happened[telling].astype(float), w[telling]
    p = np.column_stack([p, np.zeros(len(p))])  # the last one is harmless
    theta = np.full(p.shape[1], 1.0 / p.shape[1])
    if start is not None:  # an inner point, since a share of 0 says nothing about its neighbourhood
        theta[:] = 0.01 * theta + 0.99 * np.append(start[speaks], 1.0 - start[speaks].sum())
    gap = np.inf
    for _ in range(_STEPS):
        P = predicted(p, theta)
        slope = (1.0 - 2.0 * SMALLEST) * ((w * ((1.0 - y) / (1.0 - P) - y / P)) @ p)
        gap = float(slope @ theta - slope.min())
        if gap <= _GAP:
            break
        bend = (1.0 - 2.0 * SMALLEST) ** 2 * (p.T * (w * (y / P**2 + (1.0 - y) / (1.0 - P) ** 2))) @ p
        bend += (_RIDGE * np.trace(bend) + np.finfo(float).tiny) * np.eye(len(bend))
        target = _least(slope - bend @ theta, bend)
        theta = _search(p, y, w, theta, target - theta)
    shares = np.zeros(len(speaks))
    shares[speaks] = theta[:-1]
    return shares, gap


def predicted(probability: Float[Array, "n generator"], shares: Float[Array, " generator"]) -> Float[Array, " n"]:
    """Return the probability of events of a fault with some shares."""
    return SMALLEST + (1.0 - 2.0 * SMALLEST) * (probability @ shares)


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
        "# What comes of a fault: the probability that it acts like each generator of the interaction models; the rest"
        " up to 1 is harmless.\n"
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


# --- the fit ----------------------------------------------------------------------------------------------------------


def _fit(fault: str, events: FaultEvents, resamples: int, seed: int, confidence: float) -> FaultEffect:
    if not len(events):
        raise SettingError("events", len(events), f"at least one of {fault}")
    best, _ = most_likely(events.probability, events.happened)
    drawn = np.zeros((resamples, len(GENERATORS)))
    for i, rows in enumerate(cluster_draws(events.motion, resamples, seed)):
        counts = np.bincount(rows, minlength=len(events)).astype(float)
        drawn[i] = most_likely(events.probability, events.happened, counts, best)[0]
    ends = (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)
    low, high = np.quantile(drawn, ends, axis=0) if resamples else np.full((2, len(GENERATORS)), np.nan)
    return FaultEffect(
        shares={name: Fitted(float(best[i]), float(low[i]), float(high[i])) for i, name in enumerate(GENERATORS)},
        fitted=figures(predicted(events.probability, best), events.happened),
        held_out=_held_out(events),
        motions=len(np.unique(events.motion)),
    )


def _held_out(events: FaultEvents) -> Figures | None:
    """Judge each scene with shares that were fitted on the others."""
    names = np.unique(events.scene)
    if len(names) < 2:
        return None
    guessed = np.zeros(len(events))
    for name in names:
        own = events.scene == name
        others = events.rows(~own)
        guessed[own] = predicted(events.probability[own], most_likely(others.probability, others.happened)[0])
    return figures(guessed, events.happened)


def _least(slope: Float[Array, " k"], bend: Float[Array, "k k"]) -> Float[Array, " k"]:
    """Minimise slope.x + x.bend.x/2 over the probability simplex, exactly: every set of positive entries is tried."""
    k = len(slope)
    free = np.array([chosen for chosen in product((False, True), repeat=k) if any(chosen)])
    # Lagrange's equations on each set; the others' rows say x = 0.
    system = np.zeros((len(free), k + 1, k + 1))
    system[:, :k, :k] = np.where(free[:, :, None] & free[:, None, :], bend, ~free[:, :, None] * np.eye(k))
    system[:, :k, k] = system[:, k, :k] = free
    right = np.column_stack([np.where(free, -slope, 0.0), np.ones(len(free))])
    x = np.linalg.solve(system, right[..., None])[:, :k, 0]
    value = x @ slope + 0.5 * np.einsum("si,ij,sj->s", x, bend, x)
    value[(x < -1e-12).any(axis=1)] = np.inf
    found = np.maximum(x[int(np.argmin(value))], 0.0)
    return found / found.sum()


def _search(p: Array, y: Array, w: Array, theta: Array, step: Array) -> Array:
    """Go along a step as far as the likelihood rises."""

    def loss(there: Array) -> float:
        P = predicted(p, there)
        return -float(w @ np.where(y > 0.0, np.log(P), np.log1p(-P)))

    here, length = loss(theta), 1.0
    while length > 1e-12 and loss(theta + length * step) > here + 1e-12 * abs(here):
        length *= 0.5
    return theta + length * step if length > 1e-12 else theta


def _joined(parts: Sequence[FaultEvents]) -> FaultEvents:
    return FaultEvents(
        **{
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("probability", "happened", "motion", "scene")
        }
    )


def _document(found: Figures) -> dict[str, Any]:
    return {name: value if isinstance(value, int) else _rounded(value) for name, value in found._asdict().items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _rounded_down(value: float) -> float:
    # So that shares never sum to more than 1.
    return float(np.floor(value * 10**_DIGITS) / 10**_DIGITS)
