"""Clamped quintic B-splines as matrices: values and derivatives at parameters, of many curves by one product."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from graceful_plan.array_types import Float

Array = np.ndarray

DEGREE = 5
"""Continuous up to the fourth derivative: the curvature of a planar curve has a continuous derivative, twice."""


@lru_cache(maxsize=64)
def basis(controls: int, u: tuple[float, ...], derivatives: int = 3) -> Float[Array, "derivative u control"]:
    """Return what takes control points to the curve and its first derivatives at parameters.

    The parameter goes from 0 to 1, knots are even. By de Boor's recursion; C. de Boor, "A Practical Guide to Splines",
    1978, chapters IX and X.

    Args:
        controls: Number of control points, more than `DEGREE`.
        u: Parameters.
        derivatives: How many.
    """
    spans = controls - DEGREE
    knots = np.concatenate([np.zeros(DEGREE), np.arange(spans + 1) / spans, np.ones(DEGREE)])
    at = np.asarray(u, dtype=float)
    found = [_values(knots, at, DEGREE, controls)]
    # Derivatives of a curve are curves of lower degree through scaled differences of its control points.
    difference = np.eye(controls)
    for order in range(1, derivatives + 1):
        degree = DEGREE - order
        inner = knots[order:-order]
        width = (
            knots[order + degree + 1 : order + degree + 1 + len(difference) - 1]
            - knots[order : order + len(difference) - 1]
        )
        difference = (degree + 1) * np.diff(difference, axis=0) / width[:, None]
        found.append(_values(inner, at, degree, len(difference)) @ difference)
    result = np.stack(found)
    result.flags.writeable = False
    return result


def _values(
    knots: Float[Array, " knot"], u: Float[Array, " n"], degree: int, controls: int
) -> Float[Array, "n control"]:
    """Evaluate all B-splines of a degree; at the end of the last span they are those of that span."""
    last = np.flatnonzero(np.diff(knots) > 0.0)[-1]
    span = np.clip(np.searchsorted(knots, u, side="right") - 1, 0, last)
    value = np.zeros((len(u), len(knots) - 1))
    value[np.arange(len(u)), span] = 1.0
    for d in range(1, degree + 1):
        n = len(knots) - 1 - d
        left, right = knots[d : d + n] - knots[:n], knots[d + 1 : d + 1 + n] - knots[1 : 1 + n]
        rising = np.divide(u[:, None] - knots[:n], left, out=np.zeros((len(u), n)), where=left > 0.0)
        falling = np.divide(knots[d + 1 : d + 1 + n] - u[:, None], right, out=np.zeros((len(u), n)), where=right > 0.0)
        value = rising * value[:, :n] + falling * value[:, 1 : n + 1]
    return value[:, :controls]
