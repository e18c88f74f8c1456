"""replan(): a new motion for a robot that executes another one, from a moment of that on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.constraint import Constraint
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.exceptions import SettingError
from graceful_plan.judge.verification import LIMIT_TOLERANCE, verify
from graceful_plan.path import Path, finite_array
from graceful_plan.plan import plan
from graceful_plan.planners.motion_descent import DRIVING_TIME_PRICE, time_price
from graceful_plan.query.arguments import checked_objective, checked_speed
from graceful_plan.query.candidates.departure import at_time
from graceful_plan.query.endpoints.configurations import configurations_of, wrapped_near
from graceful_plan.query.endpoints.goals import Goal, has_poses
from graceful_plan.query.endpoints.lead_in import Takeover
from graceful_plan.query.stop import quickest_stop, surely_collides
from graceful_plan.result import PlanResult, PlanStatus, Verdict
from graceful_plan.scene.mobile.base_pose import BasePose
from graceful_plan.scene.pose_goal import PoseGoal, pose_error
from graceful_plan.scene.scene import Scene, checked_scene
from graceful_plan.setting_checks import finite
from graceful_plan.timing.trajectory import REST, State, Trajectory

TIME_LIMIT = 0.1
"""Default time limit of a call [s]: ten times that of a first verified motion on bundled scenes."""
_REMEMBERED = 60.0
"""Time before the takeover from which on the swing of contents is computed [s]; in a mug it decays to 1 in 400."""


def replan(
    motion: Trajectory,
    scene: Scene,
    *,
    at: float,
    goal: Goal | State | None = None,
    w: float | None = None,
    objective: Objective | None = None,
    time_limit: float | None = None,
    iterations: int | None = None,
    seed: int = 0,
    speed: float = 1.0,
    constraints: Iterable[Constraint] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> PlanResult:
    """Plan a motion that takes over from another one while the robot moves, such as after a change of the scene.

    The rest of the present motion is verified again in the scene. It is kept if it passes, leads to the goal, and no
    better one is found. The new motion begins at `at` with the position and velocity of the present one.

    The robot follows the present motion until `at`. A result that comes later than that must be dropped, so `at` has
    to be later than the present time by more than the time limit.

    Args:
        motion: The motion that the robot executes.
        scene: The scene as it is now. Predictions of moving entities are on the clock of `motion`.
        at: Time at which the new motion takes over, on the clock of `motion` [s].
        goal: See `plan`; by default the end of `motion`, with the velocity that it has there.
        w: Safety weight; see `plan`.
        objective: Objective to minimise; see `plan`.
        time_limit: Time budget of the whole call [s]; 0.1 by default, unlimited if `iterations` is given. Only the
            search for a stop along a blocked motion goes on beyond it.
        iterations: Planner iterations; see `plan`.
        seed: Seed of all random numbers.
        speed: Fraction of the velocity limits to use; the robot must not be faster at `at`.
        constraints: Constraints along the motion; see `plan`.
        cancelled: See `plan`.

    Returns:
        The result. If it is SOLVED, its trajectory leads to the goal, and `detail` says whether it is the present
        motion. Otherwise no such motion was found. The trajectory is then the rest of the present motion if that
        passes in the scene, else the quickest verified stop along it; it is None if there is no such stop either.
        Every trajectory begins at `at`: `motion.spliced(result.trajectory)` is the motion to execute from then on.

    Raises:
        GracefulPlanError: For misuse, as by `plan`.
    """
    started = time.perf_counter()
    if not isinstance(motion, Trajectory):
        raise SettingError("motion", motion, "a Trajectory")
    finite("at", at, "a finite time [s]")
    checked_scene(scene)
    limit = TIME_LIMIT if time_limit is None and iterations is None else time_limit
    asked = tuple(default_constraints(scene) if constraints is None else constraints)
    bound = checked_objective(objective, w).bind(scene, search_paces(checked_speed(speed)))
    end = State(motion.q[-1], motion.qd[-1])
    if at > motion.t[-1] and np.abs(end.qd).max() > REST:
        raise SettingError("at", at, f"at most {motion.t[-1]:.6g} s, where the motion ends with a velocity")
    motion = motion.since(min(at, float(motion.t[-1])) - _REMEMBERED)
    rest = motion.since(at)
    leads = goal is None or _reaches(end, goal, scene)
    began = time.perf_counter()
    kept = _kept(motion, rest, scene, asked)
    verdict_seconds = time.perf_counter() - began

    @cache
    def stop() -> tuple[Trajectory, Verdict] | None:
        return quickest_stop(motion, scene, float(at), asked)

    if not kept.passed:
        stop()  # first, since planning may use up the time
    found = plan(
        _takeover(motion, at, None if kept.passed and leads else stop, rest.path if leads else None),
        end if goal is None else goal,
        at_time(scene, at),
        objective=bound.objective,
        # A new motion needs a verdict, too, which takes about as long.
        time_limit=None if limit is None else max(0.0, limit - verdict_seconds - (time.perf_counter() - started)),
        iterations=iterations,
        seed=seed,
        speed=speed,
        constraints=asked,
        cancelled=cancelled,
    )
    found = replace(found, stats={**found.stats, "total_time": time.perf_counter() - started})
    if kept.passed and leads:
        price = time_price(careful=SceneConstraints(scene, asked).level)
        price = price if scene.base is None else DRIVING_TIME_PRICE
        cost = bound.breakdown(rest)
        if cost.total + price * rest.duration <= _ranking(found, price):
            kept_on = replace(found, status=PlanStatus.SOLVED, cost=cost, goal_index=0)
            return _along(kept_on, rest, kept, "the present motion is kept")
    if found.trajectory is not None:
        return replace(found, trajectory=found.trajectory.later(at))
    if kept.passed:
        return _along(found, rest, kept, f"{found.detail}; the trajectory is the rest of the present motion")
    if (halt := stop()) is not None:
        return _along(found, *halt, f"{found.detail}; the trajectory is a stop")
    return found


def _reaches(end: State, goal: Goal | State, scene: Scene) -> bool:
    """Return whether the end of a motion meets a goal."""
    if isinstance(goal, State):
        step = np.abs(end.qd - finite_array("goal.qd", goal.qd, ndim=1, last=len(end.qd))).max()
        return bool(step <= LIMIT_TOLERANCE) and _is_at(end.q, goal.q, scene)
    return bool(np.abs(end.qd).max() <= REST) and _is_at(end.q, goal, scene)


def _is_at(q: Float[Array, " nq"], goal: Goal, scene: Scene) -> bool:
    """Return whether a configuration meets a goal."""
    if isinstance(goal, PoseGoal):
        position, orientation = pose_error(goal, compile_scene(scene).kernels.tool_pose(q))
        return position <= goal.position_tolerance and orientation <= goal.orientation_tolerance
    if isinstance(goal, BasePose):
        turn = 0.0 if goal.yaw is None else np.remainder(goal.yaw - q[2] + np.pi, 2.0 * np.pi) - np.pi
        return bool(max(abs(goal.x - q[0]), abs(goal.y - q[1]), abs(turn)) <= LIMIT_TOLERANCE)
    if has_poses(goal):
        return any(_is_at(q, one, scene) for one in goal)  # type: ignore[union-attr, arg-type]
    away = wrapped_near(configurations_of(goal, scene), q, scene) - q  # type: ignore[arg-type]
    return bool(np.abs(away).max(axis=1).min() <= LIMIT_TOLERANCE)


def _ranking(result: PlanResult, price: float) -> float:
    return np.inf if result.trajectory is None else result.cost.total + price * result.trajectory.duration


def _along(result: PlanResult, trajectory: Trajectory, verdict: Verdict, detail: str) -> PlanResult:
    return replace(result, path=trajectory.path, trajectory=trajectory, verdict=verdict, detail=detail)


def _kept(motion: Trajectory, rest: Trajectory, scene: Scene, constraints: tuple[Constraint, ...]) -> Verdict:
    """Verify the rest of a motion in a scene that may have changed; a failed verdict may be empty."""
    if surely_collides(rest, scene):
        return Verdict()
    held = SceneConstraints(scene, constraints).around(rest.q[[0, -1]])
    proof = compile_scene(scene).proof.clearance
    begun, end = motion.at(float(rest.t[0])), State(rest.q[-1], rest.qd[-1])
    return verify(rest, scene, start=begun, goal=end, constraints=held.constraints, clearance=proof, before=motion)


def _takeover(
    motion: Trajectory,
    at: float,
    stop: Callable[[], tuple[Trajectory, Verdict] | None] | None,
    onward: Path | None,
) -> Takeover:
    """Return the start of the new motion, whose time is 0 at `at`.

    A stop along the present motion takes long to find, so it is not looked for where that motion is kept anyway.
    """

    def halt() -> Trajectory | None:
        found = None if stop is None else stop()
        return None if found is None else found[0].later(-at)

    return Takeover(motion.at(float(at)), before=motion.later(-at), stop=halt, onward=onward)
