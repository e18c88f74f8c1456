"""Starts and goals that exact geometry accepts, although spheres touch there: does `plan` accept them?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.compare.problems.problem_files import ProblemFile
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.judge.exact import exactly_free
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE, way_out

Array = np.ndarray

_DRAWN, _TIGHT = 1500, 40
"""Configurations drawn in one of two ways in a scene, and how many tight ones of them are asked for a way out."""
_AROUND = 0.08
"""Standard deviation around goals [rad]."""


@dataclass(frozen=True)
class TightEnds:
    """How many configurations were looked at, and what came of them."""

    free: int
    """By exact geometry; with clearance they are accepted anyway."""
    tight: int
    """Of these, those without clearance of spheres that were tried."""
    refused: int
    """Of the tight ones, those from which no short way leads to clearance."""


def tight_ends(problems: Sequence[ProblemFile]) -> TightEnds:
    """Draw configurations evenly and around goals, and try the tight ones among them."""
    rng, free, tight, refused = np.random.default_rng(0), 0, 0, 0
    for problem in problems:
        scene = problem.scene
        if not len(goals := np.atleast_2d(np.asarray(problem.goals, dtype=float))):
            continue
        lower, upper = scene.limits.position.T
        held = SceneConstraints(scene, ())
        around = goals[rng.integers(len(goals), size=_DRAWN)] + _AROUND * rng.normal(size=(_DRAWN, len(lower)))
        for q in (rng.uniform(lower, upper, around.shape), np.clip(around, lower, upper)):
            q = q[exactly_free(q, scene)]
            closest = q[held.clearance(q) < TARGET_CLEARANCE][:_TIGHT]
            free, tight = free + len(q), tight + len(closest)
            refused += sum(way_out(one, held, rng) is None for one in closest)
    return TightEnds(free, tight, refused)
