r"""Batched gradient descent of all paths of a front.

Each path has a box (see `refine`) or a weight, and minimises

.. math:: f = -\log(V_\mathrm{box} - V) - \log(S_\mathrm{box} - S) \quad\mathrm{or}\quad f = \log(V + w S)

by L-BFGS in the metric of smooth paths, as in CHOMP. Each path has its own step size and its own memory; all paths are
evaluated in one call of the kernel.

References:
    J. Nocedal, "Updating quasi-Newton matrices with limited storage", Mathematics of Computation 1980.
    M. Zucker et al., "CHOMP: covariant Hamiltonian optimization for motion planning", IJRR 2013 (the metric).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path, evenly
from graceful_plan.planners.interruptible import Interrupted, checked_costs, out_of_time
from graceful_plan.planners.planner import Budget, DifferentiableObjective, Problem
from graceful_plan.tuning.archive import Candidate, EdgeTest, Target

EDGES = 24
"""Edges of every path."""
_MEMORY = 8
_SLICE = 192
"""Edges that are evaluated between two checks of the time."""
_THREADS = 2
_FIRST_STEP = 0.01
"""Largest displacement of the first step, relative to the length of the path."""
_LARGEST_STEP = 0.1
_SHRINK = 0.3
_FAILURES = 4
"""Consecutive unsuccessful steps after which a path stops."""
_SETTLED = 1e-4
"""Decrease of f below which a step counts as unsuccessful; f is logarithmic, so this is a relative change of cost."""
_ARMIJO = 1e-4


def descend(
    members: Sequence[Target],
    problem: Problem,
    objective: DifferentiableObjective,
    certain: EdgeTest,
    budget: Budget,
    steps: int,
) -> list[Candidate]:
    """Descend and return the candidates that improved; one iteration is one step of all candidates.

    Args:
        members: Candidates with their targets.
        problem: Limits.
        objective: Costs at weight 1, with path length as motion.
        certain: Returns which edges are free at the finest check.
        budget: Time and iterations.
        steps: Largest number of steps.
    """
    found = [_evened(member, certain) for member in members]
    kept = [(member, q) for member, q in zip(members, found, strict=True) if q is not None]
    if not kept:
        return []
    batch = _Batch([m for m, _ in kept], np.array([q for _, q in kept]), problem, objective, certain, budget)
    # A scene's kernels are thread-safe; user-defined objectives need not be.
    with ThreadPoolExecutor(_THREADS) if isinstance(objective, SceneObjective) else nullcontext() as batch.pool:
        try:
            for _ in range(steps):
                if not np.any(batch.alive) or not budget.spend():
                    break
                batch.step()
        except Interrupted:
            pass
    return batch.candidates()


def _evened(member: Target, certain: EdgeTest) -> Float[Array, "n nq"] | None:
    """Return evenly spaced vertices; None if the path has no length or the new edges are not free."""
    path = Path(member.candidate.q)
    if len(path) < 2 or path.length == 0.0:
        return None
    if len(path) == EDGES + 1:
        return path.q  # spaced by an earlier descent
    q = evenly(path.q, EDGES + 1)
    return q if np.all(certain(q[:-1], q[1:])) else None


@final
class _Batch:
    """Paths with the same number of vertices, their costs and the L-BFGS memory of each."""

    def __init__(
        self,
        members: Sequence[Target],
        q: Float[Array, "path vertex nq"],
        problem: Problem,
        objective: DifferentiableObjective,
        certain: EdgeTest,
        budget: Budget,
    ) -> None:
        self.members, self.q, self.problem, self.certain = members, q, problem, certain
        self.objective, self.budget = objective, budget
        self.corner = np.array([member.corner for member in members])
        self.weight = np.array([np.nan if member.weight is None else member.weight for member in members])
        inner = EDGES - 1
        stiffness = 2.0 * np.eye(inner) - np.eye(inner, k=1) - np.eye(inner, k=-1)
        self.smooth = np.linalg.inv(stiffness)
        self.length = np.linalg.norm(np.diff(q, axis=1), axis=2).sum(axis=1)
        self.value = np.full(len(q), np.inf)
        self.edges = np.zeros((len(q), EDGES, 2))
        self.gradient = np.zeros_like(q[:, 1:-1])
        self.alive = np.ones(len(q), dtype=bool)
        self.moved = np.zeros(len(q), dtype=bool)
        self.failures = np.zeros(len(q), dtype=int)
        self.scale = np.ones(len(q))
        self.pairs: list[tuple[Array, Array, Array]] = []
        self.pool: ThreadPoolExecutor | None = None

    def step(self) -> None:
        """Move every active path by one step; reduce the step size of paths that do not improve."""
        if not np.any(np.isfinite(self.value)):
            rows = np.arange(len(self.q))
            self.value, self.edges, self.gradient = self._evaluated(self.q, rows)
            self.alive &= np.isfinite(self.value)
            return
        rows = np.flatnonzero(self.alive)
        direction = self._direction()[rows]
        slope = np.sum(direction * self.gradient[rows], axis=(1, 2))
        q = self.q[rows].copy()
        q[:, 1:-1] += self.scale[rows, None, None] * direction
        np.clip(q, self.problem.lower, self.problem.upper, out=q)
        value, edges, gradient = self._evaluated(q, rows)
        enough = value <= self.value[rows] + _ARMIJO * self.scale[rows] * np.minimum(slope, 0.0)
        better = enough & (value < self.value[rows])
        better[better] = self._free(q[better])
        self._remember(rows[better], q[better], value[better], edges[better], gradient[better])
        worse = rows[~better]
        self.failures[worse] += 1
        self.scale[worse] *= _SHRINK
        self.alive &= self.failures < _FAILURES

    def candidates(self) -> list[Candidate]:
        """Return the paths that have moved."""
        return [
            self.members[k].candidate.moved_to(self.q[k], self.edges[k]) for k in np.flatnonzero(self.moved).tolist()
        ]

    def _evaluated(
        self, q: Float[Array, "path vertex nq"], rows: Array
    ) -> tuple[Float[Array, " path"], Float[Array, "path edge 2"], Float[Array, "path inner nq"]]:
        """Evaluate f, the costs of the edges, and the derivatives of f by the inner vertices."""
        q0, q1 = q[:, :-1].reshape(-1, q.shape[2]), q[:, 1:].reshape(-1, q.shape[2])

        def asked(first: int) -> tuple[Array, Array, Array]:
            if out_of_time(self.budget):
                raise Interrupted
            part = self.objective.edge_gradients(q0[first : first + _SLICE], q1[first : first + _SLICE])
            assert part is not None, "whoever has derivatives has them everywhere"
            return part

        slices = range(0, len(q0), _SLICE)
        parts = list(map(asked, slices) if self.pool is None else self.pool.map(asked, slices))
        cost, d0, d1 = (np.concatenate(arrays).reshape(*q.shape[:1], EDGES, -1) for arrays in zip(*parts, strict=True))
        checked_costs(self.objective, "edge_gradients", cost)
        along = np.diff(q, axis=1)
        along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-300)
        d_motion = along[:, :-1] - along[:, 1:]
        d_impact = d1[:, :-1] + d0[:, 1:] - d_motion
        value, slope = self._aimed(cost.sum(axis=1), rows)
        gradient = slope[:, 0, None, None] * d_motion + slope[:, 1, None, None] * d_impact
        return value, cost, gradient

    def _aimed(self, cost: Float[Array, "path 2"], rows: Array) -> tuple[Float[Array, " path"], Float[Array, "path 2"]]:
        """Evaluate f from costs, infinite outside the box, and its derivatives by motion and impact."""
        weight = self.weight[rows]
        boxed = np.isnan(weight)
        room = np.where(boxed[:, None], self.corner[rows] - cost, 1.0)
        inside = np.all(room > 0.0, axis=1)
        room = np.where(inside[:, None], room, 1.0)
        both = np.column_stack([np.ones(len(rows)), np.where(boxed, 1.0, weight)])
        total = np.maximum(np.sum(both * cost, axis=1), 1e-300)
        value = np.where(boxed, np.where(inside, -np.log(room).sum(axis=1), np.inf), np.log(total))
        return value, np.where(boxed[:, None], 1.0 / room, both / total[:, None])

    def _direction(self) -> Float[Array, "path inner nq"]:
        """Return the L-BFGS direction of each path."""
        work = self.gradient.copy()
        shares = []
        for s, y, weight in reversed(self.pairs):
            share = weight * np.sum(s * work, axis=(1, 2))
            work -= share[:, None, None] * y
            shares.append(share)
        work = self._curvature()[:, None, None] * np.einsum("ij,kjn->kin", self.smooth, work)
        for (s, y, weight), share in zip(self.pairs, reversed(shares), strict=True):
            work += (share - weight * np.sum(y * work, axis=(1, 2)))[:, None, None] * s
        return self._limited(-work)

    def _limited(self, direction: Float[Array, "path inner nq"]) -> Float[Array, "path inner nq"]:
        largest = np.max(np.linalg.norm(direction, axis=2), axis=1)
        limit = _LARGEST_STEP * self.length
        return direction * np.minimum(1.0, limit / np.maximum(largest, 1e-300))[:, None, None]

    def _curvature(self) -> Float[Array, " path"]:
        """Return the scale of the metric: from the last step of a path, or such that its first step is small."""
        smooth = np.einsum("ij,kjn->kin", self.smooth, self.gradient)
        largest = np.max(np.linalg.norm(smooth, axis=2), axis=1)
        scale = _FIRST_STEP * self.length / np.maximum(largest, 1e-300)
        for s, y, weight in self.pairs:
            known = weight > 0.0
            bent = np.sum(y * np.einsum("ij,kjn->kin", self.smooth, y), axis=(1, 2))
            newest = np.sum(s * y, axis=(1, 2)) / np.maximum(bent, 1e-300)
            scale = np.where(known, newest, scale)
        return scale

    def _remember(self, rows: Array, q: Array, value: Array, edges: Array, gradient: Array) -> None:
        """Accept steps and store their curvature pairs."""
        s, y, weight = np.zeros_like(self.gradient), np.zeros_like(self.gradient), np.zeros(len(self.q))
        s[rows], y[rows] = q[:, 1:-1] - self.q[rows, 1:-1], gradient - self.gradient[rows]
        bend = np.sum(s * y, axis=(1, 2))
        sound = bend > 1e-10 * np.sqrt(np.sum(s * s, axis=(1, 2)) * np.sum(y * y, axis=(1, 2)))
        weight[sound] = 1.0 / bend[sound]
        s[~sound] = y[~sound] = 0.0
        self.pairs = [*self.pairs, (s, y, weight)][-_MEMORY:]
        slow = self.value[rows] - value < _SETTLED
        self.q[rows], self.value[rows], self.edges[rows], self.gradient[rows] = q, value, edges, gradient
        self.moved[rows], self.failures[rows] = True, np.where(slow, self.failures[rows] + 1, 0)
        self.scale[rows] = np.minimum(1.0, 2.0 * self.scale[rows])

    def _free(self, q: Float[Array, "path vertex nq"]) -> Bool[Array, " path"]:
        nq = q.shape[2]
        free = np.asarray(self.certain(q[:, :-1].reshape(-1, nq), q[:, 1:].reshape(-1, nq)), dtype=bool)
        return np.asarray(free.reshape(len(q), EDGES).all(axis=1))
