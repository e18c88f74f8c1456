"""Goals with a velocity, such as that of a conveyor belt: motions arrive along it.

The path ends with a run-in, long enough to reach the velocity from rest, and the search ends at its beginning. Limits
on velocities, accelerations and specific forces do not depend on the direction of time. A run-in is therefore a stop
from the opposite velocity, backwards in time; the judge checks it as it is executed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.judge.verification import verify
from graceful_plan.path import finite_array
from graceful_plan.query.endpoints.configurations import wrapped_near
from graceful_plan.query.endpoints.goals import Goal
from graceful_plan.query.endpoints.lead_in import RunIn
from graceful_plan.query.endpoints.stopping import path_along, share_of_limits, stops_from, too_fast, within_limits
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.query.endpoints.usable import usable
from graceful_plan.result import PlanResult, PlanStatus, Verdict
from graceful_plan.timing.trajectory import REST, State, Trajectory

_HALVINGS = 5
"""Steps of the bisection for the largest possible share of a goal velocity, whose resolution is 3 %."""


def find_goal(
    goal: Goal | State,
    constraints: SceneConstraints,
    start: Float[Array, " nq"],
    speed: float,
    *,
    late: Callable[[], bool],
) -> tuple[Goal, RunIn | None] | PlanResult:
    """Return the goal of the search, and the run-in if the motion ends with a velocity; else why there is none.

    Args:
        goal: The goal.
        constraints: Constraints and scene.
        start: Start of the motion; joints without limits end near it.
        speed: Fraction of the velocity limits to use.
        late: Whether no time is left; it ends the search for a run-in.

    Raises:
        GracefulPlanError: For wrong shapes and NaN, and for a velocity of a robot with a base.
    """
    if not isinstance(goal, State):
        return goal, None
    scene, nq = constraints.scene, len(constraints.scene.joints)
    q, velocity = (finite_array(f"goal.{name}", getattr(goal, name), ndim=1, last=nq) for name in ("q", "qd"))
    if np.abs(velocity).max() <= REST:
        return q, None
    if scene.base is not None:
        raise UnsupportedError("a goal with a velocity does not support mobile bases; plan to rest")
    possible = within_limits(velocity, speed, scene)
    if possible is None:
        most = 1.0 / float(share_of_limits(velocity, speed, scene).max())
        told = f"{too_fast('goal', velocity, speed, scene)}; {most:.3g} of the velocity is within the limits"
        return PlanResult(status=PlanStatus.INVALID_GOAL, detail=told)
    wrapped = wrapped_near(q[None], start, scene)
    found = usable(["goal"], wrapped, scene, Travel(start))
    if not len(found.q):
        return PlanResult(status=PlanStatus.INVALID_GOAL, detail=found.detail)
    return _run_in(State(found.q[0], possible), constraints.around(found.q), start, speed, late)


def _run_in(
    goal: State, held: SceneConstraints, start: Float[Array, " nq"], speed: float, late: Callable[[], bool]
) -> tuple[Goal, RunIn | None] | PlanResult:
    scene, why = held.scene, ""
    for motion, is_straight in _run_ins(goal, held, speed, late):
        if late():
            return PlanResult(status=PlanStatus.TIMEOUT, detail="goal: no run-in of its velocity was found in time")
        verdict = _verdict(motion, goal, held)
        if not verdict.passed:
            why = why or f"the straight run-in takes {motion.duration:.3g} s; {_problems(verdict)}"
            continue
        path, is_clear = path_along(motion.reversed(), -goal.qd, held, is_straight=is_straight)
        path = path.reversed()
        # The search wraps joints without limits near the start.
        turns = wrapped_near(path.q[:1], start, scene)[0] - path.q[0]
        run_in = RunIn(
            goal.qd,
            replace(path, q=path.q + turns),
            is_clear,
            Trajectory(motion.t, motion.q + turns, motion.qd, motion.qdd, motion.joints),
            _beyond(goal, motion, held, speed, late),
        )
        return run_in.path.q[0], run_in
    detail = f"goal: its velocity cannot be reached; {why}{_possible_share(goal, held, speed, late)}"
    return PlanResult(status=PlanStatus.INVALID_GOAL, detail=detail)


def _possible_share(goal: State, held: SceneConstraints, speed: float, late: Callable[[], bool]) -> str:
    """Return a message with the largest share of a goal velocity that is possible; empty without time to find it."""
    least, most = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (least + most)
        slower = State(goal.q, middle * goal.qd)
        passes = any(_verdict(motion, slower, held).passed for motion, _ in _run_ins(slower, held, speed, late))
        if late():
            return ""
        least, most = (middle, most) if passes else (least, middle)
    return f"; {least:.2g} of the velocity is possible" if least else f"; nor is {most:.2g} of the velocity possible"


def _run_ins(
    goal: State, held: SceneConstraints, speed: float, late: Callable[[], bool]
) -> Iterator[tuple[Trajectory, bool]]:
    """Yield motions from rest to a goal with a velocity to try, and whether they are straight."""
    for stop, is_straight in stops_from(State(goal.q, -goal.qd), held, speed, late):
        yield stop.reversed(), is_straight


def _verdict(motion: Trajectory, goal: State, held: SceneConstraints) -> Verdict:
    proof = compile_scene(held.scene).proof.clearance
    return verify(motion, held.scene, goal=goal, constraints=held.constraints, clearance=proof)


def _problems(verdict: Verdict) -> str:
    return "; ".join(f"{name}: {verdict.checks[name].detail}" for name in verdict.failures)


def _beyond(goal: State, motion: Trajectory, held: SceneConstraints, speed: float, late: Callable[[], bool]) -> str:
    """Return a note if the robot cannot stop beyond the goal after the run-in `motion`; empty without time to check."""
    before, why = motion.later(-motion.duration), ""
    for stop, _ in stops_from(goal, held, speed, late):
        proof = compile_scene(held.scene).proof.clearance
        verdict = verify(stop, held.scene, start=goal, constraints=held.constraints, clearance=proof, before=before)
        if verdict.passed:
            return ""
        why = why or f"the straight stop takes {stop.duration:.3g} s; {_problems(verdict)}"
    return "" if late() else f"goal: no stop beyond it; {why}"
