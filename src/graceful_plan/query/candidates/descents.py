"""Descents for a request: the objective and clearance that motions descend along, and where paths begin and end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import LONG, DescentSettings, MotionDescents, Start
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.timing.spline import Spline

STRAY_CLEARANCE = 0.005
"""Clearance that descents keep where there is room for it [m]: a healthy robot and the object in its fingers stray from
the path by up to 6 mm (FailBench's Panda at half of its speed, six tasks), and with 3 mm a chart grazed a cabinet. Not
where a vessel is kept level: its tilt counts as clearance, too, and J of a watering can rose by a third."""
_NEARLY = 0.8
"""Share of that clearance below which a descent is repeated with a heavier penalty."""
SHORTENING = DescentSettings(screens=False, bends=0, fine=1, hurries=True)
"""Where the shortest motion is the best one: in each homotopy class a descent from one path ends within a percent of
it, and each search that begins anew may find another class."""
_LEAST_TIGHT = 0.15
"""Least length at a tight end along which the spheres do not count [rad]."""


def motion_descents(request: Request, problem: SceneProblem, settings: DescentSettings) -> MotionDescents | None:
    """Return descents for a request; None if its objective has no gradient.

    Args:
        request: What to descend for.
        problem: Where its paths were searched.
        settings: Work of a round.
    """
    objective = request.objective.descended()
    if objective is None:
        return None
    scene, speed = objective.scene, request.speed
    ends = problem.kernels.clearance(np.vstack([problem.start, problem.goals]))
    wanted = 0.0 if request.constraints.level else min(STRAY_CLEARANCE, 0.5 * float(ends.min()))
    keeping = replace(problem, margin=max(problem.margin, wanted))
    return MotionDescents(
        # Which departure pays is only known of motions that are timed.
        space=native_space(keeping, objective, timed=request.max_wait == 0.0 or objective.kernel is None),
        velocity=speed * scene.limits.velocity,
        acceleration=speed**2 * scene.limits.acceleration,
        is_free=_keeps(problem, 0.5 * problem.margin),
        has_clearance=_keeps(problem, _NEARLY * keeping.margin) if wanted else None,
        felt=request.constraints.charged,
        careful=request.constraints.level,
        projected=problem.projected if request.constraints.level else None,
        counts_points=objective.objective.exposure == "waypoints",
        settings=_affordable(settings, objective),
    )


def start_of(path: Path, ends: Endpoints) -> Start:
    """Return a path of a search as a start of descents, from the real start to a real goal."""
    whole, arrival = ends.joined(path)
    return start_along(whole, arrival, ends)


def start_along(whole: Path, arrival: int, ends: Endpoints) -> Start:
    """Return a whole path as a start of descents."""
    return Start(whole, _tight(ends.departure), _tight(ends.arrivals[arrival]), arrival=arrival)


def _keeps(problem: SceneProblem, margin: float) -> Callable[[Spline, Start], bool]:
    """Return whether curves keep a margin [m], but for tight ends."""
    free = replace(problem, margin=margin).states_free

    def is_free(curve: Spline, start: Start) -> bool:
        q = curve.samples
        if start.tight_start == start.tight_end == 0.0:
            return bool(free(q).all())
        done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
        clear = (done >= start.tight_start) & (done <= done[-1] - start.tight_end)
        return bool(free(q[clear]).all())

    return is_free


def _affordable(settings: DescentSettings, objective: SceneObjective) -> DescentSettings:
    """Spare evaluations where Python computes the cost of states."""
    return replace(settings, middle=LONG) if objective.kernel is None else settings


def _tight(way: Path) -> float:
    """Return the length at an end along which the spheres may be too close [rad]; the judge checks it exactly."""
    return max(_LEAST_TIGHT, 3.0 * way.length) if way.length > 0.0 else 0.0
