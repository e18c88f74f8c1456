"""The scenes in benchmarks/unseen are sound and share no object with the bundled scenes."""

import mujoco
import numpy as np
import pytest

import failbench
import graceful_plan as gp
from benchmarks import suite, variants
from sizes import first_quick

SCENES = suite.unseen_scenes()
TASKS = suite.unseen_task_names()
_ROOM = 0.02
"""Clearance at the ends of tasks [m]."""
_STILL = 0.003
"""Distance that objects at rest may creep in one second [m]."""
_OBSTACLES = {
    "bathroom": {"pedestal", "wall", "tap"},
    "bedside": {"pedestal"},
    "breakfast_bar": {"pedestal", "stool"},
    "lab_bench": {"gantry"},
    "pantry": {"pedestal", "wall", "cupboard"},
    "play_table": set(),
    "reading_corner": {"pedestal", "bookcase"},
    "studio": {"pedestal", "wall"},
    "workbench": {"pedestal", "wall", "rack"},
    "buffet": {"pedestal"},
    "stove": {"pedestal", "shelf"},
}
"""Bodies that collide but are not entities, so hits of them do not count."""


def test_there_are_enough_of_them():
    assert len(SCENES) >= 5 and len(TASKS) >= 12
    assert not set(SCENES) & set(gp.scenes())
    assert {suite.is_tabletop(name) for name in TASKS} == {True, False}


def test_quick_runs_take_one_task_per_scene():
    quick = suite.unseen_task_names(suite.Options(quick=True))
    assert [name.split("/")[0] for name in quick] == list(SCENES)
    assert suite.chosen(TASKS, ("lab_bench/*", "*/carry_plank")) == [
        name for name in TASKS if name.startswith("lab_bench/") or name == "play_table/carry_plank"
    ]


@pytest.mark.parametrize("name", SCENES)
def test_nothing_is_in_anything_else(name):
    assert variants.problems(suite.scene(name)) == []


@pytest.mark.parametrize("name", SCENES)
def test_movable_bodies_have_a_severity_and_stay_at_rest(name):
    scene = suite.scene(name)
    world = failbench.build_world(scene)
    data = mujoco.MjData(world.model)
    data.qpos[:] = scene.home_qpos
    mujoco.mj_forward(world.model, data)
    before = data.xpos.copy()
    for _ in range(round(1.0 / world.model.opt.timestep)):
        mujoco.mj_step(world.model, data)
    assert world.movable.keys() <= scene.entities.keys()
    for thing, body in world.movable.items():
        assert np.linalg.norm(data.xpos[body] - before[body]) < _STILL, thing


@pytest.mark.parametrize("name", (*SCENES, *suite.vessel_scenes()))
def test_colliding_bodies_are_entities_or_listed(name):
    scene = suite.scene(name)
    model, listed = scene.model, {g for entity in scene.entities.values() for g in entity.geoms}
    solid = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    rest = [g for g in solid if model.geom_bodyid[g] not in scene.robot_bodies and g not in listed]
    assert {model.body(model.geom_bodyid[g]).name for g in rest} == _OBSTACLES[name]


@pytest.mark.parametrize("name", SCENES)
def test_no_object_was_used_to_fit_constants(name):
    """Compare kind, size and mass of the carried objects with those of the bundled scenes."""
    bundled = {_shape(scene, thing) for scene in map(suite.scene, gp.scenes()) for thing in scene.notes.objects}
    scene = suite.scene(name)
    for thing in scene.notes.objects:
        assert _shape(scene, thing) not in bundled


def _shape(scene: gp.Scene, thing: str) -> tuple[object, ...]:
    model = scene.model
    body = model.body(scene.notes.objects[thing].body).id
    geoms = np.flatnonzero(model.geom_bodyid == body)
    sizes = [(int(model.geom_type[g]), *model.geom_size[g].round(4).tolist()) for g in geoms]
    return (*sizes, round(float(model.body_mass[body]), 3))


@pytest.mark.parametrize("name", first_quick(TASKS))
def test_ends_are_free_and_a_path_exists(name):
    task = suite.task(name)
    assert task.object_name is not None
    for q in (task.start, *task.goal):
        assert float(gp.clearance(q, task.scene)) >= _ROOM
    assert gp.plan(task.start, task.goal, task.scene, w=0.0, speed=0.5, iterations=1000).trajectory is not None
