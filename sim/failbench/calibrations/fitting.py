"""Fit the constants of a failure model to rollouts by maximum likelihood, with intervals.

A model is a `Family`: named constants, and probabilities that depend on them. Events of one motion are correlated and
models are approximate, so the likelihood is tempered: `trust` events weigh as much as one independent event. Intervals
resample whole motions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from failbench.basics.statistics import check_confidence
from failbench.calibrations.failures import Failures
from failbench.calibrations.skill import SMALLEST
from graceful_plan import Scene
from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.exceptions import SettingError
from graceful_plan.setting_checks import positive

_STEP = 1e-5
"""Step of finite differences, in units of a prior's spread."""
_ENOUGH = 0.05
"""Expected gain of the log-likelihood below which the search ends [nat]."""
_SHORTEST = 1e-3
"""Least fraction of a step in the line search."""
_FARTHEST = 4.0
"""Greatest distance of a constant from its prior in spreads, within its own bounds."""


@dataclass(frozen=True, kw_only=True)
class Constant:
    """A fitted constant of a model.

    Args:
        name: Name of the constant.
        prior: Value expected without data.
        spread: Standard deviation of the prior; of the logarithm if the constant is positive, that is if `low` > 0.
        low: Least value.
        high: Greatest value.
        unit: Unit of the value.
        meaning: Meaning in words.
        shared: Whether all shape classes share the value.
    """

    name: str
    prior: float
    spread: float
    low: float = -np.inf
    high: float = np.inf
    unit: str = ""
    meaning: str = ""
    shared: bool = False

    def __post_init__(self) -> None:
        if not self.low <= self.prior <= self.high:
            raise SettingError(f"prior of {self.name}", self.prior, f"between {self.low:g} and {self.high:g}")
        positive(f"spread of {self.name}", self.spread)

    @property
    def positive(self) -> bool:
        """Whether the constant is fitted by its logarithm."""
        return self.low > 0.0

    def value(self, z: float, centre: float) -> float:
        """Return the value at `z` spreads from `centre`."""
        found = centre * np.exp(z * self.spread) if self.positive else centre + z * self.spread
        return float(np.clip(found, self.low, self.high))

    def bounds(self, centre: float) -> tuple[float, float]:
        """Return the least and the greatest `z`, in spreads from `centre`."""
        ends = [np.log(x / centre) if self.positive else x - centre for x in (self.low, self.high)]
        return max(-_FARTHEST, float(ends[0] / self.spread)), min(_FARTHEST, float(ends[1] / self.spread))


class Prior(NamedTuple):
    """Fields of a `Constant` other than its name, for tables of constants."""

    prior: float
    spread: float
    low: float = -np.inf
    high: float = np.inf
    unit: str = ""


class Family(ABC):
    """A model of failures whose constants can be fitted."""

    constants: tuple[Constant, ...]
    """Fitted constants: once if shared, otherwise for each shape class."""
    faults: tuple[str, ...] = ("gripper_failure",)
    """Names of the faults that the model describes."""
    components: tuple[str, ...] = ("carried",)
    """Components whose touches are the events of the fit; any of them."""

    @abstractmethod
    def shape(self, scene: Scene) -> str:
        """Return the shape class of the carried object."""

    @abstractmethod
    def prepare(self, scene: Scene, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Any:
        """Compute everything for some states that does not depend on the constants."""

    @abstractmethod
    def probability(self, values: Mapping[str, float], prepared: Any) -> Float[Array, "n entity"]:
        """Return P(any of the components hits the entity | a fault of `faults`) for each state."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """All failures of one task, prepared for a fit.

    | field    | meaning                                        | shape    |
    |----------|------------------------------------------------|----------|
    | scene    | name of the scene                              |          |
    | task     | name of the task                               |          |
    | shape    | shape class of the carried object              |          |
    | prepared | result of the family's `prepare`               |          |
    | hit      | whether the failure hit the entity             | n entity |
    | counted  | whether the pair counts                        | n entity |
    | motion   | index of the motion of each failure            | n        |
    """

    scene: str
    task: str
    shape: str
    prepared: Any
    hit: Bool[Array, "n entity"]
    counted: Bool[Array, "n entity"]
    motion: Int[Array, " n"]


class Fitted(NamedTuple):
    """A fitted constant with its interval."""

    value: float
    low: float
    high: float


def samples_of(family: Family, failures: Sequence[Failures], scenes: Mapping[tuple[str, str], Scene]) -> list[Sample]:
    """Prepare the failures that a family describes.

    Args:
        family: The family to fit.
        failures: The failures.
        scenes: Scenes with the object attached, by name of the scene and the task.
    """
    groups: dict[tuple[str, str], list[tuple[int, Failures]]] = {}
    for i, whole in enumerate(failures):
        part = whole.only(family.faults)
        if len(part) and not set(family.components).isdisjoint(part.components):
            groups.setdefault((part.scene, part.task), []).append((i, part))
    found = []
    for (scene, task), members in groups.items():
        where = scenes[scene, task]
        parts = [part for _, part in members]
        q, qd = (np.concatenate([getattr(part, name) for part in parts]) for name in ("q", "qd"))
        events = [part.events([c for c in family.components if c in part.components]) for part in parts]
        found.append(
            Sample(
                scene=scene,
                task=task,
                shape=family.shape(where),
                prepared=family.prepare(where, q, qd),
                hit=np.concatenate([hit for hit, _ in events]),
                counted=np.concatenate([np.tile(counted, (len(hit), 1)) for hit, counted in events]),
                motion=np.repeat([i for i, _ in members], [len(part) for part in parts]),
            )
        )
    return found


def predictions(
    family: Family, samples: Sequence[Sample], values: Mapping[str, Mapping[str, float]]
) -> list[Float[Array, "n entity"]]:
    """Return a family's predictions for samples, with the constants of each sample's shape class."""
    return [family.probability(values[sample.shape], sample.prepared) for sample in samples]


class FitLayout(NamedTuple):
    """Layout of the fitted vector: its constants and shape classes; entries are in spreads from their centres."""

    family: Family
    slots: tuple[tuple[Constant, str | None], ...]
    """Constants with their shape class; None for all classes."""
    centres: tuple[float, ...]

    def values(self, z: Float[Array, " slot"], shape: str) -> dict[str, float]:
        """Return the constants of a shape class."""
        return {self.slots[i][0].name: self.value(i, float(z[i])) for i in self.columns(shape)}

    def value(self, slot: int, z: float) -> float:
        """Return one constant."""
        return self.slots[slot][0].value(z, self.centres[slot])

    def columns(self, shape: str) -> list[int]:
        """Return the slots that a shape class depends on."""
        return [i for i, (_, own) in enumerate(self.slots) if own in (None, shape)]

    def bounds(self) -> Float[Array, "2 slot"]:
        """Return the least and the greatest value of each slot, in spreads."""
        return np.array([c.bounds(x) for (c, _), x in zip(self.slots, self.centres, strict=True)]).T


def fit(
    family: Family,
    samples: Sequence[Sample],
    *,
    trust: float = 25.0,
    resamples: int = 500,
    seed: int = 0,
    confidence: float = 0.95,
    iterations: int = 30,
    shapes: Sequence[str] = (),
) -> dict[str, dict[str, Fitted]]:
    """Fit the constants: first common ones for all shapes, then for each shape with the common ones as prior.

    Args:
        family: The model.
        samples: The data, see `samples_of`.
        trust: Number of events that weigh as much as one independent event.
        resamples: Number of resamples of the motions for the intervals.
        seed: Seed of the resamples.
        confidence: Confidence level of the intervals.
        iterations: Greatest number of iterations of the search.
        shapes: Shape classes that get constants even without data: the common ones.

    Returns:
        Constants by shape class and name.
    """
    check_confidence(confidence)
    if not samples:
        raise SettingError("samples", 0, "at least one")
    alike = FitLayout(family, tuple((c, None) for c in family.constants), tuple(c.prior for c in family.constants))
    z = optimum(alike, samples, trust, iterations)
    centre = {c.name: alike.value(i, float(z[i])) for i, c in enumerate(family.constants)}
    dropped = sorted({sample.shape for sample in samples})
    slots = [(c, None) for c in family.constants if c.shared]
    slots += [(c, shape) for shape in dropped for c in family.constants if not c.shared]
    apart = FitLayout(family, tuple(slots), tuple(centre[c.name] for c, _ in slots))
    ends = (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)
    fitted: list[dict[tuple[str, str | None], Fitted]] = []
    for layout, best in ((alike, z), (apart, optimum(apart, samples, trust, iterations))):
        low, high = np.quantile(_bootstrap(layout, samples, best, trust, resamples, seed), ends, axis=0)
        numbers = [Fitted(*(layout.value(i, float(x[i])) for x in (best, low, high))) for i in range(len(best))]
        fitted.append({(c.name, shape): x for (c, shape), x in zip(layout.slots, numbers, strict=True)})

    def of(constant: Constant, shape: str) -> Fitted:
        own = fitted[1].get((constant.name, None if constant.shared else shape))
        return fitted[0][constant.name, None] if own is None else own

    return {shape: {c.name: of(c, shape) for c in family.constants} for shape in sorted({*shapes, *dropped})}


def optimum(layout: FitLayout, samples: Sequence[Sample], trust: float, iterations: int) -> Float[Array, " slot"]:
    """Return the maximum of prior times tempered likelihood.

    Uses Fisher scoring within bounds. A quasi-Newton method would need several times as many gradients, which are
    finite differences here.
    """
    low, high = layout.bounds()
    z = np.zeros(len(low))
    for _ in range(iterations):
        here, gradient, fisher, _ = quadratic(layout, samples, z, trust)
        free = ~((z <= low) & (gradient > 0.0) | (z >= high) & (gradient < 0.0))
        step = np.zeros(len(z))
        step[free] = -np.linalg.solve(fisher[np.ix_(free, free)], gradient[free])
        gain, length = -float(gradient @ step), 1.0
        if gain < 2.0 * _ENOUGH:
            break
        while length > _SHORTEST:
            there = np.clip(z + length * step, low, high)
            if loss(layout, samples, there, trust) < here - 1e-4 * length * gain:
                break
            length *= 0.5
        else:
            break
        z = there
    return z


def _clipped(p: Float[Array, "n entity"]) -> Float[Array, "n entity"]:
    return np.clip(p, SMALLEST, 1.0 - SMALLEST)


def loss(layout: FitLayout, samples: Sequence[Sample], z: Float[Array, " slot"], trust: float) -> float:
    """Return the negative logarithm of the likelihood and the prior [nat]."""
    found = 0.5 * trust * float(z @ z)
    for sample in samples:
        found += _surprise(_clipped(layout.family.probability(layout.values(z, sample.shape), sample.prepared)), sample)
    return found


def _surprise(p: Float[Array, "n entity"], sample: Sample) -> float:
    return float(-np.log(np.where(sample.hit, p, 1.0 - p))[sample.counted].sum())


def quadratic(
    layout: FitLayout, samples: Sequence[Sample], z: Float[Array, " slot"], trust: float
) -> tuple[float, Float[Array, " slot"], Float[Array, "slot slot"], dict[int, Float[Array, " slot"]]]:
    """Return the loss, its gradient, the Fisher information with the prior's, and the gradient of each motion."""
    here, fisher = 0.5 * trust * float(z @ z), trust * np.eye(len(z))
    shares: dict[int, Float[Array, " slot"]] = {}
    for sample in samples:
        columns = layout.columns(sample.shape)
        p, slopes = _slopes(layout, sample, z, columns)
        here += _surprise(p, sample)
        weight = np.where(sample.counted, 1.0 / (p * (1.0 - p)), 0.0)
        each = np.einsum("ne,cne->nc", weight * (p - sample.hit), slopes)
        fisher[np.ix_(columns, columns)] += np.einsum("ane,bne,ne->ab", slopes, slopes, weight, optimize=True)
        for motion in np.unique(sample.motion).tolist():
            share = shares.setdefault(motion, np.zeros(len(z)))
            share[columns] += each[sample.motion == motion].sum(axis=0)
    return here, trust * z + np.sum(list(shares.values()), axis=0), fisher, shares


def _slopes(
    layout: FitLayout, sample: Sample, z: Float[Array, " slot"], columns: Sequence[int]
) -> tuple[Float[Array, "n entity"], Float[Array, "column n entity"]]:
    """Return probabilities, and their derivatives by the constants in units of spreads."""

    def at(point: Float[Array, " slot"]) -> Float[Array, "n entity"]:
        return _clipped(layout.family.probability(layout.values(point, sample.shape), sample.prepared))

    here, axes = at(z), _STEP * np.eye(len(z))
    return here, np.stack([(at(z + axes[i]) - here) / _STEP for i in columns])


def _bootstrap(
    layout: FitLayout, samples: Sequence[Sample], z: Float[Array, " slot"], trust: float, resamples: int, seed: int
) -> Float[Array, "resample slot"]:
    """Resample whole motions with replacement; take one Newton step from the optimum to that of each resample."""
    _, _, fisher, shares = quadratic(layout, samples, z, trust)
    pushes = np.array(list(shares.values()))
    n = len(pushes)
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), size=resamples)
    # Minus the full sample, whose gradient the prior balances except at active bounds.
    steps = np.linalg.solve(fisher, ((drawn - 1.0) @ pushes).T).T
    return np.clip(z - steps, *layout.bounds())
