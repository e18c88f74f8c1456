"""Distances of straight motions from neighbours: they are kept if a choice keeps them, and told if none does."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from order_jobs import action_state, job_scene

import graceful_plan as gp
from graceful_plan.job.actions import Carry, Deed, Transport
from graceful_plan.job.job_result import JobResult, JobStatus
from graceful_plan.job.job_state import pose_key
from graceful_plan.job.motions import JobMotion, Refusal
from graceful_plan.query.candidates.descents import TRACKING_CLEARANCE

_STRAIGHT = ("approach", "lift", "lower", "retreat")
_SAMPLES = 40


def _glasses(apart: float) -> gp.Scene:
    return job_scene("tray").edit(move={"glass1": [0.4, -0.47, 0.4], "glass2": [0.4 + apart, -0.47, 0.4]})


def _job(apart: float) -> gp.Job:
    return gp.Job(_glasses(apart)).place("glass1", at=[0.42, 0.35, 0.4])


def _distance(piece: JobMotion, thing: str) -> float:
    """Return the least distance of the robot and its object from a body along a motion, by MuJoCo [m]."""
    scene, model = piece.scene, piece.scene.model
    mine = scene.robot_bodies | scene.held_bodies
    others = [g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name == thing]
    pairs = [(a, b) for a, b in scene.collision_pairs().tolist() if int(model.geom_bodyid[a]) in mine and b in others]
    least = np.inf
    for t in np.linspace(piece.trajectory.t[0], piece.trajectory.t[-1], _SAMPLES):
        data = scene.data_at(piece.trajectory.at(t).q)
        least = min(least, *(mujoco.mj_geomDistance(model, data, a, b, 0.1, None) for a, b in pairs))
    return least


def _straight_distance(result: JobResult, thing: str) -> float:
    pieces = [piece for step in result.unwrap() for piece in step.pieces if piece.label in _STRAIGHT]
    return min(_distance(piece, thing) for piece in pieces)


@pytest.mark.parametrize("apart", [0.08, 0.09])
def test_straight_motions_keep_away_from_a_neighbour(apart: float) -> None:
    result = gp.plan_job(_job(apart), 0.0, grasps=2, iterations=4)
    assert _straight_distance(result, "glass2") >= TRACKING_CLEARANCE and not result.detail


def test_where_every_choice_is_close_to_a_neighbour_the_job_is_possible_and_tells_it() -> None:
    state, motions = action_state(_job(0.09))
    to = _job(0.09).goals["glass1"].at
    assert to is not None
    close = next(
        grasp
        for grasp in motions.grasps(state, "glass1", [pose_key(to)])
        if not isinstance(near := motions.nearness(state, "glass1", grasp, pose_key(to)), Refusal)
        and 0.0 < near.moving < TRACKING_CLEARANCE
    )
    result = gp.plan_job(_job(0.09).use("glass1", [close]), 0.0, iterations=4)
    assert result.status is JobStatus.SOLVED and _straight_distance(result, "glass2") < TRACKING_CLEARANCE
    assert "'glass2'" in result.detail and result.detail in str(result)


def test_a_place_beside_a_neighbour_is_used_only_if_there_is_no_other() -> None:
    scene = job_scene("tray").edit(move={"glass1": [0.4, -0.47, 0.4], "glass2": [0.45, 0.35, 0.4]})
    job = gp.Job(scene).place("glass1", at=[0.4, 0.2, 0.4])
    state, motions = action_state(job)
    X = state.pose("glass1").copy()
    far, near = X.copy(), X.copy()
    far[:3, 3], near[:3, 3] = [0.4, 0.2, 0.4], [0.45 - _width(scene) - 0.001, 0.35, 0.4]
    choices = [Transport("glass1", tuple(map(pose_key, poses))) for poses in ((near,), (near, far))]
    to = pose_key(near)
    grasp = next(
        one
        for one in motions.grasps(state, "glass1", [to])
        if isinstance(choices[0].motion(state, Carry(one, to), motions), Deed)
    )
    refused = choices[1].motion(state, Carry(grasp, to), motions)
    assert isinstance(refused, Refusal) and "'glass2'" in refused.why
    near_job = gp.Job(scene).place("glass1", at=near)
    result = gp.plan_job(near_job, 0.0, grasps=2, iterations=6)
    assert result.status is JobStatus.SOLVED and "'glass2'" in result.detail
    lower = next(piece for step in result.steps for piece in step.pieces if piece.label == "lower")
    assert _distance(lower, "glass2") > 0.0


def _width(scene: gp.Scene) -> float:
    """Return the largest horizontal extent of a glass [m]."""
    return max(2.0 * float(scene.model.geom_size[g][0]) for g in scene.geoms_named("glass1"))
