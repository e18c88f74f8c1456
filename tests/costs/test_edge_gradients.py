"""Derivatives of the costs of edges against finite differences of the costs themselves."""

import numpy as np
import pytest

import graceful_plan as gp

STEP = 1e-7


def random_edges(scene, n, seed=0):
    rng = np.random.default_rng(seed)
    lower, upper = scene.limits.position.T
    q0 = rng.uniform(lower, upper, (n, len(lower)))
    return q0, np.clip(q0 + 0.2 * rng.normal(size=q0.shape), lower, upper)


def walker():
    place = [[0.6, -0.5, 0.9], [0.6, 0.5, 0.9]]
    return gp.MovingEntity("walker", "adult", size=[0.3, 0.3, 0.9], t=[0.0, 4.0], position=place, spread=0.05)


def check(objective, q0, q1, step):
    cost, d_q0, d_q1 = objective.edge_gradients(q0, q1, step)
    kernel = objective.kernel
    np.testing.assert_allclose(cost, kernel.edges(q0, q1, step), rtol=1e-12, atol=1e-14)
    for j, unit in enumerate(STEP * np.eye(q0.shape[1])):
        for given, before, after in (
            (d_q0, kernel.edges(q0 - unit, q1, step), kernel.edges(q0 + unit, q1, step)),
            (d_q1, kernel.edges(q0, q1 - unit, step), kernel.edges(q0, q1 + unit, step)),
        ):
            slope = (after - before) @ [1.0, objective.w] / (2.0 * STEP)
            error = np.abs(slope - given[:, j]) / np.maximum(1.0, np.abs(given).max(axis=1))
            assert np.sort(error)[-2] < 1e-5  # one edge may be at a kink
            assert np.median(error) < 1e-7


@pytest.mark.parametrize(
    ("scene", "task"), [("tabletop", "lift_to_goal"), ("desk", "bring_coffee"), ("dining_table", "serve_tea")]
)
@pytest.mark.parametrize("step", [0.015, 0.05])
def test_gradients_equal_those_of_the_costs(scene, task, step):
    scene = gp.load_scene(scene).tasks[task].scene
    check(gp.Objective(w=1.3).bind(scene), *random_edges(scene, 60), step)


def test_arms_that_fail_have_gradients_that_descend():
    scene = gp.load_scene("tabletop").tasks["lift_to_goal"].scene
    q0, q1 = random_edges(scene, 24, seed=4)
    objective = gp.Objective(impact=gp.ImpactCost(gp.FailureMixture(faults="arm"))).bind(scene)
    cost, d_q0, d_q1 = objective.edge_gradients(q0, q1, 0.03)
    kernel, step = objective.kernel, 1e-3  # single precision
    np.testing.assert_allclose(cost, kernel.edges(q0, q1, 0.03), rtol=1e-5, atol=1e-6)
    for given, moved in (
        (d_q0, lambda unit: kernel.edges(q0 + unit, q1, 0.03)),
        (d_q1, lambda unit: kernel.edges(q0, q1 + unit, 0.03)),
    ):
        units = step * np.eye(q0.shape[1])
        slope = np.stack([(moved(u) - moved(-u)) @ [1.0, objective.w] / (2.0 * step) for u in units], axis=1)
        cosine = (given * slope).sum(axis=1) / np.linalg.norm(given, axis=1) / np.linalg.norm(slope, axis=1)
        assert np.quantile(cosine, 0.1) > 0.9 and np.median(cosine) > 0.98


def test_moving_entities_contribute():
    still = gp.load_scene("tabletop").tasks["lift_to_goal"].scene
    scene = still.with_moving(walker())
    q0, q1 = random_edges(scene, 40)
    objective = gp.Objective().bind(scene)
    assert (objective.edges(q0, q1)[:, 1] > gp.Objective().bind(still).edges(q0, q1)[:, 1]).any()
    check(objective, q0, q1, 0.015)


def test_without_derivatives_there_is_nothing():
    scene = gp.load_scene("tabletop").tasks["lift_to_goal"].scene
    q0, q1 = random_edges(scene, 3)
    assert gp.Objective(impact=gp.ImpactCost("box_overlap")).bind(scene).edge_gradients(q0, q1) is None
    assert (
        gp.Objective(impact=gp.ImpactCost("box_overlap"), exposure="waypoints").bind(scene).edge_gradients(q0, q1)
        is None
    )


def test_an_edge_without_length_has_no_slope():
    scene = gp.load_scene("tabletop").tasks["lift_to_goal"].scene
    q0, _ = random_edges(scene, 3)
    cost, d_q0, d_q1 = gp.Objective().bind(scene).edge_gradients(q0, q0)
    assert not cost.any() and not d_q0.any() and not d_q1.any()
