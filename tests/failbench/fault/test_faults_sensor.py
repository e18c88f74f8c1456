"""Signatures of the faults of sensors and of the command line, against theory or the healthy run."""

import numpy as np
import pytest
from breaking import Nothing, Record, healthy_run, joint

from failbench import SimSettings
from failbench.fault.registry import DEGREES, BiasDrift, ControlDelay, DeadZone, Dropout, Noise, ScaleError

TORQUE = SimSettings(control="torque")


def readings_off(record):
    """Return the error of the position readings [step joint], from the servo law."""
    robot, done = record.robot, healthy_run()
    meant = done.commands(record.onset_step, len(record.q))
    return (meant - record.command)[:, robot.actuators] * robot.gain / robot.kp


def test_noise_has_its_standard_deviation_and_is_held():
    off = np.concatenate(
        [readings_off(Record(Noise(degree="severe", targets=("all",), ramp=0.0), seed=seed)) for seed in range(3)]
    )
    samples = off[::5]  # 0.01 s
    assert np.repeat(samples, 5, axis=0) == pytest.approx(off, abs=1e-12)
    assert samples.size == 3 * 40 * 7
    # The standard error of a standard deviation s is s / sqrt(2 n).
    assert samples.std() == pytest.approx(0.05, rel=3.0 / np.sqrt(2.0 * samples.size))
    assert abs(samples.mean()) < 3.0 * 0.05 / np.sqrt(samples.size)


def test_noise_shakes_only_its_joint():
    record, well = Record(Noise(degree="critical", targets=joint(4))), Record(Nothing())
    off = np.abs(record.q - well.q).max(axis=0)
    assert off[3] > 5e-3
    assert np.delete(off, 3).max() < 0.2 * off[3]


@pytest.mark.parametrize("degree", DEGREES)
def test_drift_grows_linearly_at_its_rate(degree):
    fault = BiasDrift(degree=degree, targets=joint(1), ramp=0.0)
    record = Record(fault, when=1.0, horizon=1.2)
    late = record.t > 0.7  # the servo follows with a lag of kd / kp = 0.1 s
    slope, _ = np.polyfit(record.t[late], record.q[late, 0], 1)
    residual = record.q[late, 0] - np.polyval(np.polyfit(record.t[late], record.q[late, 0], 1), record.t[late])
    assert abs(slope) == pytest.approx(fault.amount, rel=0.01)
    assert np.abs(residual).max() < 1e-3
    error = readings_off(record)[:, 0]
    assert np.abs(error) == pytest.approx(fault.amount * (record.t - record.dt))


def test_drift_goes_either_way():
    signs = {np.sign(readings_off(Record(BiasDrift(targets=joint(1)), seed=s, horizon=0.1))[-1, 0]) for s in range(8)}
    assert signs == {-1.0, 1.0}


@pytest.mark.parametrize("degree", DEGREES)
def test_delayed_commands_lag_by_whole_steps(degree):
    fault = ControlDelay(degree=degree, targets=(*joint(2), *joint(5)), ramp=0.0)
    record, done = Record(fault), healthy_run()
    steps = round(fault.amount / record.dt)
    meant = done.commands(record.onset_step - steps, len(record.q))
    assert np.array_equal(record.command[:, [1, 4]], meant[:, [1, 4]])
    others = [0, 2, 3, 5, 6, 7]
    assert np.array_equal(record.command[:, others], done.commands(record.onset_step, len(record.q))[:, others])


def test_before_the_motion_nothing_was_commanded():
    record, done = Record(ControlDelay(degree="critical", targets=("robot",), ramp=0.0), when=0.0), healthy_run()
    assert (record.command[:100] == done.command[0]).all()
    assert np.array_equal(record.command[100:], done.command[:100])


def test_delay_of_the_moving_arm_is_its_speed_times_the_delay():
    record = Record(ControlDelay(degree="severe", targets=joint(1), ramp=0.0), when=0.3, horizon=0.44)
    well = Record(Nothing(), when=0.3, horizon=0.44)
    # Four time constants of the servo later.
    assert record.q[-1, 0] - well.q[-1, 0] == pytest.approx(-0.1 * well.qd[-1, 0], rel=0.05)


def test_controller_is_blind_in_a_gap():
    fault = Dropout(degree="critical", targets=joint(1))
    record = Record(fault, horizon=0.15)
    robot = record.robot
    blind = robot.kp[0] * (record.command[:, 0] - record.q0[0]) - robot.kd[0] * record.qd0[0]
    limit = record.limit[0, 0]
    assert record.force[:, 0] == pytest.approx(np.clip(blind, -limit, limit), rel=1e-9)
    assert np.abs(record.q[-1, 0] - record.q0[0]) > 0.05  # though it moves


def test_readings_come_back_after_a_gap():
    seed = 1  # with this seed, no other gap begins soon
    record = Record(Dropout(degree="minor", targets=joint(1)), seed=seed, horizon=0.1)
    robot, after = record.robot, record.t[1:] > 0.03
    q, qd = record.q[:-1, 0], record.qd[:-1, 0]  # the sensor reads the state before a step
    seen = robot.kp[0] * (record.command[1:, 0] - q) - robot.kd[0] * qd
    limit = record.limit[0, 0]
    assert record.force[1:, 0][after] == pytest.approx(np.clip(seen, -limit, limit)[after], rel=1e-6)
    assert not np.allclose(record.force[1:, 0][~after], np.clip(seen, -limit, limit)[~after], rtol=1e-3)


def test_longer_gaps_contain_the_shorter_ones():
    lost = {}
    for degree in ("minor", "critical"):
        record = Record(Dropout(degree=degree, targets=joint(1)), horizon=1.0, seed=2)
        robot = record.robot
        seen = robot.kp[0] * (record.command[1:, 0] - record.q[:-1, 0]) - robot.kd[0] * record.qd[:-1, 0]
        seen = np.clip(seen, -record.limit[0, 0], record.limit[0, 0])
        lost[degree] = ~np.isclose(record.force[1:, 0], seen, rtol=1e-6)
    assert lost["minor"].sum() < lost["critical"].sum()
    assert lost["minor"][:8].all() and lost["critical"][:78].mean() > 0.5


@pytest.mark.parametrize("settings", [SimSettings(), TORQUE])
def test_a_scaled_reading_settles_where_it_reads_the_target(settings):
    fault = ScaleError(degree="severe", targets=joint(1))
    record = Record(fault, when=1.0, horizon=1.5, done=healthy_run(settings))
    wanted = healthy_run().trajectory.q[-1, 0]
    assert 1.05 * record.q[-1, 0] == pytest.approx(wanted, abs=1e-3)


@pytest.mark.parametrize("settings", [SimSettings(), TORQUE])
def test_joint_with_play_in_its_sensor_runs_ahead_by_its_width(settings):
    fault = DeadZone(degree="moderate", targets=joint(1), zone="play")
    done = healthy_run(settings)
    record, well = Record(fault, done=done), Record(Nothing(), done=done)
    ahead = (record.q - well.q)[:, 0] * np.sign(well.qd[:, 0])
    assert ahead.max() == pytest.approx(0.03, rel=0.15)


@pytest.mark.parametrize("zone", ["range", "play"])
def test_controller_does_not_see_motion_within_the_dead_zone(zone):
    fault = DeadZone(degree="severe", targets=joint(1), zone=zone)
    record = Record(fault, horizon=0.1)
    inside = np.abs(record.q[:, 0] - record.q0[0]) < 0.06
    robot = record.robot
    qd = np.concatenate([record.qd0[:1], record.qd[:-1, 0]])
    blind = robot.kp[0] * (record.command[:, 0] - record.q0[0]) - robot.kd[0] * qd
    assert 10 < inside.sum() < len(inside)
    limit = record.limit[0, 0]
    assert record.force[inside, 0] == pytest.approx(np.clip(blind, -limit, limit)[inside], rel=1e-9)


@pytest.mark.parametrize(
    "fault", [Noise(degree="critical", targets=joint(1)), BiasDrift(degree="critical", targets=joint(1))]
)
def test_misreading_acts_alike_in_both_kinds_of_control(fault):
    servo, torque = (Record(fault, when=1.0, done=healthy_run(s)) for s in (SimSettings(), TORQUE))
    off = [np.abs(r.q[:, 0] - r.q0[0]).max() for r in (servo, torque)]
    assert 0.5 < off[1] / off[0] < 2.0
    assert off[1] > 0.01
