"""Fit a network to drops by maximum likelihood, with L-BFGS over all pairs at once, so that fits are reproducible.

Generated scenes are the training data. Bundled scenes, which look different, select the weight decay and calibrate the
network: its bound is scaled to the greatest likelihood on them. The scale is 0 if nothing learned generalises to them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from failbench.calibrations.skill import Figures, figures
from failbench.learning.rollouts import Pairs
from graceful_plan.array_types import Array, Float, Int
from graceful_plan.costs.models.drop.network import LOOKS, MOST_HIDDEN, STATE_FEATURES, DropNetwork, fade, squash
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES
from graceful_plan.exceptions import SettingError
from graceful_plan.path import plain_numbers

_CERTAIN = 1e-6
"""Distance from 1 to which probabilities are clamped; nothing can be learned beyond."""
_SCALES = tuple(i / 20 for i in range(31))
"""Scales of the bound to try."""
_LEAST_SPREAD = 1e-3


@dataclass(frozen=True, kw_only=True)
class Training:
    """Settings of the fit.

    Args:
        hidden: Units in each of two layers.
        bound: Bound of the logarithm of the odds factor, before calibration.
        decays: Weight decays to try.
        iterations: Greatest number of iterations of each fit.
        seed: Seed of the initial weights.
    """

    hidden: int = 16
    bound: float = 3.0
    decays: tuple[float, ...] = (1e-3, 3e-3, 1e-2)
    iterations: int = 120
    seed: int = 0

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not 1 <= self.hidden <= MOST_HIDDEN:
            raise SettingError("hidden", self.hidden, f"between 1 and {MOST_HIDDEN}")
        if not 0.0 < self.bound <= 20.0:
            raise SettingError("bound", self.bound, "above 0 and at most 20")
        if not self.decays or min(self.decays) < 0.0:
            raise SettingError("decays", self.decays, "at least one, none negative")


class Learned(NamedTuple):
    """A network, and its quality on the scenes that selected it, compared with the drop model alone."""

    network: DropNetwork
    plain: Figures
    corrected: Figures
    decay: float
    scale: float


def train(pairs: Pairs, training: Training | None = None) -> Learned:
    """Fit a network to pairs of drops and entities.

    Raises:
        SettingError: If there are no pairs to fit, or none to select by.
    """
    training = Training() if training is None else training
    if pairs.chooses.all() or not pairs.chooses.any():
        raise SettingError("pairs", len(pairs), "some of generated and some of bundled scenes")
    fitted, other = pairs.of(~pairs.chooses), pairs.of(pairs.chooses)
    tried = [
        (replace(network, bound=scale * training.bound), decay, scale)
        for decay in training.decays
        for network in [_fit(fitted, training, decay)]
        for scale in _SCALES
    ]
    losses = [_loss(logits(network, other)[0], other.hit) for network, _, _ in tried]
    network, decay, scale = tried[int(np.argmin(losses))]
    return Learned(
        network=network,
        plain=figures(probability(None, other), other.hit),
        corrected=figures(probability(network, other), other.hit),
        decay=decay,
        scale=scale,
    )


def probability(network: DropNetwork | None, pairs: Pairs) -> Float[Array, " pair"]:
    """Return P of a hit for each pair; by the drop model alone without a network."""
    return 1.0 / (1.0 + np.exp(-logits(network, pairs)[0]))


def logits(network: DropNetwork | None, pairs: Pairs) -> tuple[Float[Array, " pair"], Int[Array, " pair"]]:
    """Return the log-odds of each pair, and the index of the surface with the greatest."""
    found = _plain_logit(pairs)
    if network is not None:
        found = found + fade(pairs.plain) * network.log_factor(pairs.told, pairs.looks, pairs.shape)
    most = np.maximum.reduceat(found, pairs.first)
    counts = np.diff(np.append(pairs.first, len(found)))
    rows = np.flatnonzero(found == np.repeat(most, counts))
    _, where = np.unique(np.repeat(np.arange(len(pairs)), counts)[rows], return_index=True)
    return most, rows[where]


def _plain_logit(pairs: Pairs) -> Float[Array, " surface"]:
    P = np.clip(pairs.plain, 1e-300, 1.0 - _CERTAIN)
    return np.log(P) - np.log1p(-P)


def _loss(logit: Array, hit: Array) -> float:
    return float(np.mean(np.logaddexp(0.0, logit) - hit * logit))


# --- the fit ----------------------------------------------------------------------------------------------------------

_SHAPES = ("told", "looks", "shapes", "first_bias", "second", "second_bias", "last", "last_bias")


def _sizes(hidden: int) -> dict[str, tuple[int, ...]]:
    h = hidden
    shapes = ((h, len(STATE_FEATURES)), (h, len(LOOKS)), (len(SHAPE_CLASSES), h), (h,), (h, h), (h,), (h,), (1,))
    return dict(zip(_SHAPES, shapes, strict=True))


def _unpacked(flat: Array, hidden: int) -> dict[str, Any]:
    sizes = _sizes(hidden)
    ends = np.cumsum([int(np.prod(shape)) for shape in sizes.values()])
    return {
        name: part.reshape(shape) for (name, shape), part in zip(sizes.items(), np.split(flat, ends[:-1]), strict=True)
    }


def _fit(pairs: Pairs, training: Training, decay: float) -> DropNetwork:
    from scipy.optimize import minimize

    mean, spread = pairs.told.mean(axis=0), np.maximum(pairs.told.std(axis=0), _LEAST_SPREAD)
    told = (pairs.told - mean) / spread
    rng = np.random.default_rng(training.seed)
    begin = [
        rng.normal(scale=1.0 / np.sqrt(shape[-1]), size=shape) if len(shape) == 2 else np.zeros(shape)
        for shape in _sizes(training.hidden).values()
    ]
    begin[-2] = rng.normal(scale=0.1, size=training.hidden)
    found: Any = minimize(
        _objective,
        np.concatenate([np.ravel(part) for part in begin]),
        args=(pairs, told, training, decay),
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": training.iterations},
    )
    weights = _unpacked(found.x, training.hidden)
    # The normalisation of the inputs is folded into the weights.
    weights["told"] = weights["told"] / spread
    weights["first_bias"] = weights["first_bias"] - weights["told"] @ mean
    return DropNetwork(**weights, bound=training.bound)


def _objective(
    flat: Float[Array, " weight"], pairs: Pairs, told: Float[Array, "surface told"], training: Training, decay: float
) -> tuple[float, Float[Array, " weight"]]:
    """Return the mean negative log-likelihood with the penalty, and its gradient."""
    w = _unpacked(flat, training.hidden)
    first = told @ w["told"].T + pairs.looks @ w["looks"].T + pairs.shape @ w["shapes"] + w["first_bias"]
    kept = squash(first)
    second = kept @ w["second"].T + w["second_bias"]
    raw = squash(second) @ w["last"] + w["last_bias"][0]
    weight = fade(pairs.plain)
    logit = _plain_logit(pairs) + weight * training.bound * squash(raw)
    most = np.maximum.reduceat(logit, pairs.first)
    counts = np.diff(np.append(pairs.first, len(logit)))
    decides = (logit == np.repeat(most, counts)).astype(float)
    d_logit = np.repeat((1.0 / (1.0 + np.exp(-most)) - pairs.hit) / len(pairs), counts) * decides
    d_raw = d_logit * weight * training.bound * _slope(raw)
    d_second = d_raw[:, None] * w["last"] * _slope(second)
    d_first = d_second @ w["second"] * _slope(first)
    slopes = {
        "told": d_first.T @ told,
        "looks": d_first.T @ pairs.looks,
        "shapes": pairs.shape.T @ d_first,
        "first_bias": d_first.sum(axis=0),
        "second": d_second.T @ kept,
        "second_bias": d_second.sum(axis=0),
        "last": d_raw @ squash(second),
        "last_bias": np.array([d_raw.sum()]),
    }
    value = _loss(most, pairs.hit) + 0.5 * decay * float(flat @ flat)
    return value, np.concatenate([np.ravel(slopes[name]) for name in _SHAPES]) + decay * flat


def _slope(x: Array) -> Array:
    return (1.0 + x * x) ** -1.5
