"""Fit the constants of a drop model to drops, by maximum likelihood, and say how sure they are.

A model is a `Family`: named constants, and probabilities that depend on them. Events of one motion are alike and no
model is true, so the likelihood is tempered: a prior weighs as if `trust` events told as much as one. Intervals draw
whole motions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from failbench.drops import Drops
from failbench.skill import SMALLEST
from failbench.statistics import check_confidence
from graceful_plan import Scene, SettingError
from graceful_plan.array_types import Bool, Float, Int

Array = np.ndarray

_STEP = 1e-4
"""Of finite differences, in units of a prior's spread."""
_FARTHEST = 4.0
"""How many spreads a constant may be from its prior, within its own bounds."""


@dataclass(frozen=True, kw_only=True)
class Constant:
    """A number of a model that is fitted.

    Args:
        name: What it is called.
        prior: What it is taken to be before anything is seen.
        spread: How far from that it may well be, as a standard deviation: of its logarithm if it is positive by
            nature, which is the case if `low` is.
        low: Least value.
        high: Greatest value.
        unit: Of the value.
        meaning: In words.
    """

    name: str
    prior: float
    spread: float
    low: float = -np.inf
    high: float = np.inf
    unit: str = ""
    meaning: str = ""

    def __post_init__(self) -> None:
        if not self.low <= self.prior <= self.high:
            raise SettingError(f"prior of {self.name}", self.prior, f"between {self.low:g} and {self.high:g}")
        if not 0.0 < self.spread < np.inf:
            raise SettingError(f"spread of {self.name}", self.spread, "finite and above 0")

    @property
    def positive(self) -> bool:
        """Whether it is fitted by its logarithm."""
        return self.low > 0.0

    def value(self, z: float, centre: float) -> float:
        """Return the value that is `z` spreads from `centre`."""
        found = centre * np.exp(z * self.spread) if self.positive else centre + z * self.spread
        return float(np.clip(found, self.low, self.high))

    def bounds(self, centre: float) -> tuple[float, float]:
        """Return the least and the greatest number of spreads from `centre`."""
        ends = [np.log(x / centre) if self.positive else x - centre for x in (self.low, self.high)]
        return max(-_FARTHEST, float(ends[0] / self.spread)), min(_FARTHEST, float(ends[1] / self.spread))


class Family(ABC):
    """A model of drops whose constants can be fitted."""

    @property
    @abstractmethod
    def constants(self) -> tuple[Constant, ...]:
        """What is fitted, for each shape class."""

    @abstractmethod
    def shape(self, scene: Scene) -> str:
        """Return the shape class of the carried object."""

    @abstractmethod
    def prepare(self, scene: Scene, q: Float[Array, "n nq"], qd: Float[Array, "n nq"]) -> Any:
        """Return whatever of some states does not depend on the constants."""

    @abstractmethod
    def probability(self, values: Mapping[str, float], prepared: Any) -> Float[Array, "n entity"]:
        """Return P(the carried object hits the entity | it is dropped) for each of the states."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sample:
    """All drops of one task, prepared.

    | field    | meaning                                        | shape    |
    |----------|------------------------------------------------|----------|
    | scene    | name of the scene                              |          |
    | task     | name of the task                               |          |
    | shape    | shape class of what is dropped                 |          |
    | prepared | what the family makes of the states            |          |
    | hit      | what happened                                  | n entity |
    | counted  | which of it counts                             | n entity |
    | motion   | which motion each drop is of                   | n        |
    """

    scene: str
    task: str
    shape: str
    prepared: Any
    hit: Bool[Array, "n entity"]
    counted: Bool[Array, "n entity"]
    motion: Int[Array, " n"]


class Fitted(NamedTuple):
    """A constant that was fitted, with its interval."""

    value: float
    low: float
    high: float


def samples_of(family: Family, drops: Sequence[Drops], scenes: Mapping[tuple[str, str], Scene]) -> list[Sample]:
    """Prepare drops.

    Args:
        family: Whose constants are to be fitted.
        drops: What was dropped.
        scenes: The scene of each scene's name and task's name, with the object attached.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for i, part in enumerate(drops):
        groups.setdefault((part.scene, part.task), []).append(i)
    found = []
    for (scene, task), members in groups.items():
        where = scenes[scene, task]
        parts = [drops[i] for i in members]
        q, qd, hit = (np.concatenate([getattr(part, name) for part in parts]) for name in ("q", "qd", "hit"))
        found.append(
            Sample(
                scene=scene,
                task=task,
                shape=family.shape(where),
                prepared=family.prepare(where, q, qd),
                hit=hit,
                counted=np.concatenate([np.tile(part.counted, (len(part), 1)) for part in parts]),
                motion=np.repeat(members, [len(part) for part in parts]),
            )
        )
    return found


def predictions(
    family: Family, samples: Sequence[Sample], values: Mapping[str, Mapping[str, float]]
) -> list[Float[Array, "n entity"]]:
    """Return what a family predicts for samples, with the constants of each one's shape class."""
    return [family.probability(values[sample.shape], sample.prepared) for sample in samples]


def fit(
    family: Family,
    samples: Sequence[Sample],
    *,
    trust: float = 25.0,
    resamples: int = 500,
    seed: int = 0,
    confidence: float = 0.95,
    iterations: int = 60,
) -> dict[str, dict[str, Fitted]]:
    """Fit the constants: first for all shapes alike, then for each, with what fits all as its prior.

    Args:
        family: The model.
        samples: What happened; see `samples_of`.
        trust: How many events weigh as much as one independent one.
        resamples: How often motions are drawn for the intervals.
        seed: Of the draws.
        confidence: Of the intervals.
        iterations: Of L-BFGS, at most.

    Returns:
        Constants by shape class and name.
    """
    check_confidence(confidence)
    if not samples:
        raise SettingError("samples", 0, "at least one")
    priors = {constant.name: constant.prior for constant in family.constants}
    shared = _values(family, _optimum(family, samples, priors, trust, iterations), priors)
    found = {}
    for shape in sorted({sample.shape for sample in samples}):
        own = [sample for sample in samples if sample.shape == shape]
        z = _optimum(family, own, shared, trust, iterations)
        drawn = _bootstrap(family, own, shared, z, trust, resamples, seed)
        low, high = np.quantile(drawn, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence], axis=0)
        ends = (_values(family, end, shared) for end in (z, low, high))
        found[shape] = {name: Fitted(*numbers) for name, *numbers in _together(*ends)}
    return found


def _together(*values: Mapping[str, float]) -> list[tuple[str, float, float, float]]:
    first, *others = values
    return [(name, number, *(other[name] for other in others)) for name, number in first.items()]  # pyright: ignore[reportReturnType]


def _values(family: Family, z: Float[Array, " constant"], centre: Mapping[str, float]) -> dict[str, float]:
    return {c.name: c.value(float(x), centre[c.name]) for c, x in zip(family.constants, z, strict=True)}


def _optimum(
    family: Family, samples: Sequence[Sample], centre: Mapping[str, float], trust: float, iterations: int
) -> Float[Array, " constant"]:
    """Return where prior and tempered likelihood are greatest, in spreads from the prior."""
    from scipy.optimize import minimize

    events = sum(int(sample.counted.sum()) for sample in samples)

    def loss(z: Float[Array, " constant"]) -> float:
        values = _values(family, z, centre)
        surprise = sum(_surprise(family.probability(values, sample.prepared), sample) for sample in samples)
        return (surprise + 0.5 * trust * float(z @ z)) / events

    def both(z: Float[Array, " constant"]) -> tuple[float, Float[Array, " constant"]]:
        here = loss(z)
        return here, np.array([(loss(z + _STEP * axis) - here) / _STEP for axis in np.eye(len(z))])

    bounds = [constant.bounds(centre[constant.name]) for constant in family.constants]
    start = np.zeros(len(bounds))
    found = minimize(both, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": iterations})
    return np.asarray(found.x, dtype=float)


def _clipped(p: Float[Array, "n entity"]) -> Float[Array, "n entity"]:
    return np.clip(p, SMALLEST, 1.0 - SMALLEST)


def _surprise(p: Float[Array, "n entity"], sample: Sample) -> float:
    """Return the negative log-likelihood [nat]."""
    p = _clipped(p)
    return float(-np.log(np.where(sample.hit, p, 1.0 - p))[sample.counted].sum())


def _bootstrap(
    family: Family,
    samples: Sequence[Sample],
    centre: Mapping[str, float],
    z: Float[Array, " constant"],
    trust: float,
    resamples: int,
    seed: int,
) -> Float[Array, "resample constant"]:
    """Draw whole motions with replacement, and take one Newton step from the optimum to that of each draw."""
    count = len(z)
    scores: dict[int, Float[Array, " constant"]] = {}
    fisher = trust * np.eye(count)
    for sample in samples:
        p, slopes = _linear(family, sample, z, centre)
        variance = p * (1.0 - p)
        push = np.where(sample.counted, (p - sample.hit) / variance, 0.0)
        each = np.einsum("ne,cne->nc", push, slopes)
        for motion in np.unique(sample.motion):
            scores[int(motion)] = scores.get(int(motion), np.zeros(count)) + each[sample.motion == motion].sum(axis=0)
        fisher += np.einsum("ane,bne,ne->ab", slopes, slopes, sample.counted / variance)
    pushes = np.array(list(scores.values()))
    n = len(pushes)
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), size=resamples)
    # Less that of all motions once, which the prior balances but for what bounds hold back.
    steps = np.linalg.solve(fisher, ((drawn - 1.0) @ pushes).T).T
    low, high = np.array([c.bounds(centre[c.name]) for c in family.constants]).T
    return np.clip(z - steps, low, high)


def _linear(
    family: Family, sample: Sample, z: Float[Array, " constant"], centre: Mapping[str, float]
) -> tuple[Float[Array, "n entity"], Float[Array, "constant n entity"]]:
    """Return probabilities and their derivatives with respect to the constants, in spreads."""

    def at(point: Float[Array, " constant"]) -> Float[Array, "n entity"]:
        return _clipped(family.probability(_values(family, point, centre), sample.prepared))

    axes = _STEP * np.eye(len(z))
    return at(z), np.stack([(at(z + axis) - at(z - axis)) / (2.0 * _STEP) for axis in axes])
