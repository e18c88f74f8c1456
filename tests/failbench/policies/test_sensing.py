"""Observations of a policy with a broken sensor, against the fault's definition."""

from __future__ import annotations

import numpy as np
import pytest

from failbench.fault.fault import Fault
from failbench.fault.registry import BiasDrift, ControlDelay, DeadZone, Dropout, LooseJoint, Noise, ScaleError
from failbench.policies.batch import EpisodeBatch
from failbench.policies.policy import Observation
from failbench.policies.task import PolicyTask
from failbench.recording.records import RolloutRequest

ONSET = 0.1
JOINT = 3


def watched(
    task: PolicyTask, fault: Fault | None, until: float = 0.5
) -> list[tuple[Observation, np.ndarray, np.ndarray]]:
    """Let the robot move; return observations with the true positions and velocities."""
    batch, robot = EpisodeBatch(task, 1), task.world.robot
    job = None if fault is None else RolloutRequest(fault=fault, onset=ONSET, seed=3)
    episode = batch.begin(0, np.random.default_rng(0), job)
    data = batch.episodes[0]._live
    found = []
    while episode.time < until - 1e-9:
        batch.advance({0: ("joint_velocity", np.clip(task.goal - task.start, -0.4, 0.4))})
        found.append((episode.observation, data.qpos[robot.qpos].copy(), data.qvel[robot.dofs].copy()))
    return found


def struck(task: PolicyTask) -> tuple[str, ...]:
    return (task.world.robot.joints[JOINT],)


def test_a_healthy_robot_sees_the_truth(easy):
    for seen, q, qd in watched(easy, None, 0.2):
        np.testing.assert_array_equal(seen.q, q)
        np.testing.assert_array_equal(seen.qd, qd)


def test_readings_of_a_loose_joint_are_exact(easy):
    for seen, q, _ in watched(easy, LooseJoint(degree="severe", targets=struck(easy))):
        np.testing.assert_array_equal(seen.q, q)


def test_a_wrong_scale(easy):
    fault = ScaleError(degree="critical", targets=struck(easy), ramp=0.0)
    for seen, q, qd in watched(easy, fault):
        factor = np.ones(len(q))
        factor[JOINT] = 1.1 if seen.time > ONSET + 1e-9 else 1.0
        np.testing.assert_allclose(seen.q, factor * q, atol=1e-9)
        np.testing.assert_allclose(seen.qd, factor * qd, atol=1e-9)


def test_drift_grows_at_its_rate(easy):
    found = watched(easy, BiasDrift(degree="critical", targets=struck(easy), ramp=0.0))
    error = [(seen.time, (seen.q - q)[JOINT]) for seen, q, _ in found if seen.time > ONSET + 1e-9]
    slope = np.polyfit(*zip(*error, strict=True), 1)[0]
    assert abs(slope) == pytest.approx(0.4, rel=1e-6)
    assert all(np.delete(seen.q - q, JOINT).any() == 0 for seen, q, _ in found)


def test_noise_has_the_stated_deviation(easy):
    fault = Noise(degree="critical", targets=("all",))
    errors = np.array([seen.q - q for seen, q, _ in watched(easy, fault, 1.5) if seen.time > ONSET + 1e-9])
    assert errors.std() == pytest.approx(0.1, rel=0.15)


def test_a_dead_zone_shows_at_most_its_width(easy):
    fault = DeadZone(degree="severe", targets=struck(easy))
    error = np.array([(seen.q - q)[JOINT] for seen, q, _ in watched(easy, fault)])
    assert np.abs(error).max() <= 0.06 + 0.002  # plus the motion within one step
    assert np.abs(error).max() > 0.03


def test_readings_stand_during_gaps(easy):
    fault = Dropout(degree="critical", targets=struck(easy))
    found = watched(easy, fault)
    first = [seen for seen, _, _ in found if ONSET + 1e-9 < seen.time < ONSET + 0.16]
    at_onset = next(q for seen, q, _ in found if abs(seen.time - ONSET) < 1e-9)
    assert len(first) >= 7
    for seen in first:
        assert seen.q[JOINT] == at_onset[JOINT]
        assert seen.qd[JOINT] == first[0].qd[JOINT]


def test_a_delay_makes_everything_old_but_the_clock(easy):
    found = watched(easy, ControlDelay(degree="severe", targets=("all",), ramp=0.0))
    truth = {round(seen.time, 6): q for seen, q, _ in found}
    late = [seen for seen, _, _ in found if seen.time > ONSET + 0.12]
    assert late
    for seen in late:
        np.testing.assert_array_equal(seen.q, truth[round(seen.time - 0.1, 6)])
