"""Quick checks of configurations agree with the exact judge and `plan`."""

from __future__ import annotations

import dataclasses
import inspect
import re

import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.judge.exact import Judge
from sizes import first_quick

_TASKS = {
    "tabletop": "lift_to_goal",
    "tabletop_l1": "green_to_blue",
    "tabletop_l3": "corner_to_blue",
    "desk": "water_plant",
    "dining_table": "serve_tea",
    "kitchen_counter": "move_oil",
}


def _held_otherwise(task: gp.Task, rng: np.random.Generator) -> gp.Scene:
    """Attach the task's object turned and shifted at random, so it may intersect the arm."""
    assert task.object_name is not None and task.scene.carried is not None
    X_TO = task.scene.carried.X_TO.copy()
    angle = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    X_TO[:3, :3] = turn @ X_TO[:3, :3]
    X_TO[:3, 3] += rng.uniform([-0.03, -0.03, -0.11], [0.03, 0.03, 0.03])
    return task.world.attach(task.object_name, X_TO=X_TO, support=task.support)


@pytest.mark.parametrize("name", first_quick(_TASKS))
def test_positive_clearance_is_free_by_exact_geometry(name: str) -> None:
    task, rng = gp.load_scene(name).tasks[_TASKS[name]], np.random.default_rng(0)
    clear = []
    for scene in (task.scene, *(_held_otherwise(task, rng) for _ in range(12))):
        q = rng.uniform(*scene.limits.position.T, size=(400, len(scene.joints)))
        q = q[gp.clearance(q, scene) > 0.0][:40]
        assert not list(Judge(scene).touches(q))
        clear.append(len(q))
    assert clear[0] == 40 and sum(clear) >= 120


def test_an_object_held_inside_the_last_link_is_a_collision_for_both() -> None:
    """Both are fixed to the same link, so their distance is constant."""
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    X_TO = task.scene.carried.X_TO.copy()
    X_TO[2, 3] -= 0.1
    scene = task.world.attach(task.object_name, X_TO=X_TO)
    q = np.random.default_rng(0).uniform(*scene.limits.position.T, size=(50, 7))
    assert (gp.clearance(q, scene) < 0.0).all()
    result = gp.plan(task.start, task.goal, scene, w=0.0, iterations=10)
    assert result.status is gp.PlanStatus.INVALID_START and "panda/link7" in result.detail


def test_an_object_held_close_to_the_last_link_is_free_for_both() -> None:
    """The object's covering spheres overlap those of the link; the geoms never touch."""
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    X_TO = task.scene.carried.X_TO.copy()
    X_TO[2, 3] -= 0.056
    scene = task.world.attach(task.object_name, X_TO=X_TO)
    assert gp.clearance(task.start, scene) == gp.clearance(task.start, task.scene) > 0.0
    assert gp.plan(task.start, task.start, scene, w=0.0, iterations=10).status is gp.PlanStatus.SOLVED


@pytest.mark.parametrize(("gap", "free"), [(0.001, True), (-0.001, False)])
def test_an_obstacle_beside_the_base_blocks_all_or_nothing(gap: float, free: bool) -> None:
    text = f"""<mujoco><compiler angle="radian" autolimits="true"/>
    <custom><numeric name="r/velocity_limit" data="1"/><numeric name="r/acceleration_limit" data="1"/></custom>
    <worldbody>
      <body name="r/foot"><geom type="box" size=".1 .1 .1"/>
        <body name="r/a" pos="0 0 .3"><joint name="j" range="-1 1"/><geom size=".1"/><site name="t"/></body></body>
      <body name="box" pos="{0.2 + gap} 0 0"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
    </worldbody></mujoco>"""
    scene = gp.Scene.from_mjcf(text, robot="r/", tool="t")
    assert (gp.clearance([0.0], scene) > 0.0) == free
    status = gp.plan([-0.5], [0.5], scene, iterations=10).status
    assert status is (gp.PlanStatus.SOLVED if free else gp.PlanStatus.INVALID_START)


def test_the_default_interaction_model_is_the_documented_one():
    stated = re.search(
        r'by default "(\w+)"[^"]*of\s+`ImpactCost` is\s+"(\w+)"', str(gp.interaction_probability.__doc__)
    )
    default = inspect.signature(gp.interaction_probability).parameters["model"].default
    (costs,) = (field.default for field in dataclasses.fields(gp.ImpactCost) if field.name == "model")
    assert stated is not None and stated.groups() == (default, costs)
    task = gp.load_scene("tabletop_l1").tasks["green_to_blue"]
    q = np.linspace(task.start, task.goal[0], 20)
    P = gp.interaction_probability(q, task.scene)
    np.testing.assert_array_equal(P, gp.interaction_probability(q, task.scene, default))
    assert not np.array_equal(P, gp.interaction_probability(q, task.scene, costs))
