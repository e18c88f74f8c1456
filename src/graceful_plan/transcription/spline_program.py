r"""The program behind `optimise_trajectory`: joint positions, joint velocities and the duration as variables.

Cubics join positions and velocities at evenly spaced nodes, so accelerations are linear on each piece. This is the
Hermite-Simpson scheme for a double integrator, whose equations such pieces satisfy exactly, with the dependent states
eliminated. With h the time of a piece and w = h * velocity, everything is linear in the nodes over a power of h,

.. math:: q = B_0 \ell, \quad \dot q = B_1 \ell / h, \quad \ddot q = B_2 \ell / h^2, \quad \dddot q = B_3 \ell / h^3

with l = (q, w) at both ends of the piece. All other costs and constraints are functions of (q, qd, qdd) at samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.planners.optimisers.nlp import Pattern, Program, Values


def hermite(u: Float[Array, " n"]) -> Float[Array, "n order end"]:
    """Return B_0 to B_3 at fractions `u` of a piece: coefficients of q, w at its beginning and q, w at its end."""
    one = np.ones_like(u)
    rows = [
        [1.0 - 3.0 * u**2 + 2.0 * u**3, u - 2.0 * u**2 + u**3, 3.0 * u**2 - 2.0 * u**3, u**3 - u**2],
        [6.0 * u**2 - 6.0 * u, 1.0 - 4.0 * u + 3.0 * u**2, 6.0 * u - 6.0 * u**2, 3.0 * u**2 - 2.0 * u],
        [12.0 * u - 6.0, 6.0 * u - 4.0, 6.0 - 12.0 * u, 6.0 * u - 2.0],
        [12.0 * one, 6.0 * one, -12.0 * one, 6.0 * one],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


@final
class SplineLayout:
    """Layout of the variables: (q, w) of each node, then the time of a piece relative to `time`.

    Args:
        pieces: Number of pieces.
        nq: Number of joints.
        time: Initial time of a piece [s], which scales its variable.
    """

    def __init__(self, pieces: int, nq: int, time: float) -> None:
        self.pieces, self.nq, self.time = pieces, nq, time
        self.size = 2 * nq * (pieces + 1) + 1

    def pack(self, q: Float[Array, "node nq"], w: Float[Array, "node nq"], h: float) -> Float[Array, " variable"]:
        """Pack nodes and the time of a piece [s] into a vector of variables."""
        return np.append(np.concatenate([q, w], axis=1), h / self.time)

    def nodes(self, x: Float[Array, " variable"]) -> tuple[Float[Array, "node nq"], Float[Array, "node nq"]]:
        """Return q and w of all nodes."""
        both = x[:-1].reshape(self.pieces + 1, 2, self.nq)
        return both[:, 0], both[:, 1]

    def h(self, x: Float[Array, " variable"]) -> float:
        """Time of a piece [s]."""
        return float(x[-1]) * self.time

    def places(self, piece: Int[Array, " n"]) -> Int[Array, "n local"]:
        """Return the indices of the variables of pieces: both end nodes, then the time."""
        own = 2 * self.nq * piece[:, None] + np.arange(4 * self.nq)
        return np.concatenate([own, np.full((len(piece), 1), self.size - 1)], axis=1)


@final
class Samples:
    """Samples of the motion at which costs and constraints are evaluated.

    Args:
        layout: Layout of the variables.
        piece: Piece of each sample.
        u: Position of each sample on its piece, as a fraction.
    """

    def __init__(self, layout: SplineLayout, piece: Int[Array, " n"], u: Float[Array, " n"]) -> None:
        self.layout, self.piece, self.u = layout, piece, u
        self.coefficient = hermite(u)[:, :3]
        self.places = layout.places(piece)

    def __len__(self) -> int:
        return len(self.piece)

    def states(self, x: Float[Array, " variable"]) -> Float[Array, "order n nq"]:
        """Return positions, velocities and accelerations."""
        ends = x[self.places[:, :-1]].reshape(len(self), 4, self.layout.nq)
        h = self.layout.h(x)
        scaled = np.einsum("soe,sej->osj", self.coefficient, ends)
        return scaled / np.array([1.0, h, h * h])[:, None, None]

    def slopes(
        self, x: Float[Array, " variable"], states: Float[Array, "order n nq"], z: Float[Array, "n order nq"]
    ) -> Float[Array, "n local"]:
        """Return derivatives with respect to `places` of functions with derivatives `z` by q, qd and qdd."""
        h = self.layout.h(x)
        weighed = self.coefficient / np.array([1.0, h, h * h])[:, None]
        own = np.einsum("soe,soj->sej", weighed, z).reshape(len(z), -1)
        time = -(np.einsum("sj,sj->s", z[:, 1], states[1]) + 2.0 * np.einsum("sj,sj->s", z[:, 2], states[2])) / h
        return np.concatenate([own, self.layout.time * time[:, None]], axis=1)

    def curvature(
        self,
        x: Float[Array, " variable"],
        states: Float[Array, "order n nq"],
        z: Float[Array, "n order nq"],
        zz: Float[Array, "n state state"],
    ) -> Float[Array, "n local local"]:
        """Return second derivatives with respect to `places` of functions with derivatives `z` and `zz`."""
        n, nq, h, scale = len(z), self.layout.nq, self.layout.h(x), self.layout.time
        power = np.array([0.0, 1.0, 2.0])
        weighed = self.coefficient / (h**power)[:, None]
        # Derivatives of (q, qd, qdd) with respect to the local variables (ends, time).
        jacobian = np.zeros((n, 3, nq, 4 * nq + 1))
        for joint in range(nq):
            jacobian[:, :, joint, joint : 4 * nq : nq] = weighed
        jacobian[..., -1] = -scale / h * power[:, None] * np.moveaxis(states, 0, 1)
        flat = jacobian.reshape(n, 3 * nq, -1)
        found = np.swapaxes(flat, 1, 2) @ zz @ flat
        mixed = np.einsum("soe,soj,o->sej", weighed, z, -power).reshape(n, -1) * scale / h
        found[:, :-1, -1] += mixed
        found[:, -1, :-1] += mixed
        found[:, -1, -1] += np.einsum("soj,osj,o->s", z, states, power * (power + 1.0)) * (scale / h) ** 2
        return found


class Charge(NamedTuple):
    """Values and derivatives of a running cost of (q, qd, qdd), one per sample."""

    value: Float[Array, " n"]
    slope: Float[Array, "n order nq"]
    curvature: Float[Array, "n state state"]


Charging = Callable[[Array, bool], Charge]
"""A running cost: maps states [order, n, nq], and whether to compute the curvature, to a `Charge`."""


@final
@dataclass(frozen=True, eq=False)
class Integral:
    """A term of the cost: a weighted sum over samples, times the time of a piece."""

    samples: Samples
    weight: Float[Array, " n"]
    charge: Charging


@final
@dataclass(frozen=True, eq=False)
class LinearRows:
    """Constraints that are linear in the nodes over a power of h; their limits are O(1)."""

    name: str
    pattern: Pattern
    """Row and column of each entry; rows count from 0."""
    entry: Float[Array, " nonzero"]
    power: int
    least: Float[Array, " row"]
    most: Float[Array, " row"]


@final
@dataclass(frozen=True, eq=False)
class SampleRows:
    """Constraints on functions of (q, qd, qdd) at samples, one or more each; their curvature is neglected."""

    name: str
    samples: Samples
    bounded: Callable[[Array], tuple[Array, Array]]
    """Maps states to values [n, k] and their derivatives [n, k, order, nq]."""
    least: Float[Array, "n k"]
    most: Float[Array, "n k"]


@final
@dataclass(frozen=True, eq=False)
class SplineCost:
    """The cost to minimise.

    Args:
        time: Cost of a second.
        integrals: Other terms of the cost.
    """

    time: float
    integrals: Sequence[Integral] = ()


@final
@dataclass(frozen=True, eq=False)
class SplineRows:
    """The constraints of a program.

    Args:
        linear: Limits of position, velocity, acceleration and jerk.
        sampled: Limits of torque and clearance.
        slack: Excess per row name up to which an iterate is worth keeping; 0 for names not listed.
    """

    linear: Sequence[LinearRows] = ()
    sampled: Sequence[SampleRows] = ()
    slack: Mapping[str, float] = field(default_factory=dict)

    def joined(self, of_rows: Callable[[LinearRows | SampleRows], Array]) -> Float[Array, " constraint"]:
        """Concatenate an array per group of rows, flattened."""
        return np.concatenate([np.zeros(0), *(of_rows(rows).ravel() for rows in (*self.linear, *self.sampled))])


@final
class SplineProgram(Program):
    """Minimise time, integrals or both over piecewise cubics with evenly spaced nodes.

    Args:
        layout: Layout of the variables.
        bounds: Lower and upper bounds of the variables.
        cost: The cost to minimise.
        rows: The constraints.
    """

    def __init__(
        self,
        layout: SplineLayout,
        bounds: tuple[Float[Array, " variable"], Float[Array, " variable"]],
        cost: SplineCost,
        rows: SplineRows,
    ) -> None:
        self.layout, self.cost, self.rows = layout, cost, rows
        self.lower, self.upper = bounds
        self.least = rows.joined(lambda part: part.least)
        self.most = rows.joined(lambda part: part.most)
        self.slack = rows.joined(lambda part: np.full(part.least.size, rows.slack.get(part.name, 0.0)))
        """Excess over each constraint up to which an iterate is worth keeping."""
        self.jacobian_pattern = self._jacobian_pattern()
        self._pair = np.triu_indices(4 * layout.nq + 1)
        self.hessian_pattern = self._hessian_pattern()

    def _jacobian_pattern(self) -> Pattern:
        rows, columns, first, last = [], [], 0, self.layout.size - 1
        for part in self.rows.linear:
            n = len(part.least)
            rows += [part.pattern.row + first, *([np.arange(n) + first] if part.power else [])]
            columns += [part.pattern.column, *([np.full(n, last)] if part.power else [])]
            first += n
        for part in self.rows.sampled:
            n, k = part.least.shape
            local = part.samples.places.shape[1]
            rows.append(np.repeat(np.arange(n * k) + first, local))
            columns.append(np.repeat(part.samples.places, k, axis=0).ravel())
            first += n * k
        none = np.zeros(0, dtype=int)
        return Pattern(np.concatenate([none, *rows]), np.concatenate([none, *columns]))

    def _hessian_pattern(self) -> Pattern:
        """Return all pairs of variables of the same piece, and the time paired with every variable."""
        places = self.layout.places(np.arange(self.layout.pieces))
        row, column = places[:, self._pair[0]], places[:, self._pair[1]]
        keys, inverse = np.unique(row * self.layout.size + column, return_inverse=True)
        self._slot = inverse.reshape(row.shape)
        self._time_slot = np.searchsorted(keys, np.arange(self.layout.size) * self.layout.size + self.layout.size - 1)
        return Pattern(keys // self.layout.size, keys % self.layout.size)

    def evaluate(self, x: Float[Array, " variable"]) -> Values:
        """Compute cost, gradient, constraints and Jacobian."""
        cost, gradient = self._cost(x)
        values, entries, h = [], [], self.layout.h(x)
        for part in self.rows.linear:
            scaled = part.entry / h**part.power
            value = np.bincount(part.pattern.row, scaled * x[part.pattern.column], len(part.least))
            values.append(value)
            entries += [scaled, *([-part.power * value * self.layout.time / h] if part.power else [])]
        for part in self.rows.sampled:
            states = part.samples.states(x)
            value, slope = part.bounded(states)
            local = [part.samples.slopes(x, states, slope[:, k]) for k in range(value.shape[1])]
            values.append(value.ravel())
            entries.append(np.stack(local, axis=1).ravel())
        return Values(cost, gradient, np.concatenate([np.zeros(0), *values]), np.concatenate([np.zeros(0), *entries]))

    def _cost(self, x: Array) -> tuple[float, Array]:
        h, scale = self.layout.h(x), self.layout.time
        cost, gradient = self.cost.time * h * self.layout.pieces, np.zeros(len(x))
        gradient[-1] = self.cost.time * scale * self.layout.pieces
        for part in self.cost.integrals:
            states = part.samples.states(x)
            charge = part.charge(states, False)
            total = float(part.weight @ charge.value)
            cost += h * total
            local = h * part.weight[:, None] * part.samples.slopes(x, states, charge.slope)
            gradient += np.bincount(part.samples.places.ravel(), local.ravel(), len(x))
            gradient[-1] += scale * total
        return cost, gradient

    def hessian(
        self, x: Float[Array, " variable"], factor: float, multipliers: Float[Array, " constraint"]
    ) -> Float[Array, " nonzero"]:
        """Return the Hessian of the cost and the linear rows; the curvature of sampled rows is neglected."""
        assert self.hessian_pattern is not None
        entries, h, scale = np.zeros(len(self.hessian_pattern.row)), self.layout.h(x), self.layout.time
        for part in self.cost.integrals:
            states = part.samples.states(x)
            charge = part.charge(states, True)
            local = h * part.samples.curvature(x, states, charge.slope, charge.curvature)
            slopes = scale * part.samples.slopes(x, states, charge.slope)
            local[:, -1, :] += slopes
            local[:, :, -1] += slopes
            weighed = factor * part.weight[:, None] * local[:, self._pair[0], self._pair[1]]
            entries += np.bincount(self._slot[part.samples.piece].ravel(), weighed.ravel(), len(entries))
        first = 0
        for part in self.rows.linear:
            n, p = len(part.least), part.power
            share, first = multipliers[first : first + n], first + n
            if p == 0:
                continue
            weighed = share[part.pattern.row] * part.entry / h**p
            cross = -p * weighed * scale / h
            entries += np.bincount(self._time_slot[part.pattern.column], cross, len(entries))
            total = float(weighed @ x[part.pattern.column])
            entries[self._time_slot[-1]] += p * (p + 1) * total * (scale / h) ** 2
        return entries
