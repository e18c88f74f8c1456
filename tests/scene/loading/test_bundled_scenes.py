"""The household scenes: objects stay at rest, ends of tasks are free and harmless, straight paths are neither."""

from __future__ import annotations

from functools import cache, partial

import mujoco
import numpy as np
import pytest
from places import LIBRARY

import graceful_plan as gp

HOUSEHOLD = ("dining_table", "desk", "kitchen_counter")
_FOLDER = LIBRARY / "scene" / "scenes"
_ROOM = 0.02
"""Clearance of robot and object at the ends of tasks [m]: twice the protrusion of covers."""
_MILD = 5.0
"""Greatest severity below the object at the ends of a task: moderate."""

_OBSTACLES = {
    "dining_table": {"pedestal", "chair", "person_legs", "floor_under_table"},
    "desk": {"pedestal", "floor_under_desk"},
    "kitchen_counter": {"pedestal", "wall", "floor_under_trolley"},
    "tabletop": {"world"},
    "tabletop_l1": {"world"},
    "tabletop_l3": {"world"},
}
"""Bodies that collide but are not entities: hits of them do not count, so each needs a reason."""
_COVERED = {"person_legs", "floor_under_table", "floor_under_desk", "floor_under_trolley"}
"""Those that are covered by entities."""
_RAY_STEP = 0.03
"""Distance between the rays that look for uncovered bodies [m]."""


@cache
def household(name: str) -> gp.Scene:
    return gp.load_scene(name)


TASKS = [(name, task) for name in HOUSEHOLD for task in household(name).tasks]
ENDS = [(name, task, end) for name, task in TASKS for end in ("start", "goal")]


def end_of(name: str, task: str, end: str) -> tuple[gp.Task, np.ndarray]:
    found = household(name).tasks[task]
    return found, found.start if end == "start" else found.goal[0]


def worst_impact(scene: gp.Scene, q: np.ndarray) -> float:
    """Return the greatest P S of object or contents against any entity at any configuration, by Algorithm 1."""
    held = [name != "body" for name in scene.components]
    severity = np.array([[entity.severity[c] for entity in scene.entities.values()] for c in scene.components])
    return float((gp.interaction_probability(q, scene, "box_overlap") * severity)[..., held, :].max())


def near_pairs(scene: gp.Scene, data: mujoco.MjData) -> list[list[int]]:
    """Return the pairs of geoms that may touch and whose bounding spheres are close."""
    pairs = scene.collision_pairs()
    apart = np.linalg.norm(data.geom_xpos[pairs[:, 0]] - data.geom_xpos[pairs[:, 1]], axis=1)
    return pairs[apart < scene.model.geom_rbound[pairs].sum(axis=1) + _ROOM].tolist()


def test_household_scenes_are_bundled() -> None:
    assert set(HOUSEHOLD) <= set(gp.scenes())


# --- the worlds -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_nothing_falls_over(name: str) -> None:
    """After a second under gravity, every object has moved by at most 5 mm and 0.02 rad."""
    model = mujoco.MjModel.from_xml_path(str(_FOLDER / f"{name}.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    before_x, before_R = data.xpos.copy(), data.xmat.copy()
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    assert len(free) >= 8
    for _ in range(round(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert all(warning.number == 0 for warning in data.warning)
    mujoco.mj_kinematics(model, data)
    assert np.linalg.norm(data.xpos - before_x, axis=1).max() < 0.005
    assert np.abs(data.xmat - before_R).max() < 0.02


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_geometry_is_mixed(name: str) -> None:
    model = household(name).model
    kinds = {mujoco.mjtGeom(model.geom_type[g]).name.removeprefix("mjGEOM_").lower() for g in range(model.ngeom)}
    assert {"box", "cylinder", "capsule", "sphere", "mesh"} <= kinds


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_things_that_move_have_household_masses(name: str) -> None:
    model = household(name).model
    for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        mass = model.body_mass[model.jnt_bodyid[joint]]
        assert 0.02 <= mass <= 4.0, model.body(model.jnt_bodyid[joint]).name


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_the_floor_has_no_part_below_the_furniture(name: str) -> None:
    """Algorithm 1 projects straight down through all objects, so the floor must end below furniture."""
    scene = household(name)
    data = scene.data_at(scene.keyframes["ready"])
    support = {"dining_table": ["table"], "desk": ["desk"], "kitchen_counter": ["counter", "trolley"]}[name]
    for floor in scene.entities["floor"].geoms:
        for body in support:
            for top in scene.entities[body].geoms:
                half = scene.model.geom_size[[floor, top], :2]
                distance = np.abs(data.geom_xpos[floor, :2] - data.geom_xpos[top, :2])
                if scene.model.geom_type[top] == mujoco.mjtGeom.mjGEOM_BOX:
                    assert np.any(distance >= half.sum(axis=0) - 1e-9)


def collides(model: mujoco.MjModel) -> np.ndarray:
    return (model.geom_contype != 0) | (model.geom_conaffinity != 0)


@pytest.mark.parametrize("name", gp.scenes())
def test_what_collides_is_an_entity_or_known_to_be_none(name: str) -> None:
    """A new body that is not listed could be hit for free."""
    scene = household(name)
    model, listed = scene.model, {g for entity in scene.entities.values() for g in entity.geoms}
    rest = [g for g in np.flatnonzero(collides(model)) if model.geom_bodyid[g] not in scene.robot_bodies]
    assert {model.body(model.geom_bodyid[g]).name for g in rest if g not in listed} == _OBSTACLES[name]


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_covered_bodies_are_covered_by_entities(name: str) -> None:
    """Seen straight from above; an object that gets there otherwise has hit an entity before."""
    scene = household(name)
    model, data = scene.model, scene.data_at(scene.keyframes["ready"])
    solid = np.flatnonzero(collides(model)).tolist()
    entities = [g for entity in scene.entities.values() for g in entity.geoms if g in solid]
    for body in _COVERED & _OBSTACLES[name]:
        for geom in np.flatnonzero(model.geom_bodyid == model.body(body).id).tolist():
            R, (centre, half) = data.geom_xmat[geom].reshape(3, 3), model.geom_aabb[geom].reshape(2, 3)
            low, high = (data.geom_xpos[geom] + R @ centre + sign * np.abs(R) @ half for sign in (-1.0, 1.0))
            sides = [np.arange(a + 1e-3, b, _RAY_STEP) for a, b in zip(low[:2], high[:2], strict=True)]
            for x, y in np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2):
                own = depth_below(model, data, (x, y), geom)
                assert any(depth_below(model, data, (x, y), g) <= own for g in entities) or own == np.inf, (body, x, y)


def depth_below(model: mujoco.MjModel, data: mujoco.MjData, xy: tuple[float, float], geom: int) -> float:
    """Return the depth of a geom below 3 m [m]; infinite outside of its area."""
    at, down = np.array([*xy, 3.0]), np.array([0.0, 0.0, -1.0])
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        depth = mujoco.mj_rayMesh(model, data, geom, at, down)
    else:
        pose = data.geom_xpos[geom], data.geom_xmat[geom]
        depth = mujoco.mju_rayGeom(*pose, model.geom_size[geom], at, down, model.geom_type[geom])
    return depth if depth >= 0.0 else np.inf


# --- facts about them -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_all_people_and_pets_have_a_class(name: str) -> None:
    expected = {
        "dining_table": {"adult_head", "adult", "glass", "heirloom"},
        "desk": {"laptop", "phone", "paper", "mains", "pet", "glass"},
        "kitchen_counter": {"child", "flame", "glass"},
    }
    scene = household(name)
    assert expected[name] | {"table", "floor", "robust"} <= {entity.category for entity in scene.entities.values()}
    assert not {"person_head", "child_head", "laptop"} & set(scene.unlabelled)


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_a_scene_describes_itself(name: str) -> None:
    scene = household(name)
    text = scene.describe()
    for word in (name, *scene.entities, *scene.tasks):
        assert word in text


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_there_are_enough_tasks_and_objects(name: str) -> None:
    tasks = household(name).tasks
    assert len(tasks) >= 4
    assert len({task.object_name for task in tasks.values()}) >= 3
    assert all(len(task.description) > 20 for task in tasks.values())
    assert any("contents" in task.scene.components for task in tasks.values())


def test_some_tasks_begin_and_end_on_a_support() -> None:
    assert sum(bool(household(name).tasks[task].support) for name, task in TASKS) >= 2


# --- their tasks ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "task"), TASKS)
def test_the_object_of_a_task_is_in_the_gripper(name: str, task: str) -> None:
    found = household(name).tasks[task]
    note = household(name).notes.objects[found.object_name or ""]
    assert found.scene.carried is not None
    assert found.scene.carried.body == note.body
    assert note.body not in found.scene.entities
    assert (found.scene.contents is None) == (note.contents is None)
    data = found.scene.data_at(found.start)
    tool = data.site(found.scene.tool).xpos
    geoms = found.scene.components["carried"].geoms
    reach = min(np.linalg.norm(data.geom_xpos[g] - tool) - found.scene.model.geom_rbound[g] for g in geoms)
    assert reach < 0.0  # the fingers close around it


@pytest.mark.parametrize(("name", "task", "end"), ENDS)
def test_ends_have_room_by_exact_geometry(name: str, task: str, end: str) -> None:
    found, q = end_of(name, task, end)
    scene = found.scene
    assert np.all((scene.limits.position[:, 0] < q) & (q < scene.limits.position[:, 1]))
    data = scene.data_at(q)
    arm, held = set(scene.components["body"].geoms), set(scene.components["carried"].geoms)
    support = {g for s in found.support for g in scene.geoms_named(s)}
    for a, b in near_pairs(scene, data):
        d = mujoco.mj_geomDistance(scene.model, data, a, b, 2 * _ROOM, None)
        own = a in arm | held and b in arm | held
        if a in held and b in support:
            assert d >= 0.0
        else:
            assert d >= (0.005 if own else _ROOM), (scene.model.geom(a), scene.model.geom(b))


@pytest.mark.parametrize(("name", "task", "end"), ENDS)
def test_ends_are_not_above_severe_entities(name: str, task: str, end: str) -> None:
    found, q = end_of(name, task, end)
    assert worst_impact(found.scene, q) < _MILD


@pytest.mark.parametrize(("name", "task"), TASKS)
def test_the_direct_way_passes_over_something_severe(name: str, task: str) -> None:
    found = household(name).tasks[task]
    way = gp.Path(np.stack([found.start, found.goal[0]])).resampled(0.02)
    assert worst_impact(found.scene, way.q) > _MILD


@pytest.mark.parametrize("name", HOUSEHOLD)
def test_ready_is_free(name: str) -> None:
    scene = household(name)
    assert gp.clearance(scene.keyframes["ready"], scene) > _ROOM


@pytest.mark.long
def test_caution_halves_the_impact_of_three_quarters_of_the_tasks() -> None:
    """By Algorithm 1: landings after a fall, and contents, are harder to avoid."""
    halved = []
    boxes = gp.Objective(impact=gp.ImpactCost(model="box_overlap"))
    for name, task in TASKS:
        found = household(name).tasks[task]
        asked = partial(gp.plan, found.start, found.goal, found.scene, objective=boxes, constraints=[], seed=1)
        quick, careful = asked(w=0.0, iterations=400), asked(w=1.0, iterations=2000)
        assert (quick.status, careful.status) == (gp.PlanStatus.SOLVED, gp.PlanStatus.SOLVED), task
        assert quick.cost is not None and careful.cost is not None
        assert careful.cost.motion + careful.cost.impact < quick.cost.motion + quick.cost.impact
        halved.append(careful.cost.impact <= 0.5 * quick.cost.impact)
    assert np.mean(halved) >= 0.75
