"""Bundled scenes with bases: objects stay at rest, ends of tasks are free, robots can drive, walls can be sliced."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from on_wheels import rolling_qpos, rolling_spec
from places import LIBRARY

import graceful_plan as gp
from graceful_plan.scene.mobile.wheels import KEEP_OUT

_FOLDER = LIBRARY / "scene" / "scenes" / "mobile"
_ROOM = 0.02
"""Clearance of robot and load at the ends of tasks [m]: twice the protrusion of covers."""
_OBSTACLES = {
    "apartment": {"walls", "floor"},
    "hallway": {"walls", "floor"},
    "kitchen": {"walls", "floor"},
    "warehouse_aisle": {"walls", "floor", "dock"},
}
"""Bodies that collide but are not entities; the scene files give the reasons."""
_WHO_IS_THERE = {
    "apartment": {"child", "pet", "glass", "heirloom", "laptop"},
    "hallway": {"adult", "adult_head", "heirloom"},
    "kitchen": {"child", "pet", "glass"},
    "warehouse_aisle": {"adult", "glass"},
}


@cache
def mobile(name: str) -> gp.Scene:
    return gp.load_scene(name)


NAMES = gp.mobile_scenes()
TASKS = [(name, task) for name in NAMES for task in mobile(name).tasks]


def test_their_names_are_their_own():
    assert set(NAMES) == set(_OBSTACLES) and not set(NAMES) & set(gp.scenes())
    with pytest.raises(gp.GracefulPlanError, match="hallway"):
        gp.load_scene("halway")


@pytest.mark.parametrize("name", NAMES)
def test_nothing_falls_over(name):
    """After a second under gravity, every object has moved by at most 5 mm and 0.02 rad."""
    model = mujoco.MjModel.from_xml_path(str(_FOLDER / f"{name}.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before_x, before_R = data.xpos.copy(), data.xmat.copy()
    assert (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).sum() >= 2
    mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
    assert all(warning.number == 0 for warning in data.warning)
    mujoco.mj_kinematics(model, data)
    assert np.linalg.norm(data.xpos - before_x, axis=1).max() < 0.005
    assert np.abs(data.xmat - before_R).max() < 0.02


@pytest.mark.parametrize("name", NAMES)
def test_what_collides_is_an_entity_or_known_to_be_none(name):
    scene = mobile(name)
    model, listed = scene.model, {g for entity in scene.entities.values() for g in entity.geoms}
    solid = np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0))
    rest = [g for g in solid if model.geom_bodyid[g] not in scene.robot_bodies and g not in listed]
    assert {model.body(model.geom_bodyid[g]).name for g in rest} == _OBSTACLES[name]
    there = {entity.category for entity in (*scene.entities.values(), *scene.moving.values())}
    assert _WHO_IS_THERE[name] <= there


@pytest.mark.parametrize("name", NAMES)
def test_walls_are_upright_boxes_around_all_keyframes(name):
    """A floor map can be sliced from the walls, and no plan leads outside."""
    model = mobile(name).model
    walls = np.flatnonzero(model.geom_bodyid == model.body("walls").id)
    assert len(walls) >= 4 and (model.geom_type[walls] == mujoco.mjtGeom.mjGEOM_BOX).all()
    np.testing.assert_allclose(model.geom_quat[walls], np.tile([1.0, 0.0, 0.0, 0.0], (len(walls), 1)))
    assert (model.geom_pos[walls, 2] == pytest.approx(model.geom_size[walls, 2])) and (
        model.geom_size[walls, 2] > 1
    ).all()
    low = (model.geom_pos[walls] - model.geom_size[walls]).min(axis=0)
    high = (model.geom_pos[walls] + model.geom_size[walls]).max(axis=0)
    for q in mobile(name).keyframes.values():
        assert (low[:2] < q[:2]).all() and (q[:2] < high[:2]).all()


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_describes_itself(name):
    scene, text = mobile(name), mobile(name).describe()
    assert scene.base is not None and scene.components["body"].component_class == "base_coast"
    assert len(scene.tasks) >= 3 and all(len(task.description) > 20 for task in scene.tasks.values())
    assert all(word in text for word in (name, *scene.entities, *scene.tasks))


@pytest.mark.parametrize(("name", "task"), TASKS)
def test_ends_have_room_by_exact_geometry(name, task):
    found = mobile(name).tasks[task]
    scene = found.scene
    own = {g for component in scene.components.values() for g in component.geoms}
    for q in (found.start, *found.goal):
        data = scene.data_at(q)
        for a, b in scene.collision_pairs().tolist():
            distance = mujoco.mj_geomDistance(scene.model, data, a, b, 2 * _ROOM, None)
            assert distance >= _ROOM, (scene.model.geom(a), scene.model.geom(b), a in own, b in own)


@pytest.mark.parametrize(("name", "task"), [pair for pair in TASKS if mobile(pair[0]).robot == "jackal/"])
def test_the_load_stands_on_the_deck(name, task):
    """A Jackal has no gripper: its load stands slightly above the deck, upright."""
    scene = mobile(name).tasks[task].scene
    if scene.carried is not None:
        data = scene.data_at(mobile(name).tasks[task].start)
        body, deck = data.body(scene.carried.body), data.site(scene.tool)
        np.testing.assert_allclose(body.xpos - deck.xpos, [0.0, 0.0, 0.002], atol=1e-9)
        assert body.xmat[8] == pytest.approx(1.0)


@pytest.mark.parametrize(("name", "task"), TASKS)
def test_robots_stand_on_their_wheels_where_tasks_begin(name, task):
    found = mobile(name).tasks[task]
    model = rolling_spec(found.world).compile()
    assert not any(model.geom_contype[g] for g in range(model.ngeom) if model.geom(g).name.startswith(KEEP_OUT))
    data = mujoco.MjData(model)
    data.qpos[:] = rolling_qpos(found.world, model, found.start)
    for name_of_joint, value in zip(found.world.joints[3:], found.start[3:], strict=True):
        data.ctrl[model.actuator(name_of_joint).id] = value
    mujoco.mj_step(model, data, nstep=250)
    base = data.body(f"{found.world.robot}base")
    np.testing.assert_allclose(base.xpos, [*found.start[:2], 0.0], atol=2e-3)
    assert base.xmat[8] > np.cos(0.01)


@pytest.mark.long
@pytest.mark.parametrize("w", [0.0, 0.3])
@pytest.mark.parametrize(("name", "task"), TASKS)
def test_tasks_are_planned(name, task, w):
    found = mobile(name).tasks[task]
    result = gp.plan(found.start, found.goal, found.scene, w=w, iterations=5000, seed=1)
    assert result.status is gp.PlanStatus.SOLVED, result.detail
    assert result.verdict.checks["rolling"].passed and result.verdict.checks["drive_limits"].passed
    assert result.cost.impact > 0.0  # a person or object is there
