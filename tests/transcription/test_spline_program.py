"""The nonlinear program of a motion: exact cubics, and exact derivatives of every term."""

from __future__ import annotations

import numpy as np
import pytest
from wrapped import Wrapped

import graceful_plan as gp
from graceful_plan.planners.optimisers.nlp import Pattern
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.transcription.motion_charges import ImpactCharge, acceleration_charge, effort_charge, length_charge
from graceful_plan.transcription.motion_rows import (
    acceleration_rows,
    clearance_rows,
    continuity_rows,
    jerk_rows,
    position_rows,
    samples_at,
    torque_rows,
    velocity_rows,
)
from graceful_plan.transcription.spline_program import (
    Charge,
    Integral,
    Samples,
    SplineCost,
    SplineLayout,
    SplineProgram,
    SplineRows,
)
from graceful_plan.transcription.symbolic import symbolic_robot

Array = np.ndarray

_TOLERANCE = 1e-5
_STEP = 1e-6
_PIECES = 3


@pytest.fixture(scope="module")
def scene() -> Scene:
    return gp.load_scene("tabletop_l1").tasks["green_to_blue"].scene


def _program(layout: SplineLayout, integrals=(), linear=(), sampled=()) -> SplineProgram:
    bound = np.full(layout.size, np.inf)
    return SplineProgram(layout, (-bound, bound), SplineCost(1.3, integrals), SplineRows(linear, sampled))


def _point(layout: SplineLayout, scene: Scene, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    q = np.asarray(scene.tasks["green_to_blue"].start) + 0.2 * rng.normal(size=(layout.pieces + 1, layout.nq))
    return layout.pack(q, 0.1 * rng.normal(size=q.shape), 1.1 * layout.time)


def _dense(pattern: Pattern, values: Array, shape: tuple[int, int]) -> Array:
    matrix = np.zeros(shape)
    np.add.at(matrix, (pattern.row, pattern.column), values)
    return matrix


def _jacobian(program: SplineProgram, x: Array) -> Array:
    return _dense(program.jacobian_pattern, program.evaluate(x).jacobian, (len(program.least), len(x)))


def _check_slopes(program: SplineProgram, x: Array, tolerance: float = _TOLERANCE) -> None:
    values, jacobian = program.evaluate(x), _jacobian(program, x)
    scale_cost = max(1.0, float(np.abs(values.gradient).max()))
    scale_rows = max(1.0, float(np.abs(jacobian).max(initial=0.0)))
    for k in range(len(x)):
        step = _STEP * np.eye(len(x))[k]
        up, down = program.evaluate(x + step), program.evaluate(x - step)
        assert values.gradient[k] == pytest.approx((up.cost - down.cost) / (2 * _STEP), abs=tolerance * scale_cost)
        expected = (up.constraints - down.constraints) / (2 * _STEP)
        np.testing.assert_allclose(jacobian[:, k], expected, atol=tolerance * scale_rows)


def _check_curvature(program: SplineProgram, x: Array, multipliers: Array) -> None:
    assert program.hessian_pattern is not None
    upper = _dense(program.hessian_pattern, program.hessian(x, 0.7, multipliers), (len(x), len(x)))
    assert not np.tril(upper, -1).any()
    found = upper + np.triu(upper, 1).T

    def slope(x: Array) -> Array:
        return 0.7 * program.evaluate(x).gradient + multipliers @ _jacobian(program, x)

    steps = _STEP * np.eye(len(x))
    expected = np.stack([(slope(x + step) - slope(x - step)) / (2 * _STEP) for step in steps])
    np.testing.assert_allclose(found, expected, atol=_TOLERANCE * np.abs(expected).max())


@pytest.mark.parametrize("u", [0.0, 0.3, 0.5, 1.0])
def test_samples_lie_on_the_trajectory(scene: Scene, u: float) -> None:
    layout = SplineLayout(_PIECES, 7, 0.08)
    x = _point(layout, scene, 0)
    (q, w), h = layout.nodes(x), layout.h(x)
    trajectory = Trajectory(h * np.arange(_PIECES + 1), q, w / h, np.zeros_like(q), scene.joints)
    states = samples_at(layout, np.array([u])).states(x)
    inside = trajectory.at(h * (np.arange(_PIECES) + np.clip(u, 1e-9, 1 - 1e-9)))
    for found, expected in zip(states, inside, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_linear_rows_are_derivatives_over_limits(scene: Scene) -> None:
    layout, limit = SplineLayout(_PIECES, 7, 0.08), np.linspace(1.0, 3.0, 7)
    x = _point(layout, scene, 1)
    rows = [
        position_rows(layout, *scene.limits.position.T),
        velocity_rows(layout, limit),
        acceleration_rows(layout, limit),
        jerk_rows(layout, limit),
        continuity_rows(layout, limit),
    ]
    parts = [_program(layout, linear=[part]).evaluate(x).constraints for part in rows]
    ends, middle = samples_at(layout, np.array([0.0, 1.0])).states(x), samples_at(layout, np.array([0.5])).states(x)
    half = samples_at(layout, np.array([0.0, 0.5])).states(x)
    np.testing.assert_allclose(parts[0], middle[0].ravel())
    np.testing.assert_allclose(parts[1], (half[1] / limit).ravel())
    np.testing.assert_allclose(parts[2], (ends[2] / limit).ravel())
    a0, a1 = ends[2].reshape(_PIECES, 2, 7).transpose(1, 0, 2)
    np.testing.assert_allclose(parts[3], ((a1 - a0) / layout.h(x) / limit).ravel())
    jumps = np.concatenate([-a0[:1], a1[:-1] - a0[1:], a1[-1:]]) / limit
    np.testing.assert_allclose(parts[4], jumps.ravel(), atol=1e-9)


def test_slopes_and_curvature_of_limits(scene: Scene) -> None:
    layout, limit = SplineLayout(_PIECES, 7, 0.08), np.linspace(1.0, 3.0, 7)
    linear = [
        position_rows(layout, *scene.limits.position.T),
        velocity_rows(layout, limit),
        acceleration_rows(layout, limit),
        jerk_rows(layout, limit),
        continuity_rows(layout, limit),
    ]
    program, x = _program(layout, linear=linear), _point(layout, scene, 2)
    _check_slopes(program, x, 1e-7)
    _check_curvature(program, x, np.random.default_rng(0).normal(size=len(program.least)))


def test_slopes_of_torque_and_clearance(scene: Scene) -> None:
    layout = SplineLayout(2, 7, 0.08)
    kernels = gp.Objective().bind(scene).kernels
    near = samples_at(layout, np.array([0.0, 0.5]), first=False)
    torque = torque_rows(samples_at(layout, np.array([0.0, 1.0])), symbolic_robot(scene), scene.limits.torque)
    _check_slopes(_program(layout, sampled=[torque]), _point(layout, scene, 3))
    program = _program(layout, sampled=[clearance_rows(near, kernels, np.zeros(len(near)))])
    x = _point(layout, scene, 4)
    # Positions are in single precision, so the step is large; the nearest pair stays the same along it.
    jacobian, step = _jacobian(program, x), 1e-3
    for k in range(0, len(x), 3):
        move = step * np.eye(len(x))[k]
        expected = (program.evaluate(x + move).constraints - program.evaluate(x - move).constraints) / (2 * step)
        np.testing.assert_allclose(jacobian[:, k], expected, atol=0.05)


@pytest.mark.parametrize("name", ["impact", "effort", "acceleration", "length"])
def test_gradients_of_costs_in_the_program(scene: Scene, name: str) -> None:
    layout, limits = SplineLayout(2, 7, 0.08), scene.limits
    charge = {
        "impact": ImpactCharge(gp.ImpactCost(), scene, 2.0),
        "effort": effort_charge(symbolic_robot(scene), np.asarray(limits.torque)),
        "acceleration": acceleration_charge(np.asarray(limits.acceleration)),
        "length": length_charge,
    }[name]
    samples = samples_at(layout, np.array([0.0, 0.5, 1.0]))
    program = _program(layout, [Integral(samples, np.linspace(0.5, 1.0, len(samples)), charge)])
    x = _point(layout, scene, 5)
    _check_slopes(program, x)
    if name in ("acceleration", "length"):
        _check_curvature(program, x, np.zeros(0))


def test_impact_without_derivatives_is_differenced(scene: Scene) -> None:
    """A wrapper hides the gradient of its model, so differences are used."""
    layout = SplineLayout(2, 7, 0.08)
    states = samples_at(layout, np.array([0.0, 0.5])).states(_point(layout, scene, 6))
    exact, differenced = (
        ImpactCharge(cost, scene, 1.0)(states, False) for cost in (gp.ImpactCost(), gp.ImpactCost(Wrapped()))
    )
    np.testing.assert_allclose(differenced.value, exact.value)
    np.testing.assert_allclose(differenced.slope, exact.slope, atol=1e-5 * np.abs(exact.slope).max())


def test_curvature_of_impact_is_convex(scene: Scene) -> None:
    layout = SplineLayout(4, 7, 0.08)
    states = samples_at(layout, np.array([0.0, 0.5])).states(_point(layout, scene, 7))
    values = np.linalg.eigvalsh(ImpactCharge(gp.ImpactCost(), scene, 1.0)(states, True).curvature)
    assert values.max() > 0.0
    assert values.min() >= -1e-9 * values.max()


def test_curvature_of_a_general_charge() -> None:
    """A function of positions, velocities and accelerations together, with all its mixed derivatives."""
    nq, rng = 2, np.random.default_rng(8)
    A = rng.normal(size=(3 * nq, 3 * nq))
    A = A @ A.T

    def charge(states: Array, curved: bool) -> Charge:
        z = np.concatenate(list(states), axis=1)
        value = np.exp(0.1 * np.einsum("ni,ij,nj->n", z, A, z) / np.trace(A))
        first = 0.2 * (z @ A) / np.trace(A)
        second = first[:, :, None] * first[:, None, :] + 0.2 * A / np.trace(A)
        return Charge(value, (value[:, None] * first).reshape(len(z), 3, nq), value[:, None, None] * second)

    layout = SplineLayout(3, nq, 0.4)
    samples = Samples(layout, np.array([0, 1, 1, 2]), np.array([0.0, 0.2, 0.7, 1.0]))
    program = _program(layout, [Integral(samples, np.array([1.0, 2.0, 0.5, 1.5]), charge)])
    x = layout.pack(0.3 * rng.normal(size=(4, nq)), 0.3 * rng.normal(size=(4, nq)), 0.5)
    _check_slopes(program, x, 1e-7)
    _check_curvature(program, x, np.zeros(0))
