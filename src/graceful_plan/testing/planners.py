"""Contract check of planners, on small problems in the plane."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.path import Path
from graceful_plan.planners.planner import BoundObjective, Budget, Planner, Problem, path_total
from graceful_plan.testing.contract import ContractError

Findings = Iterator[str]

_GOAL_TOLERANCE = 1e-9
_ENDLESS_SECONDS = 30.0


@dataclass(frozen=True, kw_only=True)
class PlannerTrial:
    """Settings of `check_planner`.

    Args:
        iterations: Budget that is ample for the planner on an easy problem in the plane.
        time_limit: Time limit with which the planner's punctuality is tested [s].
        overrun: Time by which the planner may exceed a time limit or a cancellation [s].
        seed: Seed of all random numbers.
    """

    iterations: int = 2000
    time_limit: float = 0.1
    overrun: float = 0.05
    seed: int = 0


def check_planner(planner: object, trial: PlannerTrial | None = None) -> None:
    """Try a planner on small problems and report everything that breaks the contract of `Planner`.

    Raises:
        ContractError: With all findings, if there are any.
    """
    used = trial or PlannerTrial()
    findings: list[str] = list(_check_settings(planner))
    if isinstance(planner, Planner):
        for check in _PLANNER_CHECKS:
            try:
                findings += check(planner, used)
            except Exception as error:
                findings.append(f"{_subject(check)}: raised {type(error).__name__}: {error}")
    if findings:
        raise ContractError(planner, tuple(findings))


class _Watched(Problem):
    """Forwards queries to a problem and records invalid ones."""

    def __init__(self, problem: FunctionProblem) -> None:
        self.inner = problem
        self.start, self.goals = _read_only(problem.start), _read_only(problem.goals)
        self.lower, self.upper = _read_only(problem.lower), _read_only(problem.upper)
        self.improper: set[str] = set()

    def states_free(self, q: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        self._note(q)
        return self.inner.states_free(q)

    def edges_free(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Bool[Array, " n"]:
        self._note(q0)
        self._note(q1)
        return self.inner.edges_free(q0, q1)

    def _note(self, q: Array) -> None:
        if not np.all(np.isfinite(q)):
            self.improper.add("asked the problem about a configuration that is not finite")


def _read_only(array: Array) -> Array:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


class _Directed:
    """An objective that costs more for moving up the first axis than for moving down."""

    w = 2.0

    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        length = np.linalg.norm(q1 - q0, axis=1)
        return np.stack([0.5 * length, 0.1 * length + np.maximum(0.0, q1[:, 0] - q0[:, 0])], axis=1)

    def states(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        return np.full(len(q), 0.1)


class _Broken(Exception):
    """The error that a broken objective raises and nothing else does."""


class _Raising(_Directed):
    def edges(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> Float[Array, "n 2"]:
        raise _Broken("from the objective")

    def states(self, q: Float[Array, "n nq"]) -> Float[Array, " n"]:
        raise _Broken("from the objective")


def _hill(w: float = 1.0) -> DensityObjective:
    """Return an impact centred at (0, 1.2), so that one side of the block is worse than the other."""
    return DensityObjective(
        density=lambda q: 3.0 * np.exp(-2.0 * (q[:, 0] ** 2 + (q[:, -1] - 1.2) ** 2)), w=w, step=0.05
    )


def _outside_block(q: Array) -> Array:
    return np.max(np.abs(q), axis=1) > 0.5


def _around_block(*more_goals: tuple[float, float]) -> FunctionProblem:
    """Return a problem around a square block; goals at (2, 2) lie in a closed cell."""

    def free(q: Array) -> Array:
        in_wall = np.abs(np.max(np.abs(q - 2.0), axis=1) - 0.5) <= 0.15
        return _outside_block(q) & ~in_wall

    goals = np.array([*more_goals] or [(1.5, 0.0)])
    low, high = np.full(2, -3.0), np.full(2, 3.0)
    return FunctionProblem(start=np.array([-1.5, 0.0]), goals=goals, lower=low, upper=high, free=free, step=0.05)


_CELL = (2.0, 2.0)


def _run(
    planner: Planner, problem: Problem, objective: BoundObjective, trial: PlannerTrial, budget: Budget | None = None
) -> list[Any]:
    granted = budget or Budget(time_limit=np.inf, iterations=trial.iterations)
    return list(planner.solve(problem, objective, granted, np.random.default_rng(trial.seed)))


def _check_settings(planner: object) -> Findings:
    if not isinstance(planner, Planner):
        yield "is not a graceful_plan.planners.Planner"
        return
    frozen = dataclasses.is_dataclass(planner) and getattr(type(planner), "__dataclass_params__").frozen  # noqa: B009
    if not frozen:
        yield "is not a frozen dataclass"
    if not isinstance(getattr(planner, "name", None), str) or not planner.name:
        yield "has no name (ClassVar[str])"
    if not isinstance(getattr(planner, "anytime", None), bool):
        yield "does not say whether it is anytime (ClassVar[bool])"


def _check_paths(paths: list[Any], problem: Problem, objective: BoundObjective) -> Findings:
    """Check that every result is a valid path and cheaper than the previous one."""
    last = np.inf
    for k, path in enumerate(paths):
        if not isinstance(path, Path):
            yield f"yielded a {type(path).__name__}, not a Path"
            return
        if np.abs(path.q[0] - problem.start).max() > _GOAL_TOLERANCE:
            yield f"path {k} starts at {path.q[0]}, not at the start {problem.start}"
        if np.abs(problem.goals - path.q[-1]).max(axis=1).min() > _GOAL_TOLERANCE:
            yield f"path {k} ends at {path.q[-1]}, which is none of the goals"
        if np.any(path.q < problem.lower) or np.any(path.q > problem.upper):
            yield f"path {k} leaves the limits"
        if not np.all(problem.edges_free(path.q[:-1], path.q[1:])):
            yield f"path {k} has an edge that is not free"
        cost = path_total(objective, path)
        if not cost < last:
            yield f"path {k} costs {cost:.6g}, not less than {last:.6g} before it"
        last = cost


def _check_solution(planner: Planner, trial: PlannerTrial) -> Findings:
    """An easy problem."""
    problem, objective = _Watched(_around_block()), _hill()
    budget = Budget(iterations=trial.iterations)
    paths = _run(planner, problem, objective, trial, budget)
    if not paths:
        yield f"found no path around a block in the plane in {trial.iterations} iterations"
    yield from _check_paths(paths, problem, objective)
    yield from sorted(problem.improper)
    if budget.spent == 0:
        yield "never called budget.spend(), so that an iteration budget cannot stop it"
    if budget.spent > trial.iterations:
        yield f"spent {budget.spent} of {trial.iterations} iterations"


def _check_determinism(planner: Planner, trial: PlannerTrial) -> Findings:
    """The same seed."""
    before = _global_random_state()
    first, second = (_run(planner, _around_block(), _hill(), trial) for _ in range(2))
    if len(first) != len(second) or not all(np.array_equal(a.q, b.q) for a, b in zip(first, second, strict=True)):
        yield "gave different paths for the same seed and number of iterations"
    if not np.array_equal(before, _global_random_state()):
        yield "drew from numpy's global random state instead of `rng`"


def _global_random_state() -> tuple[bytes, int]:
    _, keys, position, *_ = np.random.get_state()  # noqa: NPY002 - to detect uses of it
    return np.asarray(keys).tobytes(), int(position)


def _check_objectives(planner: Planner, trial: PlannerTrial) -> Findings:
    """Other objectives."""
    for name, objective in (("w = 0", _hill(w=0.0)), ("a cost that depends on the direction", _Directed())):
        paths = _run(planner, _around_block(), objective, trial)
        if not paths:
            yield f"found no path with {name}"
        yield from (f"with {name}: {finding}" for finding in _check_paths(paths, _around_block(), objective))


def _check_goals(planner: Planner, trial: PlannerTrial) -> Findings:
    """Several goals."""
    problem = _around_block(_CELL, (1.5, 0.5), (1.5, -0.5))
    paths = _run(planner, problem, _hill(), trial)
    if not paths:
        yield "found no path to any of three goals, of which two can be reached"
    yield from (f"with several goals: {finding}" for finding in _check_paths(paths, problem, _hill()))


def _check_one_joint(planner: Planner, trial: PlannerTrial) -> Findings:
    """A single joint."""
    low, high = np.array([-1.0]), np.array([1.0])
    problem = FunctionProblem(start=low, goals=high[None], lower=low, upper=high)
    paths = _run(planner, problem, _hill(), trial)
    if not paths:
        yield "found no path for one joint, from its lower limit to its upper"
    yield from (f"with one joint: {finding}" for finding in _check_paths(paths, problem, _hill()))


def _check_start_is_goal(planner: Planner, trial: PlannerTrial) -> Findings:
    """Start equal to the goal."""
    problem = _around_block((-1.5, 0.0), (1.5, 0.0))
    paths = _run(planner, problem, _hill(), trial)
    if not paths or path_total(_hill(), paths[-1]) > _GOAL_TOLERANCE:
        yield "did not answer with a path of cost 0 when the start is a goal"


def _check_nothing_to_find(planner: Planner, trial: PlannerTrial) -> Findings:
    """Nothing to be found."""
    begin = time.perf_counter()
    budget = Budget(time_limit=_ENDLESS_SECONDS, iterations=trial.iterations)
    if _run(planner, _around_block(_CELL), _hill(), trial, budget):
        yield "yielded a path to a goal in a closed cell"
    if time.perf_counter() - begin >= _ENDLESS_SECONDS:
        yield f"did not stop after {trial.iterations} iterations without a path"
    if _run(planner, _around_block(), _hill(), trial, Budget(iterations=0)):
        yield "yielded a path without a budget"


def _check_clock(planner: Planner, trial: PlannerTrial) -> Findings:
    """Time limit and cancellation."""
    for goal in ((1.5, 0.0), _CELL):
        budget = Budget(time_limit=trial.time_limit)
        _run(planner, _around_block(goal), _hill(), trial, budget)
        if budget.elapsed > trial.time_limit + trial.overrun:
            yield f"returned {1e3 * (budget.elapsed - trial.time_limit):.0f} ms after the time limit"
    end = time.perf_counter() + trial.time_limit
    budget = Budget(time_limit=_ENDLESS_SECONDS, cancelled=lambda: time.perf_counter() >= end)
    _run(planner, _around_block(_CELL), _hill(), trial, budget)
    late = time.perf_counter() - end
    if late > trial.overrun:
        yield f"returned {1e3 * late:.0f} ms after it was cancelled"


def _check_exceptions(planner: Planner, trial: PlannerTrial) -> Findings:
    """An objective that raises."""
    try:
        _run(planner, _around_block(), _Raising(), trial)
    except _Broken:
        return
    yield "hid an exception that the objective raised"


PlannerCheck = Callable[[Planner, PlannerTrial], Findings]

_PLANNER_CHECKS: tuple[PlannerCheck, ...] = (
    _check_solution,
    _check_determinism,
    _check_objectives,
    _check_goals,
    _check_one_joint,
    _check_start_is_goal,
    _check_nothing_to_find,
    _check_clock,
    _check_exceptions,
)


def _subject(check: Callable[..., Findings]) -> str:
    return (check.__doc__ or check.__name__).split("\n")[0].rstrip(".").lower()
