"""When to go and which way, if somebody moves: candidates of a search are timed, and the best by its times is taken.

A search knows no times, so it charges a path for those that move as if they were anywhere along their predicted paths.
That says which way is good on average. Here the improvements that a search came across are timed, each with several
times of departure, and the one of least J at these times is taken: what a search has not found is not considered.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graceful_plan.arguments import checked_speed
from graceful_plan.array_types import Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.ends import Ends
from graceful_plan.exceptions import RetimingError
from graceful_plan.path import Path
from graceful_plan.result import CostBreakdown
from graceful_plan.retime import retime
from graceful_plan.trajectory import Trajectory

Array = np.ndarray

WAIT_STEP = 0.25
"""Times of departure that are tried are so far apart [s], or farther if that would be more than `MOST_WAITS`."""
MOST_WAITS = 16
WORTH = 0.01
"""A wait has to lower J by more than this share of it for all that a shorter one does."""
_CANDIDATES = 4


def waits(max_wait: float) -> Float[Array, " wait"]:
    """Return the waiting times to try [s], from 0."""
    count = int(np.clip(np.ceil(max_wait / WAIT_STEP), 0, MOST_WAITS))
    return np.linspace(0.0, max_wait, count + 1)


def best_departure(
    trajectory: Trajectory, objective: SceneObjective, max_wait: float = 0.0
) -> tuple[Trajectory, CostBreakdown]:
    """Return a trajectory with the wait at its start that pays, and its cost at its times.

    Args:
        trajectory: Without a wait.
        objective: In a scene where something moves.
        max_wait: Longest wait [s].
    """
    tried = [trajectory.delayed(float(wait)) for wait in waits(max_wait)]
    costs = [objective.breakdown(delayed) for delayed in tried]
    least = min(cost.total for cost in costs)
    chosen = next(i for i, cost in enumerate(costs) if cost.total <= least + WORTH * abs(least))
    return tried[chosen], costs[chosen]


def by_timed_cost(
    paths: Sequence[Path], ends: Ends, objective: SceneObjective, speed: float | str, max_wait: float = 0.0
) -> list[Path]:
    """Return some of a search's improvements in the order of J at their best departures, the best at the end.

    Args:
        paths: In the order in which they were found.
        ends: What comes before and after them.
        objective: In a scene where something moves.
        speed: As of `plan`.
        max_wait: Longest wait [s].
    """
    # Improvements come ever closer to each other: the last, the one before, the one before two, four, ...
    ages = [age for age in (0, *(2**k for k in range(_CANDIDATES - 1))) if age < len(paths)]
    candidates = [paths[-1 - age] for age in ages]
    totals = []
    for path in candidates:
        try:
            whole = ends.joined(path)[0]
            timed = retime(whole, objective.scene.limits, objective.scene.joints, speed=checked_speed(speed))
            totals.append(best_departure(timed, objective, max_wait)[1].total)
        except RetimingError:
            totals.append(np.inf)
    return [candidates[i] for i in np.argsort(-np.array(totals), kind="stable")]
