"""Starts of robots that move: motions leave along the present velocity.

The path begins with a straight lead-in along the velocity, long enough to stop in it, and the search starts at its end.
Timing begins with the present speed, so a motion along that path may stop there at worst. Descents keep only the
direction of the lead-in; their curves turn away as early as the limits allow. Where a straight lead-in is blocked, it
is the path of another stop.

Planning for a mobile base begins where it can stop on its present arc; see `BasePlanning.passing` for how the motion
goes on without a rest there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import SettingError
from graceful_plan.judge.verification import verify
from graceful_plan.path import finite_array
from graceful_plan.query.base_planning import BasePlanning, base_planning
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE
from graceful_plan.query.endpoints.goals import start_configuration
from graceful_plan.query.endpoints.lead_in import LeadIn, Takeover
from graceful_plan.query.endpoints.real_start import RealStart, real_start, without_turns
from graceful_plan.query.endpoints.stopping import path_along, stops_from, too_fast, within_limits
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import REST, State, Trajectory


def find_start(
    start: Configuration | State,
    constraints: SceneConstraints,
    tolerance: float,
    speed: float,
    *,
    late: Callable[[], bool],
    max_wait: float = 0.0,
    stops: bool = False,
) -> tuple[RealStart, LeadIn | None] | PlanResult:
    """Return where to begin planning, and the lead-in if the robot moves; if it cannot stop, return why.

    Args:
        start: Configuration, keyframe, or state; a `Takeover` has the motion that the robot leaves.
        constraints: Constraints and scene.
        tolerance: See `real_start`.
        speed: Fraction of the velocity limits to use.
        late: Whether no time is left; it ends the search for a stop.
        max_wait: Longest wait before the motion [s], which a moving robot cannot do.
        stops: Whether the motion stops before it goes on, without a lead-in.

    Raises:
        GracefulPlanError: For wrong shapes, NaN and unknown names, and for a moving robot that shall wait.
    """
    scene = constraints.scene
    takeover = start if isinstance(start, Takeover) else None
    if not isinstance(start, State):
        return real_start(start_configuration(start, scene), constraints, tolerance, speed), None
    q, velocity = _checked(start, scene)
    if np.abs(velocity).max() <= REST:
        real = real_start(q, constraints, tolerance, speed)
        return replace(real, takeover=None if takeover is None else takeover.without_turns(real.turns)), None
    if max_wait:
        raise SettingError("max_wait", max_wait, "0 for a robot that moves: it cannot wait")
    driving, possible = base_planning(scene), within_limits(velocity, speed, scene)
    why = "" if driving is None else driving.impossible_velocity(State(q, velocity), scene, speed)
    if why or possible is None:
        told = why or too_fast("start", velocity, speed, scene)
        return PlanResult(status=PlanStatus.INVALID_START, detail=told)
    q, turns = without_turns(q, scene)
    takeover = None if takeover is None else takeover.without_turns(turns)
    return _stoppable(State(q, possible), turns, constraints, speed, takeover, late=late, stops=stops)


def _checked(state: State, scene: Scene) -> tuple[Array, Array]:
    nq = len(scene.joints)
    q = finite_array("start.q", state.q, ndim=1, last=nq)
    return q, finite_array("start.qd", state.qd, ndim=1, last=nq)


def _stoppable(
    state: State,
    turns: Float[Array, " nq"],
    constraints: SceneConstraints,
    speed: float,
    takeover: Takeover | None,
    *,
    late: Callable[[], bool],
    stops: bool,
) -> tuple[RealStart, LeadIn | None] | PlanResult:
    """Return the lead-in by the first stop that the judge passes, or with `stops` that stop; else why there is none."""
    scene, driving = constraints.scene, base_planning(constraints.scene)
    held = constraints.around(state.q[None])
    before = None if takeover is None else takeover.before
    kind, why = "straight stop" if driving is None else "stop on the present arc", ""
    tried = stops_from(state, held, speed, late, takeover)
    if driving is not None:
        tried = ((stop, False) for stop in _driving_stops(driving, state, held, speed, takeover))
    for stop, is_straight in tried:
        if late():
            return PlanResult(status=PlanStatus.TIMEOUT, detail="start: the robot moves, and no stop was found in time")
        verdict = verify(
            stop,
            scene,
            start=state,
            constraints=held.constraints,
            clearance=compile_scene(scene).proof.clearance,
            before=before,
        )
        if not verdict.passed:
            problems = "; ".join(f"{name}: {verdict.checks[name].detail}" for name in verdict.failures)
            why = why or f"the {kind} takes {stop.duration:.3g} s; {problems}"
            continue
        if driving is None and not stops:
            path, is_clear = path_along(stop, state.qd, held, is_straight=is_straight)
            return RealStart(stop.q[-1], turns, takeover=takeover), LeadIn(state.qd, path, is_clear, stop)
        note = "it stops first" if stops else ""
        return RealStart(stop.q[-1], turns, stop, note=note, takeover=takeover, passes=not stops), None
    return PlanResult(status=PlanStatus.INVALID_START, detail=f"start: the robot moves and cannot stop; {why}")


def _driving_stops(
    driving: BasePlanning, state: State, held: SceneConstraints, speed: float, takeover: Takeover | None
) -> Iterator[Trajectory]:
    """Yield stops of a base on its present arc, then one along its former motion; last those that end in a tight place.

    From there, a base cannot leave in every direction.
    """
    tight = []
    for stop in _base_stops(driving, state, held, speed, takeover):
        if held.clearance(stop.q[-1:])[0] >= TARGET_CLEARANCE:
            yield stop
        else:
            tight.append(stop)
    yield from tight


def _base_stops(
    driving: BasePlanning, state: State, held: SceneConstraints, speed: float, takeover: Takeover | None
) -> Iterator[Trajectory]:
    yield from driving.stops(state, held, speed)
    if takeover is not None and (along := takeover.stop()) is not None:
        yield along
