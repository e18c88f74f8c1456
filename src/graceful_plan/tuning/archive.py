"""Archive of candidates for a front: the non-dominated ones, and selection of a representative subset."""

from __future__ import annotations

import bisect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar, final, runtime_checkable

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import CostError
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import checked_costs
from graceful_plan.planners.planner import BoundObjective

EdgeTest = Callable[[Array, Array], Array]
"""Returns for each straight edge between configurations [n, nq] whether it is free at the finest check: bool [n]."""

_SAME, _SAME_MOTION = 1e-6, 1e-9
"""Relative differences of impact and of motion below which values count as equal."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A free path and its cost.

    Args:
        q: Vertices [rad or m].
        edges: Motion and impact of each edge.
        made_by: Method that found it: "weight", "gap" or "roadmap".
        made_with: The weight, or the impact to undercut.
        size: Size of the random moves tried on it, relative to its length; it shrinks as the path converges.
    """

    q: Float[Array, "n nq"]
    edges: Float[Array, "edge 2"]
    made_by: str
    made_with: float
    size: float = 0.05
    cost: Float[Array, " 2"] = field(init=False)
    """Motion and impact."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cost", self.edges.sum(axis=0) if len(self.edges) else np.zeros(2))

    @classmethod
    def of(cls, path: Path, objective: BoundObjective, made_by: str, made_with: float) -> Candidate:
        """Evaluate the cost of a path.

        Raises:
            CostError: If the objective returns a NaN, an infinity or a negative number.
        """
        q = path.without_duplicates().q
        edges = edge_costs(objective, q[:-1], q[1:])
        return cls(q=q, edges=edges, made_by=made_by, made_with=made_with)

    def moved_to(self, q: Float[Array, "n nq"], edges: Float[Array, "edge 2"]) -> Candidate:
        """Return the candidate with a changed path."""
        return replace(self, q=q, edges=edges)


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """A candidate with a target: less motion and impact inside a box, or less V + w S.

    Args:
        candidate: The initial candidate.
        corner: Motion and impact at the upper corner of the box.
        weight: w, if V + w S is the target.
    """

    candidate: Candidate
    corner: Float[Array, " 2"]
    weight: float | None = None

    def merit(self, cost: Float[Array, "n 2"]) -> Float[Array, " n"]:
        """Return the area between costs and the corner of the box."""
        room = np.maximum(self.corner - cost, 0.0)
        return room[:, 0] * room[:, 1]


def edge_costs(objective: BoundObjective, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
    """Evaluate motion and impact of edges, and check them.

    Raises:
        CostError: If the objective returns a NaN, an infinity or a negative number.
    """
    if len(q0) == 0:
        return np.zeros((0, 2))
    costs = np.asarray(checked_costs(objective, "edges", objective.edges(q0, q1)), dtype=np.float64)
    if costs.shape != (len(q0), 2):
        raise CostError(objective, f"edges must have shape ({len(q0)}, 2), not {costs.shape}")
    return costs


@runtime_checkable
class Costed(Protocol):
    """An object with a cost, which can be on a front."""

    @property
    def cost(self) -> Float[Array, " 2"]:
        """Motion and impact."""
        ...


C = TypeVar("C", bound=Costed)


@final
class Archive(Generic[C]):
    """The non-dominated candidates, sorted by motion."""

    def __init__(self) -> None:
        self.candidates: list[C] = []
        self._motion: list[float] = []

    def __len__(self) -> int:
        return len(self.candidates)

    @property
    def costs(self) -> Float[Array, "n 2"]:
        """Motion and impact of each candidate."""
        return np.array([c.cost for c in self.candidates]).reshape(-1, 2)

    def offer(self, candidate: C) -> bool:
        """Add a candidate and drop those it dominates, unless another is at least as good; return if it was added."""
        motion, impact = candidate.cost.tolist()
        at = bisect.bisect_right(self._motion, motion)
        if at and self.candidates[at - 1].cost[1] <= impact * (1.0 + _SAME):
            return False
        begin = bisect.bisect_left(self._motion, motion * (1.0 - _SAME_MOTION))
        end = begin
        while end < len(self.candidates) and self.candidates[end].cost[1] >= impact:
            end += 1
        self.candidates[begin:end] = [candidate]
        self._motion[begin:end] = [motion]
        return True

    def drop(self, candidate: C) -> None:
        """Remove a candidate, for example one that the judge rejects."""
        at = next(i for i, other in enumerate(self.candidates) if other is candidate)
        del self.candidates[at], self._motion[at]

    def best_for(self, w: float) -> C:
        """Return the candidate with the least V + w S."""
        return self.candidates[int(np.argmin(self.costs @ np.array([1.0, w])))]

    def chosen(self, count: int) -> list[C]:
        """Return a subset of at most `count` candidates that represents the front best; see `best_subset`."""
        return [self.candidates[i] for i in best_subset(self.costs, count)]


def scaled(costs: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
    """Scale both axes of a front to 0 to 1, with the impact half linear and half logarithmic.

    Impact falls by two orders of magnitude along many fronts. On a linear axis the lower half would vanish, although
    it matters just as much for a target impact.
    """
    motion, impact = costs[:, 0], costs[:, 1]
    span = max(float(np.ptp(motion)), 1e-300), max(float(impact.max()), 1e-300)
    floor = max(float(impact.min()), 1e-3 * span[1])
    logarithm = np.log1p(impact / floor)
    logarithm = (logarithm - logarithm.min()) / max(float(np.ptp(logarithm)), 1e-300)
    return np.column_stack([(motion - motion.min()) / span[0], 0.5 * (impact / span[1] + logarithm)])


def best_subset(costs: Float[Array, "n 2"], count: int) -> list[int]:
    """Return the points of a front, sorted by motion, whose dominated area on `scaled` axes is largest; exact.

    Both ends are always included.
    """
    n = len(costs)
    if n <= count:
        return list(range(n))
    if count < 2:
        return [0][:count]
    x, y = scaled(costs).T
    area = (x[None, :] - x[:, None]) * (1.1 - y[:, None])  # strip from a point to the next
    area[np.tril_indices(n)] = -np.inf
    best = np.full(n, -np.inf)
    best[0] = 0.0
    before: list[Int[Array, " n"]] = []
    for _ in range(count - 1):
        reached = best[:, None] + area
        before.append(np.argmax(reached, axis=0))
        best = reached[before[-1], np.arange(n)]
    picked = [n - 1]
    for step in reversed(before):
        picked.append(int(step[picked[-1]]))
    return picked[::-1]


def widest_gaps(costs: Float[Array, "n 2"], count: int) -> Sequence[int]:
    """Return the points of a front, sorted by motion, after which the largest gaps lie on `scaled` axes."""
    if len(costs) < 2:
        return []
    steps = np.abs(np.diff(scaled(costs), axis=0))
    return np.argsort(-steps[:, 0] * steps[:, 1], kind="stable")[:count].tolist()


def coarse_to_fine(n: int) -> list[int]:
    """Order 0 to n - 1 from coarse to fine: both ends, the middle, the middles of the halves, and so on."""
    order, step = [0, n - 1] if n > 1 else list(range(n)), 1
    while len(order) < n:
        step *= 2
        order += [i for i in (round((n - 1) * k / step) for k in range(1, step, 2)) if i not in order]
    return order
