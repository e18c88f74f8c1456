"""Arm postures that lower the impact along a motion; they are initial guesses for descents.

Candidates are random postures around those at both ends, projected onto the constraints that keep a vessel level. The
few with the least cost along the whole motion are kept. The cost includes moving the arm to the posture and back.
"""

from __future__ import annotations

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.timing.trajectory import Trajectory

_BASE = 3
"""Number of joints of the base, which precede those of the arm."""
_DRAWN, _SHORTLIST = 3000, 80
"""Number of candidates, and number of those that are evaluated along the whole motion."""
_SCALES = (0.4, 1.5)
"""Standard deviation of the joint displacements, from the first candidate to the last [rad, or share of a range]."""
_MOVED = 0.5
"""Share of the joints that are displaced."""
_PLACES = 6
"""Number of evaluated states along the motion."""
_FREE_SHARE = 0.6
"""Least share of these states at which a posture must be free; there may be less clearance at the ends of a motion."""
_KEPT, _APART = 3, 0.3
"""Number of postures, and the least difference between two of them in some joint [rad or m]."""
_RAMP = 0.3
"""Share of a motion in which the arm moves to the posture, and in which it moves on to the end."""


def carry_postures(
    motion: Trajectory, problem: SceneProblem, objective: SceneObjective, rng: np.random.Generator
) -> Float[Array, "posture arm"]:
    """Return arm postures that cost less along a motion than its own, the best first.

    Args:
        motion: The motion.
        problem: Collision and constraints.
        objective: Cost to minimise, with all moving entities removed.
        rng: Random generator for candidates.
    """
    ends = motion.q[[0, -1], _BASE:]
    t = motion.t[0] + motion.duration * (np.arange(_PLACES) + 0.5) / _PLACES
    state, seconds = motion.at(t), motion.duration / _PLACES
    now = objective.approximate_states(state.q, state.qd)
    arms = _candidates(ends, problem, rng)
    # Candidates that are good in one place are evaluated in all.
    middle = slice(_PLACES // 2, _PLACES // 2 + 1)
    there = _with_arms(state.q[middle], arms)
    free = problem.states_free(there)
    harm = objective.approximate_states(there, _with_arms(state.qd[middle], np.zeros_like(arms)))
    arms = arms[np.argsort(np.where(free, harm, np.inf))[: min(_SHORTLIST, int(free.sum()))]]
    q, qd = _with_arms(state.q, arms), _with_arms(state.qd, np.zeros_like(arms))
    free = problem.states_free(q).reshape(-1, _PLACES)
    # Where a posture is not free, the arm keeps its current one.
    harm = seconds * np.where(free, objective.approximate_states(q, qd).reshape(-1, _PLACES), now).sum(axis=1)
    arms, harm = (of[free.mean(axis=1) >= _FREE_SHARE] for of in (arms, harm))
    way = np.linalg.norm(arms[:, None] - ends, axis=2).sum(axis=1) - np.linalg.norm(ends[1] - ends[0])
    # Base and arm move at the same time, so the arm's motion adds little to a long drive.
    length = max(motion.path.length, 1e-3)
    cost = objective.w * harm + np.hypot(length, way) - length
    chosen: list[int] = []
    for k in np.argsort(cost):
        if cost[k] >= objective.w * seconds * now.sum() or len(chosen) == _KEPT:
            break
        if all(np.abs(arms[k] - arms[other]).max() > _APART for other in chosen):
            chosen.append(int(k))
    return arms[chosen]


def with_posture(controls: Float[Array, "control column"], arm: Float[Array, " arm"]) -> Float[Array, "control column"]:
    """Return control points of a `RollingSpline` with the arm in another posture except near both ends."""
    share = np.linspace(0.0, 1.0, len(controls))[:, None]
    near = np.clip(np.minimum(share, 1.0 - share) / _RAMP, 0.0, 1.0)
    near = near * near * (3.0 - 2.0 * near)
    moved = controls.copy()
    moved[:, _BASE - 1 : -1] += near * (arm - controls[:, _BASE - 1 : -1])
    return moved


def _with_arms(rows: Float[Array, "place nq"], arms: Float[Array, "posture arm"]) -> Float[Array, "n nq"]:
    """Return each row with each of the arm postures, one posture after the other."""
    found = np.tile(rows, (len(arms), 1))
    found[:, _BASE:] = np.repeat(arms, len(rows), axis=0)
    return found


def _candidates(ends: Float[Array, "2 arm"], problem: SceneProblem, rng: np.random.Generator) -> Float[Array, "n arm"]:
    """Return random postures, projected onto the constraints."""
    lower, upper = problem.lower[_BASE:], problem.upper[_BASE:]
    shape = _DRAWN, ends.shape[1]
    scale = np.linspace(*_SCALES, _DRAWN)[:, None] * np.minimum(1.0, upper - lower)
    step = np.where(rng.uniform(size=shape) < _MOVED, scale * rng.normal(size=shape), 0.0)
    q = np.tile(problem.start, (_DRAWN, 1))
    q[:, _BASE:] = np.clip(ends[rng.integers(2, size=_DRAWN)] + step, lower, upper)
    return problem.projected(q)[:, _BASE:]
