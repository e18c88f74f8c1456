"""Constraints in a scene: core and Python agree, projections converge, misuse raises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.array_types import Float
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import LEVER, Kernels
from graceful_plan.exceptions import CostError, SettingError, UnknownNameError
from graceful_plan.planners.scene_problem import edges_hold
from graceful_plan.scene.rules.rules import CustomRule

Array = np.ndarray
TURNED = np.array([(0.0, -1.0, 0.0, 0.45), (1.0, 0.0, 0.0, 0.1), (0.0, 0.0, 1.0, 0.2), (0.0, 0.0, 0.0, 1.0)])


@dataclass(frozen=True)
class BehindPlane(gp.Constraint):
    """The tool stays behind a plane: a custom constraint."""

    x: float
    sloped: bool = True

    def residual(self, batch: gp.StateBatch) -> Float[Array, " n"]:
        return batch.tool_poses[:, 0, 3] - self.x

    def gradient(self, batch: gp.StateBatch) -> Float[Array, "n nq"] | None:
        if not self.sloped:
            return None
        step = 1e-6
        nq = batch.q.shape[1]
        rows = [
            (self.residual(gp.StateBatch(batch.scene, batch.q + step * e)) - self.residual(batch)) / step
            for e in np.eye(nq)
        ]
        return np.stack(rows, axis=1)


def constraints_of(task: gp.Task) -> list[gp.Constraint]:
    entity = next(iter(task.scene.entities))
    return [
        gp.Upright(0.3),
        gp.AxisWithin((0.0, 1.0, 0.2), (1.0, 0.0, 1.0), 1.2, frame="tool"),
        gp.ToolWithin((0.2, -0.4, 0.1), (0.7, 0.4, 0.9)),
        gp.ToolWithin((-0.4, -0.3, -0.1), (0.4, 0.3, 0.8), frame=TURNED),
        gp.KeepDistance(entity, 0.08),
    ]


def samples(scene: gp.Scene, n: int, seed: int = 0) -> Float[Array, "n nq"]:
    lower, upper = scene.limits.position.T
    return np.random.default_rng(seed).uniform(lower, upper, (n, len(lower)))


@pytest.mark.parametrize("index", range(5))
def test_core_and_python_agree(task: gp.Task, index: int) -> None:
    """The clearance is the least of collisions and of the constraint; angles are scaled by a lever."""
    scene, constraint = task.scene, constraints_of(task)[index]
    q = samples(scene, 3000)
    held = SceneConstraints(scene, [constraint])
    own = -constraint.lever * constraint.residual(gp.StateBatch(scene, q))
    expected = np.minimum(compile_scene(scene).kernels.clearance(q), own)
    np.testing.assert_allclose(held.kernels.clearance(q), expected, atol=2e-6)
    for margin in (0.0, 0.01):
        clear = np.abs(expected - margin) > 1e-5
        np.testing.assert_array_equal(held.kernels.free(q, margin)[clear], (expected > margin)[clear])
    assert 0 < (own > 0.0).sum() < len(q)


@pytest.mark.parametrize("index", range(5))
def test_gradients_are_those_of_differences(task: gp.Task, index: int) -> None:
    kernels: Kernels = SceneConstraints(task.scene, [constraints_of(task)[index]]).kernels
    q = samples(task.scene, 40, seed=3)
    step = 1e-3
    by = [
        (kernels.clearance(q + step * e) - kernels.clearance(q - step * e)) / (2.0 * step) for e in np.eye(q.shape[1])
    ]
    error = np.abs(kernels.clearance_gradient(q)[1] - np.stack(by, axis=1))
    assert np.quantile(error, 0.9) < 1e-3 and np.median(error) < 1e-4  # kinks, and single precision


def test_an_edge_is_free_where_its_configurations_are(task: gp.Task) -> None:
    held = SceneConstraints(task.scene, [gp.Upright(0.5)])
    rng = np.random.default_rng(2)
    first = samples(task.scene, 20000, seed=5)
    first = first[held.kernels.free(first, 0.002)][:60]
    second = np.clip(first + 0.3 * rng.normal(size=first.shape), *task.scene.limits.position.T)
    free = held.kernels.edges_free(first, second, 0.01, 0.0)
    along = np.linspace(0.0, 1.0, 200)[:, None, None]
    dense = held.kernels.free(first + along * (second - first)).all(axis=0)
    assert 0 < free.sum() < len(free)
    assert not np.any(dense & ~free) and np.mean(free == dense) > 0.95


def test_projections_arrive_and_move_nothing_that_holds(task: gp.Task) -> None:
    scene = task.scene
    held = SceneConstraints(scene, [gp.Upright(0.2), gp.ToolWithin((0.2, -0.5, 0.1), (0.8, 0.5, 1.0))])
    q = samples(scene, 400, seed=8)
    projected = held.kernels.projected(q)
    batch = gp.StateBatch(scene, projected)
    inside = np.min([-c.lever * c.residual(batch) for c in held.constraints if isinstance(c, gp.Constraint)], axis=0)
    assert np.mean(inside >= 0.003 - 1e-6) > 0.6  # some reach joint limits
    arrived = projected[inside >= 0.0031]
    np.testing.assert_array_equal(held.kernels.projected(arrived), arrived)
    np.testing.assert_array_equal(SceneConstraints(scene, ()).kernels.projected(q), q)
    lower, upper = scene.limits.position.T
    assert np.all((projected >= lower) & (projected <= upper))


@pytest.mark.parametrize("sloped", [True, False])
def test_custom_constraints_hold_along_edges_and_have_clearances(task: gp.Task, sloped: bool) -> None:
    scene = task.scene
    held = SceneConstraints(scene, [BehindPlane(0.5, sloped)])
    assert held.custom and isinstance(held.constraints[0].rule(scene), CustomRule)
    q = samples(scene, 50)
    clearance, gradient = held.custom_clearance(q)
    np.testing.assert_allclose(clearance, 0.5 - compile_scene(scene).kernels.tool_pose(q)[:, 0, 3], atol=1e-12)
    step = 1e-5
    moved = q + step * np.arange(q.shape[1])
    np.testing.assert_allclose(
        held.custom_clearance(moved)[0] - clearance, step * gradient @ np.arange(q.shape[1]), atol=1e-8
    )
    holds = edges_hold(held, q[:-1], q[1:], 0.05, 0.0)
    along = np.linspace(0.0, 1.0, 400)[:, None, None]
    dense = (q[:-1] + along * (q[1:] - q[:-1])).reshape(-1, q.shape[1])
    expected = held.custom_holds(dense, 0.0).reshape(400, -1).all(axis=0)
    assert np.mean(holds == expected) > 0.95 and 0 < holds.sum() < len(holds)
    assert edges_hold(held, q[:0], q[:0], 0.05, 0.0).shape == (0,)


def test_broken_custom_constraints_are_refused(task: gp.Task) -> None:
    class Wrong(gp.Constraint):
        def residual(self, batch: gp.StateBatch) -> Float[Array, " n"]:
            return np.full(len(batch), np.nan)

    class Flat(gp.Constraint):
        def residual(self, batch: gp.StateBatch) -> Float[Array, " n"]:
            return np.zeros(len(batch) + 1)

    for constraint, word in ((Wrong(), "nan"), (Flat(), "shape")):
        with pytest.raises(CostError, match=word):
            SceneConstraints(task.scene, [constraint]).objections(task.start)


def test_misuse_names_the_culprit(task: gp.Task, scene: gp.Scene) -> None:
    with pytest.raises(UnknownNameError, match="mug_of_nobody"):
        SceneConstraints(task.scene, [gp.KeepDistance("mug_of_nobody", 0.1)])
    with pytest.raises(UnknownNameError, match="mug_of_nobody"):
        SceneConstraints(task.scene, [gp.ToolSpeed(0.2, near="mug_of_nobody")])
    with pytest.raises(SettingError, match="vessel"):
        SceneConstraints(task.scene, [gp.KeepContents()])
    with pytest.raises(SettingError, match="frame"):
        SceneConstraints(scene, [gp.AxisWithin((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.1, frame="object")])
    for make in (
        lambda: gp.Upright(0.0),
        lambda: gp.Upright(np.nan),
        lambda: gp.AxisWithin((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.1),
        lambda: gp.AxisWithin((0.0, 0.0, np.inf), (0.0, 0.0, 1.0), 0.1),
        lambda: gp.ToolWithin((0.0, 0.0, 0.0), (1.0, 1.0, 0.0)),
        lambda: gp.ToolWithin((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), frame=np.zeros((4, 4))),
        lambda: gp.KeepDistance("mug", -1.0),
        lambda: gp.ToolSpeed(np.nan),
        lambda: gp.KeepContents(share=0.0),
    ):
        with pytest.raises(gp.GracefulPlanError):
            make()


def test_contents_and_grasp_are_kept_by_default(task: gp.Task) -> None:
    assert default_constraints(task.scene) == (gp.GraspHolds(),)
    coffee = gp.load_scene("desk").tasks["bring_coffee"].scene
    assert default_constraints(coffee) == (gp.KeepContents(), gp.GraspHolds())


def test_the_lever_is_one_for_all() -> None:
    assert (
        gp.Upright().lever
        == gp.AxisWithin((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 0.1).lever
        == gp.KeepContents().lever
        == LEVER
    )


def test_projections_leave_slides_alone_that_turn_nothing() -> None:
    text = """<mujoco><compiler angle="radian" autolimits="true"/><custom>
      <numeric name="r/velocity_limit" data="1 1 1"/><numeric name="r/acceleration_limit" data="1 1 1"/></custom>
    <worldbody><body name="r/a" pos="0 0 1"><joint name="r/x" axis="1 0 0" range="-1 1"/><geom size=".02"/>
      <body name="r/b" pos="0 0 .2"><joint name="r/slide" type="slide" axis="1 1 0" range="-1 1"/><geom size=".02"/>
        <body name="r/c" pos="0 0 .2"><joint name="r/y" axis="0 1 0" range="-1 1"/><geom size=".02"/>
          <site name="r/tool" pos="0 0 .1" quat="0 1 0 0"/></body></body></body></worldbody></mujoco>"""
    scene = gp.Scene.from_mjcf(text, robot="r/", tool="r/tool")
    held = SceneConstraints(scene, [gp.Upright(0.2)])
    q = samples(scene, 200, seed=3)
    projected = held.kernels.projected(q)
    moved = np.abs(projected - q).max(axis=1) > 1e-6
    assert moved.sum() > 50
    np.testing.assert_array_equal(projected[:, 1], q[:, 1])
    assert held.holds(projected[moved]).mean() > 0.95
