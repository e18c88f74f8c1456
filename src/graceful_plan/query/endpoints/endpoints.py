"""Both ends of a plan: planner start and goals with clearance, and escape paths between them and the real ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.constraints.scene_constraints import SceneConstraints
from graceful_plan.costs.objective import SceneObjective
from graceful_plan.judge.exact import nearest_pair
from graceful_plan.path import Path
from graceful_plan.query.endpoints.configurations import Configuration
from graceful_plan.query.endpoints.escape import TARGET_CLEARANCE, way_out
from graceful_plan.query.endpoints.goals import Goal, has_poses, resolve_goal, resolve_start
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.query.endpoints.usable import Resolved
from graceful_plan.result import PlanResult, PlanStatus
from graceful_plan.scene.scene import Scene

_SHARE_OF_GOALS = 0.6
"""Share of the time budget after which inverse kinematics ends with the goals found by then."""
_SHARE_OF_SETS, _SHARE_OF_WAYS = 0.2, 0.3
"""Shares of the time budget after which one usable configuration, and one with an escape path, is enough.

Configurations near the start are checked first; by then, planning to one of them helps more than checking others."""
_TOLD = 5
"""Largest number of goals whose violations are listed."""
_NO_WAY = "{}: free, but no short move leads to 2 mm of clearance of the planner's sphere model"


@dataclass(frozen=True, kw_only=True, eq=False)
class Endpoints:
    """Start and goals of the planner, with paths from the real start and to the real goals."""

    constraints: SceneConstraints
    """Constraints along the motion, loosened as far as start and goals need."""
    departure: Path
    """Path from the real start to the planner's start."""
    arrivals: tuple[Path, ...]
    """Paths from the planner's goals to the real goals."""
    goal_index: tuple[int, ...]
    """Index of the given goal that each arrival leads to."""
    notes: tuple[str, ...] = ()
    """Adjustments that made start and goals usable."""
    clear_lead: bool = False
    """Whether `departure` is the lead-in of a moving start alone, and the fast checker finds it free."""
    clear_run_in: bool = False
    """Whether the only one of `arrivals` is the run-in of a moving goal alone, and the fast checker finds it free."""

    @property
    def clearance(self) -> float:
        """Least clearance of the planner's start and goals [m]; at least 0."""
        q = np.stack([self.departure.q[-1], *(arrival.q[0] for arrival in self.arrivals)])
        return max(0.0, float(self.constraints.clearance(q).min()))

    def joined(self, path: Path) -> tuple[Path, int]:
        """Return the whole path from the real start to a real goal, and the index of its arrival."""
        away = [float(np.linalg.norm(arrival.q[0] - path.q[-1])) for arrival in self.arrivals]
        index = int(np.argmin(away))
        q = np.concatenate([self.departure.q[:-1], path.q, self.arrivals[index].q[1:]])
        return Path(q).without_duplicates(), index

    def in_the_clear(self, index: int) -> bool:
        """Return whether a whole path with this arrival has no escape paths, so that the fast checker finds it free."""
        leaves, arrives = len(self.departure) == 1, len(self.arrivals[index]) == 1
        return (leaves or self.clear_lead) and (arrives or self.clear_run_in)


def find_endpoints(
    start: Configuration,
    goal: Goal,
    constraints: SceneConstraints,
    rng: np.random.Generator,
    *,
    objective: SceneObjective | None = None,
    seed: int = 0,
    cancelled: Callable[[], bool] = lambda: False,
    late: Callable[[float], bool] = lambda _: False,
) -> Endpoints | PlanResult:
    """Convert the user's start and goal to both ends of a plan; if that fails, return a result with the reason.

    Args:
        start: Configuration or keyframe.
        goal: Configuration, keyframe, pose, or several of these.
        constraints: Constraints and scene.
        rng: Random numbers for escape paths.
        objective: Objective whose motion cost ranks goal configurations; by default the joint-space length does.
        seed: Seed of the random numbers of inverse kinematics.
        cancelled: Ends the call early once it returns True.
        late: Returns whether more than a share of the time budget is used up.

    Raises:
        GracefulPlanError: For misuse: wrong shapes, NaN, unknown names.
    """
    scene = constraints.scene
    starts = constrained("start", resolve_start(start, scene), constraints)
    if not len(starts.q):
        return PlanResult(status=PlanStatus.INVALID_START, detail=starts.detail)
    found = resolve_goal(
        goal,
        scene,
        starts.q[0],
        objective=objective,
        seed=seed,
        cancelled=lambda: cancelled() or late(_SHARE_OF_GOALS),
        hurried=lambda: late(_SHARE_OF_SETS),
    )
    goals = constrained("goal", found, constraints)
    if cancelled():
        return PlanResult(status=PlanStatus.CANCELLED, detail="before the search")
    if not len(goals.q) and has_poses(goal) and late(_SHARE_OF_GOALS):
        return PlanResult(status=PlanStatus.TIMEOUT, detail=f"no time to look for more; {goals.detail}")
    if not len(goals.q):
        return PlanResult(status=PlanStatus.INVALID_GOAL, detail=goals.detail)
    held = constraints.around(np.vstack([starts.q[:1], goals.q]))
    ends = ways_out(Travel(starts.q[0], objective), goals.q, held, rng, cancelled, late)
    if isinstance(ends, PlanResult):
        return ends
    index = tuple(goals.index[k] for k in ends.goal_index)
    return replace(ends, goal_index=index, notes=(*starts.notes, *goals.notes))


def constrained(word: str, resolved: Resolved, constraints: SceneConstraints) -> Resolved:
    """Return the configurations that satisfy the constraints, with the violations of the others as problems."""
    holds = constraints.holds(resolved.q) if len(resolved.q) else np.ones(0, dtype=bool)
    kept = np.flatnonzero(holds)
    told = tuple(f"{word}: {'; '.join(constraints.objections(q))}" for q in resolved.q[~holds][:_TOLD])
    index = tuple(resolved.index[k] for k in kept)
    return Resolved(resolved.q[kept], index, resolved.notes, (*resolved.problems, *told))


def ways_out(
    travel: Travel,
    goals: Float[Array, "goal nq"],
    constraints: SceneConstraints,
    rng: np.random.Generator,
    cancelled: Callable[[], bool] = lambda: False,
    late: Callable[[float], bool] = lambda _: False,
) -> Endpoints | PlanResult:
    """Find escape paths from the start of `travel` and from goals; if there are none, return a result that says so."""

    def over() -> bool:
        return cancelled() or late(1.0)

    start = travel.start
    departure = way_out(start, constraints, rng, over=over)
    if departure is None and over():
        return _ended(cancelled())
    if departure is None:
        return PlanResult(status=PlanStatus.INVALID_START, detail=_no_way("start", start, constraints.scene))
    clear = constraints.clearance(goals) >= TARGET_CLEARANCE
    ways = [(int(k), Path(goals[k : k + 1])) for k in np.flatnonzero(clear)]
    tight = np.flatnonzero(~clear)
    nearest = tight[np.argsort(travel.cost(goals[tight]), kind="stable")]
    for tried, k in enumerate(nearest):
        if (over() and (tried or ways)) or (ways and late(_SHARE_OF_WAYS)):
            break
        found = way_out(goals[k], constraints, rng, over=over)
        ways += [(int(k), found.reversed())] if found is not None else []
    arrivals = sorted(ways, key=lambda way: way[0])
    if cancelled() or (not arrivals and late(1.0)):
        return _ended(cancelled())
    if not arrivals:
        return PlanResult(status=PlanStatus.INVALID_GOAL, detail=_no_way("goal", goals[0], constraints.scene))
    index, paths = zip(*arrivals, strict=True)
    return Endpoints(constraints=constraints, departure=departure, arrivals=paths, goal_index=index)


def _no_way(word: str, q: Float[Array, " nq"], scene: Scene) -> str:
    """Return a message that no escape path was found, with the nearest pair of geoms."""
    told, near = _NO_WAY.format(word), nearest_pair(q, scene)
    if near is None:
        return told
    pair = ", ".join(repr(name.partition("#")[0]) for name in near[:2])  # for unnamed geoms, the body
    away = f"{near.first} is {-1e3 * near.depth:.3g} mm from {near.obstacle}"
    return f"{told}; {away}; if they may touch, say AllowedContact({pair})"


def _ended(cancelled: bool) -> PlanResult:
    return PlanResult(status=PlanStatus.CANCELLED if cancelled else PlanStatus.TIMEOUT, detail="before the search")
