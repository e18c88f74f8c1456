"""A policy that sends the executor's commands reproduces the execution, healthy and with every fault."""

from __future__ import annotations

import numpy as np
import pytest

from failbench.fault.fault import Fault
from failbench.fault.registry import faults, reactions
from failbench.policies.adapters import executor
from failbench.policies.batch import EpisodeBatch
from failbench.policies.task import PolicyTask
from failbench.recording.records import RolloutRequest
from failbench.rollouts.execution import Execution
from failbench.rollouts.single import rollout_steps
from failbench.simulated.states import CHECKPOINT
from graceful_plan.exceptions import UnsupportedError

_ROBOT = 1e-9
"""Tolerance for joints [rad]."""
_REST = 1e-5
"""Tolerance for objects at rest [m], which settle again from the harness's checkpoint."""
ONSET = 0.3
QUICK = ("noise", "control_delay", "dropout", "complete_shutdown")
"""One fault per mechanism; the others are long tests."""


def positions(task: PolicyTask, execution: Execution, job: RolloutRequest | None) -> tuple[np.ndarray, int]:
    """Return positions of everything at the beginning and after each step, and the onset's step."""
    batch, act = EpisodeBatch(task, 1), executor(execution)(task, 0)
    episode = batch.begin(0, np.random.default_rng(0), job)
    found = [episode.qpos.copy()]
    while not episode.timed_out:
        batch.advance({0: ("command", act(episode.observation))})
        found.append(episode.qpos.copy())
    return np.array(found), episode.onset


def test_a_policy_with_the_executors_commands_reproduces_the_healthy_run(exact, execution):
    found, _ = positions(exact, execution, None)
    nq = exact.world.model.nq
    states = execution.states[: len(found) // CHECKPOINT + 1, 1 : 1 + nq]
    assert len(states) > 70
    np.testing.assert_allclose(found[::CHECKPOINT][: len(states)], states, rtol=0.0, atol=_ROBOT)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in faults()]
)
def test_every_fault_reproduces_the_rollout(exact, execution, name):
    compare(exact, execution, faults()[name](degree="severe"))


@pytest.mark.long
@pytest.mark.parametrize(
    "fault",
    [faults()["noise"](degree="critical", duration=0.1), faults()["voltage_drop"](degree="severe", ramp=0.05)],
    ids=["ends", "ramp"],
)
def test_temporary_and_growing_faults_reproduce_the_rollout(exact, execution, fault):
    compare(exact, execution, fault)


def compare(task: PolicyTask, execution: Execution, fault: Fault) -> None:
    job = RolloutRequest(fault=fault, onset=ONSET, seed=5)
    found, onset = positions(task, execution, job)
    horizon = (len(found) - 1 - onset) * execution.dt
    expected = np.array([data.qpos.copy() for _, data in rollout_steps(execution, job, horizon=horizon)])
    joints = task.world.robot.qpos
    assert onset == round(ONSET / execution.dt)
    assert np.abs(found[onset + 50] - found[onset]).max() > 1e-3
    loose = fault.CATEGORY in ("end_effector", "power")  # falling objects tumble, which amplifies rounding
    found = found[onset + 1 :]
    np.testing.assert_allclose(found[:, joints], expected[:, joints], rtol=0.0, atol=1e-4 if loose else _ROBOT)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-3 if loose else _REST)


def test_a_stop_brakes_straight_ahead(easy):
    """The planned commands after a stop are unknown for policies, so a stop does not use them."""
    fast = np.clip(easy.goal - easy.start, -0.5, 0.5)
    ends = []
    for later in (fast, np.zeros_like(fast)):
        batch = EpisodeBatch(easy, 1)
        stop = reactions()["protective_stop"](degree="severe")
        episode = batch.begin(0, np.random.default_rng(0), RolloutRequest(fault=stop, onset=0.2, seed=0))
        while episode.time < 0.5:
            batch.advance({0: ("joint_velocity", fast if episode.time < 0.2 - 1e-9 else later)})
        ends.append(episode.qpos[easy.world.robot.qpos].copy())
    moved = ends[0] - easy.start
    assert np.abs(moved).max() > 0.02
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    assert np.corrcoef(moved, fast)[0, 1] > 0.99


def test_a_policy_has_no_motion_to_prepare_stops_along(easy):
    batch = EpisodeBatch(easy, 1)
    stop = reactions()["protective_stop"](prepared=0.1)
    episode = batch.begin(0, np.random.default_rng(0), RolloutRequest(fault=stop, onset=0.1, seed=0))
    with pytest.raises(UnsupportedError, match="planned motion"):
        while episode.time < 0.2:
            batch.advance({0: ("joint_velocity", np.full_like(easy.start, 0.1))})
