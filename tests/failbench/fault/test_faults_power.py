"""Signatures of the faults of the power supply, against theory or the healthy run."""

import dataclasses

import mujoco
import numpy as np
import pytest
from breaking import WELD, Nothing, Record, healthy_run

from failbench.fault.registry import DEGREES, BatteryDegradation, PowerLoss, VoltageDrop, faults
from graceful_plan.exceptions import SettingError


def test_battery_takes_the_torque_of_all_drives_along_its_ramp():
    fault = BatteryDegradation(degree="moderate", ramp=0.4)
    record = Record(fault, horizon=0.6)
    model = healthy_run().world.model
    left = record.limit / model.actuator_forcerange[:, 1]
    expected = np.maximum(1.0 - 0.5 * record.t / 0.4, 0.5)
    assert left == pytest.approx(np.tile(expected[:, None], 8), abs=0.5 * 5 * record.dt / 0.4)
    assert (np.abs(record.force) <= record.limit * (1 + 1e-12)).all()
    assert record.gain / model.actuator_gainprm[:, 0] == pytest.approx(left)


def test_empty_battery_drops_arm_and_object():
    record = Record(BatteryDegradation(degree="critical", ramp=0.2), when=1.0, horizon=0.6)
    assert not record.force[record.t > 0.21].any()
    assert record.tool[-1, 2] < record.tool[0, 2] - 0.05
    assert record.slip[-1] > 0.01


@pytest.mark.parametrize("degree", DEGREES)
def test_brown_out_weakens_all_drives_and_passes(degree):
    fault = VoltageDrop(degree=degree, ramp=0.0)
    record = Record(fault, when=0.4, horizon=0.9)
    limits = healthy_run().world.model.actuator_forcerange[:, 1]
    low = record.t <= 0.2 + 1e-9
    assert record.limit[low] == pytest.approx(np.tile(fault.amount * limits, (low.sum(), 1)))
    assert np.array_equal(record.limit[~low], np.tile(limits, ((~low).sum(), 1)))


def test_arm_recovers_from_a_brown_out():
    record, well = (Record(f, when=0.4, horizon=1.2) for f in (VoltageDrop(), Nothing()))
    off = np.abs(record.q - well.q).max(axis=1)
    assert off.max() > 0.005
    assert off[-1] < 1e-3


def unactuated(done, start, steps):
    """Let the arm move without any drive: positions after each step."""
    model = done.world.model.__copy__()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, start, mujoco.mjtState.mjSTATE_INTEGRATION)
    path = []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        path.append(data.qpos.copy())
    return np.array(path)


def test_without_power_and_brakes_the_arm_follows_the_unactuated_dynamics():
    record, done = Record(PowerLoss(brake="none")), healthy_run()
    assert not record.force.any()
    start = done.states[done.checkpoint(record.job.onset)]
    assert record.all == pytest.approx(unactuated(done, start, len(record.all)), abs=1e-12)


@pytest.mark.parametrize("degree", DEGREES)
def test_delayed_brakes_hold_from_their_time_on(degree):
    fault = PowerLoss(degree=degree)
    record, done = Record(fault, when=1.0, horizon=fault.amount + 0.4), healthy_run()
    start = done.states[done.checkpoint(record.job.onset)]
    loose = record.t <= fault.amount + 1e-9
    assert record.all[loose] == pytest.approx(unactuated(done, start, int(loose.sum())), abs=1e-12)
    held = record.t > fault.amount + 0.1
    assert np.abs(record.qd[held]).max() < 1e-3
    assert not record.force.any()


def test_stretched_arm_sags_at_most_as_in_free_fall():
    record = Record(PowerLoss(degree="minor"), when=1.0, horizon=0.1)
    sag = record.tool[0, 2] - record.tool[-1, 2]
    assert 0.0 < sag < 0.5 * 9.81 * 0.1**2


def test_immediate_brakes_stop_the_moving_arm():
    record = Record(PowerLoss(brake="immediate"), when=0.4, horizon=0.4)
    assert np.abs(record.qd0).max() > 0.5
    assert np.abs(record.qd[record.t > 0.1]).max() < 1e-3
    assert np.abs(record.q[-1] - record.q0).max() < 0.02


@pytest.mark.parametrize(("grip", "lost"), [("lost", True), ("kept", False)])
def test_grip_without_power(grip, lost):
    fault = PowerLoss(brake="immediate", grip=grip)
    for settings in (None, WELD):
        done = healthy_run() if settings is None else healthy_run(settings)
        record = Record(fault, when=1.0, horizon=0.4, done=done)
        assert (record.slip[-1] > 0.02) == lost
    assert not record.force[:, :7].any()


def test_self_locking_fingers_without_power_do_not_open_on_command():
    done = healthy_run()
    command = done.command.copy()
    command[-100:, done.world.robot.gripper_actuators] = done.world.robot.grip_open
    done = dataclasses.replace(done, command=command)
    fault = PowerLoss(brake="immediate", grip="kept")
    assert Record(fault, when=0.7, horizon=0.6, done=done).slip[-1] < 2e-3


def test_power_loss_of_an_unknown_kind_is_refused():
    with pytest.raises(SettingError, match=r"brake = 'soft'.*none, delayed, immediate"):
        PowerLoss(brake="soft")
    with pytest.raises(SettingError, match=r"grip = 'firm'.*lost, kept"):
        PowerLoss(grip="firm")


@pytest.mark.parametrize("name", ["battery_degradation", "voltage_drop", "power_loss"])
def test_a_weld_breaks_when_the_gripper_has_no_power(name):
    fault = faults()[name](degree="critical", ramp=0.0)
    assert Record(fault, when=1.0, horizon=0.3, done=healthy_run(WELD)).slip[-1] > 0.05
    mild = faults()[name](degree="minor", targets=("all",))
    assert Record(mild, when=1.0, horizon=0.3, done=healthy_run(WELD)).slip[-1] < 0.02
