"""The values that each fault writes into model and commands in one call, without simulation."""

from __future__ import annotations

import numpy as np
import pytest
from breaking import SETTINGS
from motions import world

import graceful_plan as gp
from failbench import Simulation
from failbench.fault.registry import (
    BiasDrift,
    CompleteShutdown,
    ControlDelay,
    Dropout,
    GripperFailure,
    LimitedRange,
    Noise,
    PowerLoss,
    ScaleError,
    StuckPosition,
    WeakGrip,
)

DT = SETTINGS.timestep
LEVELS = (0.25, 0.5, 1.0)


def robot():
    return world("tabletop", "green_to_blue", SETTINGS).robot


def model():
    return world("tabletop", "green_to_blue", SETTINGS).model


def plant_of(fault, *, joints=(2,), steps=200, step=0, seed=0):
    """Return a plant at some step after the onset, still healthy, as an injection passes it to the fault."""
    qpos, qvel = np.zeros(model().nq), np.zeros(model().nv)
    qpos[robot().qpos], qvel[robot().dofs] = gp.load_scene("tabletop").tasks["green_to_blue"].start, 0.3
    healthy = np.arange(steps)[:, None] + np.linspace(0.0, 0.5, model().nu)  # a distinct number for each step
    healthy[:, robot().gripper_actuators] = robot().grip_closed
    return Simulation(
        robot=robot(),
        joints=np.array(joints, dtype=int),
        gripper=True,
        dt=DT,
        rng=np.random.default_rng(seed),
        qpos=qpos,
        qvel=qvel,
        eq_active=np.ones(model().neq, dtype=np.uint8),
        command=healthy.copy(),
        healthy=healthy,
        past=healthy[:50] - 50.0,
        paced=lambda time, pace, change: np.column_stack([time, pace, change]),
        fields={name: getattr(model(), name).copy() for name in fault.FIELDS},
        step=step,
    )


def struck(fault, level=1.0, **given):
    """Return the plant after one call of the fault."""
    plant = plant_of(fault, **given)
    fault.apply(plant, level)
    return plant


def misread(plant):
    """Return the error of the readings written into the commands [step joint], by the servo law."""
    more = (plant.command - plant.healthy)[:, robot().actuators[plant.joints]]
    return -more * (robot().gain / robot().kp)[plant.joints]


@pytest.mark.parametrize("level", LEVELS)
def test_a_dead_motor_damps_only_its_joint(level):
    more = struck(CompleteShutdown(degree="moderate"), level)["dof_damping"] - model().dof_damping
    expected = np.zeros(model().nv)
    expected[robot().dofs[2]] = 10.0 * level
    assert more == pytest.approx(expected)


@pytest.mark.parametrize("level", LEVELS)
def test_both_stops_close_in_along_the_ramp(level):
    # The elbow at home is far from both ends of its range.
    plant = struck(LimitedRange(degree="severe"), level, joints=(3,))
    low, high = plant["jnt_range"][robot().joint_ids[3]] - plant.q[3]
    assert (low, high) == pytest.approx((-0.05 / level, 0.05 / level))


@pytest.mark.parametrize(("share", "level"), [(0.25, 1.0), (0.5, 1.0), (0.5, 0.5)])
def test_friction_grows_with_the_ramp(share, level):
    fault = StuckPosition(degree="minor")
    plant = struck(fault, level, step=round(share * fault.amount / DT))
    rubbing = (plant["dof_frictionloss"] - model().dof_frictionloss)[robot().dofs]
    limit = model().actuator_forcerange[robot().actuators[2], 1]
    assert rubbing == pytest.approx(np.where(np.arange(len(rubbing)) == 2, share * level * limit, 0.0))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("fault", [Noise(degree="severe"), BiasDrift(degree="severe")], ids=lambda x: x.NAME)
def test_readings_are_off_as_far_as_the_ramp_has_come(fault, level):
    whole = misread(struck(fault))
    assert misread(struck(fault, level)) == pytest.approx(level * whole)
    if isinstance(fault, BiasDrift):
        assert np.abs(whole[:, 0]) == pytest.approx(fault.amount * DT * np.arange(len(whole)))
    else:
        assert 0.5 < whole.std() / fault.amount < 1.5


@pytest.mark.parametrize("level", LEVELS)
def test_command_delay_grows_with_the_ramp(level):
    plant = struck(ControlDelay(degree="severe"), level)
    column = robot().actuators[2]
    assert (plant.healthy - plant.command)[:, column] == pytest.approx(round(0.1 * level / DT))


@pytest.mark.parametrize("level", LEVELS)
def test_a_gripper_opens_as_far_as_the_ramp_has_come(level):
    fault, column = GripperFailure(degree="severe"), robot().gripper_actuators[0]
    plant = struck(fault, level)
    opened = (plant.command[:, column] - robot().grip_closed[0]) / (robot().grip_open[0] - robot().grip_closed[0])
    assert opened == pytest.approx(level * np.minimum(1.0, DT * np.arange(len(opened)) / fault.amount))


@pytest.mark.parametrize("level", LEVELS)
def test_grip_force_falls_with_the_ramp(level):
    left = struck(WeakGrip(degree="moderate"), level)["actuator_forcerange"] / model().actuator_forcerange
    assert left[robot().gripper_actuators] == pytest.approx(1.0 - 0.9 * level)
    assert left[robot().actuators] == pytest.approx(1.0)


def gaps(fault, level=1.0, steps=15_000):
    """Return in which steps the controller gets no reading of the joint."""
    plant = plant_of(fault, steps=steps)
    blind = np.zeros(steps, dtype=bool)
    for plant.step in range(steps):
        plant["actuator_biasprm"][...] = model().actuator_biasprm
        fault.apply(plant, level)
        blind[plant.step] = not np.array_equal(plant["actuator_biasprm"], model().actuator_biasprm)
    return blind


@pytest.mark.parametrize("level", [0.5, 1.0])
def test_gaps_have_their_length_and_begin_a_quarter_of_a_second_apart(level):
    fault = Dropout(degree="severe")
    length = round(level * fault.amount / DT)
    blind = gaps(fault, level)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], blind.astype(int), [0]])))
    runs = edges[1::2] - edges[::2]
    assert blind[0]
    assert runs[:-1].min() == length  # a gap without another one inside
    # In every step with a reading, the next gap may begin: one draw per such step.
    expected = DT / 0.25 * np.count_nonzero(~blind)
    assert len(runs) - 1 == pytest.approx(expected, abs=3.0 * np.sqrt(expected))


@pytest.mark.parametrize("level", LEVELS)
def test_a_wrong_scale_spoils_position_and_speed_alike(level):
    scale = struck(ScaleError(degree="severe"), level)["actuator_biasprm"] / np.where(
        model().actuator_biasprm == 0.0, 1.0, model().actuator_biasprm
    )
    expected = np.where(model().actuator_biasprm == 0.0, 0.0, 1.0)
    expected[robot().actuators[2], 1:3] = 1.0 + 0.05 * level
    assert model().actuator_biasprm[robot().actuators[2], 1:3].all()
    assert scale == pytest.approx(expected)


def test_a_brake_holds_half_as_much_again_as_the_motor():
    every = range(len(robot().joints))
    holds = struck(PowerLoss(brake="immediate"), joints=every)["dof_frictionloss"] - model().dof_frictionloss
    limit = model().actuator_forcerange[robot().actuators, 1]
    assert holds[robot().dofs] == pytest.approx(1.5 * limit)
    assert np.delete(holds, robot().dofs) == pytest.approx(0.0)


def test_a_scaled_reading_acts_through_the_servo():
    plant = plant_of(Noise(), joints=(1, 4))
    error = np.array([0.01, -0.02])
    plant.misread(plant.joints, np.tile(error, (len(plant.command), 1)))
    actuators, q = robot().actuators[plant.joints], plant.q[plant.joints]
    gain, stiffness = model().actuator_gainprm[actuators, 0], model().actuator_biasprm[actuators, 1]
    truly_read = gain * plant.healthy[7, actuators] + stiffness * (q + error)
    assert gain * plant.command[7, actuators] + stiffness * q == pytest.approx(truly_read)
    assert np.array_equal(np.delete(plant.command, actuators, 1), np.delete(plant.healthy, actuators, 1))


def test_any_joint_is_struck_as_often_as_any_other():
    drawn = [robot().struck(("any",), np.random.default_rng(seed))[0] for seed in range(700)]
    assert {len(joints) for joints in drawn} == {1}
    counts = np.bincount(np.concatenate(drawn), minlength=len(robot().joints))
    assert len(counts) == 7 and (np.abs(counts - 100.0) < 40.0).all()  # more than four standard deviations
