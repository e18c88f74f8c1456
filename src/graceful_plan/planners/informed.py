"""Informed sampling: a lower bound of cost per length, and samples only where a better path can pass.

If a path costs at least `bound` per unit of length, a path cheaper than J through q satisfies
bound * (|q - start| + |goal - q|) < J: q lies in a prolate hyperspheroid around start and goal.

References:
    [Gammell2014] Informed RRT*: Optimal sampling-based path planning focused via direct sampling of an
    admissible ellipsoidal heuristic. Differs in: several goals, any cost bounded from below by length.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import lgamma, log, pi
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.planners.interruptible import checked_costs
from graceful_plan.planners.planner import BoundObjective, Problem, edge_totals

_PROBES = 24
_REJECTION_ROUNDS = 30


@final
@dataclass(frozen=True)
class ObjectiveBounds:
    """Properties of an objective that a planner may rely on.

    Args:
        length_bound: Lower bound of the cost per unit of joint-space length; 0 if it is unknown.
        symmetric: Whether an edge costs the same in both directions.
    """

    length_bound: float
    symmetric: bool


def probe_objective(objective: BoundObjective, problem: Problem) -> ObjectiveBounds:
    """Determine the properties of an objective from probes, since its contract guarantees none.

    The motion cost of edges of various places, directions and lengths, including the joint axes, is compared with their
    length. If the ratio is the same for all edges, it is the bound: V is this multiple of the length, and S >= 0. In
    all other cases the bound is 0, which is always valid.

    Raises:
        CostError: If the objective returns a NaN, an infinity or a negative number.
    """
    rng = np.random.default_rng(0)  # the same probes in every call; independent of the planner's random numbers
    nq = len(problem.start)
    q0 = rng.uniform(problem.lower, problem.upper, (_PROBES + nq, nq))
    q1 = rng.uniform(problem.lower, problem.upper, (_PROBES + nq, nq))
    q1[:nq] = np.where(np.eye(nq, dtype=bool), q1[:nq], q0[:nq])
    q1 = q0 + rng.uniform(0.01, 0.3, (len(q0), 1)) * (q1 - q0)
    length = np.linalg.norm(q1 - q0, axis=1)
    moved = length > 0.0
    if not moved.any():
        return ObjectiveBounds(length_bound=0.0, symmetric=False)
    cost = objective.edges(q0, q1)
    forward = checked_costs(objective, "edge costs", cost[:, 0] + objective.w * cost[:, 1])
    ratio = cost[moved, 0] / length[moved]
    proportional = ratio.max() - ratio.min() <= 1e-9 * ratio.max()
    backward = edge_totals(objective, q1, q0)
    return ObjectiveBounds(
        # slightly below the measured ratio, so that rounding never excludes the optimum
        length_bound=float(ratio.min()) * (1.0 - 1e-9) if proportional else 0.0,
        symmetric=bool(np.allclose(forward, backward, rtol=1e-9, atol=1e-12)),
    )


@final
class InformedSampler:
    """Draws configurations uniformly from the region where a path cheaper than a given cost can pass.

    Args:
        problem: Problem with start, goals and limits.
        length_bound: Lower bound of the cost per unit of length; 0 samples the whole space.
    """

    def __init__(self, problem: Problem, length_bound: float) -> None:
        self.problem, self.length_bound = problem, length_bound
        self.start, self.goals = np.asarray(problem.start), np.asarray(problem.goals)
        self.focal = np.linalg.norm(self.goals - self.start, axis=1)
        self.frames = [_frame(goal - self.start) for goal in self.goals]

    @property
    def least_cost(self) -> float:
        """Lower bound of the cost of any path."""
        return self.length_bound * float(self.focal.min())

    def bound_through(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        """Return a lower bound of the cost of any path through each configuration to any goal."""
        if self.length_bound == 0.0:
            return np.zeros(len(q))
        to_goal = np.linalg.norm(q[:, None, :] - self.goals, axis=2).min(axis=1)
        return self.length_bound * (np.linalg.norm(q - self.start, axis=1) + to_goal)

    def box(self, cost: float) -> tuple[Float[Array, " nq"], Float[Array, " nq"]]:
        """Return the corners of a box, inside the limits, that contains all paths cheaper than `cost`."""
        if self.length_bound == 0.0 or not np.isfinite(cost):
            return self.problem.lower, self.problem.upper
        length = cost / self.length_bound
        corners = []
        for goal, focal, frame in zip(self.goals, self.focal, self.frames, strict=True):
            axes = np.full(len(goal), np.sqrt(max(0.0, length**2 - focal**2)) / 2.0)
            axes[0] = length / 2.0
            half = np.linalg.norm(frame * axes, axis=1) * (focal <= length)
            corners.append(((self.start + goal) / 2.0 - half, (self.start + goal) / 2.0 + half))
        lower, upper = np.min([low for low, _ in corners], axis=0), np.max([high for _, high in corners], axis=0)
        return np.maximum(self.problem.lower, lower), np.minimum(self.problem.upper, upper)

    def draw(self, n: int, cost: float, rng: np.random.Generator) -> Float[Array, "drawn nq"]:
        """Draw at most `n` configurations that can lie on a path cheaper than `cost`; fewer if they are rare.

        Every other sample is projected onto the constraints. Random samples hardly ever satisfy a thin constraint.
        With a wide one, projected samples accumulate at its border and edges between them violate it, so half of the
        samples are left as they are.
        """
        q = self._drawn(n, cost, rng)
        q[::2] = self.problem.projected(q[::2])
        return q

    def _drawn(self, n: int, cost: float, rng: np.random.Generator) -> Float[Array, "drawn nq"]:
        lower, upper = self.problem.lower, self.problem.upper
        if self.length_bound == 0.0 or not np.isfinite(cost):
            return rng.uniform(lower, upper, (n, len(lower)))
        length = cost / self.length_bound
        open_goals = np.flatnonzero(self.focal < length)
        if len(open_goals) == 0:
            return np.zeros((0, len(lower)))
        sizes = np.array([_log_size(self.focal[g], length, len(lower)) for g in open_goals])
        whole = np.log(np.maximum(upper - lower, 1e-300)).sum() < np.logaddexp.reduce(sizes)
        share = np.exp(sizes - sizes.max())
        kept: list[Array] = []
        for _ in range(_REJECTION_ROUNDS):
            if whole:
                q = rng.uniform(lower, upper, (n, len(lower)))
                kept.append(q[self.bound_through(q) < cost])
            else:
                chosen = open_goals[rng.choice(len(open_goals), n, p=share / share.sum())]
                kept.append(self._from_spheroids(chosen, length, rng))
            if sum(map(len, kept)) >= n:
                break
        return np.concatenate(kept)[:n]

    def _from_spheroids(self, chosen: Array, length: float, rng: np.random.Generator) -> Array:
        ball = _unit_ball(len(chosen), len(self.start), rng)
        q = np.empty_like(ball)
        for g in np.unique(chosen):
            here = chosen == g
            minor = np.sqrt(max(0.0, length**2 - self.focal[g] ** 2)) / 2.0
            axes = np.full(len(self.start), minor)
            axes[0] = length / 2.0
            q[here] = (ball[here] * axes) @ self.frames[g].T + (self.start + self.goals[g]) / 2.0
        inside = np.all((q >= self.problem.lower) & (q <= self.problem.upper), axis=1)
        overlap = (
            np.linalg.norm(q - self.start, axis=1)[:, None] + np.linalg.norm(q[:, None, :] - self.goals, axis=2)
            <= length
        ).sum(axis=1)
        # a point inside k spheroids is drawn k times too often
        return q[inside & (rng.uniform(size=len(q)) * np.maximum(1, overlap) < 1.0)]


def _frame(direction: Float[Array, " nq"]) -> Float[Array, "nq nq"]:
    """Return orthonormal columns, the first along `direction`."""
    nq = len(direction)
    norm = np.linalg.norm(direction)
    if norm == 0.0:
        return np.eye(nq)
    columns = np.eye(nq)
    pivot = int(np.argmax(np.abs(direction)))
    columns[:, [0, pivot]] = columns[:, [pivot, 0]]
    columns[:, 0] = direction / norm
    q, r = np.linalg.qr(columns)
    return q * np.sign(np.diag(r))


def _log_size(focal: float, length: float, nq: int) -> float:
    """Return the logarithm of the volume of a spheroid."""
    minor = max(length**2 - focal**2, 1e-300)
    ball = 0.5 * nq * log(pi) - lgamma(0.5 * nq + 1.0)
    return ball + log(length / 2.0) + (nq - 1) * (0.5 * log(minor) - log(2.0))


def _unit_ball(n: int, nq: int, rng: np.random.Generator) -> Float[Array, "n nq"]:
    direction = rng.normal(size=(n, nq))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * rng.uniform(size=(n, 1)) ** (1.0 / nq)
