"""Postures of the arm of a base: it keeps one while the base drives."""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.path import Path
from graceful_plan.planners.planner import Problem

Array = np.ndarray

BASE = 3
"""Joints of the base: along x, along y, heading."""
_MOST_ARMS = 2
"""Postures of goals that are taken before the base moves."""


def postures(problem: Problem) -> list[Path]:
    """Return what to begin with: nothing, or moving the arm to where it has to be at a goal."""
    start = problem.start
    begins = [Path(start[None])]
    arms, first = np.unique(problem.goals[:, BASE:], axis=0, return_index=True)
    others = np.any(arms != start[BASE:], axis=1)
    # The first goals are those that are wanted most.
    for arm in arms[others][np.argsort(first[others])][:_MOST_ARMS] if arms.shape[1] else ():
        moved = with_arm(start, arm)
        if problem.edges_free(start[None], moved[None])[0]:
            begins.append(Path(np.stack([start, moved])))
    return begins


def with_arm(q: Float[Array, " nq"], arm: Float[Array, " arm"]) -> Float[Array, " nq"]:
    """Return where the base is in one configuration, with another arm."""
    return np.concatenate([q[:BASE], arm])
