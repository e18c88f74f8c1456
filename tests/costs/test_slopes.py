"""Derivatives of custom costs against differences, at states and along edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.costs.objective import Objective, search_paces
from graceful_plan.costs.slopes import CostSlopes
from graceful_plan.exceptions import CostError
from support.costs.own_costs import Bowl, Crosswise, Haste, Height

Array = np.ndarray
STEP = 1e-6
_TOLERANCE = 5e-3  # error of forward differences with steps of 1e-3, at worst in single precision


@pytest.fixture(scope="module")
def scene() -> gp.Scene:
    return gp.load_scene("tabletop").tasks["green_to_blue"].scene


def states(scene: gp.Scene, n: int, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    lower, upper = scene.limits.position.T
    q = rng.uniform(lower, upper, (n, len(lower)))
    return q, rng.normal(size=q.shape)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.sampled_from([0, 1, 5]))
@pytest.mark.parametrize("cost", [Bowl(), Bowl(told=False), Height(), Haste()], ids=repr)
def test_slopes_of_states_equal_differences(cost: gp.Cost, n: int, seed: int, scene: gp.Scene) -> None:
    slopes = CostSlopes(cost, scene)
    q, qd = states(scene, n, seed)
    value, d_q, d_qd = slopes(q, qd)
    np.testing.assert_allclose(value, slopes.states(q, qd))
    for given_, moved in ((d_q, lambda e: slopes.states(q + e, qd)), (d_qd, lambda e: slopes.states(q, qd + e))):
        differences = np.stack([(moved(e) - moved(-e)) / (2.0 * STEP) for e in STEP * np.eye(q.shape[1])], axis=1)
        np.testing.assert_allclose(
            given_, differences, atol=_TOLERANCE * max(1.0, np.abs(differences).max(initial=0.0))
        )


def test_slopes_know_whether_a_cost_has_gradients_and_uses_velocities(scene: gp.Scene) -> None:
    assert CostSlopes(Bowl(), scene).has_gradient and not CostSlopes(Bowl(told=False), scene).has_gradient
    assert CostSlopes(Haste(), scene).uses_velocity and not CostSlopes(Height(), scene).uses_velocity


def test_differences_are_one_batch(scene: gp.Scene) -> None:
    sizes: list[int] = []

    @dataclass(frozen=True)
    class Counted(gp.Cost):
        def state(self, batch: gp.StateBatch) -> Array:
            sizes.append(len(batch))
            return np.ones(len(batch))

    slopes = CostSlopes(Counted(), scene)
    q, qd = states(scene, 11, 0)
    assert not slopes.uses_velocity and not slopes.has_gradient
    sizes.clear()
    slopes(q, qd)
    assert sizes == [11 * 8]


@pytest.mark.parametrize(
    ("answer", "message"),
    [(lambda q: q[:, :3], "gradient.. returned shape"), (lambda q: q * np.nan, "returned a NaN")],
)
def test_broken_gradients_are_named(answer, message: str, scene: gp.Scene) -> None:
    @dataclass(frozen=True)
    class Broken(gp.Cost):
        def state(self, batch: gp.StateBatch) -> Array:
            return np.ones(len(batch))

        def gradient(self, batch: gp.StateBatch) -> Array:
            return answer(batch.q)

    with pytest.raises(CostError, match=message):
        CostSlopes(Broken(), scene)(*states(scene, 4, 0))


def test_only_the_direction_of_a_tangent_counts(scene: gp.Scene) -> None:
    """Perpendicular to the tangent, with the slowest joint's speed fixed, the gradient equals differences."""
    bound = Objective(motion=Haste(), w=0.7).bind(scene, search_paces())
    q, tangent = states(scene, 6, 5)
    value, _, d_tangent = bound.tangent_slopes(q, tangent)
    np.testing.assert_allclose(bound.tangent_slopes(q, 3.0 * tangent)[0], value)
    np.testing.assert_allclose(np.sum(d_tangent * tangent, axis=1), 0.0, atol=1e-9 * np.abs(d_tangent).max())
    slowest = np.argmax(np.abs(tangent) / scene.limits.velocity, axis=1)
    across = np.random.default_rng(1).normal(size=q.shape)
    kept = np.where(np.arange(q.shape[1]) == slowest[:, None], 0.0, tangent)
    across[np.arange(len(q)), slowest] = 0.0
    across -= np.sum(across * kept, axis=1, keepdims=True) / np.sum(kept**2, axis=1, keepdims=True) * kept
    after, before = (bound.tangent_slopes(q, tangent + way * STEP * across)[0] for way in (1.0, -1.0))
    differences = (after - before) / (2.0 * STEP)
    atol = _TOLERANCE * max(1.0, np.abs(differences).max())
    np.testing.assert_allclose(np.sum(d_tangent * across, axis=1), differences, atol=atol)


@pytest.mark.parametrize("exposure", ["time", "length", "waypoints"])
@pytest.mark.parametrize("motion", [gp.JointLength(), gp.JointLength((1.0, 2.0, 1.0, 1.0, 1.0, 0.5, 1.0)), Crosswise()])
@pytest.mark.parametrize("impact", [Bowl(), Bowl(told=False), Haste()], ids=repr)
def test_slopes_of_edges_equal_differences(impact: gp.Cost, motion: gp.Cost, exposure: str, scene: gp.Scene) -> None:
    bound = Objective(motion=motion, impact=impact, w=0.7, exposure=exposure).bind(scene, search_paces())
    q0, direction = states(scene, 8, 3)
    q1 = q0 + 0.2 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    q1[0] = q0[0]
    cost, d_q0, d_q1 = bound.impact_gradients(q0, q1)
    np.testing.assert_allclose(cost, bound.edges(q0, q1), atol=1e-12)
    whole = bound.edge_gradients(q0, q1)
    told = impact.gradient(gp.StateBatch(scene, q0)) is not None and not isinstance(motion, Crosswise)
    assert (whole is not None) == told
    for j, e in enumerate(STEP * np.eye(q0.shape[1])):
        for end, moves in ((0, (-e, e)), (1, (-e, e))):
            before, after = (bound.edges(q0 + (m if end == 0 else 0), q1 + (m if end == 1 else 0)) for m in moves)
            differences = (after - before)[1:] / (2.0 * STEP)
            np.testing.assert_allclose((d_q0, d_q1)[end][1:, j], differences[:, 1], atol=_TOLERANCE, rtol=_TOLERANCE)
            if whole is not None:
                total = differences @ [1.0, bound.w]
                np.testing.assert_allclose(whole[1 + end][1:, j], total, atol=_TOLERANCE, rtol=_TOLERANCE)
    assert not d_q0[0].any() or exposure == "waypoints"
