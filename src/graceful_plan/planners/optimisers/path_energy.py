r"""Energy of a path that CHOMP minimises, in a metric that is stretched by the impact.

A path is a polyline of n edges; edge i costs :math:`c_i = V_i + w S_i + \lambda O_i`, its share of the objective and of
an obstacle potential. Instead of their sum, the energy

.. math:: U = \frac n2 \sum_i c_i^2 = \frac12 \Big(\sum_i c_i\Big)^2 + \frac{n^2}{2} \mathrm{Var}(c_i)

is minimised, as for geodesics: its minima are the paths of the least sum, with vertices spaced so that all edges cost
the same. The sum alone does not change when vertices slide along the path, so a descent would let them drift. In free
space without impact, U is CHOMP's smoothness term, half the integral of the squared velocity.

The potential is that of CHOMP, a function of the clearance d. It is integrated over arc length, so that a larger
spacing of vertices near an obstacle does not lower it:

.. math:: c(d) = -d + \epsilon/2 \;(d < 0), \qquad (d - \epsilon)^2/(2 \epsilon) \;(0 \le d \le \epsilon), \qquad 0

References:
    Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013, Eq. (2) to (7). Differs
    in: exact derivatives of the sums, which include the curvature term.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.planners.optimisers.edge_derivatives import Slopes

_TINY = 1e-12
"""Length below which an edge has no direction [rad]."""


@final
@dataclass(frozen=True, kw_only=True)
class ObstaclePotential:
    """Potential of obstacles near a path.

    Args:
        weight: Slope of the potential over penetration depth, per unit of length [1/m].
        reach: Clearance from which on the potential is 0 [m].
        step: Largest distance between samples along an edge [rad].
    """

    weight: float
    reach: float
    step: float

    def density(self, clearance: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Return the weighted potential at a clearance, and its derivative."""
        gap = np.clip(self.reach - clearance, 0.0, self.reach)
        inside = np.minimum(clearance, 0.0)
        value = 0.5 * gap**2 / self.reach - inside
        return self.weight * value, np.where(clearance < 0.0, -self.weight, -self.weight * gap / self.reach)

    def edges(
        self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"], slopes: Slopes
    ) -> tuple[Float[Array, " n"], Float[Array, "n nq"], Float[Array, "n nq"]] | None:
        """Return the integral of the potential over each edge and its derivatives; None if clearance is not available.

        Integrals are trapezoid sums; all edges have as many samples as the longest one needs.
        """
        n, nq = q0.shape
        delta = q1 - q0
        length = np.linalg.norm(delta, axis=1)
        pieces = max(1, int(np.ceil(length.max(initial=0.0) / self.step)))
        t = np.linspace(0.0, 1.0, pieces + 1)
        share = np.full(pieces + 1, 1.0 / pieces)
        share[[0, -1]] *= 0.5
        known = slopes.clearance_slopes((q0[:, None] + t[:, None] * delta[:, None]).reshape(-1, nq))
        if known is None:
            return None
        value, slope = self.density(known[0].reshape(n, pieces + 1))
        force = slope[..., None] * known[1].reshape(n, pieces + 1, nq) * (share * length[:, None])[..., None]
        mean = value @ share
        longer = mean[:, None] * delta / np.maximum(length, _TINY)[:, None]
        d_q1 = np.einsum("nkj,k->nj", force, t) + longer
        d_q0 = np.einsum("nkj,k->nj", force, 1.0 - t) - longer
        return length * mean, d_q0, d_q1


@final
@dataclass(frozen=True)
class Evaluation:
    """A path with its energy."""

    q: Float[Array, "point nq"]
    energy: float
    gradient: Float[Array, "inner nq"]
    """Gradient of the energy with respect to the inner points."""
    total: float
    """J = V + w S of the path, without the potential."""
    cost: Float[Array, " edge"]
    """Cost of each edge, including the potential."""


@final
class PathEnergy:
    """Evaluates the energy of whole paths.

    Args:
        slopes: Access to objective and clearance.
        potential: Potential of obstacles; None for none.
    """

    def __init__(self, slopes: Slopes, potential: ObstaclePotential | None = None) -> None:
        self.slopes, self.potential = slopes, potential

    def __call__(self, q: Float[Array, "point nq"]) -> Evaluation:
        """Return the energy of a path and its gradient; all edges are evaluated in one batch."""
        q0, q1 = q[:-1], q[1:]
        cost, d_q0, d_q1 = self.slopes.edge_slopes(q0, q1)
        total = float(cost.sum())
        if self.potential is not None:
            energy = self.potential.edges(q0, q1, self.slopes)
            if energy is not None:
                cost, d_q0, d_q1 = cost + energy[0], d_q0 + energy[1], d_q1 + energy[2]
        n = len(cost)
        gradient = n * (cost[:-1, None] * d_q1[:-1] + cost[1:, None] * d_q0[1:])
        return Evaluation(q, 0.5 * n * float(cost @ cost), gradient, total, cost)
