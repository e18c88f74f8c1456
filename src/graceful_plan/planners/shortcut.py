"""Cost-aware shortcutting: local changes of a path, each applied only if it lowers the total cost J.

Shortcutting by length alone would undo detours around entities that a failure could hit. There are four moves, each a
replacement of the stretch between two vertices: leave out vertices, cut straight between two points, straighten a
single joint, move a point aside. All candidates of a round are evaluated in one batch.

References:
    [Geraerts2007] Creating high-quality paths for motion planning, Sec. 4 (partial shortcut). Differs in: the
    criterion is the total cost, and moves aside may lengthen the path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem
from graceful_plan.planners.planner import Budget
from graceful_plan.setting_checks import count, fraction, positive_or_none

_NEGLIGIBLE = 1e-9
"""Relative gain below which a change is rounding, not an improvement."""
_TINY = 1e-300


@final
@dataclass(frozen=True)
class Replacement:
    """New vertices for the stretch from vertex `first` to vertex `last`; `q` begins and ends with these vertices."""

    first: int
    last: int
    q: Float[Array, "vertex nq"]


@final
class Line:
    """A path with its arc length.

    Args:
        q: Vertices.
        cost: Total cost of each segment.
    """

    def __init__(self, q: Float[Array, "vertex nq"], cost: Float[Array, " segment"]) -> None:
        self.q, self.cost = q, cost
        self.arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])

    def at(self, s: Float[Array, " n"]) -> tuple[Int[Array, " n"], Float[Array, "n nq"]]:
        """Return segment and point at each arc length [rad]."""
        i = np.clip(np.searchsorted(self.arc, s, side="right") - 1, 0, len(self.q) - 2)
        t = ((s - self.arc[i]) / np.maximum(self.arc[i + 1] - self.arc[i], _TINY))[:, None]
        return i, (1.0 - t) * self.q[i] + t * self.q[i + 1]

    def stretches(self, n: int, reach: float, rng: np.random.Generator) -> Stretches:
        """Return n random stretches of 0.5 to 1 times `reach` times the length of the path."""
        span = reach * self.arc[-1] * rng.uniform(0.5, 1.0, n)
        begin = rng.uniform(0.0, 1.0, n) * (self.arc[-1] - span)
        return Stretches(begin, begin + span, *self.at(begin), *self.at(begin + span))

    def replacement(self, i: int, a: Array, middle: Array, j: int, b: Array) -> Replacement:
        """Return a replacement from point `a` on segment `i` via `middle` to point `b` on segment `j`."""
        q = np.concatenate([self.q[i : i + 1], a[None], middle, b[None], self.q[j + 1 : j + 2]])
        return Replacement(i, j + 1, q)


class Stretches(NamedTuple):
    """Stretches of a path: arc length, segment and point of both ends."""

    begin: Float[Array, " n"]
    end: Float[Array, " n"]
    first: Int[Array, " n"]
    a: Float[Array, "n nq"]
    last: Int[Array, " n"]
    b: Float[Array, "n nq"]


Move = Callable[[Line, int, float, np.random.Generator], list[Replacement]]
"""Proposes about n replacements of stretches; `reach` is their length as a fraction of the path."""


def leave_out(line: Line, n: int, reach: float, rng: np.random.Generator) -> list[Replacement]:
    """Connect non-adjacent vertices: half of the proposals skip as few vertices as possible, half any number."""
    first, last = np.triu_indices(len(line.q), k=2)
    order = np.argsort(last - first, kind="stable")
    near, rest = order[: max(n // 2, len(line.q) - 2)], order[max(n // 2, len(line.q) - 2) :]
    picked = np.concatenate([near, rng.permutation(rest)[: n // 2]])
    return [Replacement(int(i), int(j), line.q[[i, j]]) for i, j in zip(first[picked], last[picked], strict=True)]


def cut(line: Line, n: int, reach: float, rng: np.random.Generator) -> list[Replacement]:
    """Go straight between two points anywhere on the path."""
    nothing = line.q[:0]
    parts = line.stretches(n, reach, rng)
    ends = zip(parts.first.tolist(), parts.a, parts.last.tolist(), parts.b, strict=True)
    return [line.replacement(i, a, nothing, j, b) for i, a, j, b in ends if i != j]


def straighten_joint(line: Line, n: int, reach: float, rng: np.random.Generator) -> list[Replacement]:
    """Interpolate one joint linearly between two points; the other joints are unchanged."""
    proposals = []
    parts = line.stretches(n, reach, rng)
    joints = rng.integers(line.q.shape[1], size=n)
    for s0, s1, i, a, j, b, joint in zip(*parts, joints, strict=True):
        if i != j:
            middle = line.q[i + 1 : j + 1].copy()
            middle[:, joint] = a[joint] + (line.arc[i + 1 : j + 1] - s0) / (s1 - s0) * (b[joint] - a[joint])
            proposals.append(line.replacement(int(i), a, middle, int(j), b))
    return proposals


def move_aside(line: Line, n: int, reach: float, rng: np.random.Generator) -> list[Replacement]:
    """Replace a stretch by straight lines via one of its points, moved in a random direction."""
    parts = line.stretches(n, reach, rng)
    span = parts.end - parts.begin
    _, points = line.at(parts.begin + rng.uniform(size=n) * span)
    direction = rng.normal(size=points.shape)
    direction *= (0.5 * span * 10.0 ** rng.uniform(-2.0, 0.0, n) / np.linalg.norm(direction, axis=1))[:, None]
    moved = zip(parts.first.tolist(), parts.a, points + direction, parts.last.tolist(), parts.b, strict=True)
    return [line.replacement(i, a, point[None], j, b) for i, a, point, j, b in moved]


MOVES: tuple[Move, ...] = (leave_out, move_aside, cut, move_aside, straighten_joint, move_aside)
"""Moves of successive rounds; `move_aside` is the most frequent, since only it can leave the hull of the path."""


@final
@dataclass(frozen=True, kw_only=True)
class Shortcut:
    """Settings of shortcutting, which several planners use. One iteration is one round of one move."""

    candidates: int = 24
    """Replacements proposed per round."""
    patience: int = 40
    """Number of consecutive rounds without an improvement after which it stops."""
    least_gain: float = 1e-4
    """Relative decrease of J that counts as an improvement for `patience`."""
    least_reach: float = 0.02
    """Length of the shortest stretches, as a fraction of the path; the longest stretch is the whole path."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        count("candidates", self.candidates)
        count("patience", self.patience)
        fraction("least_gain", self.least_gain)
        positive_or_none("least_reach", self.least_reach)
        fraction("least_reach", self.least_reach)

    def improve(
        self, path: Path, questions: InterruptibleProblem, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield versions of a free path with decreasing cost; nothing if the budget is too small to find one."""
        with suppress(Interrupted):
            yield from self._rounds(path, questions, budget, rng)

    def _rounds(
        self, path: Path, questions: InterruptibleProblem, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        q = path.without_duplicates().q
        if len(q) < 2:
            return
        line = Line(q, questions.edge_costs(q[:-1], q[1:]))
        idle = round_ = 0
        while idle < self.patience and budget.spend():
            reach = self.least_reach ** rng.uniform()
            proposals = MOVES[round_ % len(MOVES)](line, self.candidates, reach, rng)
            better = apply_best(line, proposals, questions)
            round_, idle = round_ + 1, idle + 1
            if better is None:
                continue
            if better.cost.sum() < line.cost.sum() * (1.0 - self.least_gain):
                idle = 0
            line = better
            yield Path(line.q)


def first_and_shorter(
    find: Callable[[InterruptibleProblem, np.random.Generator], Path | None],
    shortcut: Shortcut | None,
    questions: InterruptibleProblem,
    rng: np.random.Generator,
) -> Iterator[Path]:
    """Yield the first path that is found, then cheaper versions of it until the budget ends.

    Args:
        find: Searches for a path until the budget ends.
        shortcut: Settings of shortcutting; None for no shortcutting.
        questions: Access to problem, objective and budget.
        rng: Random numbers.
    """
    with suppress(Interrupted):
        path = find(questions, rng)
        if path is None:
            return
        yield path
        if shortcut is not None:
            yield from shortcut.improve(path, questions, questions.budget, rng)


def apply_best(line: Line, proposals: list[Replacement], questions: InterruptibleProblem) -> Line | None:
    """Apply the free, non-overlapping replacements that lower J most; return None if there are none."""
    if not proposals:
        return None
    q0 = np.concatenate([p.q[:-1] for p in proposals])
    q1 = np.concatenate([p.q[1:] for p in proposals])
    begin = np.cumsum([0] + [len(p.q) - 1 for p in proposals])
    cost = questions.edge_costs(q0, q1)
    before = np.concatenate([[0.0], np.cumsum(line.cost)])
    gain = np.array([before[p.last] - before[p.first] for p in proposals]) - np.add.reduceat(cost, begin[:-1])
    order = np.argsort(-gain, kind="stable")
    order = order[gain[order] > _NEGLIGIBLE * before[-1]]
    taken: list[int] = []
    for k, free in zip(order, _are_free(proposals, order, begin, q0, q1, questions), strict=True):
        apart = all(proposals[k].last <= proposals[t].first or proposals[k].first >= proposals[t].last for t in taken)
        if free and apart:
            taken.append(int(k))
    if not taken:
        return None
    return Line(*replaced(line.q, line.cost, [(proposals[k], cost[begin[k] : begin[k + 1]]) for k in taken]))


def _are_free(
    proposals: list[Replacement], order: Array, begin: Array, q0: Array, q1: Array, questions: InterruptibleProblem
) -> list[bool]:
    """Return which proposals are free, in the order of `order`; all are checked in one batch."""
    if len(order) == 0:
        return []
    problem = questions.problem
    inside = [bool(np.all((proposals[k].q >= problem.lower) & (proposals[k].q <= problem.upper))) for k in order]
    edges = np.concatenate([np.arange(int(begin[k]), int(begin[k + 1])) for k in order])
    free = questions.edges_free(q0[edges], q1[edges])
    ends = np.cumsum([begin[k + 1] - begin[k] for k in order])[:-1]
    return [ok and bool(part.all()) for ok, part in zip(inside, np.split(free, ends), strict=True)]


def replaced(
    q: Float[Array, "vertex nq"], cost: Float[Array, "*edge"], taken: list[tuple[Replacement, Array]]
) -> tuple[Float[Array, "vertex2 nq"], Float[Array, "*edge2"]]:
    """Apply non-overlapping replacements, each with the costs of its edges; return vertices and edge costs."""
    parts, costs, at = [q[:1]], [], 0
    for new, new_cost in sorted(taken, key=lambda pair: pair[0].first):
        parts += [q[at + 1 : new.first + 1], new.q[1:]]
        costs += [cost[at : new.first], new_cost]
        at = new.last
    vertices, edges = np.concatenate([*parts, q[at + 1 :]]), np.concatenate([*costs, cost[at:]])
    moved = np.any(np.diff(vertices, axis=0) != 0.0, axis=1)
    return vertices[np.concatenate([[True], moved])], edges[moved]
