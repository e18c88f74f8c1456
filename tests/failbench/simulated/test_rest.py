"""A carried object sleeps where it came to rest, and never in the air."""

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from motions import Drop, execution

from failbench import RolloutRequest, SimSettings, rollout_steps
from failbench.simulated.rest import let_sleep

HORIZON = 0.8


@dataclass(frozen=True, kw_only=True)
class LateDrop(Drop):
    """A fault that opens the gripper after the object has been at rest in it for long."""

    NAME = "late_drop"
    PERIOD = 0.01
    wait: float = 0.3

    def apply(self, plant, level):
        if plant.time >= self.wait - 1e-9:
            plant.release()


def trace(done, fault, onset):
    """Return the carried object's height and whether it sleeps, after each step."""
    body = done.world.carried_body
    tree = done.world.model.body_treeid[body]
    rows = [
        (data.qpos[done.world.model.jnt_qposadr[done.world.model.body_jntadr[body]] + 2], data.tree_asleep[tree] >= 0)
        for _, data in rollout_steps(done, RolloutRequest(fault=fault, onset=onset, seed=0), horizon=HORIZON)
    ]
    return np.array(rows)


@pytest.mark.parametrize("grasp", ["fingers", "weld"])
def test_a_sleeping_object_falls_when_released(grasp):
    done = execution(settings=SimSettings(grasp=grasp))
    height, asleep = trace(done, LateDrop(), done.duration + 1.0).T
    released = round(LateDrop().wait / done.dt)
    assert np.ptp(height[:released]) < 1e-3
    assert height[-1] < height[0] - 0.03
    fallen = int(np.argmax(height < height[0] - 0.03))
    assert not asleep[:fallen].any()


def test_an_object_that_lies_still_sleeps():
    done = execution()
    height, asleep = trace(done, Drop(), done.duration).T
    assert asleep[-1]
    first = int(np.argmax(asleep))
    assert np.all(height[first:] == height[first])


def test_only_released_objects_may_sleep():
    done = execution()
    world = done.world
    data = mujoco.MjData(world.model)
    mujoco.mj_setState(world.model, data, done.states[0], mujoco.mjtState.mjSTATE_INTEGRATION)
    mujoco.mj_kinematics(world.model, data)
    held, lost = data.xpos.copy(), data.xpos.copy()
    lost[world.carried_body, 2] -= 0.1
    policy = np.tile(world.model.tree_sleep_policy, (2, 1))
    let_sleep(world, np.stack([held, lost]), policy)
    tree = world.model.body_treeid[world.carried_body]
    expected = np.tile(world.model.tree_sleep_policy, (2, 1))
    expected[1, tree] = int(mujoco.mjtSleepPolicy.mjSLEEP_ALLOWED)
    np.testing.assert_array_equal(policy, expected)
    assert expected[0, tree] == int(mujoco.mjtSleepPolicy.mjSLEEP_NEVER)
