"""Moving entities: positions over time, storage in scenes, refused arguments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.exceptions import NonFiniteError, SceneError, SettingError, ShapeError, UnknownNameError
from graceful_plan.scene.elements import Limits

_LIMITS = Limits(
    position=np.array([[-3.0, 3.0]] * 2), velocity=np.ones(2), acceleration=np.ones(2) * 4.0, torque=np.full(2, np.inf)
)
PERSON = {"size": [0.25, 0.85], "t": [0.0, 2.0], "position": [[1.0, -1.0, 0.85], [1.0, 1.0, 0.85]]}


def person(**changes) -> gp.MovingEntity:
    return gp.MovingEntity("person", "adult", **{**PERSON, **changes})


# --- positions --------------------------------------------------------------------------------------------------------


def test_entities_move_evenly_and_rest_before_and_after():
    position = person().at([-1.0, 0.0, 0.5, 2.0, 9.0]).position
    np.testing.assert_allclose(position[:, 1], [-1.0, -1.0, -0.5, 1.0, 1.0])
    np.testing.assert_allclose(position[:, [0, 2]], [[1.0, 0.85]] * 5)


def test_entities_turn_the_shorter_way():
    turned = person(size=[0.3, 0.2, 0.85], yaw=[3.0, -3.0]).at(1.0)
    assert turned.yaw == pytest.approx(np.pi)


@given(st.floats(-5.0, 5.0), st.floats(0.0, 10.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_spread_starts_as_given_and_never_shrinks(t, dt, spread, growth):
    entity = person(spread=spread, growth=growth)
    assert entity.at(-1.0).spread == entity.at(0.0).spread == spread
    assert entity.at(t).spread <= entity.at(t + dt).spread + 1e-12
    assert entity.at(4.0).spread == pytest.approx(np.hypot(spread, 4.0 * growth))


@given(st.floats(-10.0, 10.0), st.floats(-3.0, 5.0))
def test_later_moves_the_clock(seconds, t):
    first, second = person(growth=0.2).at(t), person(growth=0.2).later(seconds).at(t + seconds)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


@pytest.mark.parametrize("shape", [(), (1,), (2, 3)])
def test_at_takes_any_batch(shape):
    found = person().at(np.zeros(shape))
    assert (found.position.shape, found.yaw.shape, found.spread.shape) == ((*shape, 3), shape, shape)


def test_moving_entities_are_immutable():
    with pytest.raises(ValueError, match="read-only"):
        person().position[0, 0] = 5.0


# --- in a scene -------------------------------------------------------------------------------------------------------


def test_a_scene_looks_up_its_severity(scene):
    held = scene.with_moving(person()).tasks["lift_to_goal"].scene
    carried = held.components["carried"].component_class
    assert held.moving["person"].category == "adult"
    assert held.moving_severity["person"]["carried"] == scene.notes.severity.severity("adult", carried)
    assert not scene.moving


def test_severities_can_be_replaced(scene):
    one = scene.with_moving(person(severity={"body": 7.0})).with_severity({"adult": 3.0})
    assert one.moving_severity["person"]["body"] == 7.0
    assert scene.with_moving(person()).with_severity({"person": 4.0}).moving_severity["person"]["body"] == 4.0
    assert scene.with_moving(person()).with_severity({"adult": 3.0}).moving_severity["person"]["body"] == 3.0


def test_without_moving_entities_their_severities_go_and_others_stay(scene):
    still = scene.with_moving(person()).with_severity({"person": 4.0, "adult": 3.0, "table": 2.0}).without_moving()
    assert not still.moving_severity
    assert still.entities["table"].severity["body"] == 2.0
    assert still.with_moving(person()).moving_severity["person"]["body"] == 3.0


def test_a_new_prediction_replaces_the_old_one(scene):
    twice = scene.with_moving(person()).with_moving(person(t=[5.0, 7.0]))
    assert list(twice.moving) == ["person"]
    assert twice.moving["person"].t[0] == 5.0


def test_the_summary_names_moving_entities(scene):
    assert "person" in scene.with_moving(person()).describe()


def test_neither_obstacle_nor_entity(scene):
    held = scene.tasks["lift_to_goal"].scene
    in_the_way = held.with_moving(gp.MovingEntity("ghost", "adult", size=[2.0, 2.0], t=[0.0], position=[[0, 0, 1]]))
    q = held.tasks["lift_to_goal"].start
    assert list(in_the_way.entities) == list(held.entities)
    assert in_the_way.unlabelled == held.unlabelled
    assert gp.clearance(q, in_the_way) == gp.clearance(q, held)


# --- refused arguments ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"t": [0.0, np.nan]}, NonFiniteError, "t of person is not finite"),
        ({"position": [[0, 0, np.inf], [0, 0, 0]]}, NonFiniteError, "position of person is not finite"),
        ({"t": [1.0, 1.0]}, SettingError, "time must increase"),
        ({"t": [1.0, 0.0]}, SettingError, "time must increase"),
        ({"t": [], "position": np.zeros((0, 3))}, ShapeError, "t of person"),
        ({"t": [0.0]}, ShapeError, "position of person"),
        ({"position": [[0.0, 0.0], [1.0, 1.0]]}, ShapeError, "position of person"),
        ({"yaw": [0.0]}, ShapeError, "yaw of person"),
        ({"size": [0.2]}, ShapeError, "size of person"),
        ({"size": [0.2, -1.0]}, SettingError, "size of person"),
        ({"spread": -0.1}, SettingError, "spread of person"),
        ({"growth": np.nan}, SettingError, "growth of person"),
    ],
)
def test_broken_predictions_are_refused(changes, error, words):
    with pytest.raises(error, match=words):
        person(**changes)


def test_names_must_be_new(scene):
    taken = next(iter(scene.entities))
    clash = gp.MovingEntity(taken, "adult", **PERSON)
    with pytest.raises(SceneError, match=f"'{taken}'"):
        scene.with_moving(clash)
    with pytest.raises(SceneError, match="person, person"):
        scene.with_moving(person(), person())
    with pytest.raises(SceneError, match="'person' is taken"):
        scene.with_moving(person()).add_box("person", [0.1, 0.1, 0.1], [3.0, 3.0, 0.0])
    with pytest.raises(SceneError, match="needs a name"):
        gp.MovingEntity("", "adult", **PERSON)


def test_unknown_classes_are_refused(scene):
    with pytest.raises(UnknownNameError, match="'ghost'"):
        scene.with_moving(gp.MovingEntity("boo", "ghost", **PERSON))
    with pytest.raises(UnknownNameError, match="'arm'"):
        scene.with_moving(person(severity={"arm": 1.0}))


# --- waiting ----------------------------------------------------------------------------------------------------------


def _motion() -> gp.Trajectory:
    return gp.retime(gp.Path(np.array([[0.0, 0.0], [0.5, -0.3], [1.0, 0.0]])), _LIMITS)


def test_a_delayed_motion_is_the_same_after_a_rest():
    motion = _motion()
    late = motion.delayed(1.5)
    assert late.duration == pytest.approx(motion.duration + 1.5)
    for t in np.linspace(0.0, motion.duration, 23):
        for now, then in zip(motion.at(np.array(t)), late.at(np.array(t + 1.5)), strict=True):
            np.testing.assert_allclose(now, then, atol=1e-9)
    waiting = late.at(np.linspace(0.0, 1.49, 7))
    np.testing.assert_allclose(waiting.q, np.repeat(motion.q[:1], 7, axis=0), atol=1e-9)
    assert not waiting.qd.any()
    assert motion.delayed(0.0) is motion


@pytest.mark.parametrize("seconds", [-0.1, np.nan, np.inf])
def test_waits_are_checked(seconds):
    with pytest.raises(SettingError, match="seconds"):
        _motion().delayed(seconds)


def test_a_moving_robot_cannot_wait():
    motion = _motion()
    middle = motion.at(np.array([0.4, 0.5]))
    with pytest.raises(SettingError, match="wait"):
        gp.Trajectory(np.array([0.4, 0.5]), *middle, joints=motion.joints).delayed(1.0)
