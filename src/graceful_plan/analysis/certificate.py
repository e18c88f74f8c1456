r"""What can be promised of a motion: clearance between samples, impact between samples, distance from the optimum.

* The clearance is certified: see `certified_clearance`.
* The bound on the exposure rests on measured slopes of the impact, and is as good as these: between neighbouring
  samples a and b, D apart, an impact that never changes faster than L integrates to at most

  .. math:: D \frac{I_a + I_b}{2} + \frac{L^2 D^2 - (I_b - I_a)^2}{4 L}

  with L twice the greatest slope between samples around there. Proven bounds on slopes exist for none of the models.
* The lower bound on J is proven: impact is never negative, and no path is shorter than the distance to the nearest
  goal. To a pose of the tool, none is shorter than the tool's distance and turn by the arm's greatest levers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.analysis.certified_clearance import certified_clearance
from graceful_plan.array_types import Float
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.kernels import COST_STEP, Kernels
from graceful_plan.costs.cost import StateBatch, checked_state
from graceful_plan.costs.objective import EdgeSamples, Objective, SceneObjective, trajectory_batch
from graceful_plan.exceptions import SettingError
from graceful_plan.path import Path, finite_array
from graceful_plan.result import Certificate, PlanResult, PlanStatus
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

SLOPE_SAFETY = 2.0
"""How much steeper the impact may be between samples than the steepest measured slope around."""
_STEP = 0.5 * COST_STEP
"""Largest joint-space distance between samples of the impact [rad]."""
_PERIOD = 0.004
"""Largest time between samples of the impact, where the exposure is time [s]."""


def certify(
    motion: PlanResult | Path | Trajectory | ArrayLike,
    scene: Scene,
    objective: Objective | None = None,
    *,
    goal: PoseGoal | ArrayLike | None = None,
) -> Certificate:
    """Say what can be promised of a motion; takes some milliseconds. Solved problems have it: `PlanResult.certificate`.

    Args:
        motion: A result with a trajectory, a path, a trajectory, or an array of configurations [n, nq]. Of a result the
            trajectory is certified to be clear, and the impact is that of what its cost was charged for.
        scene: The scene, with what is carried attached.
        objective: What was minimised; the default `Objective()` if None.
        goal: Where the motion might have ended instead: configurations or a pose. By default nowhere else.

    Raises:
        SettingError: If a result has no trajectory.
        ShapeError: If motion or goal do not fit the scene's joints.
    """
    bound = (objective or Objective()).bind(scene)
    if isinstance(motion, PlanResult):
        if motion.trajectory is None or motion.path is None:
            raise SettingError("motion", motion.status.name, "a result with a trajectory")
        return _certificate(motion.trajectory, _charged(motion, bound), bound, goal, motion.cost.total)
    given = motion if isinstance(motion, Path | Trajectory) else Path(np.asarray(motion))
    return _certificate(given, given, bound, goal, bound.breakdown(given).total)


def certificate_of(result: PlanResult, objective: SceneObjective, goal: PoseGoal | ArrayLike) -> Certificate | None:
    """Return the certificate of a solved problem, None of others.

    Args:
        result: What came out.
        objective: What was minimised.
        goal: Every configuration that would have done, or the pose.
    """
    if result.status is not PlanStatus.SOLVED or result.trajectory is None:
        return None
    return _certificate(result.trajectory, _charged(result, objective), objective, goal, result.cost.total)


def _charged(result: PlanResult, objective: SceneObjective) -> Path | Trajectory:
    """Return the motion whose exposure is in the cost of a result; see `finish`."""
    timed = objective.objective.exposure == "time" or bool(objective.scene.moving)
    motion = result.trajectory if timed else result.path
    assert motion is not None
    return motion


def _certificate(
    motion: Path | Trajectory,
    charged: Path | Trajectory,
    objective: SceneObjective,
    goal: PoseGoal | ArrayLike | None,
    total: float,
) -> Certificate:
    clear = certified_clearance(motion, objective.kernels)
    lower = lower_bound(motion.q[0], motion.q[-1:] if goal is None else goal, objective)
    return Certificate(
        clearance=clear.bound,
        uncertified=clear.uncertified,
        exposure_bound=exposure_bound(charged, objective),
        lower_bound=lower,
        gap=total / lower - 1.0 if lower is not None and lower > 0.0 else None,
    )


# --- exposure ---------------------------------------------------------------------------------------------------------


def exposure_bound(motion: Path | Trajectory, objective: SceneObjective) -> float:
    """Bound the exposure S of a motion from above by measured slopes of the impact; a sum over waypoints is exact."""
    kind = objective.objective.exposure
    if kind == "waypoints":
        return objective.breakdown(motion).impact
    if kind == "time" and isinstance(motion, Trajectory):
        between = np.linspace(motion.t[0], motion.t[-1], int(np.ceil(motion.duration / _PERIOD)) + 1)
        t = np.union1d(motion.t, between)
        impact = checked_state(objective.objective.impact, trajectory_batch(objective.scene, motion, t, t))
        return _envelope(impact[:-1], impact[1:], np.diff(t))
    samples, impact = _impact_along(motion, objective)
    joined = np.flatnonzero(samples.edge[:-1] == samples.edge[1:])
    measure = samples.length if kind == "length" else samples.duration
    share = np.diff(samples.place)[joined]
    return _envelope(impact[joined], impact[joined + 1], share * measure[samples.edge[joined]])


def _impact_along(motion: Path | Trajectory, objective: SceneObjective) -> tuple[EdgeSamples, Float[Array, " n"]]:
    """Sample the impact along a motion, the mean over both paces that stand for the velocities to come."""
    scene, paces = objective.scene, objective.objective.paces
    points = motion.path if isinstance(motion, Trajectory) else motion
    q0, q1 = points.q[:-1], points.q[1:]
    total, samples = np.zeros(0), EdgeSamples(q0, q1, scene.limits.velocity, paces, _STEP)
    times = None
    if isinstance(motion, Trajectory):
        times = np.interp(samples.place, np.arange(len(motion), dtype=np.float64), motion.t)
    for pace in dict.fromkeys(paces):
        fixed = EdgeSamples(q0, q1, scene.limits.velocity, (pace, pace), _STEP)
        batch = StateBatch(scene, fixed.q, fixed.direction, fixed.speed, times)
        value = checked_state(objective.objective.impact, batch)
        total = value if not len(total) else total + value
    return samples, total / len(dict.fromkeys(paces))


def _envelope(first: Float[Array, " n"], second: Float[Array, " n"], gap: Float[Array, " n"]) -> float:
    """Integrate the largest function between samples that climbs no faster than measured; see the module."""
    use = gap > 0.0
    first, second, gap = first[use], second[use], gap[use]
    if not len(gap):
        return 0.0
    slope = np.abs(second - first) / gap
    around = np.pad(slope, 1)
    steepest = SLOPE_SAFETY * np.maximum(slope, np.maximum(around[:-2], around[2:]))
    climb = (steepest * gap) ** 2 - (second - first) ** 2
    bump = np.divide(climb, 4.0 * steepest, out=np.zeros_like(climb), where=steepest > 0.0)
    return float((0.5 * gap * (first + second) + bump).sum())


# --- distance from the optimum ----------------------------------------------------------------------------------------


def lower_bound(start: Float[Array, " nq"], goal: PoseGoal | ArrayLike, objective: SceneObjective) -> float | None:
    """Return a cost J that no path to a goal undercuts; None if the motion cost is not the length."""
    if not objective.motion_is_length:
        return None
    if isinstance(goal, PoseGoal):
        return _least_to_pose(start, goal, objective.kernels)
    goals = np.atleast_2d(finite_array("goal", goal, last=len(start)))
    return float(np.linalg.norm(goals - start, axis=1).min())


def _least_to_pose(start: Float[Array, " nq"], goal: PoseGoal, kernels: Kernels) -> float:
    distance, angle = pose_error(goal, kernels.tool_pose(start))
    levers, hinges = _tool_levers(kernels.robot)
    # |dx| <= sum_k L_k |dq_k| <= |L| |dq|, and likewise for the angle with levers of 1.
    by_distance = max(0.0, distance - goal.position_tolerance) / float(np.linalg.norm(levers))
    return max(by_distance, max(0.0, angle - goal.orientation_tolerance) / np.sqrt(max(hinges, 1)))


def _tool_levers(robot: RobotArrays) -> tuple[Float[Array, " nq"], int]:
    """Bound the distance of the tool from each joint's axis in all configurations, 1 for a slide; count the hinges."""
    levers, hinges = np.zeros(len(robot.lower)), 0
    link, beyond = robot.tool_link, float(np.linalg.norm(robot.X_LT[:3, 3]))
    while link >= 0:
        joint = int(robot.joint[link])
        if joint >= 0 and robot.slide[link]:
            levers[joint] = 1.0
            beyond += float(max(abs(robot.lower[joint]), abs(robot.upper[joint])))
        elif joint >= 0:
            levers[joint], hinges = beyond, hinges + 1
        beyond += float(np.linalg.norm(robot.X_PL[link, :3, 3]))
        link = int(robot.parent[link])
    return levers, hinges
