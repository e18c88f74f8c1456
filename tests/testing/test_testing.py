"""check_planner and check_cost accept correct implementations and name the defect of broken ones."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from places import ROOT

from graceful_plan.costs.cost import Cost, StateBatch
from graceful_plan.costs.motion import JointLength
from graceful_plan.path import Path
from graceful_plan.planners.planner import Budget, Planner, Problem, path_total
from graceful_plan.scene.scene import Scene
from graceful_plan.testing import ContractError, PlannerTrial, check_cost, check_planner

Array = np.ndarray

_TRIAL = PlannerTrial(iterations=40, time_limit=0.02, overrun=5.0)
"""The overrun is large because the test machine may be busy."""


def _corners(problem: Problem) -> list[Array]:
    """Via points around the block of the check, on both sides."""
    return [np.array([[-1.0, s], [1.0, s]]) if len(problem.start) == 2 else np.zeros((0, 1)) for s in (1.0, -1.0)]


@dataclass(frozen=True)
class Corners(Planner):
    """A planner that knows the paths; it breaks the contract in a given way."""

    name: ClassVar[str] = "corners"
    anytime: ClassVar[bool] = False

    fault: str = ""

    def solve(self, problem, objective, budget: Budget, rng: np.random.Generator) -> Iterator[Path]:
        if self.fault != "budget" and not budget.spend():
            return
        if self.fault == "raises":
            raise ZeroDivisionError("inside")
        candidates = [
            Path(np.concatenate([problem.start[None], via, goal[None]])).without_duplicates()
            for goal in problem.goals
            for via in ([problem.start[None]] if np.array_equal(goal, problem.start) else _corners(problem))
        ]
        free = [path for path in candidates if problem.edges_free(path.q[:-1], path.q[1:]).all()]
        best = np.inf
        for path in sorted(free, key=lambda p: self._cost(objective, p), reverse=True):
            cost = self._cost(objective, path)
            if cost < best or self.fault == "worse":
                best = min(best, cost)
                yield self._spoiled(path, problem, rng)
        yield from self._after(candidates, problem, budget)

    def _cost(self, objective, path: Path) -> float:
        try:
            return path_total(objective, path)
        except Exception:
            if self.fault == "hides":
                return 0.0
            raise

    def _spoiled(self, path: Path, problem: Problem, rng: np.random.Generator) -> Path:
        if self.fault == "start":
            return Path(path.q[1:])
        if self.fault == "goal":
            return Path(path.q[:-1])
        if self.fault == "limits":
            return Path(np.concatenate([path.q[:1], problem.upper[None] + 1.0, path.q[1:]]))
        if self.fault == "random":
            return Path(path.q + np.where(path.q == 1.0, 1e-3 * np.random.default_rng().uniform(), 0.0))
        if self.fault == "global":
            np.random.uniform()  # noqa: NPY002 - the fault
        if self.fault == "type":
            return path.q  # pyright: ignore[reportReturnType]
        return path

    def _after(self, candidates: list[Path], problem: Problem, budget: Budget) -> Iterator[Path]:
        if self.fault == "collides":
            yield Path(np.stack([problem.start, problem.goals[0]]))
        if self.fault == "writes":
            problem.start[0] = 0.0
        if self.fault == "nan":
            problem.states_free(np.full((1, len(problem.start)), np.nan))
        while self.fault == "overspends" and budget.spent < 50:
            budget.spent += 1
        if self.fault == "late":
            while not budget.exhausted:
                time.sleep(0.001)
                budget.spend()
            time.sleep(0.02)


def _findings(fault: str, trial: PlannerTrial = _TRIAL) -> str:
    with pytest.raises(ContractError) as caught:
        check_planner(Corners(fault=fault), trial)
    assert isinstance(caught.value, AssertionError)
    return str(caught.value)


def test_a_planner_that_is_right_passes() -> None:
    check_planner(Corners(), _TRIAL)


@pytest.mark.parametrize(
    ("fault", "finding"),
    [
        ("worse", "not less than"),
        ("start", "not at the start"),
        ("goal", "none of the goals"),
        ("limits", "leaves the limits"),
        ("random", "different paths for the same seed"),
        ("global", "numpy's global random state"),
        ("collides", "has an edge that is not free"),
        ("writes", "raised ValueError: assignment destination is read-only"),
        ("nan", "a configuration that is not finite"),
        ("overspends", "spent 50 of 40 iterations"),
        ("budget", "never called budget.spend()"),
        ("raises", "raised ZeroDivisionError: inside"),
        ("hides", "hid an exception that the objective raised"),
        ("type", "yielded a ndarray, not a Path"),
    ],
)
def test_every_fault_is_named(fault: str, finding: str) -> None:
    assert finding in _findings(fault)


def test_lateness_is_named_and_forgiven_by_a_wider_margin() -> None:
    findings = _findings("late", PlannerTrial(iterations=40, time_limit=0.02, overrun=0.01))
    assert "time limit" in findings and "cancelled" in findings


def test_a_planner_without_solution_is_reported() -> None:
    @dataclass(frozen=True)
    class Nothing(Planner):
        name: ClassVar[str] = "nothing"
        anytime: ClassVar[bool] = False

        def solve(self, problem, objective, budget: Budget, rng: np.random.Generator) -> Iterator[Path]:
            budget.spend()
            yield from ()

    with pytest.raises(ContractError) as caught:
        check_planner(Nothing(), _TRIAL)
    for part in ("around a block", "with w = 0", "three goals", "one joint", "start is a goal", "hid an exception"):
        assert part in str(caught.value)


def test_settings_that_can_be_changed_are_refused() -> None:
    class Loose(Corners):
        anytime = "yes"  # pyright: ignore[reportAssignmentType]
        name = ""

    with pytest.raises(ContractError) as caught:
        check_planner(Loose(), _TRIAL)
    assert {"has no name (ClassVar[str])", "does not say whether it is anytime (ClassVar[bool])"} <= set(
        caught.value.findings
    )
    with pytest.raises(ContractError, match=r"graceful_plan\.planners\.Planner"):
        check_planner("rrt", _TRIAL)  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class Sines(Cost):
    """A smooth cost of the configuration, broken on request."""

    fault: str = ""

    def state(self, batch: StateBatch) -> Array:
        value = 2.0 + np.sin(batch.q).sum(axis=1) / batch.q.shape[1]
        if self.fault == "shape":
            return value[:, None]
        if self.fault == "negative":
            return value - 3.0
        if self.fault == "nan":
            return np.log(value - 2.0)
        if self.fault == "impure":
            return value + np.random.default_rng().uniform()
        if self.fault == "batch":
            return value / max(1, len(batch))
        if self.fault == "order":
            return value * np.linspace(1.0, 2.0, len(batch))
        if self.fault == "writes":
            batch.q[:] = 0.0
        if self.fault == "rest":
            return value / np.linalg.norm(batch.direction, axis=1)
        return value

    def gradient(self, batch: StateBatch) -> Array:
        slope = np.cos(batch.q) / batch.q.shape[1]
        if self.fault == "gradient":
            return -slope
        if self.fault == "gradient shape":
            return slope[:, :-1]
        if self.fault == "gradient nan":
            return np.where(slope > 0.0, slope, np.nan)
        return slope


@pytest.mark.parametrize("cost", [Sines(), JointLength(), JointLength(weights=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0))])
def test_a_cost_that_is_right_passes(cost: Cost, scene: Scene) -> None:
    check_cost(cost, scene)


@pytest.mark.parametrize(
    ("fault", "finding"),
    [
        ("shape", "returned shape"),
        ("negative", "< 0 at q ="),
        ("nan", "returned nan at q ="),
        ("impure", "different numbers for the same states"),
        ("batch", "depends on which other states"),
        ("order", "depends on the order"),
        ("writes", "read-only"),
        ("rest", "returned inf"),
        ("gradient", "differs from central differences"),
        ("gradient shape", "gradient() returned shape"),
        ("gradient nan", "gradient() is not finite"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value", "ignore:divide by zero")
def test_every_fault_of_a_cost_is_named(fault: str, finding: str, scene: Scene) -> None:
    with pytest.raises(ContractError) as caught:
        check_cost(Sines(fault=fault), scene)
    assert finding in str(caught.value)


def test_other_objects_are_refused(scene: Scene) -> None:
    with pytest.raises(ContractError, match=r"graceful_plan\.Cost"):
        check_cost(lambda batch: batch, scene)  # pyright: ignore[reportArgumentType]


@pytest.mark.long
def test_the_planner_of_the_guide_keeps_the_contract():
    text = (ROOT / "docs" / "comparing-planners.md").read_text()
    known: dict[str, type] = {}
    exec(compile(text.partition("```python\n")[2].partition("```")[0], "comparing-planners.md", "exec"), known)
    check_planner(known["ViaPoint"](), PlannerTrial(overrun=5.0))
