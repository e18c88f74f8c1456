"""The table scenes against published values."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.loading.bundled import load_scene, scenes
from graceful_plan.scene.scene import Scene

_NAMES = ("tabletop_l1", "tabletop", "tabletop_l3")
_WHITE = {(x, -0.25) for x in (-0.2, -0.1, 0.0, 0.1)} | {(x, -0.35) for x in (-0.2, 0.0, 0.1, 0.2)}
_RED = {(-0.1, -0.35)} | {(x, -0.45) for x in (-0.1, 0.0, 0.1, 0.2)}
_TOOL_AHEAD_OF_HAND = 0.10
_VIA = {
    "lift": (0.2, -0.25, 0.60),
    "t1_via": (0.1395, -0.4784, 0.55),
    "t2_via": (-0.0554, -0.4398, 0.55),
    "t3_via": (0.0, -0.35, 0.55),
    "t4_via": (-0.0509, -0.2458, 0.55),
    **{f"t{i}_goal": (-0.2, -0.45, 0.55) for i in (1, 2, 3, 4)},
}
_ROUNDING = 5e-3
"""Published joint values have four decimals and come from another inverse kinematics with a loose tolerance."""


def _published_tool(scene: Scene, q: np.ndarray) -> np.ndarray:
    hand = scene.data_at(q).body("panda/hand")
    return hand.xpos + _TOOL_AHEAD_OF_HAND * hand.xmat.reshape(3, 3)[:, 2]


def test_boxes_stand_where_they_were_published(scene: Scene) -> None:
    model = scene.model
    for color, places, severity in (("white", _WHITE, 2.0), ("red", _RED, 10.0)):
        boxes = [e for e in scene.entities.values() if e.name.startswith(color)]
        assert {tuple(np.round(model.body(e.name).pos[:2], 6).tolist()) for e in boxes} == places
        assert len(boxes) == len(places)
        assert {severity} == {s for e in boxes for s in e.severity.values()}
    for name, place in (("green", (0.2, -0.25)), ("blue", (-0.2, -0.45))):
        np.testing.assert_allclose(model.body(name).pos[:2], place)
        assert set(scene.entities[name].severity.values()) == {0.0}
    free = [b for b in range(model.nbody) if model.body_dofnum[b] == 6]
    assert len(free) == 15
    for b in free:
        assert model.body_pos[b, 2] == pytest.approx(0.43)
        assert model.body_mass[b] == pytest.approx(0.216)
        np.testing.assert_allclose(model.geom_size[model.body_geomadr[b]], 0.03)


def test_the_table_is_the_published_one(scene: Scene) -> None:
    model = scene.model
    data = scene.data_at(scene.keyframes["ready"])
    np.testing.assert_allclose(data.geom("table_top").xpos, [0, -0.35, 0.38])
    np.testing.assert_allclose(model.geom("table_top").size, [0.3, 0.16, 0.02])
    legs = np.array([data.geom(f"table_leg{i}").xpos for i in (1, 2, 3, 4)])
    assert {tuple(p) for p in legs.round(6).tolist()} == {
        (x, round(-0.35 + y, 6), 0.18) for x in (0.28, -0.28) for y in (0.14, -0.14)
    }
    assert set(scene.entities["table"].severity.values()) == {1.0}
    assert len(scene.entities["table"].geoms) == 5


def test_the_simulation_is_the_published_one(scene: Scene) -> None:
    option = scene.model.opt
    assert option.timestep == 1e-3
    assert option.cone == int(mujoco.mjtCone.mjCONE_ELLIPTIC)
    assert (option.impratio, option.noslip_iterations) == (5.0, 3)
    green = scene.model.geom("green")
    assert green.condim == 6
    np.testing.assert_allclose(green.friction, [2.8, 1.2, 0.1])
    np.testing.assert_allclose(green.solref, [0.005, 1])
    np.testing.assert_allclose(green.solimp[:3], [0.015, 1, 0.02])
    np.testing.assert_allclose(scene.home_qpos[-2:], 0.03)


@pytest.mark.parametrize("name", _VIA)
def test_published_postures_reach_their_points(scene: Scene, name: str) -> None:
    assert np.linalg.norm(_published_tool(scene, scene.keyframes[name]) - _VIA[name]) < _ROUNDING


def test_the_object_is_held_as_published(scene: Scene) -> None:
    holding = scene.tasks["lift_to_goal"].scene
    assert holding.carried is not None and holding.carried.object_class == "medium"
    q = holding.keyframes["t1_goal"]
    np.testing.assert_allclose(
        holding.data_at(q).body("green").xpos, _published_tool(holding, q) - [0, 0, 0.01], atol=1e-4
    )


def test_the_published_task_is_there(scene: Scene) -> None:
    task = scene.tasks["lift_to_goal"]
    np.testing.assert_array_equal(task.start, scene.keyframes["lift"])
    np.testing.assert_array_equal(task.goal, [scene.keyframes[f"t{i}_goal"] for i in (1, 2, 3, 4)])
    assert len(scene.tasks) >= 4


@pytest.mark.parametrize("name", _NAMES)
def test_every_end_of_a_task_is_free(name: str) -> None:
    scene = load_scene(name)
    for task in scene.tasks.values():
        pairs = {tuple(sorted(pair)) for pair in task.scene.collision_pairs().tolist()}
        for q in [task.start, *task.goal]:
            data = task.scene.data_at(q)
            mujoco.mj_collision(task.scene.model, data)
            touching = {(min(a, b), max(a, b)) for a, b in data.contact.geom.tolist()}
            assert not touching & pairs, task.name


@pytest.mark.parametrize("name", _NAMES)
def test_worlds_stand_still(name: str) -> None:
    scene = load_scene(name)
    model = scene.model
    data = scene.data_at(scene.keyframes["ready"])
    data.ctrl[:7] = scene.keyframes["ready"]
    data.ctrl[7] = 0.03
    before = data.qpos.copy()
    mujoco.mj_step(model, data, nstep=200)
    free = [model.jnt_qposadr[j] for j in range(model.njnt) if model.jnt_type[j] == 0]
    moved = [np.abs(data.qpos[a : a + 3] - before[a : a + 3]).max() for a in free]
    assert max(moved) < 1e-3
    assert not data.warning.number.any()


def test_levels_differ_in_difficulty() -> None:
    easy, published, hard = (load_scene(name) for name in _NAMES)

    def objects(scene: Scene) -> int:
        return sum(scene.model.body_dofnum == 6)

    assert 3 <= objects(easy) <= 5
    assert objects(published) == 15
    assert objects(hard) >= 25
    tall = [
        g for g in range(hard.model.ngeom) if hard.model.geom_aabb[g, 5] >= 0.1 and hard.model.geom(g).name[0] in "bt"
    ]
    assert len(tall) >= 5


@pytest.mark.parametrize("name", _NAMES)
def test_every_level_has_something_precious_and_several_tasks(name: str) -> None:
    scene = load_scene(name)
    assert max(e.severity["body"] for e in scene.entities.values()) == 10.0
    assert len(scene.tasks) >= 3
    assert scene.unlabelled == ("world",)  # the floor


def test_names_of_scenes() -> None:
    assert set(_NAMES) <= set(scenes())
    with pytest.raises(UnknownNameError, match=r"'table'.*tabletop, tabletop_l1"):
        load_scene("table")


@pytest.mark.parametrize(("number", "total"), [(1, 3.78), (2, 5.74), (3, 3.95), (4, 1.27)])
def test_algorithm_1_gives_the_recomputed_values_for_the_published_trajectories(number: int, total: float) -> None:
    """With the carried box, hard boxes, no table, and the four published samples: lift, via twice, goal."""
    scene = gp.load_scene("tabletop").tasks["lift_to_goal"].scene.with_severity({"table": 0.0})
    stops = [scene.keyframes[name] for name in ("lift", f"t{number}_via", f"t{number}_via", f"t{number}_goal")]
    impact = gp.evaluate(
        np.stack(stops), scene, gp.Objective(impact=gp.ImpactCost(model="box_overlap"), exposure="waypoints")
    ).impact
    assert impact == pytest.approx(total, abs=0.02)
