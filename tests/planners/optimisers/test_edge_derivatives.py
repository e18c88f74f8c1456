"""Derivatives for optimisers: of edge costs, of clearances and of a path's energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from body_twin import BodyTwin
from saddles import saddle

import graceful_plan as gp
from graceful_plan.compare.problems.analytic import analytic_problems, disc
from graceful_plan.compare.problems.function_problem import DensityObjective, FunctionProblem
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.body.constants import BodySettings
from graceful_plan.exceptions import CostError, SettingError
from graceful_plan.planners.interruptible import Interrupted
from graceful_plan.planners.optimisers.edge_derivatives import Slopes, edge_derivatives
from graceful_plan.planners.optimisers.path_energy import ObstaclePotential, PathEnergy
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem

_STEP = 1e-6
_TOLERANCE = 1e-5
"""Relative error of a derivative; differences at `_STEP` have about 1e-9 where curvature is small."""


@dataclass(frozen=True)
class _Opaque:
    """Hides an objective's derivatives."""

    inner: DensityObjective

    @property
    def w(self) -> float:
        return self.inner.w

    def edges(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        return self.inner.edges(q0, q1)

    def states(self, q: np.ndarray) -> np.ndarray:
        return self.inner.states(q)


def _smooth_objectives() -> dict[str, DensityObjective]:
    every = {name: p.objective for name, p in analytic_problems().items() if name != "two_media"}
    return {**every, "saddle": saddle(2.0, 0.3).objective, "heavy": replace(every["hyperbolic"], w=7.0)}


def _edges(n: int, low: float, high: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q0 = rng.uniform(low, high, (n, 2))
    return q0, np.clip(q0 + 0.1 * rng.normal(size=q0.shape), low, high)


def _difference(function: Callable[[np.ndarray], float], q: np.ndarray) -> np.ndarray:
    """Compute the derivative of a function of one array, entry by entry, by differences."""
    slope = np.zeros_like(q)
    for index in np.ndindex(q.shape):
        moved = np.zeros_like(q)
        moved[index] = _STEP
        slope[index] = (function(q + moved) - function(q - moved)) / (2.0 * _STEP)
    return slope


@pytest.mark.parametrize("name", _smooth_objectives())
def test_exact_derivatives_of_edges_agree_with_differences(name: str) -> None:
    objective = _smooth_objectives()[name]
    q0, q1 = _edges(100, 0.15, 0.95)
    exact = edge_derivatives(objective, q0, q1)
    approximate = edge_derivatives(_Opaque(objective), q0, q1, difference=_STEP)
    for ours, theirs in zip(exact, approximate, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=_TOLERANCE, atol=_TOLERANCE * np.abs(theirs).max(initial=1.0))


def test_differences_see_a_jump_that_a_derivative_does_not() -> None:
    """An edge across the border of two media costs more the farther it reaches into the more expensive one."""
    objective = analytic_problems()["two_media"].objective
    q0, q1 = np.array([[0.0, 0.101]]), np.array([[0.0, -0.099]])
    _, _, d_q1 = edge_derivatives(objective, q0, q1)
    assert -4.0 < d_q1[0, 1] < -2.0  # the part of an edge below the border costs 3 per length


def test_an_edge_without_length_has_finite_derivatives() -> None:
    q = np.full((3, 2), 0.5)
    for objective in _smooth_objectives().values():
        assert all(np.isfinite(part).all() for part in edge_derivatives(objective, q, q))


def test_no_edges_have_no_derivatives() -> None:
    none = np.zeros((0, 2))
    for objective in (disc().objective, _Opaque(disc().objective)):
        cost, d_q0, d_q1 = edge_derivatives(objective, none, none)
        assert cost.shape == (0,) and d_q0.shape == d_q1.shape == (0, 2)


def test_improper_costs_are_refused() -> None:
    problem = disc().problem
    slopes = Slopes(problem, DensityObjective(density=lambda q: np.full(len(q), np.nan)), Budget())
    with pytest.raises(CostError, match="finite"):
        slopes.edge_slopes(np.zeros((2, 2)), np.ones((2, 2)))


def test_slopes_are_interrupted_between_slices() -> None:
    problem = disc()
    slopes = Slopes(problem.problem, problem.objective, Budget(time_limit=0.0))
    with pytest.raises(Interrupted):
        slopes.edge_slopes(np.zeros((2, 2)), np.ones((2, 2)))


def _potential(**settings: float) -> ObstaclePotential:
    return ObstaclePotential(**{"weight": 3.0, "reach": 0.4, "step": 0.03, **settings})


def test_potential_is_that_of_chomp_and_continuously_differentiable() -> None:
    potential = _potential()
    d = np.array([-0.3, 0.0, 0.1, 0.4, 5.0, np.inf])
    value, slope = potential.density(d)
    np.testing.assert_allclose(value, 3.0 * np.array([0.3 + 0.2, 0.2, 0.3**2 / 0.8, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(slope, -3.0 * np.array([1.0, 1.0, 0.75, 0.0, 0.0, 0.0]))
    around = np.array([-1e-9, 1e-9, 0.4 - 1e-9, 0.4 + 1e-9])
    value, slope = potential.density(around)
    assert np.abs(np.diff(value.reshape(2, 2))).max() < 1e-8 and np.abs(np.diff(slope.reshape(2, 2))).max() < 1e-7


def test_gradient_of_the_potential_on_a_moving_path() -> None:
    """100 edges that touch, leave or graze the disc: the change of length matters as much as the potential."""
    problem = disc().problem
    slopes = Slopes(problem, disc().objective, Budget())
    rng = np.random.default_rng(1)
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, 100), rng.uniform(0.7, 1.6, 100)
    q0 = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    q1 = q0 + rng.normal(0.0, 0.04, q0.shape)
    charged = _potential().edges(q0, q1, slopes)
    assert charged is not None
    value, d_q0, d_q1 = charged

    def of(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        again = _potential().edges(first, second, slopes)
        assert again is not None
        return again[0]

    assert (value > 0.0).sum() > 60
    for j, unit in enumerate(_STEP * np.eye(2)):
        np.testing.assert_allclose((of(q0 + unit, q1) - of(q0 - unit, q1)) / (2 * _STEP), d_q0[:, j], atol=1e-5)
        np.testing.assert_allclose((of(q0, q1 + unit) - of(q0, q1 - unit)) / (2 * _STEP), d_q1[:, j], atol=1e-5)


def test_a_problem_without_clearance_has_no_potential() -> None:
    problem = FunctionProblem(start=np.zeros(2), goals=np.ones((1, 2)), lower=-np.ones(2), upper=np.ones(2))
    assert problem.clearance_gradient(np.zeros((1, 2))) is None
    slopes = Slopes(problem, disc().objective, Budget())
    assert _potential().edges(np.zeros((1, 2)), np.ones((1, 2)), slopes) is None


def test_potential_does_not_depend_on_how_a_path_is_cut_up() -> None:
    slopes = Slopes(disc().problem, disc().objective, Budget())
    path = gp.Path(np.array([[-2.0, 0.3], [-0.5, 1.1], [0.4, 1.0], [2.0, 0.0]]))
    totals = []
    for step in (0.2, 0.1, 0.037):
        q = path.resampled(step).q
        charged = _potential().edges(q[:-1], q[1:], slopes)
        assert charged is not None
        totals.append(charged[0].sum())
    np.testing.assert_allclose(totals[:2], totals[2], rtol=0.01)


@pytest.mark.parametrize("obstacles", [False, True])
def test_gradient_of_the_energy(obstacles: bool) -> None:
    instance = disc()
    objective = replace(saddle().objective, step=0.2)  # longer than every edge, so the number of samples is constant
    energy = PathEnergy(Slopes(instance.problem, objective, Budget()), _potential(step=0.2) if obstacles else None)
    q = np.linspace([-1.8, 0.2], [1.9, 0.6], 25) + 0.02 * np.random.default_rng(0).normal(size=(25, 2))
    at = energy(q)

    def of(inner: np.ndarray) -> float:
        return energy(np.concatenate([q[:1], inner, q[-1:]])).energy

    np.testing.assert_allclose(_difference(of, q[1:-1]), at.gradient, rtol=_TOLERANCE, atol=1e-5 * at.energy)


def test_energy_is_half_the_squared_cost_if_all_edges_cost_the_same() -> None:
    objective = disc().objective
    at = PathEnergy(Slopes(disc().problem, objective, Budget()))(np.linspace([0.0, 0.0], [3.0, 4.0], 11))
    assert at.energy == pytest.approx(0.5 * 5.0**2) and at.total == pytest.approx(5.0)
    uneven = PathEnergy(Slopes(disc().problem, objective, Budget()))(np.array([[0.0, 0.0], [0.6, 0.8], [3.0, 4.0]]))
    assert uneven.energy > at.energy and uneven.total == pytest.approx(5.0)


@pytest.fixture(scope="module")
def carrying() -> gp.Scene:
    return gp.load_scene("desk").tasks["bring_coffee"].scene


def test_clearance_of_a_scene_counts_from_the_margin(carrying: gp.Scene) -> None:
    kernels = compile_scene(carrying).kernels
    q = np.random.default_rng(0).uniform(kernels.robot.lower, kernels.robot.upper, (100, kernels.nq))
    problem = SceneProblem(kernels=kernels, start=q[0], goals=q[1:2], margin=0.03)
    clearance, gradient = problem.clearance_gradient(q)
    np.testing.assert_allclose(clearance, kernels.clearance(q) - 0.03, atol=1e-6)
    decided = np.abs(clearance) > 1e-4
    assert 0 < problem.states_free(q).sum() < 100
    np.testing.assert_array_equal((clearance > 0.0)[decided], problem.states_free(q)[decided])
    assert gradient.shape == q.shape


class _Clearances:
    """Clearance in double precision, pair by pair, over all spheres."""

    def __init__(self, scene: gp.Scene) -> None:
        self.twin, self.robot = BodyTwin(scene, BodySettings.shipped()), compile_scene(scene).robot

    def centres(self, q: np.ndarray) -> np.ndarray:
        X, robot = self.twin.poses(q), self.robot
        return np.einsum("sij,sj->si", X[robot.sphere_link, :3, :3], robot.sphere[:, :3]) + X[robot.sphere_link, :3, 3]

    def of(self, q: np.ndarray, i: int, j: int) -> float:
        """Return the distance of sphere i to obstacle j, or to sphere -1 - j."""
        centre, radius = self.centres(q), self.robot.sphere[:, 3]
        if j >= 0:
            return self.twin.distance_to(j, centre[i]) - radius[i]
        return float(np.linalg.norm(centre[i] - centre[-1 - j])) - radius[i] - radius[-1 - j]

    def nearest(self, q: np.ndarray) -> tuple[float, int, int]:
        centre, link, world = self.centres(q), self.robot.sphere_link, self.twin.world
        pairs = [
            (i, o)
            for i in range(len(link))
            for o in range(len(world.kind))
            if not int(world.ignores[o]) >> int(link[i]) & 1
        ]
        found = [(self.twin.distance_to(o, centre[i]) - self.robot.sphere[i, 3], i, o) for i, o in pairs]
        for a, b in self.robot.self_pair:
            for i in np.flatnonzero(link == a):
                rest = np.flatnonzero(link == b)
                apart = np.linalg.norm(centre[i] - centre[rest], axis=1) - self.robot.sphere[rest, 3]
                found += [(d - self.robot.sphere[i, 3], int(i), -1 - int(k)) for d, k in zip(apart, rest, strict=True)]
        return min(found)


@pytest.mark.long
def test_gradient_of_clearance_in_a_scene() -> None:
    """100 configurations near contact and in it, with obstacles and with the robot itself."""
    scene = gp.load_scene("tabletop").tasks["lift_to_goal"].scene
    kernels, oracle = compile_scene(scene).kernels, _Clearances(scene)
    q = np.random.default_rng(3).uniform(kernels.robot.lower, kernels.robot.upper, (3000, kernels.nq))
    q = q[np.abs(kernels.clearance(q)) < 0.05][:100]
    errors, with_itself = [], 0
    for x, clearance, gradient in zip(q, *kernels.clearance_gradient(q), strict=True):
        distance, i, j = oracle.nearest(x)
        assert clearance == pytest.approx(distance, abs=2e-6)
        moves = _STEP * np.eye(kernels.nq)
        slope = np.array([(oracle.of(x + m, i, j) - oracle.of(x - m, i, j)) / (2.0 * _STEP) for m in moves])
        errors.append(np.abs(slope - gradient).max() / np.abs(gradient).max())
        with_itself += j < 0
    assert len(errors) == 100 and 0 < with_itself < 100
    assert np.median(errors) < _TOLERANCE
    assert np.quantile(errors, 0.95) < 10 * _TOLERANCE  # poses are in single precision


@pytest.mark.parametrize(("faults", "rounding"), [("drop_only", 1e-6), ("service_robot", 1e-4)])
def test_hits_can_be_smeared(carrying: gp.Scene, faults: str, rounding: float) -> None:
    objective = gp.Objective(w=2.0, impact=gp.ImpactCost(gp.FailureMixture(faults=faults))).bind(carrying)
    task = gp.load_scene("desk").tasks["bring_coffee"]
    q = np.linspace(task.start, task.goal[0], 200)
    narrow = objective.states(q)
    wide = objective.widened(0.3)
    assert wide is not None and wide.w == 2.0
    assert np.ptp(wide.states(q)) < 0.7 * np.ptp(narrow)
    barely = objective.widened(1e-6)
    assert barely is not None
    np.testing.assert_allclose(barely.states(q), narrow, rtol=rounding, atol=1e-12)
    assert wide.edge_gradients(q[:1], q[1:2]) is not None


def test_objectives_that_cannot_be_smeared_are_refused(carrying: gp.Scene) -> None:
    for impact in (
        gp.ImpactCost("box_overlap"),
        gp.ImpactCost("box_overlap", consequence="energy"),
    ):
        assert gp.Objective(impact=impact).bind(carrying).widened(0.1) is None
    for metres in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(SettingError, match="metres"):
            gp.Objective().bind(carrying).widened(metres)
