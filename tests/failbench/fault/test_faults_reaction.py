"""Signatures of the robot's protective stop, against the interrupted motion."""

import dataclasses

import numpy as np
import pytest
from breaking import WELD, Nothing, Record, healthy_run
from mujoco.batch import MODEL_FIELDS

import failbench
import graceful_plan as gp
from failbench import RolloutRequest, rollout_steps, run_rollouts
from failbench.fault.registry import DEGREES, ProtectiveStop, faults, from_document, reactions, to_document
from failbench.rollouts import stops_ahead
from failbench.testing import check_fault
from graceful_plan.exceptions import SettingError


def test_a_stop_is_a_reaction_and_no_fault():
    assert list(reactions()) == ["protective_stop"]
    assert failbench.reactions() is reactions()
    assert not set(reactions()) & set(faults())
    assert ProtectiveStop.CATEGORY == "reaction"
    assert set(ProtectiveStop.FIELDS) <= MODEL_FIELDS


@pytest.mark.parametrize("category", [0, 1])
def test_a_stop_keeps_the_contract_of_faults(category):
    check_fault(ProtectiveStop(category=category))
    check_fault(ProtectiveStop(category=category), healthy_run(WELD))


def braking_time(record):
    """Return the time to stop from the speed at the onset with the degree's deceleration [s]."""
    return np.max(np.abs(record.qd0) / record.robot.acceleration) / record.job.fault.amount


@pytest.mark.parametrize("degree", DEGREES)
def test_a_stop_brakes_along_the_path_with_its_deceleration(degree):
    done = healthy_run()
    record = Record(ProtectiveStop(degree=degree), when=0.5, horizon=1.4)
    needed = braking_time(record)
    assert needed > 0.02
    assert np.ptp(record.q[record.t > needed + 0.15], axis=0).max() < 5e-3  # small oscillations remain
    # While braking, the motion's clock advances by half of that time.
    onset = record.onset_step * record.dt
    end = done.trajectory.at(done.trajectory.t[0] + min(onset + needed / 2.0, done.duration)).q
    assert record.q[-1] == pytest.approx(end, abs=5e-3)
    if needed > 0.1:  # half of the speed is left after half of the time
        half = np.argmin(np.abs(record.t - needed / 2.0))
        assert np.abs(record.qd[half]).max() == pytest.approx(0.5 * np.abs(record.qd0).max(), rel=0.25)


def test_a_stop_stays_on_the_path_of_the_motion():
    done = healthy_run()
    record = Record(ProtectiveStop(degree="moderate"), when=0.4, horizon=0.6)
    fine = done.trajectory.at(np.linspace(done.trajectory.t[0], done.trajectory.t[-1], 4000)).q
    off = np.abs(record.q[:, None] - fine[None]).max(axis=2).min(axis=1)
    assert off.max() < 5e-3


def test_at_rest_nothing_happens():
    record, well = (Record(f, when=1.0, horizon=0.2) for f in (ProtectiveStop(), Nothing()))
    assert record.q == pytest.approx(well.q, abs=1e-4)


@pytest.mark.long
def test_a_ramp_brakes_later():
    hard, soft = (Record(ProtectiveStop(ramp=ramp), when=0.4, horizon=0.8) for ramp in (0.0, 0.2))
    moved = [np.abs(record.q[-1] - record.q0).max() for record in (hard, soft)]
    assert moved[1] > 1.1 * moved[0]
    assert np.abs(soft.qd[-1]).max() < 0.01


def test_brakes_that_close_at_once_stop_each_joint_on_its_own():
    record = Record(ProtectiveStop(category=0), when=0.4, horizon=0.4)
    arm = record.robot.actuators
    assert not record.force[:, arm].any()
    assert np.abs(record.qd0).max() > 0.5
    assert np.abs(record.qd[record.t > 0.1]).max() < 1e-3
    assert record.slip[-1] < 0.02  # the gripper holds


def test_the_robot_goes_on_after_its_time_as_all_faults_do():
    done = healthy_run()
    record = Record(ProtectiveStop(duration=0.1), horizon=0.2)
    meant = done.commands(record.onset_step, len(record.command))
    assert np.array_equal(record.command[50:], meant[50:])


def test_native_rollouts_are_the_plain_loop():
    done = healthy_run()
    jobs = [
        RolloutRequest(fault=ProtectiveStop(category=category, ramp=ramp), onset=0.5 * done.duration, seed=0)
        for category in (0, 1)
        for ramp in (0.0, 0.1)
    ]
    for job, rollout in zip(jobs, run_rollouts(done, jobs, horizon=0.2), strict=True):
        *_, (_, data) = rollout_steps(done, job, horizon=0.2)
        joint = done.world.model.body_jntadr[done.world.carried_body]
        x = data.qpos[done.world.model.jnt_qposadr[joint] :][:7]
        pose = np.concatenate([x[3:7], x[:3]])
        assert any(np.array_equal(pose, seen) for seen in rollout.poses.values())


def test_a_stop_has_a_json_form_and_refuses_other_categories():
    for category in (0, 1):
        fault = ProtectiveStop(category=category, degree="minor")
        assert from_document(to_document(fault)) == fault
    with pytest.raises(SettingError, match=r"category = 2.*0, 1"):
        ProtectiveStop(category=2)
    assert dataclasses.replace(ProtectiveStop(), degree="critical").amount == 2.0


# --- stops planned ahead ----------------------------------------------------------------------------------------------


def test_a_prepared_stop_follows_the_stop_that_was_planned():
    done, every = healthy_run(), 0.1
    record = Record(ProtectiveStop(prepared=every), when=0.5, horizon=1.0)
    onset = record.onset_step * record.dt
    planned = gp.plan_stops(done.trajectory, done.world.scene, every=every).after(done.trajectory.t[0] + onset)
    wanted = done.trajectory.spliced(planned).at(done.trajectory.t[0] + onset + record.t).q
    assert np.abs(record.q - wanted).max() < 0.02  # the servos' lag
    assert record.q[-1] == pytest.approx(planned.q[-1], abs=5e-3)
    assert np.abs(record.qd[-1]).max() < 0.01
    assert np.abs(record.q[-1] - record.q0).max() > 0.01  # it was moving


def test_degree_and_ramp_do_not_change_a_prepared_stop():
    hard, soft = (
        Record(ProtectiveStop(prepared=0.2, degree=degree, ramp=ramp), when=0.4, horizon=0.3)
        for degree, ramp in (("critical", 0.0), ("minor", 0.1))
    )
    assert np.array_equal(hard.command, soft.command)


def test_prepared_stops_are_planned_once_for_all_rollouts_and_threads(monkeypatch):
    done = dataclasses.replace(healthy_run())
    planned = []
    monkeypatch.setattr(stops_ahead, "plan_stops", lambda *a, **k: planned.append(k) or gp.plan_stops(*a, **k))
    jobs = [RolloutRequest(fault=ProtectiveStop(prepared=0.2), onset=0.1 * k, seed=k) for k in range(6)]
    assert {one.status for one in run_rollouts(done, jobs, horizon=0.1, threads=2, batch=1)} == {"completed"}
    assert planned == [{"every": 0.2}]


def test_prepared_stops_have_a_json_form_and_refuse_impossible_settings():
    fault = ProtectiveStop(prepared=0.1)
    assert from_document(to_document(fault)) == fault
    for prepared in (0.0, -1.0, np.nan, np.inf, "0.1"):
        with pytest.raises(SettingError, match="prepared"):
            ProtectiveStop(prepared=prepared)
    with pytest.raises(SettingError, match="category 0"):
        ProtectiveStop(prepared=0.1, category=0)


@pytest.mark.long
def test_a_prepared_stop_keeps_the_coffee_that_a_straight_brake_spills():
    task = gp.load_scene("desk").tasks["bring_coffee"]
    motion = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=40, speed=0.5).unwrap()
    when = failbench.AtFraction(0.5)
    stops = [ProtectiveStop(when=when), ProtectiveStop(when=when, prepared=0.1)]
    braked, prepared = (failbench.validate(motion, task.scene, stop, n=1, horizon=1.5, threads=1) for stop in stops)
    assert braked.spilled.mean > 0.05
    assert prepared.spilled.mean == 0.0 and prepared.observed.mean < braked.observed.mean
