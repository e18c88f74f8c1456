"""A planning problem inside OMPL: space, motion validator and objective in Python, solved in short slices.

This module imports OMPL; `planners.py` imports it only when a planner runs. Callbacks must return exactly `bool` or
`ob.Cost`, since OMPL's bindings accept no other types. The motion validator must not store the space information, which
owns it. States are read with `s[0:n]` and never stored.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import dist
from typing import final

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from graceful_plan.array_types import Array
from graceful_plan.path import Path
from graceful_plan.planners.informed import InformedSampler, probe_objective
from graceful_plan.planners.interruptible import Interrupted, InterruptibleProblem, out_of_time
from graceful_plan.planners.ompl.kind import Kind
from graceful_plan.planners.planner import Budget

_SLICE_SECONDS = 0.02
_SLICE_ITERATIONS = 100
_ESTIMATES_BETWEEN_LOOKS = 2000  # about 5 ms
_PROVEN = 1e-8  # relative gap to the lower bound of the cost at which a path counts as optimal


@contextmanager
def quiet() -> Generator[None, None, None]:
    """Silence OMPL's console output, which reports normal events (such as setting the seed again) as errors."""
    level = ou.getLogLevel()
    ou.setLogLevel(ou.LOG_NONE)
    try:
        yield
    finally:
        ou.setLogLevel(level)


def end_of_slice(budget: Budget) -> ob.PlannerTerminationCondition:
    """Return the condition that ends a slice of a search; each evaluation is one iteration of the budget."""
    end, used = budget.elapsed + min(_SLICE_SECONDS, budget.remaining_seconds), 0
    timed = np.isfinite(budget.time_limit)

    def stop() -> bool:
        nonlocal used
        used += 1
        return used > _SLICE_ITERATIONS or (timed and budget.elapsed >= end) or not budget.spend()

    return ob.PlannerTerminationCondition(stop)


@final
@dataclass
class _Best:
    """Best-known cost, shared with the motion validator."""

    cost: float = np.inf


@final
class _Validator(ob.MotionValidator):
    """Checks motions; with an informed sampler, it also rejects states that no better path can pass."""

    def __init__(
        self,
        si: ob.SpaceInformation,
        questions: InterruptibleProblem,
        informed: InformedSampler | None,
        best: _Best,
    ) -> None:
        super().__init__(si)
        self._questions, self._informed, self._best = questions, informed, best
        self._n = len(questions.problem.start)

    def checkMotion(self, s0: ob.State, s1: ob.State) -> bool:
        q0, q1 = np.array([s0[0 : self._n]]), np.array([s1[0 : self._n]])
        if self._informed is not None and np.isfinite(self._best.cost):
            if self._informed.bound_through(q1)[0] >= self._best.cost:
                return False
        return bool(self._questions.problem.edges_free(q0, q1)[0])


@final
class _Objective(ob.OptimizationObjective):
    """Objective of OMPL with this library's edge costs, one edge at a time."""

    def __init__(self, si: ob.SpaceInformation, questions: InterruptibleProblem, bound: float, symmetric: bool) -> None:
        super().__init__(si)
        self._questions, self._bound, self._symmetric = questions, bound, symmetric
        self._n = len(questions.problem.start)
        self._estimates = 0

    def isSymmetric(self) -> bool:
        return self._symmetric

    def stateCost(self, s: ob.State) -> ob.Cost:
        return ob.Cost(0.0)

    def motionCost(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        q0, q1 = np.array([s0[0 : self._n]]), np.array([s1[0 : self._n]])
        return ob.Cost(float(self._questions.edge_costs(q0, q1)[0]))

    def motionCostHeuristic(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        self._estimates += 1
        if self._estimates % _ESTIMATES_BETWEEN_LOOKS == 0 and out_of_time(self._questions.budget):
            raise Interrupted  # BIT* draws a whole batch by rejection without checking its termination condition
        return ob.Cost(self._bound * dist(s0[0 : self._n], s1[0 : self._n]) if self._bound else 0.0)

    def motionCostBestEstimate(self, s0: ob.State, s1: ob.State) -> ob.Cost:
        return self.motionCostHeuristic(s0, s1)


@final
class Session:
    """An OMPL planner on one problem, run in slices.

    Args:
        questions: Access to problem and objective.
        seed: Seed of OMPL's generator, > 0; OMPL has one seed per process.
        kind: The planner.
    """

    def __init__(self, questions: InterruptibleProblem, seed: int, kind: Kind) -> None:
        problem = questions.problem
        facts = probe_objective(questions.objective, problem)
        self.questions, self.best = questions, _Best()
        self.sampler = InformedSampler(problem, facts.length_bound)
        self.informed = kind.informed and facts.length_bound > 0.0
        with quiet():
            ou.RNG.setSeed(seed)  # before any object that draws random numbers is built
            self.space = ob.RealVectorStateSpace(len(problem.start))
            self._set_bounds(problem.lower, problem.upper)
            si = ob.SpaceInformation(self.space)
            n = len(problem.start)
            si.setStateValidityChecker(lambda s: bool(problem.states_free(np.array([s[0:n]]))[0]))
            guide = self.sampler if self.informed else None
            si.setMotionValidator(_Validator(si, questions, guide, self.best))
            si.setup()
            self.definition = ob.ProblemDefinition(si)
            self._set_ends(si)
            ours = _Objective(si, questions, facts.length_bound, facts.symmetric)
            ours.setCostThreshold(ob.Cost(self.sampler.least_cost * (1.0 + _PROVEN)))
            self.definition.setOptimizationObjective(ours)
            self.planner = getattr(og, kind.name)(si)
            kind.configure(self.planner)
            self.planner.setProblemDefinition(self.definition)
            self.planner.setup()

    def improvements(self) -> Iterator[Path]:
        """Yield paths of decreasing cost; one iteration is one evaluation of OMPL's termination condition.

        Raises:
            CostError: If the objective violates its contract.
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
        with quiet():
            self.planner.solve(end_of_slice(budget))
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
        """Restrict samples to the bounding box of the informed set; the validator rejects those outside the set."""
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
