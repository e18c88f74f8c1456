"""RRT, RRT* and PRM over poses of a base, connected by Reeds-Shepp curves, as implemented in OMPL.

These planners do not turn in place: a base that can turn in place still drives curves with a least radius. Their paths
are starts for smooth drives, like those of lattices. The arm keeps its posture. Each motion is checked and evaluated in
one batch of chords of its curve. OMPL requests one motion at a time, by callbacks into Python. Its generator is seeded
per process: do not interleave two of these planners where results must be reproducible.

References:
    [LaValle1998] Rapidly-exploring random trees. [Karaman2011] S. Karaman, E. Frazzoli, "Sampling-based algorithms for
    optimal motion planning", IJRR 30. [Kavraki1996] L. Kavraki et al., "Probabilistic roadmaps", TRA 12.
    [ReedsShepp1990] As in `mobile.floor.reeds_shepp`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from graceful_plan.exceptions import SettingError
from graceful_plan.mobile.planners.bases_only import of_a_base
from graceful_plan.mobile.planners.postures import BASE, postures
from graceful_plan.path import Path, is_whole, plain_numbers
from graceful_plan.planners.interruptible import Interrupted
from graceful_plan.planners.ompl.kind import Kind, set_growth
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem, path_total
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.setting_checks import fraction, positive_or_none


@dataclass(frozen=True, kw_only=True)
class PoseSpace:
    """Settings shared by the planners.

    Args:
        radius: Radius of the tightest curve [m].
        around: Extent of the sampled area beyond start and goals, within the limits of the base [m].
    """

    radius: float = 0.3
    around: float = 5.0

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("radius", self.radius)
        positive_or_none("around", self.around)


@final
@dataclass(frozen=True, kw_only=True)
class ReedsSheppRRT(Planner):
    """Rapidly-exploring random tree; stops at the first path. One iteration is one sample.

    Args:
        poses: Curves and sampled area.
        range: Longest extension [m]; default: a fifth of the extent of the space (OMPL's default).
        goal_bias: Share of samples that are a goal (OMPL's default).
    """

    name: ClassVar[str] = "reeds_shepp_rrt"
    anytime: ClassVar[bool] = False
    drives: ClassVar[bool] = True

    poses: PoseSpace = PoseSpace()
    range: float | None = None
    goal_bias: float = 0.05

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("range", self.range)
        fraction("goal_bias", self.goal_bias)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield the first path.

        Raises:
            SettingError: If the robot has no base that drives both ways.
        """
        found = _improvements(self, self.poses, Kind("RRT", self._configure), (problem, objective, budget, rng))
        for path in found:
            yield path
            return

    def _configure(self, planner: Any) -> None:
        set_growth(planner, self.goal_bias, self.range)


@final
@dataclass(frozen=True, kw_only=True)
class ReedsSheppRRTStar(Planner):
    """RRT* by J = V + w S of the curves. One iteration is one sample.

    Args:
        poses: Curves and sampled area.
        range: Longest extension [m]; default: a fifth of the extent of the space (OMPL's default).
        goal_bias: Share of samples that are a goal (OMPL's default).
        rewire_factor: Factor on the least number of neighbours (OMPL's default).
    """

    name: ClassVar[str] = "reeds_shepp_rrt_star"
    anytime: ClassVar[bool] = True
    drives: ClassVar[bool] = True

    poses: PoseSpace = PoseSpace()
    range: float | None = None
    goal_bias: float = 0.05
    rewire_factor: float = 1.1

    def __post_init__(self) -> None:
        plain_numbers(self)
        positive_or_none("range", self.range)
        fraction("goal_bias", self.goal_bias)
        positive_or_none("rewire_factor", self.rewire_factor)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost.

        Raises:
            SettingError: If the robot has no base that drives both ways.
        """
        return _improvements(self, self.poses, Kind("RRTstar", self._configure), (problem, objective, budget, rng))

    def _configure(self, planner: Any) -> None:
        set_growth(planner, self.goal_bias, self.range)
        planner.setRewireFactor(self.rewire_factor)


@final
@dataclass(frozen=True, kw_only=True)
class ReedsSheppPRM(Planner):
    """Probabilistic roadmap of OMPL; yields the shortest paths over it while it grows, if their J improves.

    Edges are compared by the length of their curves. One iteration is one check of the clock by OMPL.

    Args:
        poses: Curves and sampled area.
        neighbours: Number of neighbours that a new pose is connected to (OMPL's default).
    """

    name: ClassVar[str] = "reeds_shepp_prm"
    anytime: ClassVar[bool] = True
    drives: ClassVar[bool] = True

    poses: PoseSpace = PoseSpace()
    neighbours: int = 10

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not (is_whole(self.neighbours) and self.neighbours >= 1):
            raise SettingError("neighbours", self.neighbours, "a whole number, at least 1")

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost.

        Raises:
            SettingError: If the robot has no base that drives both ways.
        """
        kind = Kind("PRM", lambda planner: planner.setMaxNearestNeighbors(self.neighbours))
        return _improvements(self, self.poses, kind, (problem, objective, budget, rng))


def _improvements(
    planner: Planner,
    poses: PoseSpace,
    kind: Kind,
    asked: tuple[Problem, BoundObjective, Budget, np.random.Generator],
) -> Iterator[Path]:
    """Yield paths of decreasing J, with one arm posture after the other."""
    problem, objective, budget, rng = asked
    if not of_a_base(objective, planner.name)[1].reverse:
        raise SettingError("planner", planner.name, "one for bases that only drive forward, such as 'drive_lattice'")
    from graceful_plan.mobile.planners.pose_session import PoseSession  # importing the library must not import OMPL

    best, begins = np.inf, postures(problem)
    for k, begin in enumerate(begins):
        goals = problem.goals[(problem.goals[:, BASE:] == begin.q[-1, BASE:]).all(axis=1)]
        if not len(goals) or budget.exhausted:
            continue
        with budget.share(budget.remaining_seconds / (len(begins) - k), budget.remaining_iterations) as part:
            session = PoseSession((problem, objective, part), int(rng.integers(1, 2**31)), kind, (begin.q[-1], goals))
            with suppress(Interrupted):
                for q in session.run(poses.radius, poses.around):
                    path = Path(np.concatenate([begin.q[:-1], q])).without_duplicates()
                    if (total := path_total(objective, path)) < best:
                        best = total
                        yield path
