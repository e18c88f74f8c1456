"""Starts and goals that are free by exact geometry although covering spheres touch: does `plan` accept them?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.compare.problems.problem_files import ProblemFile
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.judge.exact import exactly_free
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE, way_out

_DRAWN, _TIGHT = 1500, 40
"""Configurations drawn per scene and distribution, and tight configurations tried among these."""
_AROUND = 0.08
"""Standard deviation around goals [rad]."""


@dataclass(frozen=True)
class TightEnds:
    """Numbers of configurations."""

    free: int
    """Free configurations by exact geometry."""
    tight: int
    """Free configurations without clearance of the spheres, as far as tried."""
    refused: int
    """Tight configurations from which `plan` finds no short path to clearance."""


def tight_ends(problems: Sequence[ProblemFile]) -> TightEnds:
    """Draw configurations uniformly and around goals, and try the tight ones."""
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
