"""Descents for a request: their objective, clearance and starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np

from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import LONG, DescentSettings, MotionDescents, SmoothCurve, Start
from graceful_plan.planners.native import native_space
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.query.candidates.motions import price_of_time
from graceful_plan.query.endpoints.endpoints import Endpoints
from graceful_plan.query.request import Request
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.scene import Scene

TRACKING_CLEARANCE = 0.005
"""Clearance that descents keep from obstacles where the scene allows it [m].

A healthy robot and the object in its fingers deviate from the path by up to 6 mm (FailBench's Panda at half speed, six
tasks); with 3 mm, a held chart grazed a cabinet. Where a vessel has to stay level, this clearance is not part of the
margin, since a margin tightens the tilt limit, too: J of a watering can rose by a third."""
_HAND_STRAYS = 0.002
"""Deviation of the hand from the path [m]; 1 to 2.5 mm with a tray of 1.3 kg, FailBench's Panda at full speed."""
_TURNS = 0.035
"""Rotation of a held object in the fingers before it slips [rad]: 1 to 2 degrees for the same tray.

The rim of an object held by its handle then moves by 4 to 6 mm; with a clearance of 5 mm, it grazed a lamp in 5 of 16
motions."""
_NEARLY = 0.8
"""Share of the clearance below which a descent is repeated with a heavier penalty."""
SHORTENING = DescentSettings(screens=False, bends=0, fine=1, hurries=True)
"""Settings if the shortest motion is the best one.

A descent from one path ends within a percent of the shortest motion of its homotopy class, and a new search may find
another class."""
_SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))
_LEAST_LEG = 0.25
"""Least distance of the control point next to a moving start or goal, relative to the length of lead-in or run-in."""
_LEAST_TIGHT = 0.15
"""Least length at a tight end along which the sphere model is not checked [rad]."""


def motion_descents(request: Request, problem: SceneProblem, settings: DescentSettings) -> MotionDescents | None:
    """Return the descents for a request; None if its objective has no gradient.

    Args:
        request: The request.
        problem: The problem that was searched for paths.
        settings: Amount of work in a round.
    """
    objective = request.objective.descended()
    if objective is None:
        return None
    scene, speed = objective.scene, request.speed
    compiled = compile_scene(scene)
    ends = compiled.kernels.clearance(np.vstack([problem.start, problem.goals]))
    there_is = 0.5 * float(ends.min())
    margin = max(problem.margin, 0.0 if request.constraints.level else min(TRACKING_CLEARANCE, there_is))
    room = max(0.0, min(stray(scene), there_is) - margin)
    keeping = replace(problem, margin=margin, kernels=request.constraints.with_room(room))

    def nearly() -> SceneProblem:
        return replace(problem, margin=_NEARLY * margin, kernels=request.constraints.with_room(_NEARLY * room))

    return MotionDescents(
        # The best departure time is known only for timed motions.
        space=native_space(keeping, objective, timed=request.max_wait == 0.0 or objective.kernel is None),
        velocity=speed * scene.limits.velocity,
        acceleration=speed**2 * scene.limits.acceleration,
        is_free=_keeps(lambda: replace(problem, margin=0.5 * problem.margin)),
        has_clearance=_keeps(nearly) if margin + room > problem.margin else None,
        felt=request.constraints.penalised,
        time_price=price_of_time(request),
        projected=problem.projected if request.constraints.level else None,
        counts_points=objective.objective.exposure == "waypoints",
        settings=_affordable(settings, objective),
        leaving=None if request.lead is None else request.lead.velocity,
        least_leg=0.0 if request.lead is None else _LEAST_LEG * request.lead.path.length,
        arriving=None if request.run_in is None else request.run_in.velocity,
        least_last_leg=0.0 if request.run_in is None else _LEAST_LEG * request.run_in.path.length,
    )


@per_layout
def stray(scene: Scene) -> float:
    """Return the deviation of a healthy robot and its carried object from the path [m].

    A carried object adds the rotation in the fingers, times its largest distance from the tool.
    """
    if scene.carried is None:
        return TRACKING_CLEARANCE
    compiled = compile_scene(scene)
    mine = compiled.impact_tables.part_component == list(scene.components).index("carried")
    box = compiled.impact_tables.part_box[mine]
    R, centre, half = box[:, :9].reshape(-1, 1, 3, 3), box[:, None, 9:12], box[:, None, 12:]
    corners = (R @ (_SIGNS * half)[..., None])[..., 0] + centre
    reach = np.linalg.norm(corners - compiled.robot.X_LT[:3, 3], axis=-1).max(initial=0.0)
    return max(TRACKING_CLEARANCE, _HAND_STRAYS + _TURNS * float(reach))


def start_of(path: Path, ends: Endpoints) -> Start:
    """Return a path of a search as a start of descents, extended to the real start and a real goal."""
    whole, arrival = ends.joined(path)
    return start_along(whole, arrival, ends)


def start_onto(whole: Path, ends: Endpoints) -> Start:
    """Return a path from the real start as a start of descents to the real goal nearest to its end."""
    goals = np.stack([arrival.q[-1] for arrival in ends.arrivals])
    arrival = int(np.argmin(np.linalg.norm(goals - whole.q[-1], axis=1)))
    return start_along(Path(np.vstack([whole.q, goals[arrival]])).without_duplicates(), arrival, ends)


def start_along(whole: Path, arrival: int, ends: Endpoints) -> Start:
    """Return a whole path as a start of descents."""
    tight_start = 0.0 if ends.clear_lead else _tight(ends.departure)
    tight_end = 0.0 if ends.clear_run_in else _tight(ends.arrivals[arrival])
    return Start(whole, tight_start, tight_end, arrival=arrival)


def _keeps(problem: Callable[[], SceneProblem]) -> Callable[[SmoothCurve, Start], bool]:
    """Return a test whether curves are free in a problem, apart from their tight ends; the problem is built lazily."""
    made = cache(problem)

    def is_free(curve: SmoothCurve, start: Start) -> bool:
        q, free = curve.samples, made().states_free
        if start.tight_start == start.tight_end == 0.0:
            return bool(free(q).all())
        done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
        clear = (done >= start.tight_start) & (done <= done[-1] - start.tight_end)
        return bool(free(q[clear]).all())

    return is_free


def _affordable(settings: DescentSettings, objective: SceneObjective) -> DescentSettings:
    """Return settings with fewer evaluations if the cost of states is computed in Python."""
    return replace(settings, middle=LONG) if objective.kernel is None else settings


def _tight(way: Path) -> float:
    """Return the length at an end along which the sphere model may collide [rad]; the judge checks it exactly."""
    return max(_LEAST_TIGHT, 3.0 * way.length) if way.length > 0.0 else 0.0
