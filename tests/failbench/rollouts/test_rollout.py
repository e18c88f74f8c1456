import copy
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from motions import Drop, Shake, Weaken, execution

from failbench import RolloutRequest, SimSettings, rollout_steps, run_rollouts
from failbench.rollouts.rollout import _run_group
from failbench.simulated.states import CHECKPOINT
from failbench.sweeps.rows import rollout_row
from graceful_plan.exceptions import SettingError, UnknownNameError

FAULTS = (
    Drop(),
    Weaken(),
    Weaken(degree="minor", ramp=0.1, duration=0.2, targets=("joint2",)),
    Shake(),
    Shake(ramp=0.1, duration=0.15, targets=("panda/joint4", "panda/joint6")),
)


def jobs_of(faults, duration, seed=0):
    rng = np.random.default_rng(seed)
    return [
        RolloutRequest(fault=fault, onset=float(rng.uniform(0.0, duration)), seed=int(rng.integers(2**31)))
        for fault in faults
    ]


def flat(rollout):
    poses = {name: tuple(pose) for name, pose in rollout.poses.items()}
    kept = ("onset", "status", "events", "fell", "tipped", "left_support", "spilled", "dropped")
    return (*(getattr(rollout, name) for name in kept), tuple(sorted(poses.items())))


@pytest.fixture(scope="module")
def done():
    return execution()


def named(done, faults):
    """Replace targets by the names of the robot's joints."""
    joints = done.world.robot.joints
    return [
        type(f)(
            degree=f.degree,
            ramp=f.ramp,
            duration=f.duration,
            targets=tuple(joints[int(t[-1]) - 1] if t[-1].isdigit() else t for t in f.targets),
        )
        for f in faults
    ]


def test_native_rollouts_are_a_plain_loop_bit_by_bit(done):
    jobs = jobs_of(named(done, FAULTS), done.duration)
    for job, rollout in zip(jobs, run_rollouts(done, jobs, horizon=0.3), strict=True):
        *_, (model, data) = rollout_steps(done, job, horizon=0.3)
        for name, pose in rollout.poses.items():
            body = model.body(name).id if name != "carried" else done.world.carried_body
            joint = model.body_jntadr[body]
            adr = model.jnt_qposadr[joint]
            position, quaternion = data.qpos[adr : adr + 3], data.qpos[adr + 3 : adr + 7]
            assert np.array_equal(pose, np.concatenate([quaternion, position])), (job.fault, name)


def test_batches_and_threads_change_nothing(done):
    jobs = jobs_of(named(done, FAULTS) * 3, done.duration)
    expected = [flat(r) for r in run_rollouts(done, jobs, horizon=0.25, batch=32)]
    assert [flat(r) for r in run_rollouts(done, jobs, horizon=0.25, batch=4, threads=2)] == expected
    assert [flat(r) for r in run_rollouts(done, jobs[::-1], horizon=0.25, batch=1)] == expected[::-1]


def test_the_object_falls_when_the_gripper_opens(done):
    (rollout,) = run_rollouts(done, [RolloutRequest(fault=Drop(), onset=0.3, seed=0)])
    assert rollout.dropped
    assert rollout.status == "completed"
    assert any(event.striker == "carried" for event in rollout.events)


def test_nothing_happens_to_a_healthy_robot(done):
    """With a fault without effect, the rollout equals the healthy run, but for the creep of the held object."""
    job = RolloutRequest(fault=Weaken(degree="minor", duration=done.dt, targets=("gripper",)), onset=0.1, seed=0)
    (rollout,) = run_rollouts(done, [job], horizon=0.4)
    assert not rollout.events
    assert not rollout.dropped
    last = None
    for _, data in rollout_steps(done, job, horizon=0.4):
        last = data
    ahead = done.checkpoint(0.1) + round(0.4 / done.dt) // CHECKPOINT
    healthy = mujoco.MjData(done.world.model)
    mujoco.mj_setState(done.world.model, healthy, done.states[ahead], mujoco.mjtState.mjSTATE_INTEGRATION)
    # Not bit by bit: sleeping objects are awake for a moment after the fork.
    model = done.world.model
    held = np.arange(7) + model.jnt_qposadr[model.body_jntadr[done.world.carried_body]]
    others = np.setdiff1d(np.arange(model.nq), held)
    assert last.qpos[others] == pytest.approx(healthy.qpos[others], abs=1e-5)
    assert last.qpos[held] == pytest.approx(healthy.qpos[held], abs=1e-3)


@pytest.mark.parametrize("fault", [Weaken(ramp=0.05, duration=0.1), Shake(duration=0.1)])
def test_a_temporary_fault_leaves_no_trace_in_the_model(done, fault):
    model = None
    changed = False
    for model, _ in rollout_steps(done, RolloutRequest(fault=fault, onset=0.2, seed=1), horizon=0.2):
        changed |= not np.array_equal(model.actuator_gainprm, done.world.model.actuator_gainprm)
    assert changed == bool(fault.FIELDS)
    for name in ("actuator_gainprm", "actuator_biasprm", "dof_damping", "jnt_range", "eq_data"):
        assert np.array_equal(getattr(model, name), getattr(done.world.model, name)), name


def test_a_failure_after_the_end_strikes_a_robot_at_rest(done):
    (rollout,) = run_rollouts(done, [RolloutRequest(fault=Drop(), onset=99.0, seed=0)], horizon=0.1)
    assert rollout.onset == pytest.approx(done.duration, abs=CHECKPOINT * done.dt)


def test_a_diverging_simulation_is_reported(done, monkeypatch):
    broken = copy.copy(done.states)
    broken[10, :] = np.where(np.arange(broken.shape[1]) == 3, np.nan, broken[10])
    object.__setattr__(exploding := copy.copy(done), "states", broken)
    jobs = [RolloutRequest(fault=Drop(), onset=k * CHECKPOINT * done.dt, seed=0) for k in (9, 10, 11)]
    rollouts = run_rollouts(exploding, jobs, horizon=0.05)
    assert [r.status for r in rollouts] == ["completed", "diverged", "completed"]
    assert np.array_equal(rollouts[1].state, broken[10], equal_nan=True)
    assert rollouts[0].state is None
    assert rollouts[0].poses
    assert not rollouts[1].poses
    assert not rollouts[1].events
    row = rollout_row(rollouts[1], done)
    assert row["status"] == "diverged"
    assert row["observed_impact"] is row["dropped"] is None  # must not average as harmless
    assert rollout_row(rollouts[0], done)["observed_impact"] is not None


def test_no_log_is_left_in_the_working_directory(done, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    test_a_diverging_simulation_is_reported(done, monkeypatch)
    assert not list(tmp_path.iterdir())


def test_misuse_is_refused(done):
    with pytest.raises(SettingError, match=r"horizon = 0\.0"):
        run_rollouts(done, [RolloutRequest(fault=Drop(), onset=0.1, seed=0)], horizon=0.0)
    with pytest.raises(UnknownNameError, match="unknown target 'elbow'"):
        run_rollouts(done, [RolloutRequest(fault=Drop(targets=("elbow",)), onset=0.1, seed=0)])
    for setting in ("threads", "batch"):
        for wrong, expected in ((0, "at least 1"), (10**400, "at most")):
            with pytest.raises(SettingError, match=rf"{setting} = .*{expected}"):
                run_rollouts(done, [RolloutRequest(fault=Drop(), onset=0.1, seed=0)], **{setting: wrong})
    assert run_rollouts(done, []) == []


@dataclass(frozen=True, kw_only=True)
class Bug(Drop):
    """A fault with a bug."""

    NAME = "bug"

    def apply(self, plant, level):
        raise IndexError("a mistake in a fault")


@pytest.mark.parametrize("threads", [1, 3])
def test_a_mistake_in_a_fault_is_raised_and_ends_the_others(done, threads, monkeypatch):
    begun = []

    def counted(*given):
        begun.append(given)
        return _run_group(*given)

    monkeypatch.setattr("failbench.rollouts.rollout._run_group", counted)
    jobs = [RolloutRequest(fault=fault, onset=0.2, seed=0) for fault in (Bug(), *[Drop()] * 60)]
    with pytest.raises(IndexError, match="a mistake in a fault"):
        run_rollouts(done, jobs, horizon=0.05, threads=threads, batch=1)
    assert len(begun) < len(jobs)


def test_a_weld_lets_go_without_a_push():
    done = execution(settings=SimSettings(grasp="weld"))
    job = RolloutRequest(fault=Drop(), onset=0.3, seed=0)
    body = done.world.carried_body
    adr = int(done.world.model.jnt_dofadr[done.world.model.body_jntadr[body]])
    speeds = [data.qvel[adr : adr + 3].copy() for _, data in rollout_steps(done, job, horizon=0.02)]
    g = done.world.model.opt.gravity
    fall = np.diff(speeds, axis=0) / done.dt
    assert fall == pytest.approx(np.tile(g, (len(fall), 1)), abs=1e-6)


@pytest.mark.parametrize("horizon", [0.0, -1.0, 0.001, float("nan"), float("inf"), 1e9])
def test_horizons_are_checked(done, horizon):
    job = RolloutRequest(fault=Drop(), onset=0.1, seed=0)
    for ask in (
        lambda: run_rollouts(done, [job], horizon=horizon),
        lambda: list(rollout_steps(done, job, horizon=horizon)),
    ):
        with pytest.raises(SettingError, match=r"horizon = .*0\.002 s.*200 s"):
            ask()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"onset": float("nan")}, "onset = nan"),
        ({"onset": -0.1}, "onset = -0.1"),
        ({"seed": -1}, "seed = -1, expected a whole number"),
        ({"weight": float("inf")}, "weight = inf"),
    ],
)
def test_jobs_are_checked(wrong, message):
    with pytest.raises(SettingError, match=message):
        RolloutRequest(**({"fault": Drop(), "onset": 0.1, "seed": 0} | wrong))


@dataclass(frozen=True, kw_only=True)
class ReadsHigh(Weaken):
    """A sensor that reads too much, by the degree's amount."""

    NAME = "reads_high"
    FIELDS = ()

    def apply(self, plant, level):
        plant.misread(plant.joints, np.full((len(plant.ahead), len(plant.joints)), 0.1 * self.amount * level))


@pytest.mark.parametrize("control", ["servo", "torque"])
def test_a_joint_whose_sensor_reads_high_comes_to_rest_too_low(control):
    done = execution(settings=SimSettings(control=control))
    joint = done.world.robot.joints[3]
    *_, (_, data) = rollout_steps(
        done, RolloutRequest(fault=ReadsHigh(targets=(joint,)), onset=done.duration, seed=0), horizon=1.0
    )
    off = data.qpos[done.world.robot.qpos] - done.trajectory.q[-1]
    assert off[3] == pytest.approx(-0.075, abs=0.005)
    assert np.abs(np.delete(off, 3)).max() < 0.005
