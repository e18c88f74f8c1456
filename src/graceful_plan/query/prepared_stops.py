"""Stops along a motion, planned ahead for a grid of moments, and where there are none."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from graceful_plan.constraints.constraint import Constraint
from graceful_plan.exceptions import SettingError
from graceful_plan.query.stop import plan_stop
from graceful_plan.result import Check
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.setting_checks import positive
from graceful_plan.timing.prepared_stops import PreparedStops
from graceful_plan.timing.trajectory import Trajectory

_GENTLE = 0.5
"""Share of the acceleration limits with which a robot could brake; the rest is for the curves of its path."""
EVERY = 0.1
"""Default time between two moments [s]: the time that a robot goes on before its stop begins."""


def plan_stops(
    motion: Trajectory,
    scene: Scene,
    *,
    every: float = EVERY,
    constraints: Iterable[Constraint] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> PreparedStops:
    """Plan the quickest verified stops along a motion ahead, and find where there are none.

    A moment lacks a stop if no verified stop that begins there ends more than `every` before the motion does, although
    braking at half of the acceleration limits would. Along full vessels, stops are often as long as the motion.

    Args:
        motion: The motion.
        scene: Robot, surroundings and carried object.
        every: Time between the moments at which stops begin [s]. Between them, nothing is checked.
        constraints: Constraints along the stops, as for `plan_stop`.
        cancelled: Called before each moment. Once it returns True, the other moments get no stop.

    Returns:
        The stops, and the stretches without one (`gaps`).

    Raises:
        SettingError: If `every` is not a finite time > 0, or as for `plan_stop`.
    """
    if not isinstance(motion, Trajectory):
        raise SettingError("motion", motion, "a Trajectory")
    positive("every", every, "a finite time > 0 s")
    kept = None if constraints is None else tuple(constraints)
    checked_scene(scene)
    times = np.arange(float(motion.t[0]), float(motion.t[-1]), every).tolist()
    stops = [None if cancelled() else plan_stop(motion, scene, at=t, constraints=kept).trajectory for t in times]
    missing = [_is_missing(stop, motion, t, every, scene) for t, stop in zip(times, stops, strict=True)]
    return PreparedStops(motion=motion, every=every, stops=tuple(stops), gaps=_stretches(times, missing))


def stops_check(prepared: PreparedStops) -> Check:
    """Return the check that warns where no stop exists; its worst value is the longest time to standstill [s]."""
    motion = prepared.motion
    longest = max((stop.duration for stop in prepared.stops if stop is not None), default=motion.duration)
    looked = f"looked for every {prepared.every:g} s"
    if not prepared.gaps:
        return Check(
            passed=True, worst=longest, limit=motion.duration, detail=f"the longest takes {longest:.3g} s; {looked}"
        )
    where = ", ".join(f"{a:.3g} to {b:.3g} s" if b > a else f"{a:.3g} s" for a, b in prepared.gaps)
    told = f"no stop along the path before the motion ends, at {where}; {looked}"
    return Check(passed=False, worst=longest, limit=motion.duration, first=prepared.gaps[0][0], detail=told)


def _is_missing(stop: Trajectory | None, motion: Trajectory, t: float, every: float, scene: Scene) -> bool:
    """Return whether braking would end much earlier than a stop."""
    if stop is None:
        return True
    latest = float(motion.t[-1]) - every
    braking = float((np.abs(motion.at(t).qd) / (_GENTLE * scene.limits.acceleration)).max())
    return bool(t + braking < latest < stop.t[-1])


def _stretches(times: Sequence[float], missing: Sequence[bool]) -> tuple[tuple[float, float], ...]:
    """Return the first and last time of each run of moments that are missing."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(int)))
    return tuple((times[first], times[end - 1]) for first, end in edges.reshape(-1, 2).tolist())
