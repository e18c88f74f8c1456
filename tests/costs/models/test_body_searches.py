"""Costs of failing arms in searches and descents, against the same model in full."""

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.core.kernels import ImpactKernel
from graceful_plan.costs.models.body.body import SEARCHED, BodyModel
from graceful_plan.costs.objective import search_paces

_FINE = 0.004  # rad; edge integrals have converged at this step
_WEIGHTS = np.array([[0.035, 0.004], [0.031, 0.024], [0.053, 0.053], [0.005, 0.005]])
TASKS = [("tabletop", "lift_to_goal"), ("kitchen_counter", "unload_jar"), ("dining_table", "serve_tea")]


@pytest.fixture(scope="module", params=TASKS, ids=lambda name: name[0])
def task(request):
    scene, name = request.param
    return gp.load_scene(scene).tasks[name]


def _severity(scene):
    return np.array([[e.severity[name] for e in scene.entities.values()] for name in scene.components])


def _kernel(task, severity=None, weights=_WEIGHTS):
    severity = _severity(task.scene) if severity is None else severity
    return BodyModel().kernel(task.scene, severity, weights, search_paces())


def _edges(task, n=60, length=1.0, seed=0):
    """Edges near the path from start to goal, most of them along it."""
    rng = np.random.default_rng(seed)
    way = task.goal[0] - task.start
    first = task.start + rng.uniform(size=(n, 1)) * way + rng.normal(scale=0.15, size=(n, len(way)))
    step = 0.7 * way / np.linalg.norm(way) + rng.normal(scale=0.25, size=first.shape)
    return first, first + length * step / np.linalg.norm(step, axis=1)[:, None]


def _motion(task, seed, n=127):
    """States of a curved motion from start to goal, almost at rest at both ends."""
    rng, u = np.random.default_rng(seed), np.linspace(0.0, 1.0, n)[:, None]
    bends = [scale * rng.normal(size=len(task.start)) for scale in (0.4, 0.2)]
    q = task.start + u * (task.goal[0] - task.start) + sum(np.sin((k + 1) * np.pi * u) * b for k, b in enumerate(bends))
    q = np.clip(q, *task.scene.limits.position.T)
    qd = np.gradient(q, axis=0)
    fastest = np.abs(qd / task.scene.limits.velocity).max(axis=1)
    return q, qd * (0.7 / fastest)[:, None] * np.sin(np.pi * u) ** 0.5


def _cosine(a, b):
    return (a * b).sum() / np.linalg.norm(a) / np.linalg.norm(b)


def test_edges_in_searches_cost_nearly_as_much_as_in_full(task):
    kernel, (first, second) = _kernel(task), _edges(task)
    exact, found = kernel.edges(first, second, _FINE)[:, 1], kernel.edges(first, second, rough=True)[:, 1]
    error = (found - exact) / exact.mean()
    assert np.sqrt(np.mean(error**2)) < 1.5 * SEARCHED and abs(error.mean()) < SEARCHED
    assert np.corrcoef(exact, found)[0, 1] > 0.99
    assert (found != kernel.edges(first, second)[:, 1]).any()


def test_motions_in_descents_cost_nearly_as_much_as_in_full(task):
    kernel = _kernel(task)
    values = []
    for seed in range(12):
        q, qd = _motion(task, seed)
        values.append((kernel.moving_states(q, qd).mean(), kernel.state_slopes(q, qd, rough=True)[0].mean()))
    exact, found = np.transpose(values)
    error = (found - exact) / exact.mean()
    assert np.sqrt(np.mean(error**2)) < SEARCHED
    assert np.corrcoef(exact, found)[0, 1] > 0.99


def test_slopes_of_a_motion_push_its_control_points_the_right_way(task):
    kernel, pushed = _kernel(task), []
    hats = np.maximum(0.0, 1.0 - np.abs(np.arange(127) - np.arange(6, 121, 6)[:, None]) / 9.0)
    for seed in range(12):
        q, qd = _motion(task, seed)
        exact, found = kernel.state_slopes(q, qd)[1:], kernel.state_slopes(q, qd, rough=True)[1:]
        pushed.append([(hats @ a, hats @ b) for a, b in zip(exact, found, strict=True)])
    for by_what in np.swapaxes(pushed, 0, 1):  # by q, by velocity
        assert _cosine(by_what[:, 0], by_what[:, 1]) > 0.6  # only 32 of 127 states count, and some hits are brief


def test_few_states_are_all_evaluated(task):
    kernel, (q, qd) = _kernel(task), _motion(task, 0, n=28)
    value, d_q, d_qd = kernel.state_slopes(q, qd, rough=True)
    turned = kernel.state_slopes(q[::-1], qd[::-1], rough=True)
    for one, other in zip((value, d_q, d_qd), turned, strict=True):
        np.testing.assert_allclose(one, other[::-1], rtol=1e-3, atol=1e-4 * np.abs(one).max())
    alone = [kernel.state_slopes(q[k : k + 1], qd[k : k + 1], rough=True)[0][0] for k in range(28)]
    np.testing.assert_allclose(value, alone, rtol=1e-3, atol=1e-4 * value.max())
    for motion in (_motion(task, seed, n=28) for seed in range(1, 6)):
        assert _cosine(kernel.state_slopes(*motion, rough=True)[1], kernel.state_slopes(*motion)[1]) > 0.6


def test_units_of_severity_do_not_matter(task):
    first, second = _edges(task, 12)
    cost = _kernel(task).edges(first, second, rough=True)
    scaled = _kernel(task, 64.0 * _severity(task.scene)).edges(first, second, rough=True)
    np.testing.assert_allclose(scaled[:, 1], 64.0 * cost[:, 1], rtol=1e-9)


def test_entities_of_negligible_severity_do_not_count():
    task = gp.load_scene("tabletop").tasks["lift_to_goal"]
    severity, (first, second) = _severity(task.scene), _edges(task, 30)
    names = list(task.scene.entities)
    table = severity * (np.array(names) == "table")
    others = severity - table
    few = others + 1e-3 * table
    assert _kernel(task, 1e-3 * table).edges(first, second, rough=True)[:, 1].max() > 0.0
    without, both = (_kernel(task, one).edges(first, second, rough=True) for one in (others, few))
    np.testing.assert_array_equal(without, both)
    assert (_kernel(task, others).edges(first, second) != _kernel(task, few).edges(first, second)).any()


def test_sums_and_factors_and_times_follow_their_terms(task):
    body, (first, second) = _kernel(task), _edges(task, 10, 0.4)
    drop = gp.FailureMixture().kernel(task.scene, _severity(task.scene), search_paces())
    assert isinstance(drop, ImpactKernel)
    rough, falls = (kernel.edges(first, second, rough=True) for kernel in (body, drop))
    np.testing.assert_array_equal(falls, drop.edges(first, second))  # only expensive terms are approximated
    np.testing.assert_allclose((body + drop).edges(first, second, rough=True)[:, 1], rough[:, 1] + falls[:, 1])
    np.testing.assert_allclose(body.scaled(3.0).edges(first, second, rough=True)[:, 1], 3.0 * rough[:, 1])
    speed = 0.5 * task.scene.limits.velocity
    seconds = (np.abs(second - first) / speed).max(axis=1)
    timed = body.timed(speed).edges(first, second, rough=True)
    np.testing.assert_allclose(timed[:, 1], rough[:, 1] * seconds / rough[:, 0])


def test_an_edge_without_length(task):
    q = task.start[None]
    np.testing.assert_array_equal(_kernel(task).edges(q, q, rough=True), np.zeros((1, 2)))
