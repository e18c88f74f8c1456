"""Recovery after a fault is noticed, and its use of the brakes."""

from __future__ import annotations

import numpy as np
import pytest

import graceful_plan as gp
from failbench.fault.registry import faults
from failbench.policies import recovery
from failbench.policies.adapters import OpenLoop, scripted
from failbench.policies.policy import Acting, PolicyError
from failbench.policies.recovery import ReplanOnFailure, StopOnFailure, recovering
from failbench.policies.rollouts import roll_out
from failbench.policies.task import PolicySettings, policy_task
from failbench.recording.records import RolloutRequest


def following(task, seed):
    return OpenLoop(task.straight, task.settings.period)


HARMLESS = faults()["noise"](degree="minor", duration=0.01, targets=("panda/joint7",))


class Watched:
    """A policy that records its observations."""

    def __init__(self, policy, seen):
        self.policy, self.seen = policy, seen

    @property
    def action(self):
        return self.policy.action

    def __call__(self, observation):
        self.seen.append(observation)
        return self.policy(observation)


def watch_recovery(task, recovery, delay=0.1, onset=0.3, fault=HARMLESS, factory=following):
    """Return the onset, observation times, measured and desired joint positions, and observations of an episode."""
    seen = []
    inner = recovering(factory, recovery, onset, delay)
    job = RolloutRequest(fault=fault, onset=onset, seed=0)
    rollout = roll_out(task, lambda task, seed: Watched(inner(task, seed), seen), [0], [job])[0]
    return rollout, np.array([one.time for one in seen]), np.array([one.q for one in seen]), seen


def test_a_stop_ends_where_its_deceleration_ends_it(easy):
    rollout, time, q, _ = watch_recovery(easy, StopOnFailure(brakes=False))
    after = q[time > 0.4 + 0.35]
    assert not rollout.success
    assert np.ptp(after, axis=0).max() < 5e-3
    began = q[np.searchsorted(time, 0.4 - 1e-9)]
    speed = (began - q[np.searchsorted(time, 0.38 - 1e-9)]) / 0.02
    braking = (np.abs(speed) / easy.scene.limits.acceleration).max()
    np.testing.assert_allclose(after[-1] - began, 0.5 * speed * braking, atol=0.02)


def test_replanning_arrives_after_its_planning_time():
    task = policy_task("tabletop_l1/green_to_blue", PolicySettings(noise=0.0, limit=3.0, horizon=0.3))
    rollout, time, q, _ = watch_recovery(task, ReplanOnFailure(w=0.0, iterations=20, time_limit=0.5))
    assert rollout.success
    waiting = q[(time > 0.4 + 0.35) & (time < 0.4 + 0.5)]
    assert np.ptp(waiting, axis=0).max() < 5e-3
    assert rollout.reached > 0.9 + 0.3


def test_a_stop_does_not_depend_on_readings(easy):
    """A stop must not start from a noisy speed reading, which would throw the arm about."""
    wild = faults()["noise"](degree="critical", targets=("all",), ramp=0.0)
    calm, broken = (watch_recovery(easy, StopOnFailure(brakes=False), fault=fault)[3] for fault in (HARMLESS, wild))
    assert np.abs(calm[-1].q - broken[-1].q).max() > 0.01
    np.testing.assert_array_equal([one.q_desired for one in calm[:60]], [one.q_desired for one in broken[:60]])


def test_a_recovery_starts_from_the_desired_state_of_another_kind_of_policy(easy):
    """The recovery's actions are joint positions, even after a policy with tool poses; rows have equal length."""
    _, time, _, seen = watch_recovery(easy, StopOnFailure(brakes=False), factory=scripted)
    wanted = np.array([one.q_desired for one in seen])
    change = np.abs(np.diff(wanted, n=2, axis=0)).max(axis=1)[time[2:] > 0.4 - 1e-9]
    most = easy.scene.limits.acceleration.max() * easy.settings.period**2
    assert change.max() < 1.01 * most


@pytest.mark.parametrize("onset", [0.1, 0.3])
def test_brakes_hold_a_dead_joint_at_any_onset(easy, onset):
    dead = faults()["complete_shutdown"](degree="critical", targets=("all",))

    def fallen(kind, begins=0.2):
        class Braking:
            action = "joint_position"

            def __call__(self, seen):
                self.action = kind if seen.time > begins - 1e-9 else "joint_position"
                return np.zeros(0) if self.action == "brake" else easy.start

        seen = []
        roll_out(
            easy, lambda task, seed: Watched(Braking(), seen), [0], [RolloutRequest(fault=dead, onset=onset, seed=0)]
        )
        return np.array([one.q for one in seen if one.time > 0.3])

    assert np.ptp(fallen("joint_position"), axis=0).max() > 0.3
    assert np.ptp(fallen("brake"), axis=0).max() < 2e-3


def test_replanning_needs_working_joints_and_equal_stops_share_a_plan(monkeypatch):
    task = policy_task("tabletop_l1/green_to_blue", PolicySettings(noise=0.0, limit=1.6, horizon=0.3))
    calls, plan = [], gp.plan
    monkeypatch.setattr(recovery.gp, "plan", lambda *args, **rest: calls.append(args) or plan(*args, **rest))
    settings = ReplanOnFailure(w=0.0, iterations=20, time_limit=0.3)
    stuck = faults()["stuck_position"](degree="critical", targets=("panda/joint1",))
    _, _, q, _ = watch_recovery(task, settings, fault=stuck)
    assert not calls and np.ptp(q[-30:], axis=0).max() < 2e-3
    for fault in (HARMLESS, faults()["bias_drift"](degree="minor")):
        watch_recovery(task, settings, fault=fault)
    assert len(calls) == 1


def test_policies_of_actuator_commands_cannot_be_relieved(easy):
    with pytest.raises(PolicyError, match="sends actuator commands"):
        recovering(lambda task, seed: Acting(following, "command"), StopOnFailure(), 0.3, 0.1)(easy, 0)
