"""Checks that a motion passes its via configurations and via poses in order, and when."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.judge.motion_samples import motion_samples
from graceful_plan.judge.preparation import own_placement
from graceful_plan.result import Check
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

NEAR = 1e-4
"""Largest joint error with which a configuration counts as passed [rad or m]: 0.1 mm at a distance of 1 m."""
_NARROWED = 60
"""Number of golden-section steps, which narrow a time down to rounding."""
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)


def passing(
    trajectory: Trajectory, via: Sequence[Float[Array, " nq"] | PoseGoal], scene: Scene, *, step: float = 0.002
) -> tuple[Check, tuple[float, ...]]:
    """Check whether a motion passes configurations and tool poses in order.

    Args:
        trajectory: The trajectory to check.
        via: Configurations to pass to within `NEAR`, and poses to pass to within their tolerances.
        scene: The scene.
        step: No point of the robot moves farther than this between two samples [m].

    Returns:
        The check, whose worst value is relative to the tolerance, and the times at which they are passed [s].
    """
    samples = motion_samples(trajectory, scene, step)
    worst, since, times = 0.0, float(trajectory.t[0]), []
    for number, one in enumerate(via):
        error = _error(one, scene)
        found = _first(error, trajectory, samples.q, samples.at, since)
        worst = max(worst, found[1])
        if found[1] > 1.0:
            detail = f"via {number} is missed by {found[1]:.3g} times its tolerance, at {found[0]:.3g} s"
            return Check(worst=worst, limit=1.0, first=found[0], detail=detail), tuple(times)
        since = found[0]
        times.append(since)
    detail = f"of the tolerance of a pose on the way; passed at {', '.join(f'{t:.3f}' for t in times)} s"
    return Check(passed=True, worst=worst, limit=1.0, detail=detail), tuple(times)


def _error(one: Float[Array, " nq"] | PoseGoal, scene: Scene) -> Callable[[Float[Array, " nq"]], float]:
    """Return a function that computes the error of a configuration relative to the tolerance."""
    if not isinstance(one, PoseGoal):

        def of_configuration(q: Float[Array, " nq"]) -> float:
            away = q - one
            turned = np.remainder(away + np.pi, 2.0 * np.pi) - np.pi
            return float(np.abs(np.where(scene.endless, turned, away)).max()) / NEAR

        return of_configuration
    placement = own_placement(scene)

    def of_pose(q: Float[Array, " nq"]) -> float:
        site, X_WT = placement.place(q).site(scene.tool), np.eye(4)
        X_WT[:3, :3], X_WT[:3, 3] = site.xmat.reshape(3, 3), site.xpos
        distance, angle = pose_error(one, X_WT)
        return max(distance / one.position_tolerance, angle / one.orientation_tolerance)

    return of_pose


def _first(
    error: Callable[[Float[Array, " nq"]], float],
    trajectory: Trajectory,
    q: Float[Array, "sample nq"],
    at: Float[Array, " sample"],
    since: float,
) -> tuple[float, float]:
    """Return the first time from `since` at which the error is within its tolerance, else the best, and the error."""
    later = at > since
    t = np.append(since, at[later])
    errors = np.array([error(x) for x in (trajectory.at(np.array(since)).q, *q[later])])
    around = np.pad(errors, 1, constant_values=np.inf)
    valleys = np.flatnonzero((errors <= around[:-2]) & (errors <= around[2:]))
    found = []
    for k in valleys:
        lower, upper = float(t[max(k - 1, 0)]), float(t[min(k + 1, len(t) - 1)])
        found.append(_narrowed(lambda t: error(trajectory.at(np.array(t)).q), lower, upper))
        if found[-1][1] <= 1.0:
            return found[-1]
    return min(found, key=lambda one: one[1])


def _narrowed(value: Callable[[float], float], lower: float, upper: float) -> tuple[float, float]:
    """Return the minimiser and minimum of a unimodal function (golden section)."""
    for _ in range(_NARROWED):
        a, b = upper - _GOLDEN * (upper - lower), lower + _GOLDEN * (upper - lower)
        lower, upper = (lower, b) if value(a) <= value(b) else (a, upper)
    return min(((t, value(t)) for t in (lower, 0.5 * (lower + upper), upper)), key=lambda one: one[1])
