"""One problem inside OMPL: its space, validator and objective written in Python, and solving in short slices.

Imports OMPL at the top: `planners.py` imports this module when a planner is run. What callbacks return is converted to
exactly `bool` and `ob.Cost`, since OMPL's bindings take nothing else. The motion validator must not keep the space
information, which owns it. States are read with `s[0:n]`; none is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import dist
from typing import final

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from graceful_plan.array_types import Float
from graceful_plan.path import Path
from graceful_plan.planners.informed import InformedSampler, learn_objective
from graceful_plan.planners.ompl.kind import Kind
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.questions import Interrupted, Questions, out_of_time

Array = np.ndarray
Vertex = tuple[float, ...]

_SLICE_SECONDS = 0.02
_SLICE_ITERATIONS = 100
_ESTIMATES_BETWEEN_LOOKS = 2000  # about 5 ms
_PROVEN = 1e-8  # relative gap to the least possible cost at which a path is the best there is


@contextmanager
def _quiet() -> Generator[None, None, None]:
    """Silence OMPL's console output, for it reports normal events (such as seeding again) as errors."""
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LOG_NONE)
    try:
        yield
    finally:
        ou.setLogLevel(level)


@final
@dataclass
class _Best:
    """Cost of the best path so far; what the validator measures new states against."""

    cost: float = np.inf


@final
class _Validator(ob.MotionValidator):
    """Checks motions, and refuses states that no better path can pass (if there is a sampler that knows)."""

    def __init__(
        self,
        si: ob.SpaceInformation,
        questions: Questions,
        known: KnownStates,
        informed: InformedSampler | None,
        best: _Best,
    ) -> None:
        super().__init__(si)
        self._questions, self._known = questions, known
        self._informed, self._best = informed, best
        self._n = len(questions.problem.start)

    def checkMotion(self, s0: ob.State, s1: ob.State) -> bool:
        a, b = s0[0 : self._n], s1[0 : self._n]
        q0, q1 = np.array([a]), np.array([b])
        if self._informed is not None and np.isfinite(self._best.cost):
            if self._informed.bound_through(q1)[0] >= self._best.cost:
                return False
        free = bool(self._questions.problem.edges_free(q0, q1)[0])
        if free:
            self._known.add(tuple(b))
        return free


@final
class KnownStates:
    """Every state that a checked motion led to: those that OMPL will ask edge costs for.

    Args:
        start: The first state.
        neighbours: How many neighbours OMPL looks at among n states; None if asking ahead does not pay.
    """

    def __init__(self, start: Float[Array, " nq"], neighbours: Callable[[int], int] | None) -> None:
        self._q = np.zeros((256, len(start)))
        self._index: dict[Vertex, int] = {}
        self._neighbours = neighbours
        self.add(tuple(map(float, start)))

    def add(self, vertex: Vertex) -> None:
        """Remember a state."""
        if self._neighbours is None or vertex in self._index:
            return
        n = len(self._index)
        if n == len(self._q):
            self._q = np.concatenate([self._q, np.zeros_like(self._q)])
        self._q[n] = vertex
        self._index[vertex] = n

    def near(self, vertex: Vertex) -> Float[Array, "near nq"]:
        """States that OMPL is about to connect with `vertex`."""
        if self._neighbours is None:
            return self._q[:0]
        q = self._q[: len(self._index)]
        k = min(len(q), self._neighbours(len(q)) + 2)  # one more for the state itself, one for a nearest beyond
        gap = q - vertex
        return q[np.argpartition(np.einsum("ij,ij->i", gap, gap), k - 1)[:k]]


@final
class _Objective(ob.OptimizationObjective):
    """Our edge cost; the edges that RRT* asks for one by one are evaluated together, once per new state."""

    def __init__(
        self, si: ob.SpaceInformation, questions: Questions, known: KnownStates, bound: float, symmetric: bool
    ) -> None:
        super().__init__(si)
        self._questions, self._known = questions, known
        self._bound, self._symmetric = bound, symmetric
        self._n = len(questions.problem.start)
        self._focus: Vertex | None = None
        self._costs: dict[tuple[Vertex, Vertex], float] = {}
        self._estimates = 0

    def isSymmetric(self) -> bool:
        return self._symmetric

    def stateCost(self, s: ob.State) -> ob.Cost:
        return ob.Cost(0.0)

    def motionCost(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        a, b = tuple(s0[0 : self._n]), tuple(s1[0 : self._n])
        cost = self._costs.get((a, b))
        if cost is None:
            cost = self._ask(a, b)
        return ob.Cost(cost)

    def motionCostHeuristic(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        self._estimates += 1
        if self._estimates % _ESTIMATES_BETWEEN_LOOKS == 0 and out_of_time(self._questions.budget):
            raise Interrupted  # BIT* draws a whole batch by rejection without a look at its termination condition
        return ob.Cost(self._bound * dist(s0[0 : self._n], s1[0 : self._n]) if self._bound else 0.0)

    def motionCostBestEstimate(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        return self.motionCostHeuristic(s0, s1)

    def _ask(self, a: Vertex, b: Vertex) -> float:
        """Evaluate one edge and, if its end is new, those between that end and its neighbours."""
        q0, q1 = [np.array([a])], [np.array([b])]
        if b != self._focus:
            self._focus = b
            self._costs.clear()
            near = self._known.near(b)
            here = np.broadcast_to(np.array([b]), near.shape)
            q0.append(near)
            q1.append(here)
            if not self._symmetric:
                q0.append(here)
                q1.append(near)
        starts, ends = np.concatenate(q0), np.concatenate(q1)
        cost = self._questions.edge_costs(starts, ends).tolist()
        pairs = zip(map(tuple, starts.tolist()), map(tuple, ends.tolist()), strict=True)
        self._costs.update(zip(pairs, cost, strict=True))
        return cost[0]


@final
class Session:
    """An OMPL planner on one problem, run in slices.

    Args:
        questions: The problem and the objective.
        seed: For OMPL's own generator, > 0; OMPL has one seed per process.
        kind: Which planner.
    """

    def __init__(self, questions: Questions, seed: int, kind: Kind) -> None:
        problem = questions.problem
        facts = learn_objective(questions.objective, problem)
        self.questions, self.best = questions, _Best()
        self.sampler = InformedSampler(problem, facts.length_bound)
        self.informed = kind.informed and facts.length_bound > 0.0
        with _quiet():
            ou.RNG.setSeed(seed)  # before anything that draws is built
            self.space = ob.RealVectorStateSpace(len(problem.start))
            self._set_bounds(problem.lower, problem.upper)
            si = ob.SpaceInformation(self.space)
            n = len(problem.start)
            si.setStateValidityChecker(lambda s: bool(problem.states_free(np.array([s[0:n]]))[0]))
            known = KnownStates(problem.start, kind.neighbours)
            guide = self.sampler if self.informed else None
            si.setMotionValidator(_Validator(si, questions, known, guide, self.best))
            si.setup()
            self.definition = ob.ProblemDefinition(si)
            self._set_ends(si)
            ours = _Objective(si, questions, known, facts.length_bound, facts.symmetric)
            ours.setCostThreshold(ob.Cost(self.sampler.least_cost * (1.0 + _PROVEN)))
            self.definition.setOptimizationObjective(ours)
            self.planner = getattr(og, kind.name)(si)
            kind.configure(self.planner)
            self.planner.setProblemDefinition(self.definition)
            self.planner.setup()

    def improvements(self) -> Iterator[Path]:
        """Yield each better path; one iteration is one evaluation of OMPL's termination condition.

        Raises:
            CostError: If the objective breaks its contract.
        """
        budget = self.questions.budget
        while not budget.exhausted and not self._optimal():
            path = self._slice(budget)
            if path is None:
                continue
            cost = self.questions.path_cost(path)
            if cost < self.best.cost * (1.0 - 1e-12):
                self.best.cost = cost
                yield path
                if self.informed:
                    self._shrink()

    def _slice(self, budget: Budget) -> Path | None:
        end = budget.elapsed + min(_SLICE_SECONDS, budget.remaining_seconds)
        timed, used = np.isfinite(budget.time_limit), 0

        def stop() -> bool:
            nonlocal used
            used += 1
            return used > _SLICE_ITERATIONS or (timed and budget.elapsed >= end) or not budget.spend()

        with _quiet():
            self.planner.solve(ob.PlannerTerminationCondition(stop))
            if not self.definition.hasExactSolution():
                self.definition.clearSolutionPaths()
                return None
            n = len(self.questions.problem.start)
            q = np.array([state[0:n] for state in self.definition.getSolutionPath().getStates()])
            self.definition.clearSolutionPaths()
        return Path(q)

    def _optimal(self) -> bool:
        return self.best.cost <= self.sampler.least_cost * (1.0 + _PROVEN)

    def _shrink(self) -> None:
        """Draw from the box around the informed set only; the validator refuses what is outside of the set."""
        lower, upper = self.sampler.box(self.best.cost)
        self._set_bounds(lower, upper)

    def _set_bounds(self, lower: Array, upper: Array) -> None:
        bounds = ob.RealVectorBounds(len(lower))
        for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
            bounds.setLow(i, float(low))
            bounds.setHigh(i, float(high))
        self.space.setBounds(bounds)

    def _set_ends(self, si: ob.SpaceInformation) -> None:
        problem = self.questions.problem
        goals = ob.GoalStates(si)
        for k, q in enumerate([problem.start, *problem.goals]):
            state = si.allocState()
            for i, value in enumerate(q):
                state[i] = float(value)
            if k == 0:
                self.definition.addStartState(state)
            else:
                goals.addState(state)
        self.definition.setGoal(goals)
