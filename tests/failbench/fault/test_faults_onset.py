"""Onsets of faults: gradual or instant as in the method's table; and how faults end."""

import dataclasses

import numpy as np
import pytest
from breaking import SETTINGS, WELD, Nothing, Record, healthy_run, joint
from motions import world

from failbench import AtTime, RolloutRequest, rollout_steps
from failbench.fault.registry import (
    DEGREES,
    BatteryDegradation,
    BiasDrift,
    CompleteShutdown,
    ControlDelay,
    DeadZone,
    GradualDegradation,
    IncreasedFriction,
    LooseJoint,
    Noise,
    PartialDegradation,
    ScaleError,
    StuckGripper,
    VoltageDrop,
    WeakGrip,
    faults,
    from_document,
    to_document,
)
from graceful_plan.exceptions import SettingError

GRADUAL = {
    "loose_joint",
    "partial_degradation",
    "gradual_degradation",
    "increased_friction",
    "noise",
    "bias_drift",
    "control_delay",
    "scale_error",
    "weak_grip",
    "battery_degradation",
    "voltage_drop",
}


@pytest.mark.parametrize("name", list(faults()))
def test_onsets_are_gradual_as_in_the_table(name):
    assert (faults()[name]().ramp > 0.0) == (name in GRADUAL)
    assert faults()[name](ramp=0.0).ramp == 0.0 and faults()[name](ramp=0.3).ramp == 0.3


def along(record, fault):
    """Return the ramp's progress at each step, and the tolerance of one level."""
    return np.minimum(1.0, record.t / fault.ramp), 5 * record.dt / fault.ramp


@pytest.mark.parametrize("kind", [PartialDegradation, GradualDegradation, BatteryDegradation, VoltageDrop])
def test_torque_goes_little_by_little(kind):
    fault = kind(degree="moderate", targets=("all",))
    record = Record(fault, horizon=0.15)
    level, step = along(record, fault)
    left = record.limit[:, 0] / healthy_run().world.model.actuator_forcerange[0, 1]
    assert left == pytest.approx(1.0 - (1.0 - fault.amount) * level, abs=1.01 * step * (1.0 - fault.amount))
    assert len(np.unique(left)) >= 2  # a voltage drops within 20 ms; the others take longer


def test_stiffness_goes_little_by_little():
    fault = LooseJoint(degree="moderate", targets=joint(2), backlash=0.0)
    record = Record(fault, horizon=0.3)
    level, step = along(record, fault)
    assert record.gain[:, 1] / record.robot.kp[1] == pytest.approx(1.0 - 0.9 * level, abs=step)


def test_friction_grows_little_by_little():
    fault = IncreasedFriction(degree="minor", targets=joint(1))
    record, well = Record(fault, when=0.3, horizon=0.3), Record(Nothing(), when=0.3, horizon=0.3)
    level, step = along(record, fault)
    limit = healthy_run().world.model.actuator_forcerange[0, 1]
    speed = np.concatenate([record.qd0[:1], record.qd[:-1, 0]])
    took = np.abs(record.force - well.force)[:, 0] / (0.1 * limit * (1.0 + np.abs(speed)))
    # Torque responds to friction with the servo's lag, initially 0.1 s.
    assert np.all(np.diff(took[::10]) > -0.02)
    assert (took <= level + step + 0.03).all() and took[25] < 0.5 < took[-1]


@pytest.mark.parametrize("kind", [Noise, BiasDrift])
def test_readings_go_wrong_little_by_little(kind):
    fault = kind(degree="severe", targets=joint(1))
    slow, fast = Record(fault, horizon=0.4), Record(dataclasses.replace(fault, ramp=0.0), horizon=0.4)
    robot, meant = slow.robot, healthy_run().commands(slow.onset_step, len(slow.q))
    error, full = ((meant - r.command)[:, 0] * robot.gain[0] / robot.kp[0] for r in (slow, fast))
    level, step = along(slow, fault)
    if kind is Noise:
        assert error == pytest.approx(level * full, abs=0.3 * step)
        return
    # The error is the integral of a growing rate: after the ramp, half a ramp of drift is missing.
    before = slow.t <= fault.ramp
    assert np.abs(error[before]) == pytest.approx(0.15 * slow.t[before] ** 2 / (2.0 * fault.ramp), abs=1.1e-3)
    assert (np.abs(full) - np.abs(error))[~before] == pytest.approx(0.15 * fault.ramp / 2.0, rel=0.1)
    assert np.abs(np.diff(error)).max() <= 0.15 * slow.dt * (1 + 1e-9)  # no jumps


def test_commands_get_late_little_by_little_and_never_go_back_in_time():
    fault = ControlDelay(degree="critical", targets=joint(1))
    record, done = Record(fault, horizon=0.6), healthy_run()
    whole = done.command[:, 0]
    # Find which command was sent; this joint moves monotonically here.
    sent = np.searchsorted(-whole, -record.command[:, 0])
    late = np.arange(record.onset_step, record.onset_step + len(sent)) - sent
    level, step = along(record, fault)
    assert late * record.dt == pytest.approx(0.2 * level, abs=0.2 * step + record.dt)
    assert (np.diff(sent) >= -5).all() and sent[0] >= record.onset_step - 2


def test_scale_gets_wrong_little_by_little():
    fault = ScaleError(degree="critical", targets=joint(1), ramp=0.1)
    done, levels = healthy_run(), []
    for model, _ in rollout_steps(done, RolloutRequest(fault=fault, onset=0.2, seed=0), horizon=0.2):
        levels.append(model.actuator_biasprm[0, 1] / done.world.model.actuator_biasprm[0, 1] - 1.0)
    assert np.array(levels) == pytest.approx(0.1 * np.minimum(1.0, np.arange(1, 101) / 50), abs=0.1 * 5 / 50)
    assert len(np.unique(levels)) == 10


def test_grip_gets_weak_little_by_little():
    fault = WeakGrip(degree="moderate")
    record = Record(fault, when=1.0, horizon=0.4)
    level, step = along(record, fault)
    assert record.limit[:, 7] / record.limit[0, 7] == pytest.approx((1.0 - 0.9 * level), abs=0.9 * step + 0.02)


# --- backlash, delay of readings, dead zone --------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.02, 0.04])
def test_a_joint_with_backlash_sags_by_half_the_gap(gap):
    # The load rests on one side of the gap. The reduced stiffness is equal in both, so only the gap differs.
    tight, loose = (
        Record(LooseJoint(degree="minor", targets=joint(4), backlash=b), when=1.0, horizon=2.0) for b in (0.0, gap)
    )
    assert np.abs(loose.qd[-1]).max() < 1e-3
    assert tight.q[-1, 3] - loose.q[-1, 3] == pytest.approx(gap / 2.0, rel=0.05)


def test_within_the_gap_no_torque_reaches_the_joint():
    fault = LooseJoint(degree="minor", targets=joint(1), backlash=0.3, ramp=0.0)
    record = Record(fault, when=1.0, horizon=0.2)
    assert not record.force[:, 0].any()  # the base joint carries no load, so it floats in the gap
    tight = Record(dataclasses.replace(fault, backlash=0.0), when=1.0, horizon=0.2)
    assert tight.force[:, 0].all()


def test_backlash_follows_the_degree_unless_given():
    gaps = [LooseJoint(degree=degree).gap for degree in DEGREES]
    assert np.all(np.diff(gaps) > 0.0)
    assert LooseJoint(backlash=0.1).gap == 0.1
    assert LooseJoint(backlash=0.0).period is None and LooseJoint().period == 0.0
    assert from_document(to_document(LooseJoint())) == LooseJoint()
    assert from_document(to_document(LooseJoint(backlash=0.5))) == LooseJoint(backlash=0.5)
    with pytest.raises(SettingError, match=r"backlash = -1\.0"):
        LooseJoint(backlash=-1.0)


@pytest.mark.parametrize("line", ["measurement", "both"])
def test_servos_see_where_the_joint_was(line):
    fault = ControlDelay(degree="moderate", targets=joint(1), line=line, ramp=0.0)
    record, done = Record(fault, when=0.5, horizon=0.1), healthy_run()
    robot, late = record.robot, round(fault.amount / record.dt)
    # The servo's readings: the healthy run before the onset, then the state before each step.
    q = np.concatenate([done.measured[: record.onset_step + 1, 0, 0], record.q[:-1, 0]])
    qd = np.concatenate([done.measured[: record.onset_step + 1, 1, 0], record.qd[:-1, 0]])
    seen = slice(record.onset_step - late, record.onset_step - late + len(record.q))
    sent = done.commands(record.onset_step - late * (line == "both"), len(record.q))[:, 0]
    assert record.command[:, 0] == pytest.approx(sent)
    force = robot.gain[0] * sent - robot.kp[0] * q[seen] - robot.kd[0] * qd[seen]
    limit = record.limit[0, 0]
    assert record.force[:, 0] == pytest.approx(np.clip(force, -limit, limit), rel=1e-9)


def test_delayed_readings_before_the_start_repeat_the_first_one():
    fault = ControlDelay(degree="critical", targets=joint(1), line="measurement", ramp=0.0)
    record, done = Record(fault, when=0.0, horizon=0.1), healthy_run()
    robot = record.robot
    q, qd = done.measured[0, :, 0]
    force = robot.gain[0] * record.command[:, 0] - robot.kp[0] * q - robot.kd[0] * qd
    assert record.force[:, 0] == pytest.approx(np.clip(force, -87.0, 87.0), rel=1e-9)


def test_measured_holds_the_states_of_the_joints():
    done = healthy_run()
    record = Record(Nothing(), when=0.5, horizon=0.1)
    at = record.onset_step
    assert done.measured.shape == (len(done.command), 2, 7)
    assert np.array_equal(done.measured[at, 0], record.q0) and np.array_equal(done.measured[at, 1], record.qd0)
    # Bodies that sleep in the healthy run are awake after the fork, hence the tolerance.
    assert done.measured[at + 1 : at + 51, 0] == pytest.approx(record.q, abs=1e-6)


def test_a_lines_name_is_checked():
    with pytest.raises(SettingError, match=r"line = 'radio'.*command, measurement, both"):
        ControlDelay(line="radio")
    with pytest.raises(SettingError, match=r"zone = 'twilight'.*range, play"):
        DeadZone(zone="twilight")


def test_a_sensor_reads_right_outside_its_dead_range_and_stands_within():
    fault = DeadZone(degree="severe", targets=joint(1))
    record = Record(fault, horizon=0.4)
    robot, limit = record.robot, record.limit[0, 0]
    q, qd = (np.concatenate([a[:1], b[:-1, 0]]) for a, b in ((record.q0, record.q), (record.qd0, record.qd)))
    inside = np.abs(q - record.q0[0]) <= 0.06
    assert 10 < inside.sum() < len(inside) - 10
    reading = np.where(inside, record.q0[0], q)
    force = robot.gain[0] * record.command[:, 0] - robot.kp[0] * reading - robot.kd[0] * qd
    assert record.force[:, 0] == pytest.approx(np.clip(force, -limit, limit), rel=1e-9)


@pytest.mark.parametrize("degree", DEGREES)
def test_a_gripper_stuck_open_releases_a_weld_where_fingers_would(degree):
    fingers, weld = (
        Record(StuckGripper(degree=degree), when=1.0, horizon=0.8, done=healthy_run(settings)).slip[-1] > 0.02
        for settings in (SETTINGS, WELD)
    )
    assert fingers == weld


# --- targets and duration -----------------------------------------------------------------------------------------


def robot():
    return world("tabletop", "green_to_blue", SETTINGS).robot


def test_any_joint_is_drawn_by_the_rates():
    rates = (4.0, 0.0, 1.0, 0.0, 3.0, 0.0, 0.0)
    drawn = [int(robot().struck(("any",), np.random.default_rng(seed), rates)[0][0]) for seed in range(800)]
    counts = np.bincount(drawn, minlength=7)
    assert counts[[1, 3, 5, 6]].sum() == 0
    assert counts[[0, 2, 4]] == pytest.approx([400, 100, 300], abs=60)  # more than four standard deviations


def test_rates_change_no_other_draw():
    first, second = np.random.default_rng(3), np.random.default_rng(3)
    robot().struck(("any",), first)
    robot().struck(("any",), second, (1.0,) * 7)
    assert first.random() == second.random()


@pytest.mark.parametrize("rates", [(1.0, -1.0), (0.0, 0.0), (np.inf, 1.0), (np.nan,)])
def test_invalid_rates_are_refused(rates):
    with pytest.raises(SettingError, match="rates = "):
        Noise(rates=rates)


def test_rates_of_another_robot_are_refused():
    with pytest.raises(SettingError, match=r"rates = \(1\.0, 2\.0\).* 7 "):
        robot().check_targets(("any",), (1.0, 2.0))
    fault = Noise(rates=(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0))
    assert from_document(to_document(fault)) == fault
    with pytest.raises(SettingError, match="rates = 'any'"):
        from_document({"fault": "noise", "rates": "any"})


def test_a_permanent_failure_lasts_until_restore():
    done = healthy_run()
    fault = CompleteShutdown(degree="critical", targets=("all",), when=AtTime(0.2))
    going = rollout_steps(done, RolloutRequest(fault=fault, onset=0.2, seed=0), horizon=0.5)
    dead = []
    for step, state in enumerate(going):
        model, data = state
        dead.append(not data.actuator_force[:7].any())
        if step == 99:
            going.restore()
    assert dead == [True] * 100 + [False] * 150
    for name in fault.FIELDS:
        assert np.array_equal(getattr(model, name), getattr(done.world.model, name)), name
    going.restore()  # a second call changes nothing
    with pytest.raises(StopIteration):
        next(going)
