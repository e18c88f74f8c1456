"""RRT*: a tree with the cheapest-known path to each of its nodes; edges are evaluated lazily and in batches.

Once there is a path, half of the samples lie near the best one. If the objective has a native gradient, each better
path of the tree also descends along it. Results of descents do not enter the tree: pruned by their low cost, it would
not explore other homotopy classes.

References:
    [Karaman2011] Sampling-based algorithms for optimal motion planning (RRT*).
    [Akgun2011] Sampling heuristics for optimal motion planning in high dimensions (samples near the best path;
        samples that cannot be on a better path are rejected).
    [Gammell2014] Informed RRT*; see `informed`.
    [Hauser2015] Lazy collision checking in asymptotically-optimal motion planning.
    [Jeong2019] Quick-RRT*: triangular inequality-based implementation of RRT* (parents of neighbours as parents).
    [Choudhury2016] Regionally accelerated batch informed trees (RABIT*): a local optimiser in a global search.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.path import Path, plain_numbers
from graceful_plan.planners.informed import InformedSampler, probe_objective
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem
from graceful_plan.planners.native_descents import NativeDescents
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem
from graceful_plan.planners.shortcut import Line
from graceful_plan.planners.start_at_goal import handle_start_at_goal
from graceful_plan.planners.trees.star_tree import StarTree
from graceful_plan.planners.trees.untried import Untried
from graceful_plan.planners.trees.wiring import EdgeGuess, TreeConnector
from graceful_plan.setting_checks import count, fraction, positive_or_none

_REACH = 0.08
"""Default longest extension, as a share of the extent of the space: that of RRT-Connect."""
_ASIDE = (-2.0, -0.3)
"""Exponents (base 10) of the distance of samples from the best path, relative to its length. [Akgun2011] uses one
distance, which suits only one width of a low-cost region."""
_PROVEN = 1e-8
"""Relative gap to the lower bound of the cost at which a path counts as optimal."""
_GAIN = 1e-9
"""Relative decrease of J that counts as an improvement."""
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True)
class _StarTrees(Planner):
    """Settings of RRT* and Informed RRT*."""

    anytime: ClassVar[bool] = True
    informed: ClassVar[bool]
    """Whether to sample only where a path can be better than the best path of the tree."""

    range: float | None = None
    """Longest extension [rad]; by default 8 % of the extent of the space."""
    goal_bias: float = 0.05
    """Share of samples that are a goal; each node is extended towards each goal at most once."""
    path_bias: float = 0.5
    """Share of samples near the best path of the tree, once there is one."""
    rewire_factor: float = 1.1
    """Factor on the number of neighbours, e (1 + 1/d) ln n."""
    trust: float = 0.5
    """Weight of cost estimates, as opposed to lower bounds, in skipping edges; with 0, only lower bounds count."""
    batch: int = 32
    """Largest number of samples in a batch; for a small tree, a quarter of its nodes."""
    descend: bool = True
    """Whether each better path also descends along the gradient of J, if there is a native one."""

    def __post_init__(self) -> None:
        plain_numbers(self)
        for name in ("range", "rewire_factor"):
            positive_or_none(name, getattr(self, name))
        for name in ("goal_bias", "path_bias", "trust"):
            fraction(name, getattr(self, name))
        count("batch", self.batch)

    @handle_start_at_goal
    def solve(
        self, problem: Problem, objective: BoundObjective, budget: Budget, rng: np.random.Generator
    ) -> Iterator[Path]:
        """Yield paths of decreasing cost until the budget ends or a straight line is proven optimal."""
        with suppress(Interrupted):
            if budget.exhausted:
                return
            questions = InterruptibleProblem(problem, objective, budget)
            search = _StarSearch(self, questions, rng)
            descents = NativeDescents.of(questions) if self.descend else None
            best = np.inf
            while True:
                path = search.improved()
                for candidate in _with_lower(path, descents, best):
                    total = questions.path_cost(candidate)
                    if total < best * (1.0 - _GAIN):
                        best = total
                        yield candidate
                wanted = int(min(self.batch, max(1, len(search.tree) // 4), budget.remaining_iterations))
                if search.optimal or not budget.spend(wanted):
                    return
                search.grow(wanted)


@final
@dataclass(frozen=True, kw_only=True)
class RRTStar(_StarTrees):
    """Asymptotically optimal rapidly-exploring random tree. One iteration is one sample."""

    name: ClassVar[str] = "rrt_star"
    informed: ClassVar[bool] = False


@final
@dataclass(frozen=True, kw_only=True)
class InformedRRTStar(_StarTrees):
    """RRT* that, once it has a path, samples only where a better one can pass. One iteration is one sample."""

    name: ClassVar[str] = "informed_rrt_star"
    informed: ClassVar[bool] = True


def _with_lower(path: Path | None, descents: NativeDescents | None, best: float) -> Iterator[Path]:
    """Yield a path if there is one, then the result of a descent from it."""
    if path is None:
        return
    yield path
    lower = None if descents is None else descents.lowered(path, best)
    if lower is not None:
        yield lower


@final
class _StarSearch:
    """The search of RRT*: a tree that grows towards samples.

    Args:
        settings: Settings of the planner.
        questions: Access to problem and objective.
        rng: Random numbers.
    """

    def __init__(self, settings: _StarTrees, questions: InterruptibleProblem, rng: np.random.Generator) -> None:
        problem = questions.problem
        self.settings, self.questions, self.problem, self.rng = settings, questions, problem, rng
        self.reach = settings.range or _REACH * problem.extent
        bound = probe_objective(questions.objective, problem).length_bound
        self.sampler = InformedSampler(problem, bound)
        ends = np.concatenate([problem.start[None], problem.goals])
        self.tree = StarTree(problem.start, problem.goals, questions.state_costs(ends))
        guess = EdgeGuess.learn(questions, bound=bound, reach=self.reach, trust=settings.trust)
        self.wiring = TreeConnector(self.tree, questions, guess, bounded=settings.informed)
        self.untried = Untried(problem.goals)
        self.best = np.inf
        self.way = np.zeros(0, dtype=int)
        """Nodes of the best path."""
        self._try_straight()

    @property
    def optimal(self) -> bool:
        """Whether the best path is proven optimal."""
        return self.best <= self.sampler.least_cost * (1.0 + _PROVEN)

    def improved(self) -> Path | None:
        """Return the best path of the tree if it has become better since the last call."""
        goal = int(self.tree.goals[self.tree.cost[self.tree.goals].argmin()])
        cost = float(self.tree.cost[goal])
        if not cost < self.best * (1.0 - _GAIN):
            return None
        self.best, self.way = cost, self.tree.branch(goal)
        return Path(self.tree.q[self.way].copy()).without_duplicates()

    def grow(self, n: int) -> None:
        """Grow the tree by n samples.

        Raises:
            Interrupted: If the time is over.
            CostError: If the objective violates its contract.
        """
        q, near = self._steps(n)
        tree = self.tree
        free = self.questions.edges_free(tree.q[near], q)
        d = tree.q.shape[1]
        k = int(np.ceil(self.settings.rewire_factor * np.e * (1.0 + 1.0 / d) * np.log(len(tree) + 1.0)))
        self.wiring.join(q[free], near[free], k, self.way)

    def _steps(self, n: int) -> tuple[Float[Array, "m nq"], Int[Array, " m"]]:
        """Step from the tree towards n samples; return new configurations and the nodes that they are reached from."""
        tree, settings = self.tree, self.settings
        to_goal, to_path = self.rng.uniform(size=(2, n)) < [[settings.goal_bias], [settings.path_bias]]
        beside = to_path & (len(self.way) > 0)
        target = np.where(beside[:, None], self._beside(n), self._anywhere(n))
        near = tree.nearest(target)
        self._aim_at_goals(np.flatnonzero(to_goal & ~beside), near, target)
        gap = target - tree.q[near]
        distance = np.linalg.norm(gap, axis=1)
        q = tree.q[near] + np.minimum(1.0, self.reach / np.maximum(distance, _TINY))[:, None] * gap
        q = self.problem.projected(np.clip(q, self.problem.lower, self.problem.upper))
        new = (distance > _TINY) & self._is_new(q)
        return q[new], near[new]

    def _try_straight(self) -> None:
        """Connect goals to the start by straight edges where these are free."""
        tree, goals = self.tree, self.tree.goals
        free = goals[self.questions.edges_free(tree.q[np.zeros_like(goals)], tree.q[goals])]
        steps = self.questions.edge_costs(tree.q[np.zeros_like(free)], tree.q[free])
        for goal, step in zip(free.tolist(), steps.tolist(), strict=True):
            tree.lead(goal, 0, step)

    def _anywhere(self, n: int) -> Float[Array, "n nq"]:
        """Draw samples within the limits; with informed search, where a better path can pass, if that succeeds."""
        q = self.sampler.draw(n, self.best if self.settings.informed else np.inf, self.rng)
        rest = self.rng.uniform(self.problem.lower, self.problem.upper, (n - len(q), q.shape[1]))
        return np.concatenate([q, rest])

    def _beside(self, n: int) -> Float[Array, "n nq"]:
        """Draw samples around points of the best path."""
        if len(self.way) == 0:
            return np.zeros((n, len(self.problem.start)))
        rng, line = self.rng, Line(self.tree.q[self.way], np.zeros(len(self.way) - 1))
        _, on_path = line.at(rng.uniform(size=n) * line.arc[-1])
        aside = line.arc[-1] * 10.0 ** rng.uniform(*_ASIDE, (n, 1)) / np.sqrt(on_path.shape[1])
        return np.clip(on_path + aside * rng.normal(size=on_path.shape), self.problem.lower, self.problem.upper)

    def _aim_at_goals(self, samples: Int[Array, " m"], near: Int[Array, " n"], target: Float[Array, "n nq"]) -> None:
        """Replace some samples by goals, each approached from the nearest node that has not tried that yet."""
        self.untried.learn(self.tree.q)
        for i in samples:
            goal = int(self.rng.integers(len(self.problem.goals)))
            found = self.untried.take(goal)
            if found is not None:
                near[i], target[i] = found[0], self.problem.goals[goal]

    def _is_new(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        """Return which configurations are not goals; goals are in the tree from the beginning."""
        return (np.abs(q[:, None] - self.problem.goals).max(axis=2) > _TINY).all(axis=1)
