"""Arm postures for planners whose arm does not move while the base drives."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.path import Path
from graceful_plan.planners.planner import Problem

BASE = 3
"""Number of joints of the base: along x, along y, heading."""
_MOST_ARMS = 2
"""Largest number of goal postures that the arm takes before the base moves."""


def postures(problem: Problem) -> list[Path]:
    """Return paths to start from: the start itself, and arm motions from it to the postures of goals."""
    start = problem.start
    begins = [Path(start[None])]
    arms, first = np.unique(problem.goals[:, BASE:], axis=0, return_index=True)
    others = np.any(arms != start[BASE:], axis=1)
    # Goals are in order of preference.
    for arm in arms[others][np.argsort(first[others])][:_MOST_ARMS] if arms.shape[1] else ():
        moved = with_arm(start, arm)
        if problem.edges_free(start[None], moved[None])[0]:
            begins.append(Path(np.stack([start, moved])))
    return begins


def with_arm(q: Float[Array, " nq"], arm: Float[Array, " arm"]) -> Float[Array, " nq"]:
    """Return a configuration with the same base pose and another arm posture."""
    return np.concatenate([q[:BASE], arm])
