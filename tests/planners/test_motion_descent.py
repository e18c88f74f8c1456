"""Descents of whole motions: splines, speed profiles and gradients against references, and improvements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.core import _native
from graceful_plan.costs.objective import Objective, SceneObjective, search_paces
from graceful_plan.path import Path
from graceful_plan.planners.descent_rounds import descend_from
from graceful_plan.planners.motion_descent import (
    COARSE,
    FINE,
    MIDDLE,
    TIME_PRICE,
    DescentResult,
    DescentSettings,
    MotionDescents,
    Start,
)
from graceful_plan.planners.native import native_space
from graceful_plan.planners.planner import Budget
from graceful_plan.planners.scene_problem import SceneProblem
from graceful_plan.timing.retiming import timed
from graceful_plan.timing.spline import Spline
from graceful_plan.timing.topp import EndSpeeds

MODELS = {"mixture": gp.ImpactCost(), "box_overlap": gp.ImpactCost(model="box_overlap")}


@pytest.fixture(scope="module", params=["tabletop/green_to_blue", "desk/water_plant"])
def task(request: pytest.FixtureRequest) -> gp.Task:
    scene, name = request.param.split("/")
    return gp.load_scene(scene).tasks[name]


def bound(task: gp.Task, w: float = 1.0, impact: gp.ImpactCost = MODELS["mixture"]) -> SceneObjective:
    return Objective(w=w, impact=impact).bind(task.scene, search_paces())


def bent(task: gp.Task, size: float = 0.3, seed: int = 0) -> Path:
    """A curved path from the task's start to its goal."""
    rng = np.random.default_rng(seed)
    start, goal = np.asarray(task.start), np.atleast_2d(task.goal)[0]
    s = np.linspace(0.0, 1.0, 9)[:, None]
    lower, upper = task.scene.limits.position.T
    q = start + s * (goal - start) + size * 4.0 * s * (1.0 - s) * rng.normal(size=len(start))
    return Path(np.clip(q, lower, upper))


def descent(objective: SceneObjective, path: Path, **settings: float | np.ndarray) -> _native.MotionDescent:
    problem = SceneProblem(kernels=objective.kernels, start=path.q[0], goals=path.q[-1:], margin=0.002)
    limits = objective.scene.limits
    given = {"controls": 12, "density": 6, "time_price": TIME_PRICE, **settings}
    return _native.MotionDescent(
        native_space(problem, objective),
        path=path.q,
        velocity=limits.velocity,
        acceleration=limits.acceleration,
        **given,  # pyright: ignore[reportArgumentType]
    )


def test_splines_equal_those_of_scipy() -> None:
    from scipy.interpolate import BSpline

    rng = np.random.default_rng(3)
    for n in (4, 5, 6, 7, 13):
        controls = rng.normal(size=(n, 3))
        spans = n - 3
        knots = np.clip(np.arange(n + 4) - 3.0, 0.0, spans)
        u = np.concatenate([np.linspace(0.0, spans, 57), np.arange(spans + 1.0)])
        curve = BSpline(knots, controls, 3)
        expected = [curve(u), curve.derivative(1)(u), curve.derivative(2)(u)]
        np.testing.assert_allclose(_native.spline(controls, u), expected, atol=1e-10)


def test_a_spline_begins_and_ends_at_its_control_points() -> None:
    controls = np.random.default_rng(0).normal(size=(8, 7))
    grid = Spline(controls).grid(1)
    np.testing.assert_array_equal(grid.q[[0, -1]], controls[[0, -1]])
    assert np.all(grid.q >= controls.min(axis=0) - 1e-12) and np.all(grid.q <= controls.max(axis=0) + 1e-12)


def both_gradients(one: _native.MotionDescent, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient and the differences of the energy, which nearly all agree: kinks are rare."""
    gradient = one.energy(x)[1].ravel()
    step = 1e-6
    differences = np.array(
        [(one.energy(x + step * e)[0] - one.energy(x - step * e)[0]) / (2.0 * step) for e in np.eye(len(x))]
    )
    error = np.abs(gradient - differences) / np.maximum(1.0, np.abs(differences).max())
    assert np.mean(error < 1e-4) > 0.9, np.sort(error)[-8:]
    return gradient, differences


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("w", [0.0, 1.0])
def test_gradients_equal_differences(task: gp.Task, model: str, w: float) -> None:
    """All terms: length, impact, times by the speed profile, clearance. Kinks are too rare to matter."""
    if model == "box_overlap" and w > 0.0:
        pytest.skip("Algorithm 1 has jumps")
    objective = bound(task, w, MODELS[model])
    path = bent(task)
    one = descent(objective, path)
    x = one.controls[1:-1].ravel()
    gradient, differences = both_gradients(one, x)
    cosine = gradient @ differences / np.linalg.norm(gradient) / np.linalg.norm(differences)
    assert cosine > 0.999


@pytest.mark.parametrize("share", [0.05, 0.3, 0.9])
def test_gradients_at_a_moving_start_equal_differences(task: gp.Task, share: float) -> None:
    """From crawling to too fast for the curve."""
    leaving = share * task.scene.limits.velocity * np.random.default_rng(2).uniform(-1.0, 1.0, 7)
    one = descent(bound(task), bent(task), leaving=leaving, least_leg=0.01)
    x = one.controls[1:-1].ravel()
    x[:7] += 0.1 * leaving / np.linalg.norm(leaving)
    gradient, differences = both_gradients(one, x)
    np.testing.assert_allclose(gradient[:7], differences[:7], rtol=1e-3, atol=1e-4 * np.abs(differences).max())


@pytest.mark.parametrize("share", [0.05, 0.3, 0.9])
@pytest.mark.parametrize("both", [False, True])
def test_gradients_at_a_moving_end_equal_differences(task: gp.Task, share: float, both: bool) -> None:
    """From crawling to too fast for the curve."""
    arriving = share * task.scene.limits.velocity * np.random.default_rng(2).uniform(-1.0, 1.0, 7)
    starts = {"leaving": arriving[::-1].copy(), "least_leg": 0.01} if both else {}
    one = descent(bound(task), bent(task), arriving=arriving, least_last_leg=0.01, **starts)
    x = one.controls[1:-1].ravel()
    x[-7:] -= 0.1 * arriving / np.linalg.norm(arriving)
    x[:7] += 0.1 * float(both) * arriving[::-1] / np.linalg.norm(arriving)
    gradient, differences = both_gradients(one, x)
    np.testing.assert_allclose(gradient[-7:], differences[-7:], rtol=1e-3, atol=1e-4 * np.abs(differences).max())


def test_descents_keep_the_direction_of_a_moving_end_and_become_fast_enough_for_it(task: gp.Task) -> None:
    arriving = 0.5 * task.scene.limits.velocity * np.random.default_rng(4).uniform(-1.0, 1.0, 7)
    one = descent(bound(task), bent(task), arriving=arriving, least_last_leg=0.01)
    one.run(200, np.inf)
    last = one.controls[-1] - one.controls[-2]
    np.testing.assert_allclose(last / np.linalg.norm(last), arriving / np.linalg.norm(arriving), atol=1e-9)
    assert one.speed_room >= 1.0
    speed = float(np.linalg.norm(arriving))
    trajectory = timed(Spline(one.controls), task.scene.limits, task.scene.joints, ends=EndSpeeds(end=speed))
    np.testing.assert_allclose(trajectory.qd[-1], arriving, atol=1e-9)
    assert one.duration == pytest.approx(trajectory.duration, rel=0.05)


def test_descents_keep_the_direction_of_a_moving_start_and_become_slow_enough_for_it(task: gp.Task) -> None:
    leaving = 0.5 * task.scene.limits.velocity * np.random.default_rng(4).uniform(-1.0, 1.0, 7)
    one = descent(bound(task), bent(task), leaving=leaving, least_leg=0.01)
    one.run(200, np.inf)
    first = one.controls[1] - one.controls[0]
    np.testing.assert_allclose(first / np.linalg.norm(first), leaving / np.linalg.norm(leaving), atol=1e-9)
    assert one.speed_room >= 1.0
    speed = float(np.linalg.norm(leaving))
    trajectory = timed(Spline(one.controls), task.scene.limits, task.scene.joints, ends=EndSpeeds(start=speed))
    np.testing.assert_allclose(trajectory.qd[0], leaving, atol=1e-9)
    assert one.duration == pytest.approx(trajectory.duration, rel=0.05)


def test_the_cost_in_a_descent_is_that_of_the_trajectory(task: gp.Task) -> None:
    objective = bound(task)
    one = descent(objective, bent(task, 0.0), controls=16)
    one.run(100, np.inf)
    trajectory = timed(Spline(one.controls), task.scene.limits, task.scene.joints)
    cost = gp.evaluate(trajectory, task.scene, Objective(w=1.0))
    if objective.kernels.free(trajectory.sample(0.01).q).all():  # no penalty for low clearance
        assert one.value == pytest.approx(cost.total + TIME_PRICE * trajectory.duration, rel=0.03)
    assert one.duration == pytest.approx(trajectory.duration, rel=0.03)


def test_descents_lower_j_and_stay_within_limits(task: gp.Task) -> None:
    objective = bound(task)
    one = descent(objective, bent(task))
    before = one.value
    one.run(200, np.inf)
    assert one.value < 0.8 * before
    lower, upper = task.scene.limits.position.T
    assert np.all((one.controls >= lower) & (one.controls <= upper))


def test_without_weight_a_bent_path_becomes_straight() -> None:
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    one = descent(bound(task, 0.0), bent(task, 0.2))
    one.run(300, np.inf)
    ends = one.controls[[0, -1]]
    assert np.linalg.norm(np.diff(one.controls, axis=0), axis=1).sum() < 1.02 * np.linalg.norm(ends[1] - ends[0])


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), speed=st.floats(0.1, 1.0))
def test_edges_weighted_by_time_equal_numpy(seed: int, speed: float) -> None:
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    objective = Objective().bind(task.scene, search_paces(speed))
    rng = np.random.default_rng(seed)
    q0 = np.asarray(task.start) + 0.3 * rng.normal(size=(4, 7))
    q1 = q0 + 0.3 * rng.normal(size=(4, 7))
    generic = Objective(motion=gp.JointLength((1.0,) * 7)).bind(task.scene, search_paces(speed))  # has no kernel
    assert objective.kernel is not None and generic.kernel is None
    np.testing.assert_allclose(objective.edges(q0, q1), generic.edges(q0, q1), rtol=0.02, atol=0.02)  # other steps


def test_gradients_of_edges_weighted_by_time() -> None:
    task = gp.load_scene("tabletop").tasks["green_to_blue"]
    objective = bound(task)
    rng = np.random.default_rng(5)
    q0 = np.asarray(task.start) + 0.2 * rng.normal(size=(6, 7))
    q1 = q0 + 0.2 * rng.normal(size=(6, 7))
    found = objective.edge_gradients(q0, q1)
    assert found is not None
    step = 1e-7
    for j in range(7):
        e = np.eye(7)[j] * step
        for k, (a, b) in enumerate((((q0 - e, q1), (q0 + e, q1)), ((q0, q1 - e), (q0, q1 + e)))):
            before, after = (objective.edges(*ends) @ [1.0, objective.w] for ends in (a, b))
            np.testing.assert_allclose(found[1 + k][:, j], (after - before) / (2.0 * step), rtol=2e-3, atol=2e-4)


@pytest.mark.long
def test_rounds_of_descents_yield_free_curves_of_the_requested_stage(task: gp.Task) -> None:
    objective = bound(task)
    result = gp.plan(task.start, task.goal, task.scene, iterations=300)
    assert result.path is not None
    path = Path(result.path.q[::4] if len(result.path.q) % 4 == 1 else result.path.q)
    problem = SceneProblem(kernels=objective.kernels, start=path.q[0], goals=path.q[-1:], margin=0.002)
    asked: list[Spline] = []

    def is_free(curve: Spline, start: Start) -> bool:
        asked.append(curve)
        return len(asked) % 2 == 0  # after a refusal the descent raises its clearance penalty

    limits = task.scene.limits
    descents = MotionDescents(native_space(problem, objective), limits.velocity, limits.acceleration, is_free)
    rng = np.random.default_rng(0)
    found = list(descend_from([Start(path)], descents, Budget(iterations=1), rng))
    assert found and len(asked) >= 2 * len(found)

    def curves(settings: DescentSettings, starts: int = 1) -> list[DescentResult]:
        of = replace(descents, settings=settings, is_free=lambda curve, start: True)
        return list(descend_from([Start(path, arrival=k) for k in range(starts)], of, Budget(iterations=1), rng))

    coarse = curves(DescentSettings(fine=0, refinements=0))
    assert {len(one.curve.controls) for one in coarse} <= {COARSE.controls, MIDDLE.controls}
    soon, later = curves(DescentSettings(screens=False, fine=1, hurries=True, refinements=0))
    assert [len(one.curve.controls) for one in (soon, later)] == [MIDDLE.controls, FINE.controls]
    assert later.start.curve is soon.curve, "the finer one goes on from there"
    finely = curves(DescentSettings(screens=False, fine=1, refinements=0))
    assert [len(one.curve.controls) for one in finely] == [FINE.controls]
    begun = descents.descended(Start(path), replace(FINE, evaluations=0), Budget())
    assert begun is not None and finely[0].value < begun.value
    refined = curves(DescentSettings(refinements=4))
    assert min(one.value for one in refined) <= min(one.value for one in finely) * (1.0 + 1e-3)
    assert {one.start.arrival for one in curves(DescentSettings(bends=0, refinements=0), 2)} == {0, 1}
    assert not list(descend_from([], descents, Budget(iterations=1), rng))
    assert not list(descend_from([Start(path)], descents, Budget(time_limit=0.0), rng))


def test_unrestrained_speed_profiles_are_bang_bang() -> None:
    """One joint over a length, from rest to rest: 2 sqrt(length / a), or a plateau at the velocity limit."""
    n, length = 400, 2.0
    step = np.full(n, length / n)
    slope, bend = np.ones((n, 2, 1)), np.zeros((n, 2, 1))
    stop = np.zeros(n + 1, dtype=bool)
    stop[[0, -1]] = True
    for velocity, acceleration in ((10.0, 3.0), (1.0, 3.0)):
        limits = {"velocity": np.array([velocity]), "acceleration": np.array([acceleration])}
        q = np.append(0.0, np.cumsum(step))[:, None]
        speed = _native.fastest(step=step, q=q, slope=slope, bend=bend, stop=stop, **limits).speeds
        seconds = float((2.0 * step / (speed[:-1] + speed[1:])).sum())
        peak = min(velocity, np.sqrt(acceleration * length))
        assert seconds == pytest.approx(peak / acceleration + length / peak, rel=1e-3)


@pytest.mark.parametrize(("roughness", "slopes"), [(3.0, (0.5, 1.5)), (10.0, (-2.0, 2.0)), (0.3, (-2.0, 2.0))])
def test_speed_profiles_keep_their_limits_at_both_ends_of_every_interval(
    roughness: float, slopes: tuple[float, float]
) -> None:
    """On curves so rough that one step would overshoot the speed, no squared speed is negative."""
    n, dim, velocity = 40, 2, np.full(2, 3.0)
    stop = np.zeros(n + 1, dtype=bool)
    stop[[0, -1]] = True
    for seed in range(200):
        rng = np.random.default_rng(seed)
        step = rng.uniform(0.05, 0.5, n)
        slope = np.sign(rng.normal(size=dim)) * rng.uniform(*slopes, (n, 2, dim))
        bend, acceleration = roughness * rng.normal(size=(n, 2, dim)), rng.uniform(1.0, 5.0, dim)
        limits = {"velocity": velocity, "acceleration": acceleration}
        q = np.zeros((n + 1, dim))  # speeds do not depend on q
        x = _native.fastest(step=step, q=q, slope=slope, bend=bend, stop=stop, **limits).speeds ** 2
        assert (x >= 0.0).all() and x.max() > 0.0
        u = np.diff(x) / (2.0 * step)
        for end, speed in ((0, x[:-1]), (1, x[1:])):
            assert (np.abs(slope[:, end]) * np.sqrt(speed)[:, None] <= velocity * (1.0 + 1e-9)).all()
            felt = slope[:, end] * u[:, None] + bend[:, end] * speed[:, None]
            assert (np.abs(felt) <= acceleration * (1.0 + 1e-6) + 1e-9).all()
