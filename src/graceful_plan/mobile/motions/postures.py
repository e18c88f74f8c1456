"""Postures of the arm that are worth having along a drive: few, from many, by what a failure would do there.

Candidates are drawn around what the drive begins and ends with, and moved to where what has to stay level does. Of
these the few are chosen that together cost least at places along the way: each place takes the one that is best for it,
and being far from where the arm begins and ends costs the way there. The next candidates are drawn around these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.mobile.motions.smoothing import Smoother
from graceful_plan.planners.scene_problem import SceneProblem

Array = np.ndarray

BASE = 3
"""Joints of the base, before those of the arm."""
MOST = 14
"""Postures, besides those that a drive has to pass."""
_DRAWN = 200
"""Candidates of a round."""
SCALES = (1.0, 0.7, 0.4)
"""By how much joints move in a round [rad, or share of a shorter range], around what was chosen in those before."""
_MOVED = 0.4
"""Share of the joints that do."""
_BLOCKED = 1e6
"""What it costs at a place where a posture is not free."""


@dataclass(frozen=True, eq=False)
class Places:
    """Places of the base along a drive, to choose postures by.

    | field   | meaning                                   | unit       | shape    |
    |---------|-------------------------------------------|------------|----------|
    | q       | configurations; the arm as it is there    | rad or m   | place nq |
    | qd      | velocities of the base, the arm at rest   | m/s, rad/s | place nq |
    | seconds | how long what is around a place takes     | s          | place    |
    | metres  | length of the drive                       | m          |          |
    | room    | clearance that postures should have       | m          |          |
    """

    q: Float[Array, "place nq"]
    qd: Float[Array, "place nq"]
    seconds: Float[Array, " place"]
    metres: float
    room: float


def posture_set(
    known: Sequence[Float[Array, " arm"]],
    places: Places,
    smoother: Smoother,
    problem: SceneProblem,
    rng: np.random.Generator,
    scales: Sequence[float] = SCALES,
) -> Float[Array, "posture arm"]:
    """Return postures, the known ones among them.

    Args:
        known: What the drive begins and ends with and passes on its way; all of these are returned.
        places: Some of the drive.
        smoother: What a drive is charged for.
        problem: What has to be free, and to be kept level.
        rng: For candidates.
        scales: By how much joints move in each round [rad, or share of a shorter range].
    """
    arms = np.unique(np.array(known), axis=0)
    first, ends = len(arms), np.array(known)[[0, -1]]
    cost = _costs(arms, ends, places, smoother, problem)
    chosen = list(range(first))
    for scale in scales if smoother.objective.w > 0.0 else ():
        around = arms[chosen]
        new = _reached(_candidates(around, scale, problem, rng), ends, places, problem)
        arms = np.concatenate([arms, new])
        cost = np.concatenate([cost, _costs(new, ends, places, smoother, problem)], axis=1)
        chosen = _fewest(cost, first)
    return arms[chosen]


def _costs(
    arms: Float[Array, "posture arm"],
    ends: Float[Array, "2 arm"],
    places: Places,
    smoother: Smoother,
    problem: SceneProblem,
) -> Float[Array, "place posture"]:
    """Return what postures cost at places: harm, and a share of what the arm travels for them."""
    n, m = len(arms), len(places.q)
    q = np.repeat(places.q, n, axis=0)
    q[:, BASE:] = np.tile(arms, (m, 1))
    free = replace(problem, margin=problem.margin + places.room).states_free(q)
    cost = np.full(m * n, _BLOCKED)
    cost[free] = 0.0
    if smoother.objective.w > 0.0 and free.any():
        impact = smoother.objective.quick_states(q[free], np.repeat(places.qd, n, axis=0)[free])
        cost[free] = smoother.objective.w * impact * np.repeat(places.seconds, n)[free]
    away = np.linalg.norm(arms[:, None] - ends, axis=2).sum(axis=1)
    direct = np.linalg.norm(ends[1] - ends[0])
    way = np.hypot(places.metres, away) - np.hypot(places.metres, direct)
    return cost.reshape(m, n) + way / m


def _reached(
    arms: Float[Array, "n arm"], ends: Float[Array, "2 arm"], places: Places, problem: SceneProblem
) -> Float[Array, "m arm"]:
    """Keep those that the arm moves to and back on straight lines, somewhere on the way."""
    base = np.tile(places.q[len(places.q) // 2, :BASE], (len(arms), 1))
    there = np.column_stack([base, arms])
    free = np.ones(len(arms), dtype=bool)
    for end in ends:
        free[free] = problem.edges_free(np.column_stack([base, np.tile(end, (len(arms), 1))])[free], there[free])
    return arms[free]


def _fewest(cost: Float[Array, "place posture"], first: int) -> list[int]:
    """Choose one posture after the other, each the one that spares most beside those before."""
    chosen = list(range(first))
    best = cost[:, :first].min(axis=1)
    for _ in range(MOST):
        total = np.minimum(best[:, None], cost).sum(axis=0)
        k = int(np.argmin(total))
        if total[k] > best.sum() - 1e-9:
            break
        chosen.append(k)
        best = np.minimum(best, cost[:, k])
    return chosen


def _candidates(
    around: Float[Array, "known arm"], scale: float, problem: SceneProblem, rng: np.random.Generator
) -> Float[Array, "n arm"]:
    """Draw postures: some joints elsewhere, and the others moved until what has to be level is."""
    lower, upper = problem.lower[BASE:], problem.upper[BASE:]
    n, arm = _DRAWN, around.shape[1]
    step = scale * np.minimum(1.0, upper - lower) * rng.normal(size=(n, arm))
    drawn = around[rng.integers(len(around), size=n)] + np.where(rng.uniform(size=(n, arm)) < _MOVED, step, 0.0)
    q = np.tile(problem.start, (n, 1))
    q[:, BASE:] = np.clip(drawn, lower, upper)
    return problem.projected(q)[:, BASE:]
