"""Jackal and Fetch against published numbers, and rolling, turning and braking of their simulated versions."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_wheels import rolling_qpos, rolling_spec

import graceful_plan as gp
from graceful_plan.exceptions import SceneError
from graceful_plan.scene.loading.robot_models import robot_file

_TOLERANCE = 1e-9
"""Both sides are chains of exact transforms in double precision."""

FETCH_CHAIN = [  # joint, origin in its parent, axis, range, velocity, acceleration, effort, as published
    ("torso_lift", (-0.0869, 0, 0.3774), "slide z", (0, 0.386), 0.1, 0.5, 450),
    ("shoulder_pan", (0.1195, 0, 0.3486), "z", (-1.6056, 1.6056), 1.256, 1.5, 33.8),
    ("shoulder_lift", (0.117, 0, 0.06), "y", (-1.221, 1.518), 1.454, 1.0, 131.8),
    ("upperarm_roll", (0.219, 0, 0), "x", None, 1.571, 1.5, 76.9),
    ("elbow_flex", (0.133, 0, 0), "y", (-2.251, 2.251), 1.521, 1.5, 66.2),
    ("forearm_roll", (0.197, 0, 0), "x", None, 1.571, 1.5, 29.4),
    ("wrist_flex", (0.1245, 0, 0), "y", (-2.16, 2.16), 2.268, 2.5, 25.7),
    ("wrist_roll", (0.1385, 0, 0), "x", None, 2.268, 2.5, 7.4),
]
AHEAD = 0.035
"""Middle of a Jackal's wheels, its pivot for turns in place [m]."""
TUCKED = (0.35, 1.32, 1.4, -0.2, 1.72, 0.0, 1.66, 0.0)
_AXES = {"x": 0, "y": 1, "z": 2}
_WHEEL_INERTIA = {"jackal": 0.0024, "fetch": 0.005}
_TOOLS = {"jackal": "deck", "fetch": "tool"}


def ground(robot: str) -> mujoco.MjSpec:
    """Return a robot on a floor."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    spec.attach(
        mujoco.MjSpec.from_file(str(robot_file(robot))),
        prefix=f"{robot}/",
        frame=spec.worldbody.add_frame(pos=[0, 0, 0]),
    )
    spec.option.timestep, spec.option.impratio = 0.002, 10.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    return spec


@cache
def scene_of(robot: str) -> gp.Scene:
    return gp.Scene.from_mjcf(
        ground(robot),
        robot=f"{robot}/",
        tool=f"{robot}/{_TOOLS[robot]}",
        body_class="base_coast",
        allowed_contacts=[gp.AllowedContact(f"{robot}/base", "floor")],
    )


class Rolling:
    """A simulated robot with commanded speed and turning rate, on a ramp along x if tilted [rad]."""

    def __init__(self, robot: str, tilt: float = 0.0) -> None:
        self.base = scene_of(robot).base
        self.model = rolling_spec(scene_of(robot)).compile()
        self.model.opt.gravity[:] = 9.81 * np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
        self.data = mujoco.MjData(self.model)
        self.robot = robot
        self.dofs = [int(self.model.joint(w).dofadr[0]) for w in self.base.wheels]
        self.motors = [self.model.actuator(w).id for w in self.base.wheels]

    def run(self, seconds: float, v: float = 0.0, omega: float = 0.0) -> None:
        turn = omega * 0.5 * self.base.track / self.base.radius * np.repeat([-1.0, 1.0], len(self.motors) // 2)
        self.data.ctrl[self.motors] = v / self.base.radius + turn
        mujoco.mj_step(self.model, self.data, nstep=round(seconds / self.model.opt.timestep))

    def cut_power(self) -> None:
        self.model.actuator_gainprm[self.motors] = self.model.actuator_biasprm[self.motors] = 0.0

    @property
    def yaw(self) -> float:
        w, x, y, z = self.data.qpos[3:7]
        return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    @property
    def rims(self) -> np.ndarray:
        """Return the speed of each wheel's rim [m/s]."""
        return self.data.qvel[self.dofs] * self.base.radius

    def constants(self) -> tuple[float, float]:
        """Friction deceleration [m/s^2] and drag [1/s] of a base without power, as published for both robots."""
        n, r = len(self.dofs), self.base.radius
        rotor = self.model.dof_armature[self.dofs[0]] + _WHEEL_INERTIA[self.robot]
        mass = self.model.body_mass.sum() + n * rotor / r**2
        friction, damping = self.model.dof_frictionloss[self.dofs[0]], self.model.dof_damping[self.dofs[0]]
        return float(n * friction / (r * mass)), float(n * damping / (r**2 * mass))


# --- published numbers ------------------------------------------------------------------------------------------------


def test_a_jackal_has_the_published_masses_and_wheels():
    model = ground("jackal").compile()
    assert model.body_mass.sum() == pytest.approx(18.43, abs=0.005)
    chassis, wheel = model.body("jackal/base"), model.body("jackal/front_left")
    assert chassis.mass[0] == pytest.approx(16.523) and wheel.mass[0] == pytest.approx(0.477)
    np.testing.assert_allclose(chassis.ipos, [0.012 - AHEAD, 0.002, 0.0635 + 0.067])
    np.testing.assert_allclose(
        _inertia(model, "jackal/base"), [[0.3136, 0, 0.0164], [0, 0.3922, 0], [0.0164, 0, 0.4485]]
    )
    np.testing.assert_allclose(np.diag(_inertia(model, "jackal/front_left")), [0.0013, 0.0024, 0.0013])
    places = {tuple(np.round(model.body(name).pos, 4)) for name in scene_of("jackal").base.wheels}
    assert places == {(round(x - AHEAD, 4), y, 0.098) for x in (-0.131, 0.131) for y in (-0.1878, 0.1878)}
    assert model.geom("jackal/front_left").size[:2] == pytest.approx([0.098, 0.02])
    np.testing.assert_allclose(2 * model.geom("jackal/chassis").size, [0.42, 0.31, 0.184])


def test_a_fetch_has_the_published_masses_and_wheels():
    model = ground("fetch").compile()
    mass = {model.body(b).name.removeprefix("fetch/"): float(model.body_mass[b]) for b in range(1, model.nbody)}
    arm = sum(mass[name] for name, *_ in FETCH_CHAIN[1:])
    assert [mass["base_link"], mass["torso_fixed"], mass["left_wheel"]] == pytest.approx([70.1294, 13.2775, 4.3542])
    assert mass["torso_lift"] == pytest.approx(10.7796 + 2 * 0.169374, abs=1e-4)  # including the bellows
    assert mass["head_pan"] + mass["head_tilt"] == pytest.approx(3.16, abs=0.01)
    assert arm == pytest.approx(13.20, abs=0.01)
    assert mass["gripper"] + 2 * mass["left_finger"] == pytest.approx(1.68, abs=0.01)
    assert sum(mass.values()) == pytest.approx(121.3, abs=0.05)
    left, right = model.body("fetch/left_wheel"), model.body("fetch/right_wheel")
    assert left.pos[1] - right.pos[1] == pytest.approx(0.37476)
    assert model.geom("fetch/base").size[0] == pytest.approx(0.288)


def _inertia(model: mujoco.MjModel, name: str) -> np.ndarray:
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.body(name).iquat)
    R = R.reshape(3, 3)
    return np.round(R @ np.diag(model.body(name).inertia) @ R.T, 9)


def test_bases_have_the_published_limits():
    jackal, fetch = scene_of("jackal").base, scene_of("fetch").base
    assert (jackal.radius, jackal.track, jackal.v_max, jackal.omega_max) == (0.098, 2 * 0.1878, 2.0, 4.0)
    assert jackal.slip == pytest.approx(1 + (2 * 0.131 / jackal.track) ** 2, abs=1e-3)
    assert (fetch.radius, fetch.track, fetch.slip) == (0.06, 0.37476, 1.0)
    assert (fetch.v_max, fetch.omega_max, fetch.a_max, fetch.alpha_max, fetch.wheel_max) == (1.0, 1.5, 0.75, 0.8, 17.4)


def test_joints_of_a_fetch_are_the_published_ones():
    scene = scene_of("fetch")
    model, limits = scene.model, scene.limits
    assert scene.joints == (*scene.base.joints, *(f"fetch/{name}" for name, *_ in FETCH_CHAIN))
    for k, (name, at, axis, bounds, velocity, acceleration, effort) in enumerate(FETCH_CHAIN, 3):
        joint = model.joint(f"fetch/{name}")
        np.testing.assert_allclose(model.body(f"fetch/{name}").pos, at, atol=5e-5)
        np.testing.assert_allclose(joint.axis, np.eye(3)[_AXES[axis[-1]]])
        assert (joint.type[0] == int(mujoco.mjtJoint.mjJNT_SLIDE)) == axis.startswith("slide")
        assert bounds is None or joint.range == pytest.approx(bounds)
        assert (limits.velocity[k], limits.acceleration[k]) == (velocity, acceleration)
        assert limits.torque[k] == effort
    for side in ("left", "right"):
        assert model.joint(f"fetch/{side}_finger").range == pytest.approx([0.0, 0.05])


@given(st.lists(st.floats(0.0, 1.0), min_size=8, max_size=8), st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
def test_kinematics_of_a_fetch_follow_the_published_table(fractions, x, y, yaw):
    model = scene_of("fetch").model
    lower = np.array([(bounds or (-np.pi, np.pi))[0] for *_, bounds, _, _, _ in FETCH_CHAIN])
    upper = np.array([(bounds or (-np.pi, np.pi))[1] for *_, bounds, _, _, _ in FETCH_CHAIN])
    q = lower + np.array(fractions) * (upper - lower)
    X = _turned("z", yaw)
    X[:3, 3] = x, y, 0.004675
    for (name, _, axis, *_), value in zip(FETCH_CHAIN, q, strict=True):
        step = np.eye(4)
        step[:3, 3] = model.body(f"fetch/{name}").pos  # compared with the table above
        if axis.startswith("slide"):
            step[2, 3] += value
        else:
            step = step @ _turned(axis, value)
        X = X @ step
    X = X @ np.block([[np.eye(3), np.array([[0.16645], [0], [0]])], [np.zeros((1, 3)), np.ones((1, 1))]])
    tool = scene_of("fetch").data_at([x, y, yaw, *q]).site("fetch/tool")
    np.testing.assert_allclose(tool.xpos, X[:3, 3], atol=_TOLERANCE)
    # z of the tool leaves the hand along x of the gripper, the fingers close along y.
    np.testing.assert_allclose(tool.xmat.reshape(3, 3)[:, 1:], X[:3, [1, 0]], atol=_TOLERANCE)


def _turned(axis: str, angle: float) -> np.ndarray:
    X, R = np.eye(4), np.empty(9)
    quaternion = np.array([np.cos(angle / 2), *(np.sin(angle / 2) * np.eye(3)[_AXES[axis]])])
    mujoco.mju_quat2Mat(R, quaternion)
    X[:3, :3] = R.reshape(3, 3)
    return X


def test_a_tucked_fetch_touches_nothing():
    assert gp.clearance([0, 0, 0, *TUCKED], scene_of("fetch")) > 0.002
    assert gp.clearance([0, 0, 0, 0.2, *np.zeros(7)], scene_of("fetch")) > 0.002


# --- agreement of both models -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["jackal", "fetch"])
def test_versions_differ_by_their_root_and_wheels_alone(robot):
    scene = scene_of(robot)
    rolling, planned = rolling_spec(scene).compile(), scene.model
    wheels = set(scene.base.wheels)
    assert rolling.njnt == planned.njnt - 2 + len(wheels) and rolling.nu == planned.nu + len(wheels)
    others = {planned.joint(j).name for j in range(3, planned.njnt)}
    assert {rolling.joint(j).name for j in range(1, rolling.njnt)} == others | wheels
    assert rolling.joint(0).name == f"{robot}/rolling"
    for name in ("body_mass", "body_inertia", "body_pos", "geom_size", "geom_pos"):
        np.testing.assert_allclose(getattr(rolling, name), getattr(planned, name))


@pytest.mark.parametrize("robot", ["jackal", "fetch"])
def test_states_of_both_versions_are_the_same_place(robot):
    scene = scene_of(robot)
    q = np.array([1.0, -2.0, 0.7, *TUCKED][: len(scene.joints)])
    model = rolling_spec(scene).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = rolling_qpos(scene, model, q)
    mujoco.mj_kinematics(model, data)
    planned = scene.data_at(q)
    for g in range(model.ngeom):
        there = planned.geom(model.geom(g).name)
        np.testing.assert_allclose(data.geom(g).xpos, there.xpos, atol=_TOLERANCE)
        np.testing.assert_allclose(data.geom(g).xmat, there.xmat, atol=_TOLERANCE)


def test_incomplete_drive_descriptions_are_refused():
    spec = ground("jackal")
    spec.delete(next(n for n in spec.numerics if n.name == "jackal/drive/track"))
    with pytest.raises(SceneError, match="needs track"):
        gp.Scene.from_mjcf(spec, robot="jackal/", tool="jackal/deck")
    spec.add_numeric(name="jackal/drive/colour", data=[1.0])
    with pytest.raises(SceneError, match="colour"):
        gp.Scene.from_mjcf(spec, robot="jackal/", tool="jackal/deck")


def test_joints_of_a_base_are_those_of_the_world():
    spec = mujoco.MjSpec.from_file(str(robot_file("jackal")))
    spec.body("base").pos = [1.0, 0.0, 0.0]
    with pytest.raises(SceneError, match="base"):
        gp.Scene.from_mjcf(spec, robot="base", tool="deck")


# --- how they roll ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", ["jackal", "fetch"])
def test_wheels_do_not_sink(robot):
    sim = Rolling(robot)
    sim.run(1.0)
    assert sim.data.qpos[2] == pytest.approx(0.0, abs=3e-4)
    assert abs(sim.data.qvel).max() < 1e-3


@pytest.mark.parametrize(("robot", "least", "most"), [("jackal", 1.45, 1.6), ("fetch", 0.99, 1.02)])
@pytest.mark.parametrize("omega", [0.5, 1.5])
def test_turning_in_place_takes_the_published_slip(robot, omega, least, most):
    sim = Rolling(robot)
    sim.run(2.0, omega=omega)
    before, turned, rims = sim.yaw, 0.0, []
    for _ in range(50):
        sim.run(0.02, omega=omega)
        turned += np.angle(np.exp(1j * (sim.yaw - before)))
        before = sim.yaw
        rims.append(sim.rims[-1] - sim.rims[0])
    slip = np.mean(rims) / sim.base.track / (turned / 1.0)
    assert least < slip < most


@pytest.mark.parametrize("robot", ["jackal", "fetch"])
def test_coasting_goes_as_far_as_the_closed_form(robot):
    sim = Rolling(robot)
    a, k = sim.constants()
    for v in np.linspace(0.0, 1.0, 21):
        sim.run(0.05, v=v)
    sim.run(0.2, v=1.0)
    v, begin = sim.data.qvel[0], sim.data.qpos[0]
    sim.cut_power()
    sim.run(3.0)
    expected = v / k - a / k**2 * np.log(1 + k * v / a)
    assert sim.data.qvel[0] < 1e-3
    assert sim.data.qpos[0] - begin == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("steeper", "moves"), [(0.9, False), (1.1, True)])
def test_a_steep_ramp_moves_a_base(steeper, moves):
    a, _ = Rolling("jackal").constants()
    level = Rolling("jackal")
    mass = level.model.body_mass.sum()
    rotors = len(level.dofs) * (level.model.dof_armature[level.dofs[0]] + _WHEEL_INERTIA["jackal"])
    effective = mass + rotors / level.base.radius**2
    sim = Rolling("jackal", tilt=float(np.arcsin(steeper * a * effective / (mass * 9.81))))
    sim.cut_power()
    sim.run(1.5)
    assert (sim.data.qpos[0] > 0.02) == moves


def test_a_fetch_pivots_about_a_locked_wheel():
    """At half of its track, after sliding to a stop, while the other wheel is still driven."""
    v, sim = 0.5, Rolling("fetch")
    sim.run(1.0, v=v)
    sim.model.dof_frictionloss[sim.dofs[0]] = 1e4
    sim.model.actuator_gainprm[sim.motors[0]] = sim.model.actuator_biasprm[sim.motors[0]] = 0.0
    sim.run(3.0, v=v)
    omega, radius = sim.data.qvel[5], np.hypot(*sim.data.qvel[:2]) / sim.data.qvel[5]
    assert radius == pytest.approx(sim.base.track / 2, rel=0.05)
    assert omega == pytest.approx(v / sim.base.track, rel=0.05)  # to the left, the locked side


@pytest.mark.parametrize("v", [1.0, 2.0])
def test_a_jackal_with_all_wheels_locked_slides_by_tyre_friction(v):
    sim = Rolling("jackal")
    for speed in np.linspace(0.0, v, 21):
        sim.run(0.06, v=speed)
    sim.run(0.3, v=v)
    v, begin = sim.data.qvel[0], sim.data.qpos[0]
    sim.cut_power()
    sim.model.dof_frictionloss[sim.dofs] = 1e4
    sim.run(1.5)
    assert sim.data.qpos[0] - begin == pytest.approx(v**2 / (2 * 0.6 * 9.81), rel=0.1)


def test_a_jackal_with_one_side_locked_spins_to_that_side():
    """At a radius of 0.14 to 0.24 m, at a rate between those of full slip and of no slip."""
    v, sim = 1.5, Rolling("jackal")
    for speed in np.linspace(0.0, v, 21):
        sim.run(0.06, v=speed)
    begin, locked = sim.data.qpos[:2].copy(), sim.motors[:2]
    sim.model.actuator_gainprm[locked] = sim.model.actuator_biasprm[locked] = 0.0
    sim.model.dof_frictionloss[sim.dofs[:2]] = 1e4
    sim.run(3.0, v=v)
    omega, radius = sim.data.qvel[5], np.hypot(*sim.data.qvel[:2]) / sim.data.qvel[5]
    assert v / (1.55 * sim.base.track) < omega < v / sim.base.track
    assert 0.14 < radius < 0.24
    assert np.linalg.norm(sim.data.qpos[:2] - begin) < 0.95


def test_servos_of_a_fetch_hold_its_arm():
    sim = Rolling("fetch")
    joints = [sim.model.joint(f"fetch/{name}") for name, *_ in FETCH_CHAIN]
    addresses = [int(joint.qposadr[0]) for joint in joints]
    motors = [sim.model.actuator(f"fetch/{name}").id for name, *_ in FETCH_CHAIN]
    sim.data.qpos[addresses] = sim.data.ctrl[motors] = (0.2, 0.5, -0.3, 0.4, 1.0, 0.0, 0.8, 0.0)
    sim.run(2.0)
    assert np.abs(sim.data.qpos[addresses] - sim.data.ctrl[motors]).max() < 0.02  # sag without gravity compensation
    assert np.abs(sim.data.qvel).max() < 0.05
