"""Existence of a path: OMPL's RRT-Connect with exact geometry, within a time limit."""

from __future__ import annotations

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

import graceful_plan as gp
from graceful_plan.judge.exact import Judge

Array = np.ndarray

_STEP = 0.03
"""Distance between checked configurations of an edge [rad or m]."""


def finds_path(start: Array, goal: Array, scene: gp.Scene, seconds: float, seed: int = 1) -> bool:
    """Whether OMPL's RRT-Connect connects two configurations, with exact geometry only.

    Args:
        start: Configuration of the planned joints.
        goal: Configuration of the planned joints.
        scene: The scene.
        seconds: Time limit of the search [s].
        seed: Seed of OMPL, > 0.
    """
    judge, n = Judge(scene), len(start)
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed)
    bounds = ob.RealVectorBounds(n)
    for i, (low, high) in enumerate(scene.limits.position):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    space = ob.RealVectorStateSpace(n)
    space.setBounds(bounds)
    space.setLongestValidSegmentFraction(_STEP / space.getMaximumExtent())
    information = ob.SpaceInformation(space)

    def valid(state: ob.State) -> bool:
        q = np.array([[state[i] for i in range(n)]])
        return not any(judge.is_violation(touch, at_end=False) for touch in judge.touches(q))

    information.setStateValidityChecker(valid)
    information.setup()
    definition = ob.ProblemDefinition(information)
    ends = [information.allocState() for _ in range(2)]
    for end, q in zip(ends, (start, goal), strict=True):
        for i in range(n):
            end[i] = float(q[i])
    definition.setStartAndGoalStates(*ends)
    planner = og.RRTConnect(information)
    planner.setProblemDefinition(definition)
    planner.setup()
    return bool(planner.solve(seconds)) and definition.hasExactSolution()
