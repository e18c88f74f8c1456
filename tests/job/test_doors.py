"""Doors and drawers: the handle keeps to the joint's path, objects in a drawer come along, and it is closed again."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest
from order_jobs import action_state
from places import ROOT

import failbench as fb
import graceful_plan as gp
from graceful_plan.exceptions import SettingError, UnknownNameError
from graceful_plan.job.actions import Action, Deed
from graceful_plan.job.job_result import JobStatus
from graceful_plan.job.job_state import JobState, pose_key
from graceful_plan.job.motions import JobMotion
from graceful_plan.job.opening import shut_in

SCENES = ROOT / "tests" / "support" / "scenes"
MUG = [0.4, 0.4, 0.4]


def scene() -> gp.Scene:
    return gp.load_scene(SCENES / "drawer.yaml")


def job(*allowed: Action) -> gp.Job:
    return gp.Job(scene()).place("mug", at=MUG).allow(*allowed)


@cache
def done(joint: str, to: float | None = None) -> tuple[Mapping[str, JobMotion], Deed, JobState]:
    """Return the motions of opening by the first choice that is possible, the deed, and the state before."""
    action = gp.Open(joint, handle=f"{joint}_handle", to=to)
    state, motions = action_state(job(action))
    for choice in action.candidates(state, motions):
        deed = action.motion(state, choice, motions)
        if isinstance(deed, Deed):
            return {piece.label: piece for piece in deed.steps[0][2]}, deed, state
    raise AssertionError("no choice is possible")


@pytest.mark.parametrize(("joint", "to"), [("drawer", 0.25), ("door", 0.8)])
def test_the_part_keeps_to_the_path_of_its_joint(joint: str, to: float) -> None:
    pieces, deed, before = done(joint, to)
    assert list(pieces) == ["transit", "approach", "grip", "pull", "release", "retreat"]
    for piece in pieces.values():
        assert gp.verify(piece.trajectory, piece.scene).passed, piece.label
    pull, gone = pieces["pull"], []
    closed = before.world.data_at(before.q).body(joint)
    for q in pull.trajectory.q[:: len(pull.trajectory.q) // 8]:
        held = pull.scene.data_at(q).body(f"{joint}@joined")
        turn = held.xmat.reshape(3, 3) @ closed.xmat.reshape(3, 3).T
        gone.append(
            np.linalg.norm(held.xpos - closed.xpos) if joint == "drawer" else np.arctan2(turn[1, 0], turn[0, 0])
        )
        there = before.world.with_state({joint: min(max(gone[-1], 0.0), to)}).data_at(before.q).body(joint)
        np.testing.assert_allclose(held.xpos, there.xpos, atol=2e-3)
        np.testing.assert_allclose(held.xmat, there.xmat, atol=0.01)
    assert gone[0] == pytest.approx(0.0, abs=2e-3) and np.all(np.diff(gone) > -1e-3)
    after = deed.state.world
    assert after.home_qpos[after.model.joint(joint).qposadr[0]] == pytest.approx(to)


def test_objects_in_a_drawer_come_along_and_come_within_reach() -> None:
    pieces, deed, before = done("drawer", 0.25)
    np.testing.assert_allclose(deed.state.pose("mug")[:3, 3], before.pose("mug")[:3, 3] - [0.25, 0.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(deed.state.pose("vase"), before.pose("vase"))
    pull = pieces["pull"]
    mug = next(b for b in pull.scene.robot_bodies if pull.scene.model.body(b).name.startswith("mug@"))
    here, there = (pull.scene.data_at(q).xpos[mug] for q in pull.trajectory.q[[0, -1]])
    np.testing.assert_allclose(there - here, [-0.25, 0.0, 0.0], atol=1e-3)
    state, motions = action_state(job())
    for now, is_reached in ((state, False), (deed.state, True)):
        assert any(motions.grasps(now, "mug", [pose_key(now.pose("mug"))])) is is_reached


def test_moving_entities_go_on_while_a_part_is_opened() -> None:
    way = np.array([[3.0, -5.0, 0.9], [3.0, 5.0, 0.9]])
    walker = gp.MovingEntity("walker", "adult", size=[0.3, 0.9], t=np.array([0.0, 20.0]), position=way)
    action = gp.Open("drawer", handle="drawer_handle")
    walked = gp.Job(scene().with_moving(walker)).place("mug", at=MUG).allow(action)
    state, motions = action_state(walked)
    later = state.after(state.q, 8.0)
    deeds = [action.motion(later, choice, motions) for choice in action.candidates(later, motions)]
    pieces = next(deed for deed in deeds if isinstance(deed, Deed)).steps[0][2]
    assert {float(piece.scene.moving["walker"].t[0]) for piece in pieces} == {-8.0}


def test_a_part_is_opened_only_once_and_not_if_it_is_open() -> None:
    action = gp.Open("drawer", handle="drawer_handle")
    _, deed, _ = done("drawer", 0.25)
    state, motions = action_state(job(action))
    assert not list(action.candidates(deed.state, motions))
    assert not list(action.candidates(state.with_joint("drawer", 0.25), motions))


def test_misuse_is_named() -> None:
    with pytest.raises(UnknownNameError, match="shelf"):
        job(gp.Open("shelf", handle="drawer_handle"))
    with pytest.raises(SettingError, match="surroundings"):
        job(gp.Open("panda/joint1", handle="drawer_handle"))
    with pytest.raises(SettingError, match="moves"):
        job(gp.Open("drawer", handle="door_handle"))
    with pytest.raises(SettingError, match=r"0\.25"):
        job(gp.Open("drawer", handle="drawer_handle", to=0.4))
    with pytest.raises(SettingError, match="grasps"):
        gp.Open("drawer", handle="drawer_handle", grasps=(np.eye(4),))  # type: ignore[arg-type]


def test_what_stands_in_a_closed_drawer_is_told_with_the_joint_and_the_action_that_opens_it() -> None:
    closed = gp.plan_job(job(), 0.3, grasps=1, iterations=1)
    assert closed.status is JobStatus.INFEASIBLE
    assert "joint 'drawer'" in closed.detail and "gp.Open('drawer', handle='drawer_handle')" in closed.detail


def test_a_joint_that_does_not_shut_an_object_in_is_no_remedy() -> None:
    far = gp.plan_job(gp.Job(scene()).place("vase", at=[0.5, 0.58, 2.4]), 0.3, grasps=1, iterations=1)
    assert far.status is JobStatus.INFEASIBLE and "gp.Open" not in far.detail


def test_what_stands_behind_a_door_is_told_with_its_joint() -> None:
    shut = gp.Job(gp.load_scene(SCENES / "cupboard.yaml")).place("mug", at=MUG)
    result = gp.plan_job(shut, 0.3, grasps=1, iterations=1)
    assert result.status is JobStatus.INFEASIBLE and "gp.Open('door', handle='door_handle')" in result.detail
    state, motions = action_state(shut)
    assert shut_in(state.with_joint("door", 1.8), "mug", motions) is None
    inside = shut_in(state, "mug", motions, is_reached=True)
    assert inside is not None and inside.joint == "door"
    outside = state.moved("mug", np.eye(4))
    assert shut_in(outside, "mug", motions, is_reached=True) is None


@pytest.mark.long
def test_a_job_opens_a_drawer_takes_what_is_in_it_and_closes_it() -> None:
    closed = gp.plan_job(job(), 0.3, grasps=3, iterations=3)
    assert closed.status is JobStatus.INFEASIBLE and "mug" in closed.detail
    opening = gp.Open("drawer", handle="drawer_handle")
    closing = gp.Close("drawer", handle="drawer_handle", required=True)
    result = gp.plan_job(job(opening, closing), 0.3, grasps=3, iterations=4)
    assert [step.kind for step in result.unwrap()] == ["open", "pick", "place", "close"] and result.order == ("mug",)
    pieces = [piece for step in result.steps for piece in step.pieces]
    assert all(gp.verify(piece.trajectory, piece.scene).passed for piece in pieces)
    last = pieces[-1]
    data = last.scene.data_at(last.trajectory.q[-1])
    assert data.joint("drawer").qpos[0] == pytest.approx(0.0)
    np.testing.assert_allclose(data.body("mug").xpos, MUG, atol=1e-6)
    validated = fb.validate_job(result, ["drop/*/severe", "collapse/*/severe"], n=2)
    assert {motion.label for motion in validated.motions} >= {"pull", "carry"}


@pytest.mark.long
def test_an_object_is_put_into_a_drawer_and_the_drawer_is_closed() -> None:
    room = scene().edit(move={"mug": MUG})
    opening = gp.Open("drawer", handle="drawer_handle")
    closing = gp.Close("drawer", handle="drawer_handle", required=True)
    stowing = (
        gp.Job(room)
        .place("mug", on="drawer", in_region=[[0.3, -0.25, 0.2], [0.48, 0.05, 0.3]], n=3)
        .allow(opening, closing)
    )
    result = gp.plan_job(stowing, 0.3, grasps=3, iterations=12)
    assert [step.kind for step in result.unwrap()] == ["open", "pick", "place", "close"]
    last = result.steps[-1].pieces[-1]
    data = last.scene.data_at(last.trajectory.q[-1])
    inside = data.body("mug").xpos - data.body("drawer").xpos
    assert data.joint("drawer").qpos[0] == pytest.approx(0.0)
    assert np.all(np.abs(inside[:2]) < 0.15) and inside[2] == pytest.approx(0.01, abs=2e-3)
