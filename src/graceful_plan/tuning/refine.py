r"""Refinement of a whole front: moves of its paths that enlarge the area that the front dominates.

A weighted sum cannot hold a path in a concave part of the front: it slides to one end of that part. Therefore each
path has a box, whose corner is the motion of its right neighbour and the impact of its left neighbour. Moves are
accepted if they enlarge

.. math:: (V_\mathrm{box} - V)\,(S_\mathrm{box} - S),

its contribution to the dominated area. A path thus minimises motion under a bound on impact and impact under a bound
on motion; the bounds follow its neighbours, and the paths spread out. Paths from both sides are sent into the widest
gaps. With derivatives, all paths first descend together (`descent`). Random moves, batched per round, do the rest:
they change the number of vertices, slide along obstacles, and jump.

References:
    N. Beume, B. Naujoks and M. Emmerich, "SMS-EMOA: multiobjective selection based on dominated hypervolume", EJOR
        2007.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.path import Path
from graceful_plan.planners.interruptible import out_of_time
from graceful_plan.planners.planner import BoundObjective, Budget, DifferentiableObjective, Problem
from graceful_plan.planners.shortcut import Line, Replacement, cut, leave_out, move_aside, replaced, straighten_joint
from graceful_plan.tuning.archive import Archive, Candidate, EdgeTest, Target, edge_costs, widest_gaps
from graceful_plan.tuning.descent import descend
from graceful_plan.tuning.front_problem import FrontProblem
from graceful_plan.tuning.points import dominated_area

WEIGHTS = 0.02, 100.0
"""Range of weights, relative to the motion of the shortest path over its impact."""
_WEIGHTS = 16
"""Number of these weights at which the paths of a front descend."""
_ASIDE = 4.0
"""Ratio of the neighbouring weights whose best paths also start a descent."""
_STEPS = 40
"""Gradient steps between two evaluations of the whole front."""
_ROUNDS, _ROUNDS_ALONE = 8, 32
"""Rounds of random moves between two evaluations, after a descent and without one."""
_TURN = 3
"""Largest number of evaluations in a turn."""
_PATIENCE, _GAIN = 2, 3e-4
"""A turn ends after this many evaluations in a row with a smaller relative gain of the area than this."""
_PROPOSALS = 8
"""Moves of each path per round."""
_CHUNK = 6
"""Number of paths whose moves are evaluated in one batch."""
_VERTICES = 24
"""Approximate number of vertices of a path for random moves."""
_WIDE = 2
"""Reach of the boxes in descents: spacing the vertices of a path evenly increases its cost slightly."""
_RIM = 0.1
"""Extension of a box beyond a gap, relative to its sides."""
_BEYOND = 1.1
"""Corner of the boxes at both ends of a front, relative to its largest costs."""
_EPS = 1e-9
"""Relative growth of an area that counts as rounding."""


@final
class Refinement:
    """Improves the candidates of an archive turn by turn.

    One iteration is one gradient step of all paths, or one round of random moves.

    Args:
        sought: The problem; its costs are evaluated at weight 1.
        archive: Initial candidates; improved candidates are added to it.
        budget: Time and iterations.
        rng: Random numbers.
        capacity: Number of candidates refined at a time, not counting those sent into gaps.
    """

    def __init__(
        self, sought: FrontProblem, archive: Archive[Candidate], budget: Budget, rng: np.random.Generator, capacity: int
    ) -> None:
        self.problem, self.objective, self.certain = sought.problem, sought.objective_at(1.0), sought.certain
        self.archive, self.budget, self.rng, self.capacity = archive, budget, rng, capacity
        self.smooth = _has_derivatives(self.objective, self.problem)

    def turn(self, found: Sequence[Candidate], rounds: int = _TURN) -> Iterator[None]:
        """Improve new candidates and then the whole front, as long as that helps; yields between the steps.

        Args:
            found: Candidates of a sweep. They need not be in the archive; once refined, some may enter it.
            rounds: Largest number of rounds, after which the search for new candidates continues.
        """
        self._descend(weighted(self.archive, found))
        yield
        idle = 0
        for _ in range(rounds):
            if idle >= _PATIENCE or self.budget.exhausted:
                return
            before, corner = self.archive.costs, _BEYOND * self.archive.costs.max(axis=0)
            self._descend(self._boxed(_WIDE))
            yield
            self._moves([replace(m, candidate=_spaced(m.candidate, self.objective)) for m in self._boxed()])
            yield
            gain = dominated_area(self.archive.costs, corner) / max(dominated_area(before, corner), 1e-300) - 1.0
            idle = 0 if gain > _GAIN else idle + 1

    def _boxed(self, reach: int = 1) -> list[Target]:
        gaps, front = max(2, self.capacity // 4), self.archive.chosen(self.capacity)
        return [aimed for aimed in boxed(front, gaps, reach) if len(aimed.candidate.q) > 1]

    def _descend(self, members: list[Target]) -> None:
        """Descend from candidates if the objective has gradients."""
        if self.smooth and isinstance(self.objective, DifferentiableObjective):
            for candidate in descend(members, self.problem, self.objective, self.certain, self.budget, _STEPS):
                self.archive.offer(candidate)

    def _moves(self, members: list[Target]) -> None:
        """Try rounds of random moves on candidates."""
        for round_ in range(_ROUNDS if self.smooth else _ROUNDS_ALONE):
            if not self.budget.spend():
                break
            for first in range(0, len(members), _CHUNK):
                if out_of_time(self.budget):
                    break
                part = members[first : first + _CHUNK]
                news = improved(part, self.problem, self.objective, self.certain, self.rng, round_)
                members[first : first + _CHUNK] = news
        for member in members:
            self.archive.offer(member.candidate)


def _has_derivatives(objective: BoundObjective, problem: Problem) -> bool:
    """Return whether the objective has derivatives, and path length as its motion."""
    if not isinstance(objective, DifferentiableObjective):
        return False
    q0, q1 = problem.start[None], problem.goals[:1]
    found = objective.edge_gradients(q0, q1)
    return found is not None and bool(np.allclose(found[0][:, 0], np.linalg.norm(q1 - q0, axis=1)))


def weighted(archive: Archive[Candidate], found: Sequence[Candidate] = ()) -> list[Target]:
    """Return candidates to minimise V + w S: those found, and the best below, at and above weights of a range."""
    motion, impact = archive.candidates[0].cost.tolist()
    if not impact > 0.0:
        return []
    sent = []
    for w in (motion / impact * np.geomspace(*WEIGHTS, _WEIGHTS)).tolist():
        starts = {id(c): c for c in (archive.best_for(w * factor) for factor in (1.0, _ASIDE, 1.0 / _ASIDE))}
        sent += [(candidate, w) for candidate in starts.values()]
    sent += [(c, c.made_with * factor) for c in found for factor in (1.0, _ASIDE, 1.0 / _ASIDE)]
    beyond = np.full(2, np.inf)
    return [
        Target(candidate=replace(candidate, made_by="weight", made_with=w), corner=beyond, weight=w)
        for candidate, w in sent
    ]


def boxed(front: list[Candidate], gaps: int, reach: int = 1) -> list[Target]:
    """Return the box of each candidate of a front, and boxes of the widest gaps for both of their neighbours.

    Args:
        front: Candidates, sorted by motion.
        gaps: Number of gaps.
        reach: Distance in the front to the neighbours that define a box, 1 for the adjacent ones.
    """
    costs = np.array([c.cost for c in front])
    rim = np.broadcast_to(_BEYOND * costs.max(axis=0), (reach, 2))
    right = np.append(costs[:, 0], rim[:, 0])[reach:]
    left = np.append(rim[:, 1], costs[:, 1])[: len(costs)]
    members = [Target(candidate=c, corner=np.array(box)) for c, *box in zip(front, right, left, strict=True)]
    for k in widest_gaps(costs, gaps):
        # Slightly wider than the gap, because the neighbours themselves lie on its rim.
        corner = np.array([costs[k + 1, 0], costs[k, 1]]) + _RIM * np.abs(costs[k + 1] - costs[k])
        for candidate in front[k : k + 2]:
            sent = replace(candidate, made_by="gap", made_with=float(costs[k, 1]))
            members.append(Target(candidate=sent, corner=corner))
    return members


def _spaced(candidate: Candidate, objective: BoundObjective) -> Candidate:
    """Subdivide long edges, so that there are vertices to move everywhere."""
    path = Path(candidate.q)
    step = path.length / _VERTICES
    if path.segment_lengths.max() <= 2.0 * step:
        return candidate
    q = path.resampled(1.5 * step).q
    return replace(candidate, q=q, edges=edge_costs(objective, q[:-1], q[1:]))


def improved(
    members: list[Target],
    problem: Problem,
    objective: BoundObjective,
    certain: EdgeTest,
    rng: np.random.Generator,
    round_: int,
) -> list[Target]:
    """Try one round of moves on members, in one batch."""
    lines = [Line(m.candidate.q, m.candidate.edges[:, 0]) for m in members]
    proposals = [_proposals(line, m.candidate.size, rng, round_) for line, m in zip(lines, members, strict=True)]
    owner = np.repeat(np.arange(len(members)), [len(p) for p in proposals])
    every = [p for part in proposals for p in part]
    inside = [i for i, p in enumerate(every) if np.all((p.q >= problem.lower) & (p.q <= problem.upper))]
    every, owner = [every[i] for i in inside], owner[inside]
    if not every:
        return members
    q0, q1 = np.concatenate([p.q[:-1] for p in every]), np.concatenate([p.q[1:] for p in every])
    begin = np.cumsum([0, *(len(p.q) - 1 for p in every)])
    edges = edge_costs(objective, q0, q1)
    after = np.add.reduceat(edges, begin[:-1], axis=0)
    gains = _gains(members, every, owner, after)
    wanted = gains > 0.0
    free = _free(wanted, begin, q0, q1, certain)
    taken = []
    for k, member in enumerate(members):
        mine = np.flatnonzero(free & (owner == k))
        order = mine[np.argsort(-gains[mine], kind="stable")]
        news = [(every[i], edges[begin[i] : begin[i + 1]]) for i in order.tolist()]
        taken.append(_taken(member, news, bool(np.any(owner == k))))
    return taken


def _proposals(line: Line, size: float, rng: np.random.Generator, round_: int) -> list[Replacement]:
    """Propose moves: smooth displacements in half of the rounds, sized by past success; shortcuts in the others."""
    moves = (bend, leave_out, bend, move_aside, bend, cut, bend, straighten_joint)
    move = moves[round_ % len(moves)]
    if move is bend:
        return bend(line, _PROPOSALS, size, rng)
    return move(line, _PROPOSALS, 0.02 ** rng.uniform(), rng)[:_PROPOSALS]


def bend(line: Line, n: int, size: float, rng: np.random.Generator) -> list[Replacement]:
    """Displace a random stretch smoothly, half of the time in one joint only.

    Args:
        line: The path.
        n: Number of proposals.
        size: Size of the displacement, relative to the length of the path.
        rng: Random numbers.
    """
    last = len(line.q) - 1
    if last < 2:
        return []
    proposals = []
    nq = line.q.shape[1]
    centre, half = rng.integers(1, last, n), rng.integers(1, max(2, last // 2) + 1, n)
    push = rng.normal(size=(n, nq)) / np.sqrt(nq)
    alone = rng.uniform(size=n) < 0.5
    joint, amount = rng.integers(nq, size=n), rng.normal(size=n)
    push[alone] = 0.0
    push[alone, joint[alone]] = amount[alone]
    push *= size * line.arc[-1] * 10.0 ** rng.uniform(-0.5, 0.5, (n, 1))
    for c, h, d in zip(centre.tolist(), half.tolist(), push, strict=True):
        i, j = max(0, c - h), min(last, c + h)
        s = (np.arange(i + 1, j) - c) / h
        q = line.q[i : j + 1].copy()
        q[1:-1] += ((1.0 - s * s) ** 2)[:, None] * d
        proposals.append(Replacement(i, j, q))
    return proposals


def _gains(
    members: list[Target], every: list[Replacement], owner: Array, after: Float[Array, "n 2"]
) -> Float[Array, " n"]:
    """Return the increase in area of each replacement; 0 if there is none."""
    gains = np.zeros(len(every))
    for k, member in enumerate(members):
        mine = np.flatnonzero(owner == k)
        before = np.concatenate([np.zeros((1, 2)), np.cumsum(member.candidate.edges, axis=0)])
        first, last = np.array([(every[i].first, every[i].last) for i in mine], dtype=int).reshape(-1, 2).T
        cost = member.candidate.cost + after[mine] - (before[last] - before[first])
        now = float(member.merit(member.candidate.cost[None])[0])
        gains[mine] = np.where(member.merit(cost) > now * (1.0 + _EPS) + 1e-300, member.merit(cost) - now, 0.0)
    return gains


def _free(wanted: Bool[Array, " n"], begin: Array, q0: Array, q1: Array, certain: EdgeTest) -> Bool[Array, " n"]:
    """Check the wanted replacements for collisions, in one batch."""
    free = wanted.copy()
    picked = np.flatnonzero(wanted)
    if len(picked):
        edges = np.concatenate([np.arange(begin[i], begin[i + 1]) for i in picked])
        ends = np.concatenate([[0], np.cumsum(begin[picked + 1] - begin[picked])[:-1]])
        free[picked] = np.logical_and.reduceat(np.asarray(certain(q0[edges], q1[edges]), dtype=bool), ends)
    return free


def _taken(member: Target, news: list[tuple[Replacement, Array]], tried: bool) -> Target:
    """Apply the best non-overlapping replacements as long as the area grows."""
    candidate = member.candidate
    size = candidate.size * (1.3 if news else 0.93 if tried else 1.0)
    candidate = replace(candidate, size=float(np.clip(size, 1e-4, 0.2)))
    apart: list[tuple[Replacement, Array]] = []
    best = float(member.merit(candidate.cost[None])[0])
    for new in news:
        if all(new[0].last <= other.first or new[0].first >= other.last for other, _ in apart):
            together = float(member.merit(_applied(candidate, [*apart, new]).cost[None])[0])
            if together > best:
                apart, best = [*apart, new], together
    return replace(member, candidate=_applied(candidate, apart) if apart else candidate)


def _applied(candidate: Candidate, news: list[tuple[Replacement, Array]]) -> Candidate:
    return candidate.moved_to(*replaced(candidate.q, candidate.edges, news))
