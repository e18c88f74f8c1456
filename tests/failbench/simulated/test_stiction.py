"""Held objects stay where they stick while the load is within friction, and slip where it is not."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from grippers import SLIDES, armed, below
from numpy.typing import ArrayLike

import graceful_plan as gp
from failbench import ObjectLost, build_world, execute
from failbench.policies.batch import EpisodeBatch
from failbench.policies.task import PolicySettings, policy_task

_STAYS = 2e-3
"""Largest displacement of an object that sticks [m]."""
_FREQUENCY = 2.0
"""Of shaking [Hz]."""


def slick() -> gp.Scene:
    """Return an arm whose fingers hold a block by friction of 0.1: 7 N for 3 N of weight."""
    spec = armed(SLIDES).spec.copy()
    for geom in spec.geoms:
        geom.friction = [0.1, 0.005, 0.0001]
    scene = gp.Scene.from_mjcf(spec, robot="a/", tool="g/tool", velocity=[9.0], acceleration=[120.0])
    return scene.attach("block", X_TO=below(0.02), fingers=gp.Opening())


def shaken(q: ArrayLike, acceleration: float, seconds: float, joints: tuple[str, ...]) -> gp.Trajectory:
    """Return the first joint shaken at an amplitude [rad/s^2] that rises and falls smoothly, from rest to rest."""
    t, w = np.arange(0.0, seconds + 1e-9, 0.005), 2.0 * np.pi * _FREQUENCY
    rise = np.clip(t / 2.0, 0.0, 1.0)
    envelope = rise**3 * (10.0 - 15.0 * rise + 6.0 * rise**2)
    x = acceleration / w**2 * envelope * envelope[::-1] * np.sin(w * t)
    xd = np.gradient(x, t)
    xd[[0, -1]] = 0.0
    moves = np.eye(1, np.size(q))
    q_t, qd, qdd = (np.outer(values, moves) for values in (x, xd, np.gradient(xd, t)))
    return gp.Trajectory(t, np.asarray(q) + q_t, qd, qdd, joints)


@pytest.mark.parametrize("seconds", [5.0, pytest.param(60.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("acceleration", [0.0, 40.0])
def test_a_block_stays_while_grasp_holds(acceleration: float, seconds: float) -> None:
    scene = slick()
    motion = shaken([0.0], acceleration, seconds, scene.joints)
    check = gp.verify(motion, scene, constraints=[gp.GraspHolds(share=1.0)]).checks["grasp_holds"]
    assert check.passed and 0.4 < check.worst < 0.6
    assert execute(motion, build_world(scene), tolerance=0.2).slip < _STAYS


def test_a_block_slips_beyond_what_the_grasp_holds() -> None:
    scene = slick()
    motion = shaken([0.0], 100.0, 5.0, scene.joints)
    assert not gp.verify(motion, scene, constraints=[gp.GraspHolds(share=1.0)]).checks["grasp_holds"].passed
    with pytest.raises(ObjectLost, match="slipped"):
        execute(motion, build_world(scene), tolerance=0.2)


@pytest.mark.parametrize("joint", [0, 3])
@pytest.mark.parametrize("seconds", [5.0, pytest.param(60.0, marks=pytest.mark.long)])
def test_a_mug_stays_in_a_hand_that_swings(joint: int, seconds: float) -> None:
    task = gp.load_scene("desk").tasks["bring_coffee"]
    order = np.roll(np.eye(len(task.scene.joints)), joint, axis=1)
    still = shaken(np.zeros(len(order)), 10.0, seconds, task.scene.joints)
    q = np.atleast_2d(task.start)[0]
    motion = gp.Trajectory(still.t, q + still.q @ order, still.qd @ order, still.qdd @ order, still.joints)
    world = build_world(task.scene)
    assert execute(motion, world).slip < _STAYS


@pytest.mark.long
def test_a_policy_that_swings_for_a_minute_keeps_its_object() -> None:
    task = policy_task("tabletop_l1/green_to_blue", PolicySettings(noise=0.0, limit=60.0))
    batch = EpisodeBatch(task, 1)
    episode = batch.begin(0, np.random.default_rng(0))
    model, tool = task.world.model, task.world.model.site(task.world.scene.tool).id
    places = []
    for period in range(3000):
        swing = 0.2 * np.sin(np.pi * 0.02 * period) * np.eye(len(task.start))[0]
        batch.advance({0: ("joint_position", task.start + swing)})
        data = mujoco.MjData(model)
        data.qpos[:] = episode.qpos
        mujoco.mj_kinematics(model, data)
        R_WT = data.site_xmat[tool].reshape(3, 3)
        places.append(R_WT.T @ (data.xpos[task.world.carried_body] - data.site_xpos[tool]))
    assert np.linalg.norm(np.array(places) - places[0], axis=1).max() < _STAYS
