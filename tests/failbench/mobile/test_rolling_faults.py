"""The effect of each fault on a driving base, and the same effect in FailBench's native simulation."""

import numpy as np
import pytest

import failbench as fb
import graceful_plan as gp
from failbench.recording.records import RolloutRequest
from failbench.rollouts.execution import execute
from failbench.rollouts.rollout import run_rollouts
from failbench.rollouts.single import rollout_steps
from failbench.simulated.world import build_world
from jackals import jackal

ONSET, HORIZON = 1.2, 1.6


@pytest.fixture(scope="module")
def driven():
    scene = jackal((20.0, 20.0))
    motion = gp.plan([-3.0, 0.0, 0.0], gp.BasePose(3.0, 0.5, 0.0), scene, iterations=2000)
    return execute(motion, build_world(scene))


def rolled(driven, fault, seed=0):
    """Return x, y, heading of the base after the onset, and the angles of its wheels."""
    world = driven.world
    rows = [
        np.concatenate([data.qpos[world.rolling.qpos], data.qpos[world.robot.qpos[:4]]])
        for _, data in rollout_steps(driven, RolloutRequest(fault=fault, onset=ONSET, seed=seed), horizon=HORIZON)
    ]
    return np.array(rows)


@pytest.fixture(scope="module")
def healthy(driven):
    return rolled(driven, fb.faults()["loose_joint"](degree="minor", duration=0.002))


def fault(name, degree="critical", targets=("all",), **settings):
    kind = fb.faults()[name]
    chosen = targets if "joints" in kind.STRIKES and name != "power_loss" else ()
    return kind(degree=degree, targets=chosen, **settings)


LEFT = ("jackal/front_left",)


def test_a_healthy_base_follows_and_its_loop_goes_on_from_any_onset(driven, healthy):
    assert (driven.tracking_error < [0.02, 0.005, 0.015]).all() and driven.healthy.harmless
    world, first = driven.world, driven.checkpoint(ONSET)
    nq = world.model.nq
    states = driven.states[first : first + len(healthy) // 5, 1 : 1 + nq][:, world.rolling.qpos]
    np.testing.assert_allclose(healthy[4::5][: len(states) - 1, :3], states[1:], atol=0.02)


# name, targets, least loss of distance [m], least turn [rad].
SIGNATURES = [
    ("complete_shutdown", ("all",), 0.8, 0.0),
    ("limited_range", ("all",), 1.5, 0.0),
    ("limited_range", LEFT, 1.0, 0.15),
    ("partial_degradation", ("all",), 0.8, 0.0),
    ("gradual_degradation", ("all",), 0.5, 0.0),
    ("stuck_position", ("all",), 1.5, 0.0),
    ("stuck_position", LEFT, 1.0, 0.15),
    ("increased_friction", ("all",), 1.5, 0.0),
    ("increased_friction", LEFT, 1.0, 0.15),
    ("noise", LEFT, 0.0, 0.01),
    ("bias_drift", LEFT, 0.0, 0.05),
    ("control_delay", ("all",), 0.0, 0.15),
    ("dropout", LEFT, 0.1, 0.1),
    ("scale_error", ("all",), 0.1, 0.0),
    ("scale_error", LEFT, 0.0, 0.1),
    ("battery_degradation", ("robot",), 0.3, 0.0),
    ("power_loss", ("robot",), 1.2, 0.0),
]


@pytest.mark.parametrize(("name", "targets", "shorter", "turned"), SIGNATURES)
def test_faults_leave_their_signature(driven, healthy, name, targets, shorter, turned):
    found = rolled(driven, fault(name, targets=targets))
    assert healthy[-1, 0] - found[-1, 0] >= shorter or shorter == 0.0
    assert np.abs(found[:, 2] - healthy[:, 2]).max() >= turned


def test_loose_and_weak_drives_and_dead_zones_change_little(driven, healthy):
    """Drives slip by less than a wheel's turn, and the loop corrects it; so it does after a brown-out."""
    for name in ("loose_joint", "dead_zone"):
        found = rolled(driven, fault(name))
        away = np.linalg.norm((found - healthy)[:, :2], axis=1)
        assert 1e-4 < away.max() < 0.1
    found = rolled(driven, fault("voltage_drop"))
    away = np.linalg.norm((found - healthy)[:, :2], axis=1)
    assert away.max() > 0.05 > 2.0 * away[-1]


@pytest.mark.parametrize("name", ["gripper_failure", "weak_grip", "stuck_gripper"])
def test_faults_of_grippers_leave_a_base_without_one_alone(driven, healthy, name):
    np.testing.assert_allclose(rolled(driven, fb.faults()[name]()), healthy, atol=2e-3)


def test_one_motor_drives_a_side(driven):
    robot, rng = driven.world.robot, np.random.default_rng(0)
    assert robot.struck(LEFT, rng)[0].tolist() == [0, 1]
    assert robot.struck(("any",), rng)[0].tolist() in ([0, 1], [2, 3])
    angles = rolled(driven, fault("stuck_position", targets=LEFT))[:, 3:]
    turned = np.abs(np.diff(angles, axis=0)).sum(
        axis=0
    )  # back and forth: the loop swings the base about the blocked side
    assert (turned[:2] < 0.1).all() and (turned[2:] > 1.0).all()


def test_a_base_without_power_rolls_as_far_as_its_friction_lets_it(driven):
    found = rolled(driven, fault("complete_shutdown"))
    model, base = driven.world.model, driven.world.rolling.base
    wheels = driven.world.robot.dofs[:4]
    speed = (found[1, 0] - found[0, 0]) / driven.dt
    mass = float(model.body_subtreemass[model.body("jackal/base").id])
    effective = mass + 4 * (model.dof_armature[wheels[0]] + 0.0024) / base.radius**2
    a = 4 * model.dof_frictionloss[wheels[0]] / (base.radius * effective)
    k = 4 * model.dof_damping[wheels[0]] / (base.radius**2 * effective)
    t = HORIZON
    expected = (speed + a / k) * (1 - np.exp(-k * t)) / k - a / k * t
    assert found[-1, 0] - found[0, 0] == pytest.approx(expected, rel=0.05)


def test_native_rollouts_are_the_same_bit_by_bit(driven):
    chosen = [
        RolloutRequest(fault=fault(name, "severe", LEFT), onset=ONSET, seed=3)
        for name in ("control_delay", "bias_drift", "stuck_position", "dropout")
    ]
    for job, rollout in zip(chosen, run_rollouts(driven, chosen, horizon=0.4, batch=2), strict=True):
        *_, (_, data) = rollout_steps(driven, job, horizon=0.4)
        assert rollout.status == "completed" and np.isfinite(data.qpos).all()


def test_hits_of_a_failing_base_count_by_speed():
    scene = jackal((1.2, 0.05))
    motion = gp.plan([-3.0, -0.9, 0.0], gp.BasePose(0.0, 0.0), scene, w=0.0, iterations=1500)
    report = fb.validate(motion, scene, fault("bias_drift", targets=LEFT), n=4, horizon=1.0, threads=1)
    worst = scene.entities["child0"].severity["body"]
    assert report.diverged == 0 and 0.0 <= report.observed.mean <= worst
    assert set(report.by_entity) == {"child0"} and report.duration == pytest.approx(motion.trajectory.duration)
