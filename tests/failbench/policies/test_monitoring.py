"""A monitor in the loop: healthy episodes, faults of all kinds, and the reactions it starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import graceful_plan as gp
from failbench.fault.registry import faults
from failbench.policies import (
    BrakeOnFailure,
    OpenLoop,
    PolicySettings,
    PreparedStop,
    SensorErrors,
    StopOnFailure,
    Watch,
    evaluate,
    healthy_records,
    monitored,
    policy_task,
    roll_out,
    scripted,
    varied_task,
)
from failbench.policies.policy import PolicyError
from failbench.recording.records import RolloutRequest
from graceful_plan.exceptions import SettingError
from graceful_plan.timing.dynamics import RobotDynamics

SENSORS = SensorErrors()


@pytest.fixture(scope="module")
def task():
    return policy_task("tabletop_l1/green_to_blue", PolicySettings(noise=0.0, period=0.01, limit=1.4, horizon=1.4))


def following(task, seed):
    return OpenLoop(task.straight, task.settings.period)


@pytest.fixture(scope="module")
def watch(task):
    records = [r for k in range(13) for r in healthy_records(varied_task(task, k), following, [k], sensors=SENSORS)]
    return Watch(limits=gp.MonitorLimits.fit(records), sensors=SENSORS)


def episodes(task, watch, jobs, recovery=None, seed=50):
    stop = StopOnFailure() if recovery is None else recovery
    return roll_out(varied_task(task, seed), monitored(following, stop, watch), [seed] * len(jobs), jobs)


def test_healthy_episodes_of_other_robots_raise_no_alarm(task, watch):
    for seed in (100, 101, 102):
        assert [rollout.notice for rollout in episodes(task, watch, [None], seed=seed)] == [None]


def test_every_kind_of_fault_is_noticed(task, watch):
    kinds = {name: fault(degree="critical") for name, fault in faults().items()}
    jobs = [RolloutRequest(fault=fault, onset=0.3, seed=3) for fault in kinds.values()]
    found = dict(zip(kinds, episodes(task, watch, jobs), strict=True))
    late = {name: rollout.notice for name, rollout in found.items() if rollout.notice is None}
    assert late == {}
    for name, rollout in found.items():
        assert rollout.notice.time >= 0.3, name
        assert rollout.notice.time <= 0.3 + (0.9 if name in ("weak_grip", "battery_degradation") else 0.5), name
    assert found["gripper_failure"].notice.where == "gripper"


def test_the_same_seed_gives_the_same_episode(task, watch):
    job = RolloutRequest(fault=faults()["noise"](degree="severe"), onset=0.3, seed=3)
    first, second = (episodes(task, watch, [job])[0] for _ in range(2))
    assert first.notice == second.notice and first.events == second.events and first.distance == second.distance


@pytest.mark.parametrize("kind", [StopOnFailure, BrakeOnFailure, "prepared"])
def test_reactions_stop_the_arm_after_the_notice(task, watch, kind):
    motion = task.straight
    recovery = (
        PreparedStop(motion=motion, stops=gp.plan_stops(motion, task.scene, every=0.1, constraints=[]))
        if kind == "prepared"
        else kind()
    )
    job = RolloutRequest(fault=faults()["noise"](degree="moderate", targets=("panda/joint7",)), onset=0.3, seed=3)
    stopped, healthy = episodes(task, watch, [job], recovery)[0], episodes(task, watch, [None])[0]
    assert stopped.notice is not None and not stopped.success
    assert stopped.distance[0] > healthy.distance[0] + 0.05


def test_sensors_delay_lose_and_blur_samples(task):
    exact = SensorErrors(position=0.0, speed=0.0, torque=0.0, opening=0.0, jitter=0.0, delay=0.0, lost=0.0)
    clean, late, lossy = (
        healthy_records(task, following, [0], sensors=sensors)[0]
        for sensors in (exact, replace(exact, delay=0.05), replace(exact, lost=0.5))
    )
    periods = len(clean.t)
    assert len(late.t) == periods - 5 and 0.3 * periods < len(lossy.t) < 0.7 * periods
    np.testing.assert_array_equal(clean.q[:-5], late.q)
    assert np.isnan(clean.torque[0]).all() and np.isfinite(clean.torque[1:]).all()
    assert clean.opening[0] > 0.0  # the fingers hold an object
    noisy = healthy_records(task, following, [0], sensors=replace(exact, position=0.01))[0]
    assert np.std(noisy.q - clean.q) == pytest.approx(0.01, rel=0.1)


def test_torques_of_a_healthy_robot_are_those_of_its_dynamics(task):
    record = healthy_records(task, following, [0], sensors=replace(SENSORS, torque=0.0))[0]
    state = task.straight.at(np.array([0.7]))
    wanted = RobotDynamics(task.scene)(state.q[0], state.qd[0], state.qdd[0])
    row = int(np.abs(record.t - 0.7).argmin())
    assert np.abs(record.torque[row - 5 : row + 5].mean(axis=0) - wanted).max() < 3.0  # of 87 N m


def test_varied_robots_differ_from_their_scene_within_the_share(task):
    varied, other = varied_task(task, 1, 0.2), varied_task(task, 2, 0.2)
    ratio = varied.world.model.body_mass / np.maximum(task.world.model.body_mass, 1e-12)
    changed = ratio[(task.world.model.body_mass > 0.0) & (ratio != 1.0)]
    assert len(changed) >= 8 and changed.min() >= 0.8 and changed.max() <= 1.2 and np.ptp(changed) > 0.1
    assert not np.array_equal(varied.world.model.body_mass, other.world.model.body_mass)
    assert varied.scene is task.scene
    np.testing.assert_array_equal(varied_task(task, 1, 0.0).world.model.body_mass, task.world.model.body_mass)
    for share in (-0.1, 1.0, np.nan):
        with pytest.raises(SettingError):
            varied_task(task, 1, share)


def test_evaluations_with_a_monitor_watch_healthy_episodes_too(task, watch):
    report = evaluate(task, following, "drop/*/critical", n=2, recovery=StopOnFailure(), watch=watch, threads=1)
    assert "when the monitor notices" in report.recovery
    assert [rollout.notice for rollout in report.healthy_rollouts] == [None, None]
    noticed = [rollout.notice for rollouts in report.rollouts.values() for rollout in rollouts]
    assert any(notice is not None for notice in noticed)


def test_misuse_is_refused(task, watch):
    with pytest.raises(SettingError):
        evaluate(task, following, "drop/*/critical", n=1, watch=watch)
    with pytest.raises(PolicyError):
        roll_out(task, monitored(scripted, StopOnFailure(), watch), [0])
    for bad in ({"position": -1.0}, {"lost": 1.0}, {"delay": np.nan}):
        with pytest.raises(SettingError):
            SensorErrors(**bad)
