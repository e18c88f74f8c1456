r"""How likely each of several causes is, from what each of them would make likely: a concave fit.

An event happens with the probability

.. math:: P = \epsilon + (1 - 2 \epsilon) \Big( o + \sum_g \theta_g P_g \Big), \qquad
    \theta_g \ge 0, \quad \sum_g \theta_g \le 1

where cause g makes it happen with P_g, epsilon is the least that counts, and o is what is known already. The logarithm
of the likelihood of independent events is concave in theta, so its maximum is global; Newton steps, each the exact
solution of a quadratic problem over all active sets, find it, and the Frank-Wolfe gap bounds how much is missing.

References:
    [Jaggi2013] Revisiting Frank-Wolfe, for the gap.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from failbench.calibrations.skill import SMALLEST
from graceful_plan.array_types import Bool, Float

Array = np.ndarray

_GAP = 1e-4  # how much of the logarithm of the likelihood may be missing [nat]
_STEPS = 100
_RIDGE = 1e-9  # of the curvature; keeps causes that say the same where they are
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
    """Return the shares of causes under which events are most likely, and a bound of what is missing [nat].

    Args:
        probability: P_g.
        happened: Whether each event happened.
        weight: How often each event counts; once if None.
        offset: What is known already; with any shares, P has to be in [0, 1].
        start: Shares to begin with.
        harmless: Whether shares may sum to less than 1. If so, a cause that never says anything has no share.
    """
    w = np.ones(len(happened)) if weight is None else weight
    known = np.zeros(len(happened)) if offset is None else offset
    # What nobody expects and did not happen says nothing.
    telling = (w > 0.0) & (happened | (probability > _NOTHING).any(axis=1))
    speaks = np.asarray((probability[telling] > _NOTHING).any(axis=0)) | (not harmless)
    p, y, w, known = probability[telling][:, speaks], happened[telling].astype(float), w[telling], known[telling]
    if harmless:
        p = np.column_stack([p, np.zeros(len(p))])
    theta = np.full(p.shape[1], 1.0 / p.shape[1])
    if start is not None:  # an inner point, since a share of 0 says nothing about its neighbourhood
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
    """Return probabilities that are never quite 0 or 1."""
    return SMALLEST + (1.0 - 2.0 * SMALLEST) * probability


def log_likelihood(
    P: Float[Array, " n"], happened: Bool[Array, " n"], weight: Float[Array, " n"] | None = None
) -> float:
    """Return the logarithm of the likelihood of events [nat]."""
    each = np.where(happened, np.log(P), np.log1p(-P))
    return float(each.sum() if weight is None else weight @ each)


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


def _search(p: Array, known: Array, y: Array, w: Array, theta: Array, step: Array) -> Array:
    """Go along a step as far as the likelihood rises."""

    def loss(there: Array) -> float:
        return -log_likelihood(likely(known + p @ there), y > 0.0, w)

    here, length = loss(theta), 1.0
    while length > 1e-12 and loss(theta + length * step) > here + 1e-12 * abs(here):
        length *= 0.5
    return theta + length * step if length > 1e-12 else theta
