r"""Concave maximum-likelihood fit of the probabilities of several causes, given the events that each predicts.

The probability of an event is

.. math:: P = \epsilon + (1 - 2 \epsilon) \Big( o + \sum_g \theta_g P_g \Big), \qquad
    \theta_g \ge 0, \quad \sum_g \theta_g \le 1

where P_g is its probability under cause g, epsilon the least probability, and o a known offset. The log-likelihood of
independent events is concave in theta, so its maximum is global. It is found by Newton steps, each the exact solution
of a quadratic problem over all active sets. The Frank-Wolfe gap bounds the distance from the maximum.

References:
    [Jaggi2013] Revisiting Frank-Wolfe, for the gap.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from failbench.calibrations.skill import SMALLEST
from graceful_plan.array_types import Array, Bool, Float

_GAP = 1e-4  # greatest gap of the log-likelihood from its maximum [nat]
_STEPS = 100
_RIDGE = 1e-9  # relative to the curvature; keeps causes with equal predictions in place
_NOTHING = 1e-7


def most_likely(
    probability: Float[Array, "n cause"],
    happened: Bool[Array, " n"],
    weight: Float[Array, " n"] | None = None,
    *,
    offset: Float[Array, " n"] | None = None,
    start: Float[Array, " cause"] | None = None,
    harmless: bool = True,
) -> tuple[Float[Array, " cause"], float]:
    """Return the shares of causes with the greatest likelihood, and a bound of the gap from the maximum [nat].

    Args:
        probability: P_g of each event and cause.
        happened: Whether each event happened.
        weight: Weight of each event; 1 if None.
        offset: Known part o of the probability; P must be in [0, 1] for any shares.
        start: Initial shares.
        harmless: Whether shares may sum to less than 1. If so, a cause that predicts no event has share 0.
    """
    w = np.ones(len(happened)) if weight is None else weight
    known = np.zeros(len(happened)) if offset is None else offset
    # Events that no cause predicts and that did not happen carry no information.
    telling = (w > 0.0) & (happened | (probability > _NOTHING).any(axis=1))
    speaks = np.asarray((probability[telling] > _NOTHING).any(axis=0)) | (not harmless)
    p, y, w, known = probability[telling][:, speaks], happened[telling].astype(float), w[telling], known[telling]
    if harmless:
        p = np.column_stack([p, np.zeros(len(p))])
    theta = np.full(p.shape[1], 1.0 / p.shape[1])
    if start is not None:  # moved to an inner point, since a share of 0 would stay at the boundary
        given = np.append(start[speaks], 1.0 - start[speaks].sum()) if harmless else start
        theta[:] = 0.01 * theta + 0.99 * given
    gap = np.inf
    for _ in range(_STEPS):
        P = likely(known + p @ theta)
        slope = (1.0 - 2.0 * SMALLEST) * ((w * ((1.0 - y) / (1.0 - P) - y / P)) @ p)
        gap = float(slope @ theta - slope.min())
        if gap <= _GAP:
            break
        bend = (1.0 - 2.0 * SMALLEST) ** 2 * (p.T * (w * (y / P**2 + (1.0 - y) / (1.0 - P) ** 2))) @ p
        bend += (_RIDGE * np.trace(bend) + np.finfo(float).tiny) * np.eye(len(bend))
        target = _least(slope - bend @ theta, bend)
        theta = _search(p, known, y, w, theta, target - theta)
    shares = np.zeros(len(speaks))
    shares[speaks] = theta[:-1] if harmless else theta
    return shares, gap


def likely(probability: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return probabilities bounded away from 0 and 1 by `SMALLEST`."""
    return SMALLEST + (1.0 - 2.0 * SMALLEST) * probability


def log_likelihood(
    P: Float[Array, " n"], happened: Bool[Array, " n"], weight: Float[Array, " n"] | None = None
) -> float:
    """Return the log-likelihood of events [nat]."""
    each = np.where(happened, np.log(P), np.log1p(-P))
    return float(each.sum() if weight is None else weight @ each)


def _least(slope: Float[Array, " k"], bend: Float[Array, "k k"]) -> Float[Array, " k"]:
    """Minimise slope.x + x.bend.x/2 over the probability simplex, exactly: all sets of positive entries are tried."""
    k = len(slope)
    free = np.array([chosen for chosen in product((False, True), repeat=k) if any(chosen)])
    # Lagrange's equations on each set; the rows of the other entries say x = 0.
    system = np.zeros((len(free), k + 1, k + 1))
    system[:, :k, :k] = np.where(free[:, :, None] & free[:, None, :], bend, ~free[:, :, None] * np.eye(k))
    system[:, :k, k] = system[:, k, :k] = free
    right = np.column_stack([np.where(free, -slope, 0.0), np.ones(len(free))])
    x = np.linalg.solve(system, right[..., None])[:, :k, 0]
    value = x @ slope + 0.5 * np.einsum("si,ij,sj->s", x, bend, x)
    value[(x < -1e-12).any(axis=1)] = np.inf
    found = np.maximum(x[int(np.argmin(value))], 0.0)
    return found / found.sum()


def _search(p: Array, known: Array, y: Array, w: Array, theta: Array, step: Array) -> Array:
    """Move along a step, halving it until the likelihood rises."""

    def loss(there: Array) -> float:
        return -log_likelihood(likely(known + p @ there), y > 0.0, w)

    here, length = loss(theta), 1.0
    while length > 1e-12 and loss(theta + length * step) > here + 1e-12 * abs(here):
        length *= 0.5
    return theta + length * step if length > 1e-12 else theta
