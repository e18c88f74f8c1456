r"""Certificates of a motion: clearance between samples, and a lower bound of the path length.

* The clearance is certified: see `certified_clearance`.
* The lower bound is proven: no path is shorter than the distance to the nearest goal. To reach a pose, the tool has to
  translate and rotate; the bound divides both amounts by the arm's greatest levers. Impact is never negative, so the
  bound holds for J, too. Where impact contributes to J the bound is loose; hence the gap is reported at w = 0 only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.analysis.certified_clearance import certified_clearance
from graceful_plan.array_types import Array, Float
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels
from graceful_plan.costs.objective import Objective, SceneObjective
from graceful_plan.exceptions import SettingError, ShapeError
from graceful_plan.path import Path, finite_array
from graceful_plan.result import Certificate, PlanResult
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory


def certify(
    motion: PlanResult | Path | Trajectory | ArrayLike,
    scene: Scene,
    objective: Objective | None = None,
    *,
    goal: PoseGoal | ArrayLike | None = None,
) -> Certificate:
    """Certify the clearance of a motion and bound its length from below; takes a few milliseconds.

    Args:
        motion: A result with a trajectory, a path, a trajectory, or an array of configurations [n, nq]. For a result,
            the clearance is that of the trajectory, and the gap uses the cost in the result.
        scene: The scene, with the carried object attached.
        objective: The objective of the search; the default `Objective()` if None.
        goal: Alternative goals of the motion: configurations or a pose. By default only its own end.

    Raises:
        SettingError: If a result has no trajectory.
        ShapeError: If motion or goal do not fit the scene's joints.
    """
    bound = (objective or Objective()).bind(scene)
    w = bound.w
    if isinstance(motion, PlanResult):
        if motion.trajectory is None:
            raise SettingError("motion", motion.status.name, "a result with a trajectory")
        moved, length, w = motion.trajectory, motion.cost.motion, motion.cost.w
    else:
        moved = motion if isinstance(motion, Path | Trajectory) else Path(finite_array("motion", motion, ndim=2))
        length = moved.length if isinstance(moved, Path) else moved.path.length
    clear = certified_clearance(moved, compile_scene(bound.scene).proof)
    least = lower_bound(moved.q[0], moved.q[-1:] if goal is None else goal, bound)
    return Certificate(
        clearance=clear.bound,
        uncertified=clear.uncertified,
        lower_bound=least,
        gap=length / least - 1.0 if least and w == 0.0 else None,
    )


def lower_bound(start: Float[Array, " nq"], goal: PoseGoal | ArrayLike, objective: SceneObjective) -> float | None:
    """Compute a lower bound of the length of paths to a goal [rad]; None if the motion cost is not the length."""
    if not objective.motion_is_length:
        return None
    if isinstance(goal, PoseGoal):
        return _least_to_pose(start, goal, objective.kernels)
    goals = np.atleast_2d(finite_array("goal", goal, last=len(start)))
    if not len(goals):
        raise ShapeError("goal", goals.shape, f"(n >= 1, {len(start)})")
    return float(np.linalg.norm(goals - start, axis=1).min())


def _least_to_pose(start: Float[Array, " nq"], goal: PoseGoal, kernels: Kernels) -> float:
    distance, angle = pose_error(goal, kernels.tool_pose(start))
    levers, hinges = _tool_levers(kernels.robot)
    # |dx| <= sum_k L_k |dq_k| <= |L| |dq|, and likewise for the angle with levers of 1.
    by_distance = max(0.0, distance - goal.position_tolerance) / float(np.linalg.norm(levers))
    return max(by_distance, max(0.0, angle - goal.orientation_tolerance) / np.sqrt(max(hinges, 1)))


def _tool_levers(robot: RobotArrays) -> tuple[Float[Array, " nq"], int]:
    """Bound the tool's distance from each joint axis in all configurations (1 for a slide), and count the hinges."""
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
