"""Jobs of a mobile robot: it drives between tables with an object, and stands still while the arm works."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from order_jobs import action_state
from places import ROOT

import failbench as fb
import graceful_plan as gp
from graceful_plan.exceptions import SettingError
from graceful_plan.job.actions import Action, Deed
from graceful_plan.job.job_result import JobStatus
from graceful_plan.job.job_state import pose_key
from graceful_plan.job.still_base import arm_alone, reached_poses, straight_arm_motion

SCENES = ROOT / "tests" / "support" / "scenes"
TABLES, KITCHEN = SCENES / "fetch_tables.yaml", SCENES / "fetch_kitchen.yaml"


def scene() -> gp.Scene:
    return gp.load_scene(TABLES)


def test_a_straight_motion_leaves_the_base_where_it_is() -> None:
    room = scene()
    q = room.keyframes["ready"]
    goal = gp.PoseGoal.from_tool(q, room, translation=[0.0, 0.0, 0.05])
    found = straight_arm_motion(q, goal, room, objective=gp.Objective(), speed=1.0)
    motion = found.unwrap()
    assert motion.joints == room.joints
    np.testing.assert_array_equal(motion.q[:, :3], np.tile(q[:3], (len(motion.q), 1)))
    np.testing.assert_allclose(room.pose(motion.q[-1]), goal.X_WT, atol=1e-3)
    assert gp.verify(motion, room).passed
    assert arm_alone(room, q).joints == room.joints[3:] and arm_alone(room, q).base is None


def test_poses_are_reached_without_driving_if_the_arm_is_long_enough() -> None:
    room = scene()
    q = room.keyframes["ready"]
    near = gp.PoseGoal.from_tool(q, room, translation=[0.0, 0.05, 0.0])
    (found, *_) = reached_poses(near, room, q, count=2, seed=0)
    np.testing.assert_array_equal(found[:3], q[:3])
    X = near.X_WT.copy()
    X[:2, 3] = -1.4, 0.2
    (found,) = reached_poses(gp.PoseGoal(X), room, q, count=1, seed=0)
    assert np.linalg.norm(found[:2] - q[:2]) > 0.3
    np.testing.assert_allclose(room.pose(found), X, atol=1e-5)


def test_grasps_are_found_where_the_base_can_stand() -> None:
    state, motions = action_state(gp.Job(scene()).place("can", at=[-1.4, 0.1, 0.74]))
    here = pose_key(state.pose("can"))
    assert next(motions.grasps(state, "can", [here]), None) is not None


def test_a_base_without_an_arm_is_refused() -> None:
    with pytest.raises(SettingError, match="arm"):
        gp.Job(gp.load_scene("apartment"))


@pytest.mark.long
def test_a_fetch_carries_a_can_from_one_table_to_the_other() -> None:
    result = gp.plan_job(gp.Job(scene()).place("can", at=[-1.4, 0.1, 0.74]), 0.3, grasps=2, iterations=1)
    assert result.status is JobStatus.SOLVED and result.order == ("can",)
    pieces = [piece for step in result.unwrap() for piece in step.pieces]
    for piece, following in pairwise(pieces):
        np.testing.assert_allclose(piece.trajectory.q[-1], following.trajectory.q[0], atol=1e-9)
    for piece in pieces:
        assert gp.verify(piece.trajectory, piece.scene).passed, piece.label
        drives = np.ptp(piece.trajectory.q[:, :3], axis=0).max() > 1e-9
        assert drives == (piece.label in ("transit", "carry")), piece.label
    end = pieces[-1].scene.data_at(pieces[-1].trajectory.q[-1]).body("can").xpos
    np.testing.assert_allclose(end, [-1.4, 0.1, 0.74], atol=2e-3)
    validated = fb.validate_job(result, "drop/*/severe", n=4)
    assert {motion.label for motion in validated.motions} == {"lift", "carry", "lower"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("action", "driving"),
    [(gp.Open("drawer", handle="drawer_handle"), ["transit"]), (gp.Pour("kettle", into="pot"), ["transit", "carry"])],
)
def test_the_base_stands_while_the_arm_opens_a_drawer_or_pours(action: Action, driving: list[str]) -> None:
    job = gp.Job(gp.load_scene(KITCHEN)).place("mug", at=[-1.4, 0.3, 0.74]).allow(action)
    state, motions = action_state(job)
    deeds = (action.motion(state, choice, motions) for choice in action.candidates(state, motions))
    deed = next(deed for deed in deeds if isinstance(deed, Deed))
    at = state.q
    for piece in (piece for _, _, pieces in deed.steps for piece in pieces):
        np.testing.assert_allclose(piece.trajectory.q[0], at, atol=1e-9)
        assert gp.verify(piece.trajectory, piece.scene).passed, piece.label
        drives = np.ptp(piece.trajectory.q[:, :3], axis=0).max() > 1e-9
        assert drives == (piece.label in driving), piece.label
        at = piece.trajectory.q[-1]
    if isinstance(action, gp.Open):
        np.testing.assert_allclose(deed.state.pose("mug")[:3, 3], [1.19, 0.0, 0.57], atol=1e-6)
