import mujoco
import numpy as np
import pytest
from motions import ARM, FINGERS, SERVO, arm, world

import graceful_plan as gp
from failbench import SimSettings, build_world, execute
from failbench.simulated.states import STATE
from failbench.simulated.world import SENSOR_SIZE
from graceful_plan.exceptions import SettingError, UnsupportedError

TASKS = [(name, task) for name in gp.scenes() for task in gp.load_scene(name).tasks]


@pytest.mark.parametrize(("scene", "task"), TASKS)
def test_every_bundled_task_can_be_simulated(scene, task):
    made = world(scene, task)
    model = made.model
    source = made.scene.model
    assert [model.geom(g).name for g in range(model.ngeom)] == [source.geom(g).name for g in range(source.ngeom)]
    assert {pair[1] for pair in made.pairs} == set(made.scene.entities)
    assert {pair[0] for pair in made.pairs} == set(made.scene.components) - {"contents"}
    assert len(made.sensor_adr) == len(made.pairs)
    assert (np.diff(made.sensor_adr) == SENSOR_SIZE).all()
    assert [model.body(body).name for body in made.obstacles] == list(made.scene.unlabelled)
    assert len(made.obstacle_adr) == len(made.obstacles)
    assert not model.body_gravcomp.any()
    assert (made.robot.grip_open > made.robot.grip_closed).all()
    for entity, body in made.movable.items():
        assert body in made.entity_bodies[entity]
        assert model.jnt_type[model.body_jntadr[body]] == mujoco.mjtJoint.mjJNT_FREE


def test_a_contact_sensor_feels_its_pair_and_no_other():
    made = build_world(arm())
    data = mujoco.MjData(made.model)
    vase = made.model.jnt_qposadr[made.model.body_jntadr[made.movable["vase"]]]
    data.qpos[made.robot.qpos] = 0.0
    data.qpos[vase : vase + 3] = 0.25, 0.0, 0.41  # the vase's top is 1 cm inside the link
    mujoco.mj_forward(made.model, data)
    (adr,) = made.sensor_adr
    count, force, place = data.sensordata[adr], data.sensordata[adr + 1 : adr + 4], data.sensordata[adr + 4 : adr + 7]
    assert made.pairs == (("body", "vase"),)
    assert count >= 1
    assert place == pytest.approx([0.25, 0.0, 0.5], abs=0.05)
    assert force[2] < 0.0  # force of the link on the vase
    data.qpos[vase + 2] = 0.1
    mujoco.mj_forward(made.model, data)
    assert data.sensordata[adr] == 0.0


def test_finger_force_does_not_depend_on_object_width():
    for name, task in (("tabletop", "green_to_blue"), ("dining_table", "serve_tea")):
        made = world(name, task)
        held = gp.load_scene(name).tasks[task]
        start = execute(np.stack([held.start, held.start + 1e-3]), made).states[0]
        data = mujoco.MjData(made.model)
        mujoco.mj_setState(made.model, data, start, STATE)
        data.ctrl[made.robot.gripper_actuators] = made.robot.grip_closed
        mujoco.mj_forward(made.model, data)
        pressed = np.abs(data.qfrc_actuator[made.robot.gripper_dofs]).sum()
        assert pressed == pytest.approx(70.0, rel=1e-3)


def test_bodies_may_be_without_names():
    parts = '<body pos="0 0 0.05"><geom size="0.01"/></body><body pos="0 0 0.08"><geom size="0.01"/></body></body>'
    text = ARM.format(fingers=FINGERS, actuators=SERVO).replace('<body name="link">', "<body>")
    text = text.replace('size="0.02 0.02 0.02"/></body>', f'size="0.02 0.02 0.02"/>{parts}')
    scene = gp.Scene.from_mjcf(
        text, robot="base", tool="tool", velocity=[2.0], acceleration=[5.0], entities={"block": "glass"}
    )
    assert build_world(scene).pairs == (("body", "block"),) * 3


def test_a_joint_without_an_actuator_gets_a_servo_with_the_limit_of_the_scene():
    made = build_world(arm(actuators="", torque=[30.0]))
    assert made.model.actuator_forcerange == pytest.approx(np.array([[-30.0, 30.0]]))
    assert execute([[0.0], [0.6]], made).tracking_error < 0.01


def test_a_joint_with_another_drive_than_a_servo_is_refused():
    with pytest.raises(UnsupportedError, match=r"'shoulder'.*servo.*SimSettings"):
        build_world(arm(actuators='<motor joint="shoulder"/>'))
    torque = build_world(arm(actuators='<motor joint="shoulder"/>'), SimSettings(control="torque"))
    assert torque.robot.kp > 0.0


def test_without_fingers_only_a_weld_holds():
    scene = arm(carried="block", X_TO=gp.FROM_ABOVE)
    with pytest.raises(UnsupportedError, match=r"servo.*SimSettings"):
        build_world(scene)
    made = build_world(scene, SimSettings(grasp="weld"))
    assert made.robot.weld == made.hold >= 0


@pytest.mark.parametrize(
    ("signs", "place", "opened", "closed"),
    [
        ((1, -1), 0.02, [0.04, 0.04], [0.0, 0.0]),
        ((-1, 1), 0.06, [0.0, 0.0], [0.04, 0.04]),
        ((1, 1), 0.02, [0.04, -0.04], [0.0, 0.0]),  # mirrored: both axes along y
    ],
)
def test_the_gripper_opens_as_the_fingers_part(signs, place, opened, closed):
    parts = zip(("finger", "thumb"), signs, (place, -place), zip(opened, closed, strict=True), strict=True)
    fingers = "".join(
        f"""<body name="{name}" pos="0.3 0 0">
              <joint name="{name}" type="slide" axis="0 {sign} 0" range="{min(ends)} {max(ends)}"/>
              <geom name="{name}" type="box" size="0.02 0.005 0.01" pos="0 {y} 0"/></body>"""
        for name, sign, y, ends in parts
    )
    servos = SERVO + '<position joint="finger" kp="100" kv="10"/><position joint="thumb" kp="100" kv="10"/>'
    robot = build_world(arm(fingers=fingers, actuators=servos, carried="block", X_TO=gp.FROM_ABOVE)).robot
    assert robot.grip_open == pytest.approx(opened)
    assert robot.grip_closed == pytest.approx(closed)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"timestep": 0.1}, "timestep = 0.1"),
        ({"grasp": "glue"}, "grasp = 'glue', expected one of fingers, weld"),
        ({"control": "wish"}, "control = 'wish', expected one of servo, torque"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(SettingError, match=message):
        SimSettings(**settings)


@pytest.mark.parametrize(
    "servo",
    [
        '<position joint="shoulder" kp="5" kv="0.5" gear="10" forcerange="-8 8"/>',
        '<position joint="shoulder" kp="5" kv="0.5" gear="-10" forcerange="-8 8"/>',
        '<general joint="shoulder" biastype="affine" gainprm="500" biasprm="20 -500 -50" forcerange="-80 80"/>',
    ],
)
@pytest.mark.parametrize("control", ["servo", "torque"])
def test_gears_and_constant_forces_of_drives_are_made_up_for(servo, control):
    settings = SimSettings(control=control)
    plain = '<position joint="shoulder" kp="500" kv="50" forcerange="-80 80"/>'
    first, second = (execute([[0.0], [0.6]], build_world(arm(actuators=a), settings)) for a in (plain, servo))
    assert second.tracking_error == pytest.approx(first.tracking_error, rel=1e-6)
    assert second.world.model.actuator_forcerange[0] == pytest.approx([-80.0, 80.0])


def test_a_drive_with_dynamics_of_its_own_is_refused():
    with pytest.raises(UnsupportedError, match=r"'shoulder'.*dynamics"):
        build_world(arm(actuators='<position joint="shoulder" kp="500" kv="50" timeconst="0.05"/>'))


def test_drives_without_limits_of_their_own_have_those_of_the_scene():
    servos = SERVO + '<position joint="finger" kp="100" kv="10"/><position joint="thumb" kp="100" kv="10"/>'
    model = build_world(arm(fingers=FINGERS, actuators=servos, torque=[30.0])).model
    assert model.actuator_forcelimited.all()
    # The finger servos have 100 N/m over a stroke of at most 0.04 m.
    assert model.actuator_forcerange == pytest.approx(np.outer([30.0, 4.0, 4.0], [-1.0, 1.0]))


def test_the_shared_robot_is_read_only():
    with pytest.raises(ValueError, match="read-only"):
        build_world(arm()).robot.kp[:] = 0.0


def test_air_does_not_hold_a_link_whose_inertia_is_a_placeholder():
    # As in robosuite's Panda: 10 g with an inertia of 0.01 kg m2, which MuJoCo takes for a box of 2.4 m.
    tip = """<body name="tip" pos="0.32 0 0"><inertial pos="0 0 0" mass="0.01" diaginertia="0.01 0.01 0.01"/></body>"""
    text = ARM.format(fingers=tip, actuators='<motor joint="shoulder" ctrlrange="-12 12"/>')
    air = text.replace("<option ", '<option density="1.2" viscosity="2e-5" ')
    errors = [
        execute(
            [[0.0], [0.9]],
            build_world(
                gp.Scene.from_mjcf(source, robot="base", tool="tool", velocity=[4.0], acceleration=[30.0]),
                SimSettings(control="torque"),
            ),
        ).tracking_error
        for source in (text, air)
    ]
    assert np.array_equal(errors[0], errors[1]) and errors[0] < 0.01
