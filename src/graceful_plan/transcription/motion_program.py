"""Nonlinear program of `optimise_trajectory`: cost terms and limits of a task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import Cost
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.transcription.motion_charges import ImpactCharge, acceleration_charge, effort_charge, length_charge
from graceful_plan.transcription.motion_rows import (
    acceleration_rows,
    clearance_rows,
    continuity_rows,
    jerk_rows,
    position_rows,
    samples_at,
    torque_rows,
    velocity_rows,
)
from graceful_plan.transcription.spline_program import (
    Charging,
    Integral,
    SplineCost,
    SplineLayout,
    SplineProgram,
    SplineRows,
)
from graceful_plan.transcription.symbolic import SymbolicRobot

OBJECTIVES = ("time", "effort", "acceleration", "length")
_HALVES = np.array([0.0, 0.5])
_THIRDS = np.array([0.0, 0.5, 1.0])
_SIMPSON = np.array([1.0, 4.0, 1.0]) / 6.0
_STRETCH = 1.05
"""Factor on the initial duration, so that the limits also hold between nodes."""
_SHORTEST, _LONGEST = 0.05, 50.0
"""Bounds of the duration, as fractions of the initial duration."""
_SLACK = {
    "position": 1e-6,
    "velocity": 1e-3,
    "acceleration": 1e-3,
    "jerk": 1e-3,
    "acceleration continuity": 1e-6,
    "torque": 1e-3,
    "clearance": 1e-3,
}
"""Relative excess per limit up to which an iterate is kept: a slight slowdown removes it."""
_MOMENTS = 800
"""Samples of a trajectory at which its cost is evaluated."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class MotionTask:
    """Arguments of `optimise_trajectory` after checks; see there."""

    scene: Scene
    objective: str
    w: float
    impact: Cost
    duration: float
    jerk: Float[Array, " nq"] | None
    robot: SymbolicRobot | None
    """Symbolic robot; None unless torques are minimised or limited."""
    torque: bool
    margin: float
    intervals: int


def motion_program(task: MotionTask, guess: Trajectory, margin: float) -> tuple[SplineProgram, Array]:
    """Return the program of a task, with a clearance to keep [m], and its initial point."""
    limits, nq = task.scene.limits, len(task.scene.joints)
    h = min(_STRETCH * guess.duration, max(task.duration, 1e-6)) / task.intervals
    layout = SplineLayout(task.intervals, nq, h)
    state = guess.at(np.linspace(guess.t[0], guess.t[-1], task.intervals + 1))
    x = layout.pack(state.q, state.qd * guess.duration / task.intervals, h)
    linear = [
        position_rows(layout, *limits.position.T),
        velocity_rows(layout, limits.velocity),
        acceleration_rows(layout, limits.acceleration),
    ]
    if task.jerk is not None:
        linear += [jerk_rows(layout, task.jerk), continuity_rows(layout, limits.acceleration)]
    near = samples_at(layout, _HALVES, first=False)
    kernels = compile_scene(task.scene).kernels
    clearance = kernels.clearance(near.states(x)[0])
    sampled = [clearance_rows(near, kernels, _wanted_clearance(clearance, margin))]
    if task.torque and task.robot is not None:
        sampled.append(torque_rows(samples_at(layout, _THIRDS), task.robot, np.asarray(limits.torque)))
    cost = SplineCost(1.0 if task.objective == "time" else 0.0, _integrals(task, layout))
    return SplineProgram(layout, _bounds(task, layout, x), cost, SplineRows(linear, sampled, _SLACK)), x


def motion_cost(task: MotionTask, motion: Trajectory) -> float:
    """Evaluate the task's cost of any trajectory, by the midpoint rule in time."""
    if not motion.duration > 0.0:
        return 0.0
    state = motion.at(motion.t[0] + (np.arange(_MOMENTS) + 0.5) / _MOMENTS * motion.duration)
    states = np.stack(state)
    density = np.full(_MOMENTS, 1.0 if task.objective == "time" else 0.0)
    for charge in _charges(task):
        density += charge(states, False).value
    return motion.duration * float(density.mean())


def _charges(task: MotionTask) -> list[Charging]:
    limits = task.scene.limits
    found: list[Charging] = []
    if task.objective == "effort":
        assert task.robot is not None
        found.append(effort_charge(task.robot, np.asarray(limits.torque)))
    if task.objective == "acceleration":
        found.append(acceleration_charge(np.asarray(limits.acceleration)))
    if task.objective == "length":
        found.append(length_charge)
    if task.w > 0.0:
        found.append(ImpactCharge(task.impact, task.scene, task.w))
    return found


def _integrals(task: MotionTask, layout: SplineLayout) -> list[Integral]:
    """Return integrals by Simpson's rule on each piece; nodes are sampled on both sides, for accelerations may jump."""
    samples = samples_at(layout, _THIRDS)
    return [Integral(samples, np.tile(_SIMPSON, layout.pieces), charge) for charge in _charges(task)]


def _wanted_clearance(clearance: Float[Array, " n"], margin: float) -> Float[Array, " n"]:
    """Return the margin, reduced near ends that have less clearance, such as a grasp."""
    least = np.full(len(clearance), margin)
    for view, own in ((least, clearance), (least[::-1], clearance[::-1])):
        run = int(np.argmax(own >= margin)) if np.any(own >= margin) else 0
        view[:run] = np.minimum(view[:run], own[:run])
    return least


def _bounds(task: MotionTask, layout: SplineLayout, x: Array) -> tuple[Array, Array]:
    """Return bounds: nodes within position limits, both ends fixed and at rest, a positive and limited duration."""
    lower, upper = task.scene.limits.position.T
    found = []
    for position, velocity, duration in (
        (lower, -np.inf, _SHORTEST * task.intervals * layout.time),
        (upper, np.inf, min(task.duration, _LONGEST * task.intervals * layout.time)),
    ):
        node = np.concatenate([position, np.full(layout.nq, velocity)])
        bound = np.append(np.tile(node, layout.pieces + 1), duration / (layout.pieces * layout.time))
        n = 2 * layout.nq
        bound[:n], bound[-1 - n : -1] = x[:n], x[-1 - n : -1]
        bound[layout.nq : n] = bound[-1 - layout.nq : -1] = 0.0
        found.append(bound)
    return found[0], found[1]
