"""Batched edits equal single edits, and a moved body gives the same scene as a new one."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.costs.models.spill.tables import spill_tables
from graceful_plan.exceptions import SceneError, UnknownNameError, UnsupportedError
from graceful_plan.judge.exact import Judge, state_contacts
from graceful_plan.scene.edit import PosedModel, StaticBody
from graceful_plan.scene.scene import Scene


def _solids() -> list[StaticBody]:
    turned = np.eye(4)
    turned[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    turned[:3, 3] = 0.5, 0.5, 0.9
    tetrahedron = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
    return [
        StaticBody(name="crate", kind="box", size=[0.1, 0.2, 0.05], pose=turned, entity="glass"),
        StaticBody(name="ball", kind="sphere", size=0.1, pose=[0.6, -0.4, 0.8]),
        StaticBody(name="tube", kind="cylinder", size=(0.05, 0.2), pose=[0.4, 0.6, 0.7]),
        StaticBody(name="rod", kind="capsule", size=(0.02, 0.2), pose=[0.4, -0.6, 0.7]),
        StaticBody(name="wedge", kind="mesh", size=tetrahedron, pose=[0.3, 0.3, 1.0]),
    ]


def _same_tables(first: Scene, second: Scene) -> None:
    a, b = compile_scene(first), compile_scene(second)
    _same_fields((a.robot, b.robot), (a.world, b.world), (a.impact_tables, b.impact_tables))


def _same_fields(*pairs: tuple[object, object]) -> None:
    for tables, others in pairs:
        for name in type(tables).__dataclass_fields__:
            np.testing.assert_allclose(getattr(tables, name), getattr(others, name), atol=1e-9, err_msg=name)


def test_all_in_one_go_is_one_by_one(scene: Scene) -> None:
    one_by_one = scene
    for solid in _solids():
        one_by_one = one_by_one.edit(add=[solid])
    together = scene.edit(add=_solids())
    assert set(together.entities) == set(one_by_one.entities) == {*scene.entities, "crate"}
    _same_tables(together, one_by_one)
    back = together.edit(remove=[solid.name for solid in _solids()])
    assert set(back.entities) == set(scene.entities)
    _same_tables(back, scene)


def test_a_moved_body_equals_a_new_one(scene: Scene) -> None:
    first = scene.edit(add=_solids())
    poses = {solid.name: np.array([0.7, 0.1 * k, 1.2]) for k, solid in enumerate(_solids())}
    turned = np.eye(4)
    turned[:3, :3], turned[:3, 3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]], poses["tube"]
    quarter = np.eye(4)
    quarter[:3, :3], quarter[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], poses["crate"]
    moved = first.edit(move={**poses, "tube": turned})  # a position alone keeps the orientation
    anew = [
        StaticBody(name=s.name, kind=s.kind, size=s.size, entity=s.entity,
              pose={"tube": turned, "crate": quarter}.get(s.name, poses[s.name]))
        for s in _solids()
    ]  # fmt: skip
    _same_tables(moved, scene.edit(add=anew))
    _same_tables(first, scene.edit(add=_solids()))  # the original is unchanged
    model = moved.spec.copy().compile()
    np.testing.assert_allclose(model.body_pos, moved.model.body_pos, atol=1e-12)
    np.testing.assert_allclose(model.body_quat, moved.model.body_quat, atol=1e-12)
    rng = np.random.default_rng(0)
    q = rng.uniform(*scene.limits.position.T, (300, len(scene.joints)))
    touches = [sorted(t[:3] for t in Judge(s).touches(q)) for s in (moved, scene.edit(add=anew))]
    assert touches[0] == touches[1] and touches[0]


_CRATE = [0.06, 0.04, 0.03]
_desk = gp.load_scene("desk").tasks["bring_coffee"].scene
_first = _desk.add_box("crate", _CRATE, [0.3, -0.5, 0.9], entity="robust")


@settings(max_examples=8)
@given(
    st.tuples(st.floats(-0.2, 0.8), st.floats(-0.8, 0.8), st.floats(0.4, 1.2)),
    st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda quat: np.linalg.norm(quat) > 0.1),
)
def test_moved_bodies_leave_no_outdated_tables(place, quat) -> None:
    """Tables of kernels, drops and spills, and the resulting motion contain nothing outdated.

    The crate stands on things, over them, in them, beneath them and in the base of the robot.
    """
    pose, R = np.eye(4), np.zeros(9)
    mujoco.mju_quat2Mat(R, np.array(quat) / np.linalg.norm(quat))
    pose[:3, :3], pose[:3, 3] = R.reshape(3, 3), place
    scenes = _first.edit(move={"crate": pose}), _desk.add_box("crate", _CRATE, pose, entity="robust")
    _same_tables(*scenes)
    drops, spills = ([tables(scene) for scene in scenes] for tables in (drop_tables, spill_tables))
    _same_fields(tuple(drops), tuple(spills))
    task = gp.load_scene("desk").tasks["bring_coffee"]
    results = [gp.plan(task.start, task.goal, scene, stop="first", iterations=300) for scene in scenes]
    assert results[0].status is results[1].status
    if results[0].status is gp.PlanStatus.SOLVED:
        assert results[0].cost.total == pytest.approx(results[1].cost.total, rel=1e-9)
        assert results[0].trajectory.duration == pytest.approx(results[1].trajectory.duration, rel=1e-9)


def test_planning_after_a_move_copies_neither_model_nor_spec(monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop moves obstacles in each cycle, and models of robots with meshes take tens of megabytes."""
    task = gp.load_scene("desk").tasks["bring_coffee"]
    scene = task.scene.add_box("crate", _CRATE, [0.3, 3.0, 0.9], entity="robust")
    gp.plan(task.start, task.goal, scene, stop="first", iterations=100)

    def refuse(self: PosedModel) -> mujoco.MjModel:
        raise AssertionError("the model was copied")

    for name in ("model", "spec"):
        monkeypatch.setattr(PosedModel, name, property(refuse))
    for y in (2.0, 2.5):
        scene = scene.edit(move={"crate": [0.3, y, 0.9]})
        result = gp.plan(task.start, task.goal, scene, stop="first", iterations=100)
        assert result.status is gp.PlanStatus.SOLVED


def test_scenes_that_differ_by_poses_are_judged_in_turns() -> None:
    """They share MuJoCo's data, which must not mix up their poses."""
    name = "block"
    first = _desk.add_box(name, [0.03] * 3, [0.0, 3.0, 1.0])
    q = _desk.keyframes["ready"]
    into = first.edit(move={name: first.data_at(q).site(first.tool).xpos})
    for scene in (first, into, first, into):
        assert any(name in contact.second for contact in state_contacts(q, scene)) == (scene is into)
        assert compile_scene(scene).kernels.free(q) == (scene is first)
        moved_places = compile_scene(scene.edit(move={name: [0.0, 2.0, 1.0]})).world.pose
        assert not np.array_equal(moved_places, compile_scene(scene).world.pose)


def test_moving_makes_nothing_of_the_robot_again(scene: Scene) -> None:
    first = scene.edit(add=_solids())
    moved = first.edit(move={"ball": [0.0, 0.9, 0.9]})
    assert moved.layout is first.layout and moved.collision_pairs() is first.collision_pairs()
    assert compile_scene(moved).robot.sphere is compile_scene(first).robot.sphere
    assert first.edit(remove=["ball"]).layout is not first.layout


def test_something_that_stands_freely_is_moved_too(scene: Scene) -> None:
    """It starts at its new place, and can be grasped there."""
    name = next(
        scene.model.body(int(scene.model.jnt_bodyid[j])).name
        for j in range(scene.model.njnt)
        if scene.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE
    )
    moved = scene.edit(move={name: [0.3, 0.4, 1.5]})
    np.testing.assert_allclose(moved.data_at(np.zeros(7)).body(name).xpos, [0.3, 0.4, 1.5])
    np.testing.assert_allclose(scene.data_at(np.zeros(7)).body(name).xpos, scene.model.body(name).pos)
    np.testing.assert_allclose(moved.spec.copy().compile().qpos0, moved.model.qpos0)


def test_an_obstacle_that_is_moved_into_the_way_is_in_the_way(scene: Scene) -> None:
    first = scene.edit(add=[StaticBody(name="block", kind="box", size=[0.05] * 3, pose=[0.0, 3.0, 1.0])])
    q = next(iter(first.tasks.values())).start
    into = first.edit(move={"block": first.data_at(q).site(first.tool).xpos})
    assert compile_scene(first).kernels.free(q) and not compile_scene(into).kernels.free(q)
    assert any("block" in contact.second for contact in state_contacts(q, into))
    assert not any("block" in contact.second for contact in state_contacts(q, first))


def test_edits_that_cannot_be_are_refused(scene: Scene, task) -> None:
    hand = scene.model.body(scene.model.site(scene.tool).bodyid[0]).name
    held = task.scene.carried.body
    for names in ([hand], [held]):
        with pytest.raises(SceneError, match="cannot be removed"):
            task.scene.edit(remove=names)
        with pytest.raises(SceneError, match="cannot be moved"):
            task.scene.edit(move={names[0]: [0, 0, 1]})
    with pytest.raises(UnknownNameError, match="nowhere"):
        scene.edit(move={"nowhere": [0, 0, 0]})
    with pytest.raises(UnknownNameError, match="cone"):
        StaticBody(name="a", kind="cone", size=1.0, pose=[0, 0, 0])
    with pytest.raises(SceneError, match="taken"):
        scene.edit(add=[StaticBody(name="a", kind="sphere", size=0.1, pose=[0, 0, 3])] * 2)
    stacked = scene.edit(add=[StaticBody(name="a", kind="sphere", size=0.1, pose=[0, 0, 3])])
    spec = stacked.spec.copy()
    spec.body("a").add_body(name="b", pos=[0, 0, 0.2]).add_geom(size=[0.1, 0, 0])
    with pytest.raises(UnsupportedError, match="'b'"):
        Scene.build(spec, scene.notes).edit(move={"b": [0, 0, 1]})


def test_a_hull_may_have_the_name_of_one_that_goes() -> None:
    """Repeatedly, as perception does; also with the name of one of the robot's meshes."""
    tetrahedron = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    scene = gp.load_scene("tabletop").add_mesh("rock", tetrahedron, [1.0, 1.0, 1.0])
    for k in range(1, 4):
        rock = StaticBody(name="rock", kind="mesh", size=(1.0 + k) * tetrahedron, pose=[1.0, 1.0, 1.0])
        scene = scene.edit(remove=["rock"], add=[rock])
        assert scene.model.nmesh == 1 and scene.model.mesh_vert.max() == pytest.approx(0.1 * (1.0 + k), rel=0.5)
    with_mesh = scene.edit(add=[StaticBody(name="rock#1", kind="mesh", size=tetrahedron, pose=[0.5, 1.0, 1.0])])
    assert with_mesh.model.nmesh == 2
    text = """<mujoco><asset><mesh name="rock" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/></asset><worldbody>
    <body name="r/a"><joint/><geom type="mesh" mesh="rock"/><site name="r/t"/></body></worldbody></mujoco>"""
    robot = gp.Scene.from_mjcf(text, robot="r/", tool="r/t", velocity=[1.0], acceleration=[1.0])
    assert robot.add_mesh("rock", tetrahedron, [1.0, 1.0, 1.0]).model.nmesh == 2
