"""Custom costs in searches and descents: agreement with the core, batched calls, and better motions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.costs.objective import Objective, SceneObjective, search_paces
from graceful_plan.path import Path
from graceful_plan.planners.motion_descent import TIME_PRICE
from graceful_plan.planners.native import native_space
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.timing.retiming import timed
from graceful_plan.timing.spline import Spline, grid_points
from graceful_plan.transcription.motion_charges import ImpactCharge
from sizes import first_quick
from support.costs.own_costs import Bowl, Crosswise, Haste, Height

Array = np.ndarray
_CONTROLS, _DENSITY = 9, 4
W = {"time": 0.3, "length": 0.3, "waypoints": 0.005}


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return gp.load_scene("tabletop").tasks["green_to_blue"]


def bound(task: gp.Task, objective: Objective) -> SceneObjective:
    return objective.bind(task.scene, search_paces())


def problem_of(task: gp.Task, objective: SceneObjective) -> SceneProblem:
    goals = np.atleast_2d(task.goal)
    return SceneProblem(kernels=objective.kernels, start=np.asarray(task.start), goals=goals, margin=0.002)


def descent(task: gp.Task, objective: SceneObjective, **settings: float) -> _native.MotionDescent:
    problem, limits = problem_of(task, objective), task.scene.limits
    s = np.linspace(0.0, 1.0, 9)[:, None]
    bend = 0.25 * s * (1.0 - s) * np.random.default_rng(1).normal(size=7)
    lower, upper = limits.position.T
    path = np.clip(problem.start + s * (problem.goals[0] - problem.start) + bend, lower, upper)
    given = {"controls": _CONTROLS, "density": _DENSITY, "time_price": TIME_PRICE, **settings}
    points = float(grid_points(int(given["controls"])))
    return _native.MotionDescent(
        native_space(problem, objective),
        path=path,
        velocity=limits.velocity,
        acceleration=limits.acceleration,
        points=points,
        **given,  # pyright: ignore[reportArgumentType]
    )


@pytest.mark.parametrize("exposure", ["time", "length", "waypoints"])
@pytest.mark.parametrize("motion", [gp.JointLength(), Crosswise()], ids=repr)
@pytest.mark.parametrize("impact", [Bowl(), Bowl(told=False), Haste()], ids=repr)
def test_gradients_of_motions_equal_differences(task: gp.Task, impact: gp.Cost, motion: gp.Cost, exposure: str) -> None:
    one = descent(task, bound(task, Objective(motion=motion, impact=impact, w=W[exposure], exposure=exposure)))
    x = one.controls[1:-1].ravel()
    gradient = one.energy(x)[1].ravel()
    step = 1e-6
    differences = np.array([(one.energy(x + e)[0] - one.energy(x - e)[0]) / (2 * step) for e in step * np.eye(len(x))])
    error = np.abs(gradient - differences) / np.maximum(1.0, np.abs(differences).max())
    assert np.mean(error < 5e-3) > 0.9, np.sort(error)[-8:]
    assert gradient @ differences / np.linalg.norm(gradient) / np.linalg.norm(differences) > 0.999


@pytest.mark.parametrize("exposure", ["time", "length", "waypoints"])
@pytest.mark.parametrize("motion", [gp.JointLength(), Crosswise()], ids=repr)
def test_the_cost_in_a_descent_equals_evaluate(task: gp.Task, motion: gp.Cost, exposure: str) -> None:
    objective = Objective(motion=motion, impact=Height(), w=4.0 * W[exposure], exposure=exposure)
    one = descent(task, bound(task, objective), controls=16, density=8)
    one.run(60, np.inf)
    trajectory = timed(Spline(one.controls), task.scene.limits, task.scene.joints)
    assert bound(task, objective).kernels.free(trajectory.q, 0.004).all(), "nothing is charged for being too close"
    cost = gp.evaluate(trajectory, task.scene, objective)
    assert one.value == pytest.approx(cost.total + TIME_PRICE * trajectory.duration, rel=0.03)


@dataclass(frozen=True, eq=False)
class Asked(gp.Cost):
    """Records the batch size of each evaluation."""

    sizes: list[int] = field(default_factory=list)

    def state(self, batch: gp.StateBatch) -> Array:
        self.sizes.append(len(batch))
        return batch.tool_poses[:, 2, 3] ** 2


def test_collisions_are_found_without_asking_the_cost() -> None:
    task = gp.load_scene("tabletop").tasks["right_to_left"]
    cost = Asked()
    objective = bound(task, Objective(impact=cost, w=1.0))
    problem = problem_of(task, objective)
    planner = gp.PLANNERS["rrt_connect"](shortcut=None)
    paths = list(planner.solve(problem, objective, Budget(iterations=2000), np.random.default_rng(0)))
    assert paths and not cost.sizes


def test_without_weight_no_planner_of_the_core_evaluates_the_cost(task: gp.Task) -> None:
    cost = Asked()
    objective = bound(task, Objective(impact=cost, w=0.0))
    problem = problem_of(task, objective)
    for name in ("auto", "anytime"):
        assert list(gp.PLANNERS[name]().solve(problem, objective, Budget(iterations=200), np.random.default_rng(0)))
    assert not cost.sizes


def test_whole_paths_are_evaluated_in_one_batch(task: gp.Task) -> None:
    cost = Asked()
    objective = bound(task, Objective(impact=cost, w=1.0))
    q = np.linspace(np.asarray(task.start), np.atleast_2d(task.goal)[0], 30)
    core = gp.Anytime().search(native_space(problem_of(task, objective), objective), problem_of(task, objective),
                               np.random.default_rng(0))  # fmt: skip
    core.adopt(q)
    assert len(cost.sizes) == 1
    assert core.total == pytest.approx(objective.breakdown(Path(q)).total)


@pytest.mark.long
@pytest.mark.parametrize("exposure", ["time", "length", "waypoints"])
def test_plans_descend_along_own_costs(task: gp.Task, exposure: str) -> None:
    objective = Objective(impact=Height(), w=20.0 * W[exposure], exposure=exposure)
    plain = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=100)
    own = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=100)
    assert own.status is gp.PlanStatus.SOLVED
    assert "estimated_total" in own.stats or exposure == "waypoints"  # polylines lack this estimate
    assert own.cost.total < 0.97 * gp.evaluate(plain.trajectory, task.scene, objective).total
    again = gp.plan(task.start, task.goal, task.scene, objective=objective, iterations=100)
    np.testing.assert_array_equal(own.trajectory.q, again.trajectory.q)
    assert own.cost == gp.evaluate(own.trajectory, task.scene, objective)


@dataclass(frozen=True, eq=False)
class Leaning(gp.Cost):
    """Records the batch size of each gradient evaluation."""

    sizes: list[int] = field(default_factory=list)

    def state(self, batch: gp.StateBatch) -> Array:
        return batch.q[:, 1] ** 2

    def gradient(self, batch: gp.StateBatch) -> Array:
        self.sizes.append(len(batch))
        return 2.0 * batch.q * (np.arange(batch.q.shape[1]) == 1)


@pytest.mark.parametrize("planner", first_quick(["chomp", "casadi", "auto"]))
def test_planners_evaluate_gradients_in_batches(task: gp.Task, planner: str) -> None:
    pytest.importorskip("casadi") if planner == "casadi" else None
    cost = Leaning()
    objective = bound(task, Objective(impact=cost, w=1.0))
    problem = problem_of(task, objective)
    list(gp.PLANNERS[planner]().solve(problem, objective, Budget(iterations=150), np.random.default_rng(0)))
    assert len(cost.sizes) > 5 and np.median(cost.sizes) > 10


def test_transcription_uses_custom_gradients(task: gp.Task) -> None:
    told, untold = (ImpactCharge(cost, task.scene, 2.0) for cost in (Bowl(), Bowl(told=False)))
    q = np.random.default_rng(0).normal(size=(5, 7))
    np.testing.assert_allclose(told.slope(q, q), 2.0 * np.concatenate([q - 0.3, 0.0 * q], axis=1))
    np.testing.assert_allclose(told.slope(q, q), untold.slope(q, q), atol=1e-4)


def test_a_cost_that_raises_within_a_descent_says_so(task: gp.Task) -> None:
    @dataclass(frozen=True)
    class Raises(gp.Cost):
        def state(self, batch: gp.StateBatch) -> Array:
            if len(batch) > 1:
                raise ZeroDivisionError("by my own cost")
            return np.ones(len(batch))

    one = bound(task, Objective(impact=Raises(), w=1.0))
    one.impact_slopes.__dict__.update(has_gradient=False, uses_velocity=False)
    with pytest.raises(ZeroDivisionError, match="by my own cost"):
        descent(task, one)
