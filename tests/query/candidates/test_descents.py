"""Final motions of descents: their clearance."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.constraints.scene_constraints import SceneConstraints, default_constraints
from graceful_plan.query.candidates.descents import TRACKING_CLEARANCE, stray
from graceful_plan.scene.placement import Placement
from sizes import first_quick


@pytest.mark.parametrize("name", first_quick(["corner_to_blue", "near_to_blue", "green_to_blue"]))
def test_motions_keep_the_tracking_clearance(name: str) -> None:
    task = gp.load_scene("tabletop_l3").tasks[name]
    found = gp.plan(task.start, task.goal, task.scene, w=3.0, iterations=30, seed=1)
    clearance = gp.clearance(found.unwrap().sample(0.004).q, task.scene)
    assert min(clearance[0], clearance[-1]) > 2.0 * TRACKING_CLEARANCE  # there is space
    assert clearance.min() >= 0.75 * TRACKING_CLEARANCE


def _clearance_of_held(scene, q):
    """Return the least exact distance of the carried object from obstacles [m], by configuration."""
    held, placement = scene.components["carried"].geoms, Placement(scene)
    pairs = [pair for pair in scene.collision_pairs().tolist() if set(pair) & set(held)]
    robot = scene.robot_bodies
    pairs = [pair for pair in pairs if not {int(scene.model.geom_bodyid[g]) for g in pair} & robot]
    return [
        min(mujoco.mj_geomDistance(scene.model, data, a, b, 0.1, None) for a, b in pairs)
        for data in (placement.place(row) for row in q)
    ]


@pytest.mark.parametrize(("scene_name", "name"), [("dining_table", "pass_bottle"), ("kitchen_counter", "move_oil")])
def test_objects_on_a_long_lever_keep_more_clearance(scene_name: str, name: str) -> None:
    """Also for vessels that are kept level."""
    task = gp.load_scene(scene_name).tasks[name]
    assert stray(task.scene) > 2.0 * TRACKING_CLEARANCE > TRACKING_CLEARANCE == stray(gp.load_scene("tabletop"))
    found = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=60).unwrap()
    clear = _clearance_of_held(task.scene, found.sample(0.01).q)
    assert min(clear[0], clear[-1]) > 2.0 * stray(task.scene)  # there is space
    assert min(clear) >= stray(task.scene)


def test_room_tightens_no_tilt() -> None:
    scene = gp.load_scene("desk").tasks["bring_coffee"].scene
    held = SceneConstraints(scene, default_constraints(scene))
    q = np.random.default_rng(0).uniform(*scene.limits.position.T, (2000, 7))
    wide, plain, obstacles = held.with_room(0.05), held.kernels, gp.clearance(q, scene)
    assert held.with_room(0.0) is plain
    tilted = (plain.clearance(q) < 0.0) & (obstacles > 0.06)
    np.testing.assert_array_equal(wide.clearance(q[tilted]), plain.clearance(q[tilted]))
    near = wide.free(q) != plain.free(q)
    assert near.any() and (obstacles[near] < 0.06).all()
