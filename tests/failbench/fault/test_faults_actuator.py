"""Signatures of the faults of drives and bearings, against theory or the healthy run."""

import dataclasses

import mujoco
import numpy as np
import pytest
from breaking import WELD, Nothing, Record, healthy_run, joint
from motions import ARM, SERVO, arm

import graceful_plan as gp
from failbench import RolloutRequest, SimSettings, build_world, execute, rollout_steps, run_rollouts
from failbench.fault.registry import (
    DEGREES,
    CompleteShutdown,
    GradualDegradation,
    IncreasedFriction,
    LimitedRange,
    LooseJoint,
    PartialDegradation,
    PowerLoss,
    StuckPosition,
    faults,
)
from graceful_plan.exceptions import UnsupportedError


def test_shutdown_gives_no_torque_and_leaves_the_arm_to_forward_dynamics():
    record = Record(CompleteShutdown(degree="critical", targets=("robot",)))
    assert not record.force.any()
    done = healthy_run()
    model, data = done.world.model.__copy__(), mujoco.MjData(done.world.model)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    state = done.states[done.checkpoint(record.job.onset)]
    mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    for qpos in record.all:
        mujoco.mj_step(model, data)
        assert data.qpos == pytest.approx(qpos, abs=1e-12)
    assert np.abs(record.q[-1] - record.q0).max() > 0.1  # the arm does fall


def test_shutdown_of_one_joint_leaves_the_others_their_torque():
    record = Record(CompleteShutdown(targets=joint(2)))
    assert not record.force[:, 1].any()
    assert (np.abs(record.force[:, [0, 2, 3]]) > 0.0).all()


def test_dead_motor_resists_in_proportion_to_speed():
    record = Record(CompleteShutdown(degree="minor", targets=joint(4)), horizon=0.1)
    dof = record.robot.dofs[3]
    healthy = healthy_run().world.model.dof_damping[dof]
    # MuJoCo computed the passive force of the last step from the state before it.
    assert record.data.qfrc_passive[dof] == pytest.approx(-(40.0 + healthy) * record.qd[-2, 3])


def test_loose_joint_sags_by_gravity_over_its_stiffness():
    fault = LooseJoint(degree="moderate", targets=joint(4), backlash=0.0)
    record, before = Record(fault, when=1.0, horizon=3.0), Record(Nothing(), when=1.0, horizon=0.1)
    stiffness = 0.1 * record.robot.kp[3]
    assert np.abs(record.qd[-1]).max() < 1e-3  # at rest
    # The load of arm and object, minus the feed-forward torque, of which a tenth remains.
    load = _load(record.data, 3) - 0.1 * _load(before.data, 3)
    assert before.q[-1, 3] - record.q[-1, 3] == pytest.approx(load / stiffness, rel=0.02)
    assert abs(before.q[-1, 3] - record.q[-1, 3]) > 0.01


def _load(data, joint):
    dof = healthy_run().world.robot.dofs[joint]
    return data.qfrc_bias[dof] - data.qfrc_constraint[dof]


def test_very_loose_joint_sways():
    record = Record(LooseJoint(degree="critical", targets=joint(1)), horizon=2.0)
    wanted = healthy_run().trajectory.q[-1, 0]
    assert record.q[:, 0].min() < wanted - 0.05  # overshoots
    assert record.q[-1, 0] > record.q[:, 0].min() + 0.05
    assert Record(Nothing(), horizon=2.0).q[:, 0].min() > wanted - 0.005


def test_limited_range_stops_the_joint_on_either_side():
    record = Record(LimitedRange(degree="severe", targets=joint(1)), horizon=0.5)
    away = record.q[:, 0] - record.q0[0]
    assert away.min() == pytest.approx(-0.05, abs=0.004)
    wanted = Record(Nothing(), horizon=0.5).q[:, 0] - record.q0[0]
    assert wanted.min() < -0.3
    free = wanted > -0.03
    assert away[free] == pytest.approx(wanted[free], abs=1e-6)


def test_limited_range_never_widens_the_range():
    record = Record(LimitedRange(degree="minor", targets=("all",), ramp=0.1), horizon=0.2)
    ids, healthy = record.robot.joint_ids, healthy_run().world.model.jnt_range
    assert (record.model.jnt_range[ids, 0] >= healthy[ids, 0]).all()
    assert (record.model.jnt_range[ids, 1] <= healthy[ids, 1]).all()


@pytest.mark.parametrize("degree", DEGREES)
def test_partial_degradation_leaves_a_share_of_the_torque(degree):
    fault = PartialDegradation(degree=degree, targets=("all",), ramp=0.0)
    record, well = Record(fault), Record(Nothing())
    limits = healthy_run().world.model.actuator_forcerange[:7, 1]
    assert (np.abs(record.force[:, :7]) <= fault.amount * limits * (1 + 1e-12)).all()
    # In the first step both are in the same state.
    assert record.force[0, :7] == pytest.approx(fault.amount * well.force[0, :7], rel=1e-9)
    assert (record.limit[:, 7] == well.limit[:, 7]).all()  # the gripper is not a target


def test_gradual_degradation_loses_torque_along_its_ramp():
    fault = GradualDegradation(degree="severe", targets=joint(2))
    record = Record(fault, horizon=0.8)
    left = record.gain[:, 1] / record.robot.kp[1]
    assert np.all(np.diff(left) <= 0.0)
    along = record.t <= fault.ramp
    one_level = 5 * record.dt / fault.ramp
    assert left[along] == pytest.approx(1.0 - 0.9 * record.t[along] / fault.ramp, abs=one_level)
    assert left[~along] == pytest.approx(0.1)
    assert (np.abs(record.force[:, 1]) <= record.limit[:, 1]).all()
    assert record.limit[-1, 1] == pytest.approx(8.7)


@pytest.mark.parametrize("degree", DEGREES)
def test_stuck_joint_stands_still_while_the_command_moves_on(degree):
    fault = StuckPosition(degree=degree, targets=joint(1))
    record = Record(fault, when=0.3, horizon=0.6)
    stuck = record.t > fault.amount + 0.04
    assert np.abs(record.qd[stuck, 0]).max() < 1e-3
    assert np.ptp(record.command[stuck, 0]) > 0.04
    assert np.ptp(record.q[stuck, 0]) < 1e-4
    assert np.abs(record.qd[stuck, 1]).max() > 0.1  # the other joints go on


def test_stuck_joint_rubs_harder_and_harder_before():
    record = Record(StuckPosition(degree="minor", targets=joint(1)), when=0.3, horizon=0.4)
    lag = record.q[:, 0] - Record(Nothing(), when=0.3, horizon=0.4).q[:, 0]
    assert np.all(np.diff(lag[::10]) > 0.0)  # it moves in the negative direction and lags


def test_friction_takes_the_stated_torque():
    fault = IncreasedFriction(degree="minor", targets=joint(1), ramp=0.0)
    record, well = Record(fault, when=0.3, horizon=0.3), Record(Nothing(), when=0.3, horizon=0.3)
    limit = healthy_run().world.model.actuator_forcerange[0, 1]
    steady = record.t > 0.15
    more = (record.force - well.force)[steady, 0]
    speed = record.qd[steady, 0]
    assert more == pytest.approx(0.1 * limit * (np.sign(speed) + speed), rel=0.02)


def test_dry_friction_holds_a_joint_below_its_limit():
    # Near the end of the motion, the servo's remaining error does not overcome friction.
    record = Record(IncreasedFriction(degree="severe", targets=joint(2)), when=1.0, horizon=0.5)
    assert np.abs(record.qd[-100:, 1]).max() < 1e-4


@pytest.mark.parametrize("name", [n for n, f in faults().items() if f.CATEGORY == "actuator"])
def test_several_joints_can_be_struck(name):
    fault = dataclasses.replace(faults()[name](degree="critical"), targets=(*joint(2), *joint(4)))
    record, well = Record(fault, horizon=0.6), Record(Nothing(), horizon=0.6)
    off = np.abs(record.q - well.q).max(axis=0)
    assert (off[[1, 3]] > 5.0 * 1e-3).all()


def test_a_stuck_joint_stays_in_place_for_any_joint_zero():
    text = ARM.format(fingers="", actuators=SERVO).replace('range="-2 2"', 'range="-1 3" ref="1"')
    scene = gp.Scene.from_mjcf(text, robot="base", tool="tool", velocity=[2.0], acceleration=[5.0], torque=[80.0])
    done = execute([[0.0], [0.6]], build_world(scene))
    record = Record(StuckPosition(degree="critical"), done=done)
    assert np.abs(record.q - record.q0).max() < 5e-3  # it brakes from 1.5 rad/s
    assert abs(record.qd[-1]) < 1e-3


@pytest.mark.parametrize("fault", [IncreasedFriction(), StuckPosition(), PowerLoss()])
def test_friction_and_brakes_need_to_know_the_greatest_torque(fault):
    job = RolloutRequest(fault=fault, onset=0.1, seed=0)
    with pytest.raises(UnsupportedError, match="'shoulder'"):
        run_rollouts(execute([[0.0], [0.6]], build_world(arm())), [job])
    done = execute([[0.0], [0.6]], build_world(arm(torque=[80.0])))
    *_, (_, data) = rollout_steps(done, job, horizon=0.6)
    held = abs(data.qvel[done.world.robot.dofs]) < 1e-3
    assert held or isinstance(fault, IncreasedFriction)  # its motor still acts


@pytest.mark.parametrize("fault", [CompleteShutdown, LooseJoint, PartialDegradation, GradualDegradation])
def test_a_dead_gripper_releases_its_weld(fault):
    done = healthy_run(WELD)
    jobs = [
        RolloutRequest(fault=fault(degree=degree, targets=("gripper",)), onset=0.2 * done.duration, seed=0)
        for degree in ("minor", "critical")
    ]
    kept, lost = (rollout.dropped for rollout in run_rollouts(done, jobs))
    assert lost == (fault is not PartialDegradation)  # a tenth of the force still holds the can
    assert not kept or fault is CompleteShutdown


@pytest.mark.parametrize("fault", [IncreasedFriction(), StuckPosition(), PowerLoss()])
def test_the_control_range_of_a_motor_is_its_greatest_torque(fault):
    # robosuite's arms have such motors.
    motor = '<motor joint="shoulder" ctrlrange="-40 40" gear="2"/>'
    world = build_world(arm(actuators=motor), SimSettings(control="torque"))
    assert world.model.actuator_forcerange[0].tolist() == [-80.0, 80.0]
    *_, (_, data) = rollout_steps(
        execute([[0.0], [0.6]], world), RolloutRequest(fault=fault, onset=0.1, seed=0), horizon=0.6
    )
    held = abs(data.qvel[world.robot.dofs]) < 1e-3
    assert held or isinstance(fault, IncreasedFriction)
