import numpy as np
import pytest
from motions import ARM, SERVO, arm, execution, world

import graceful_plan as gp
from failbench import ExecutionRefused, SimSettings, build_world, execute
from failbench.simulated.states import CHECKPOINT
from graceful_plan.exceptions import NonFiniteError, SettingError, ShapeError


@pytest.fixture(scope="module")
def result(task):
    return gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=20, speed=0.5)


@pytest.mark.parametrize("control", ["servo", "torque"])
@pytest.mark.parametrize("grasp", ["fingers", "weld"])
def test_a_healthy_robot_follows_and_holds(result, control, grasp):
    done = execute(result, world("tabletop", "green_to_blue", SimSettings(control=control, grasp=grasp)))
    assert done.tracking_error.max() < {"servo": 0.01, "torque": 0.002}[control]
    assert done.slip < {"fingers": 0.003, "weld": 0.0005}[grasp]
    assert done.duration == result.trajectory.duration
    assert len(done.states) == int(np.ceil(done.duration / done.dt)) // CHECKPOINT + 1


def test_checkpoints_are_where_the_trajectory_is(result):
    done = execute(result, world("tabletop", "green_to_blue"))
    start = 1  # time comes first in MuJoCo's state
    for onset in (0.0, 0.1, 0.5 * done.duration, done.duration):
        k = done.checkpoint(onset)
        t = k * CHECKPOINT * done.dt
        between = CHECKPOINT * done.dt
        assert t == pytest.approx(onset, abs=between if onset == done.duration else 0.5 * between + 1e-9)
        q = done.states[k][start:][done.world.robot.qpos]
        assert q == pytest.approx(result.trajectory.at(result.trajectory.t[0] + t).q, abs=0.01)
    assert done.checkpoint(1e9) == len(done.states) - 1


def test_the_last_command_is_held(result):
    done = execute(result, world("tabletop", "green_to_blue"))
    held = done.commands(len(done.command) - 3, 10)
    assert (held[3:] == done.command[-1]).all()
    q = held[-1][done.world.robot.actuators]
    assert q == pytest.approx(result.trajectory.q[-1], abs=0.03)  # the servo error that carries the arm's weight


def test_same_input_same_execution(result):
    first, second = (execute(result, world("tabletop", "green_to_blue")) for _ in range(2))
    assert np.array_equal(first.states, second.states)
    assert first.baseline == second.baseline


def test_configurations_and_paths_are_timed(task):
    q = np.linspace(task.start, task.goal[0], 5)
    made = world("tabletop", "green_to_blue", SimSettings(grasp="weld"))
    by_array, by_path = execute(q, made), execute(gp.Path(q), made)
    assert np.array_equal(by_array.states, by_path.states)
    speed = np.abs(by_array.trajectory.qd)
    assert (speed <= task.scene.limits.velocity * (1 + 1e-6)).all()


def test_a_motion_that_is_too_fast_is_refused_with_joint_and_time(result, task):
    t = result.trajectory
    rushed = gp.Trajectory(t.t / 8, t.q, t.qd * 8, t.qdd * 64, t.joints)
    with pytest.raises(ExecutionRefused, match=r"'panda/joint\d'.*0\.\d+ s: .* rad") as e:
        execute(rushed, world("tabletop", "green_to_blue", SimSettings(grasp="weld")))
    assert 0.0 < e.value.time < rushed.duration
    assert e.value.what[7:-1] in task.scene.joints


def test_a_motion_out_of_a_joint_s_range_is_refused_with_joint_and_time(task):
    q = np.stack([task.start, task.start, task.start])
    q[2, 3] = 0.5
    away = gp.Trajectory(np.array([0.0, 1.0, 3.0]), q, 0.0 * q, 0.0 * q, task.scene.joints)
    with pytest.raises(ExecutionRefused, match=r"'panda/joint4'.*-3\.07.*-0\.0698") as e:
        execute(away, world("tabletop", "green_to_blue"))
    assert 1.0 < e.value.time < 3.0


def test_a_diverging_healthy_run_is_refused_and_leaves_no_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    wild = arm(actuators='<position joint="shoulder" kp="500000000" kv="0"/>')
    with pytest.raises(ExecutionRefused, match="joint 'shoulder'"):
        execute(np.array([[0.0], [0.6]]), build_world(wild))
    assert not list(tmp_path.iterdir())


def test_a_motion_that_takes_too_long_is_refused(task):
    q = np.stack([task.start, task.start])
    with pytest.raises(SettingError, match=r"duration.*1000000\.0"):
        execute(
            gp.Trajectory(np.array([0.0, 1e6]), q, 0.0 * q, 0.0 * q, task.scene.joints),
            world("tabletop", "green_to_blue"),
        )


def test_an_object_that_slips_is_refused():
    bottle = gp.load_scene("dining_table").tasks["pass_bottle"]
    rushed = np.stack([bottle.start, bottle.goal[0]])
    with pytest.raises(ExecutionRefused, match=r"'bottle'.*SimSettings\(grasp='weld'\)"):
        execute(rushed, world("dining_table", "pass_bottle"))
    held = execute(rushed, world("dining_table", "pass_bottle", SimSettings(grasp="weld")))
    assert held.slip < 0.001


def test_initial_contacts_are_the_baseline():
    leaning = arm().spec.copy()
    leaning.geom("vase").size[1] = 0.2405  # the vase reaches up to the link
    leaning.body("vase").pos = 0.25, 0.0, 0.2405
    scene = gp.Scene.from_mjcf(
        leaning, robot="base", tool="tool", entities={"vase": "glass"}, velocity=[2.0], acceleration=[5.0]
    )
    away = execute(np.array([[0.0], [-0.2]]), build_world(scene))
    assert away.baseline == {("body", "vase")}
    assert not execution("tabletop", "green_to_blue").baseline


def test_other_joints_stay_at_the_pose_of_the_scene():
    head = '<body name="head"><joint name="head"/><geom size="0.05" pos="0 0 0.3"/></body>'
    text = ARM.format(fingers="", actuators=SERVO + '<position joint="head" kp="100" kv="10"/>')
    text = text.replace('<body name="link">', head + '<body name="link">')
    scene = gp.Scene.from_mjcf(
        text, robot="base", tool="tool", velocity=[2.0], acceleration=[5.0], fingers={"head": 0.7}
    )
    done = execute(np.array([[0.0], [0.6]]), build_world(scene))
    column = 1 + done.world.model.jnt_qposadr[done.world.model.joint("head").id]  # time comes first
    assert np.abs(done.states[:, column] - 0.7).max() < 0.01


def test_a_motion_that_stands_still():
    made = world("tabletop", "green_to_blue")
    start = made.scene.tasks["green_to_blue"].start if made.scene.tasks else made.scene.keyframes["above_green"]
    done = execute(start[None], made)
    assert done.duration == 0.0
    assert done.tracking_error.max() < 0.01


def test_other_joints_and_failed_plans_are_refused(task):
    made = world("tabletop", "green_to_blue")
    with pytest.raises(ShapeError):
        execute(np.zeros((3, 5)), made)
    q = np.stack([task.start, task.start])
    turned = gp.Trajectory(np.array([0.0, 1.0]), q, 0.0 * q, 0.0 * q, tuple(reversed(task.scene.joints)))
    with pytest.raises(SettingError, match=r"joints.*joint7"):
        execute(turned, made)
    with pytest.raises(NonFiniteError):
        execute(np.full((3, 7), np.nan), made)
    failed = gp.plan(task.scene.limits.position[:, 1] + 1.0, task.goal, task.scene, w=0.0)
    with pytest.raises(gp.PlanningFailed):
        execute(failed, made)
