"""Signatures of the faults of the gripper, against theory or the healthy run."""

import dataclasses

import numpy as np
import pytest
from breaking import WELD, Nothing, Record, healthy_run

from failbench.fault.registry import DEGREES, GripperFailure, StuckGripper, WeakGrip

G = 9.81


def falls_freely(record, first, last):
    """Return the vertical acceleration of the object between two times [m/s^2]."""
    during = (record.t >= first) & (record.t <= last)
    return 2.0 * np.polyfit(record.t[during], record.object[during, 2], 2)[0]


@pytest.mark.parametrize("degree", DEGREES)
def test_failing_gripper_opens_in_its_time(degree):
    fault = GripperFailure(degree=degree)
    record, robot = Record(fault, when=1.0, horizon=1.0), healthy_run().world.robot
    wide, shut = robot.grip_open[0], robot.grip_closed[0]
    opened = (record.command[:, 7] - shut) / (wide - shut)
    time = record.t - record.dt
    assert opened == pytest.approx(np.minimum(1.0, time / fault.amount) if fault.amount else np.ones_like(time))
    fingers = record.all[-1][healthy_run().world.model.jnt_qposadr[robot.gripper_joints]]
    assert fingers == pytest.approx(wide, abs=2e-3)


def test_the_object_of_a_failing_gripper_falls_freely():
    record = Record(GripperFailure(degree="critical"), when=1.0, horizon=0.2)
    assert falls_freely(record, 0.06, 0.1) == pytest.approx(-G, rel=0.02)
    assert falls_freely(Record(Nothing(), when=1.0, horizon=0.2), 0.06, 0.1) == pytest.approx(0.0, abs=0.1)


def test_a_weld_lets_go_at_once_and_cleanly():
    record = Record(GripperFailure(), when=0.5, horizon=0.1, done=healthy_run(WELD))
    assert falls_freely(record, 0.0, 0.08) == pytest.approx(-G, rel=1e-3)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grip(WeakGrip):
    """A weak grip with any share of the force."""

    share: float = 1.0

    @property
    def amount(self):
        return self.share


def lost_weight(done):
    """Return the object's weight [N], the pads' friction, and the gripper's force [N]."""
    model, robot = done.world.model, done.world.robot
    mass = model.body_mass[done.world.carried_body]
    return mass * G, model.geom_friction[robot.pads[0], 0], model.actuator_forcerange[robot.gripper_actuators[0], 1]


def slips(share, **given):
    # With a ramp; after a sudden change, the pads spring back and let go briefly at any force.
    return Record(Grip(share=share, ramp=0.3), when=1.0, horizon=0.6, **given).slip[-1] > 5e-3


def test_slip_begins_at_the_friction_cone():
    weight, friction, force = lost_weight(healthy_run())
    # The tendon halves the force: N = F / 2 per finger, and 2 mu N = m g.
    expected = 2.0 * (weight / (2.0 * friction)) / force
    low, high = 0.3 * expected, 3.0 * expected
    assert slips(low) and not slips(high)
    while high / low > 1.02:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if slips(middle) else (low, middle)
    assert high == pytest.approx(expected, rel=0.1)


def test_a_weld_breaks_at_the_friction_cone():
    done = healthy_run(WELD)
    weight, friction, force = lost_weight(done)
    expected = weight / friction / force
    assert slips(0.999 * expected, done=done)
    assert not slips(1.001 * expected, done=done)


def test_weak_grip_bounds_the_force():
    record = Record(WeakGrip(degree="moderate", ramp=0.0), when=1.0, horizon=0.1)
    assert record.force[:, 7] == pytest.approx(-7.0)
    assert record.slip[-1] < 1e-3


@pytest.mark.parametrize("degree", DEGREES)
def test_a_gripper_stuck_open_has_the_width_of_its_degree(degree):
    fault = StuckGripper(degree=degree)
    record, done = Record(fault, when=1.0, horizon=0.8), healthy_run()
    robot = done.world.robot
    width = fault.amount * robot.grip_open[0]
    fingers = record.all[:, done.world.model.jnt_qposadr[robot.gripper_joints[0]]]
    held = fingers[0]  # half the object's width
    assert fingers[-1] == pytest.approx(max(width, held), abs=2e-3)
    assert (record.slip[-1] > 0.02) == (width > held)


def releasing(done):
    """Return the same execution, but at its end the gripper opens."""
    command = done.command.copy()
    command[-100:, done.world.robot.gripper_actuators] = done.world.robot.grip_open
    return dataclasses.replace(done, command=command)


def test_a_gripper_stuck_closed_does_not_let_go():
    done = releasing(healthy_run())
    late = {"when": 0.7, "horizon": 0.6, "done": done}
    assert Record(Nothing(), **late).slip[-1] > 0.02
    assert Record(StuckGripper(closed=True), **late).slip[-1] < 2e-3


def test_a_gripper_stuck_closed_changes_nothing_else():
    record, well = Record(StuckGripper(closed=True)), Record(Nothing())
    assert np.array_equal(record.all, well.all)


@pytest.mark.parametrize("fault", [GripperFailure(), StuckGripper()])
def test_a_weld_is_cut_when_the_gripper_opens(fault):
    record = Record(fault, when=1.0, horizon=0.2, done=healthy_run(WELD))
    assert record.slip[-1] > 0.05
