"""Batches of paths with the same number of points, and STOMP's weights of them at each point.

References:
    Kalakrishnan et al., "STOMP: stochastic trajectory optimization for motion planning", ICRA 2011, Table I.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.core.kernels import FINE_STEP
from graceful_plan.planners.interruptible import InterruptibleProblem
from graceful_plan.planners.planner import Problem
from graceful_plan.planners.scene_problem import SceneProblem

_FLAT = 1e-3
"""Least range of costs at a point, relative to the largest range at any point; smaller ranges are scaled as this."""
_TINY = 1e-300


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Rollouts:
    """Paths between the same ends, with the costs of their edges."""

    q: Float[Array, "rollout point nq"]
    cost: Float[Array, "rollout edge"]
    """Total cost J of each edge."""
    blocked: Bool[Array, "rollout edge"]
    """True for edges that are not free."""

    @staticmethod
    def asked(q: Float[Array, "rollout point nq"], questions: InterruptibleProblem) -> Rollouts:
        """Evaluate paths, all in one batch.

        Raises:
            Interrupted: If the time is over.
        """
        q0, q1 = (part.reshape(-1, q.shape[2]) for part in (q[:, :-1], q[:, 1:]))
        shape = len(q), q.shape[1] - 1
        free = questions.edges_free(q0, q1).reshape(shape)
        return Rollouts(q=q, cost=questions.edge_costs(q0, q1).reshape(shape), blocked=~free)

    @staticmethod
    def joined(parts: Sequence[Rollouts]) -> Rollouts:
        """Concatenate batches."""
        return Rollouts(
            q=np.concatenate([part.q for part in parts]),
            cost=np.concatenate([part.cost for part in parts]),
            blocked=np.concatenate([part.blocked for part in parts]),
        )

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, which: slice | Int[Array, " n"]) -> Rollouts:
        return Rollouts(q=self.q[which], cost=self.cost[which], blocked=self.blocked[which])

    def best(self, n: int) -> Rollouts:
        """Return the best n paths, the best first: by number of blocked edges, then by cost."""
        return self[np.lexsort((self.cost.sum(axis=1), self.blocked.sum(axis=1)))[:n]]

    def with_first_finely_checked(self, problem: Problem) -> Rollouts:
        """Check the first path at the fine step of results; return self if that does not change its blocked edges."""
        if finely_checked(problem) is problem or self.blocked[0].any():
            return self
        free = finely_checked(problem).edges_free(self.q[0, :-1], self.q[0, 1:])
        if free.all():
            return self
        blocked = self.blocked.copy()
        blocked[0] = ~free
        return replace(self, blocked=blocked)

    def beats(self, other: Rollouts, gain: float) -> bool:
        """Return whether the first path is better than the first path of another batch.

        It is better if it has fewer blocked edges, or as many and a cost lower by more than the fraction `gain`.
        """
        mine, yours = int(self.blocked[0].sum()), int(other.blocked[0].sum())
        return mine < yours or (mine == yours and bool(self.cost[0].sum() < other.cost[0].sum() * (1.0 - gain)))


def finely_checked(problem: Problem) -> Problem:
    """Return the problem with edge checks at the fine step of results."""
    return replace(problem, check_step=FINE_STEP) if isinstance(problem, SceneProblem) else problem


def weights(rollouts: Rollouts, spread: Float[Array, "point point"], sharpness: float) -> Float[Array, "rollout point"]:
    r"""Return the weight of each rollout at each inner point.

    .. math:: P_{k,t} \propto \exp\Bigl(-h \frac{S_{k,t} - \min_k S_{k,t}}{\max_k S_{k,t} - \min_k S_{k,t}}\Bigr)

    The cost of a point is half the cost of the two edges at it. Blocked paths score worse than all free ones, by a
    bounded amount: an unbounded penalty would hide the differences between free paths.

    Args:
        rollouts: The paths.
        spread: Averaging matrix: the cost at a point is averaged over its neighbours, with rows that sum to 1.
        sharpness: Exponent h.
    """
    cost = _at_points(rollouts.cost) @ spread.T
    blocked = _at_points(rollouts.blocked.astype(np.float64)) @ spread.T
    free = _at_points(rollouts.blocked.astype(np.float64)) == 0.0
    counted = free | ~free.any(axis=0)
    low = np.where(counted, cost, np.inf).min(axis=0)
    width = np.where(counted, cost, -np.inf).max(axis=0) - low
    width = np.maximum(width, max(_FLAT * width.max(), _TINY))
    score = np.clip(cost - low, 0.0, width) / width
    score += blocked / np.maximum(blocked.max(axis=0), _TINY) + 2.0 * ~free
    weight = np.exp(-sharpness * (score - score.min(axis=0)))
    return weight / weight.sum(axis=0)


def _at_points(edge: Float[Array, "rollout edge"]) -> Float[Array, "rollout point"]:
    return 0.5 * (edge[:, :-1] + edge[:, 1:])
