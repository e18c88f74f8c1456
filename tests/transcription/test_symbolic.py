"""The symbolic robot against MuJoCo: kinematics, Jacobian and inverse dynamics to 1e-8."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import ShapeError, UnsupportedError
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.dynamics import RobotDynamics
from graceful_plan.transcription.symbolic import SymbolicRobot, symbolic_robot

_TOLERANCE = 1e-8

CRANE = """
<mujoco>
  <option gravity="0.3 -0.2 -9.7"/>
  <compiler angle="radian"/>
  <worldbody>
    <body name="crane" pos="0.1 0.2 0.3" euler="0.2 -0.3 0.5" gravcomp="0.4">
      <joint name="lift" type="slide" axis="0.3 0.2 1" range="-1 1" armature="0.3" damping="2"/>
      <geom type="box" size="0.1 0.05 0.2" mass="3"/>
      <body name="boom" pos="0.1 0 0.2" euler="0.1 0.4 0">
        <joint name="turn" axis="0 1 0.5" pos="0.02 0.01 0" range="-2 2" damping="1" stiffness="3" springref="0.2"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0.1" size="0.03" mass="1.5"/>
        <body name="trolley" pos="0.4 0 0.1" gravcomp="1.5">
          <joint name="reach" type="slide" axis="1 0 0.2" range="-0.3 0.3"/>
          <joint name="roll" axis="1 0 0" range="-3 3" armature="0.01" actuatorgravcomp="true"/>
          <geom type="box" size="0.05 0.02 0.07" pos="0.03 0.02 0" mass="0.7"/>
          <site name="hook" pos="0.1 0.02 -0.1" euler="0.3 0.2 0.1"/>
        </body>
      </body>
    </body>
    <body name="crate" pos="1 1 1">
      <freejoint/>
      <geom type="box" size="0.05 0.08 0.03" pos="0.01 0 0" mass="0.9"/>
    </body>
  </worldbody>
  <actuator>
    <motor joint="lift"/><motor joint="turn"/><motor joint="reach"/><motor joint="roll"/>
  </actuator>
</mujoco>
"""


def _crane(carried: str | None = None) -> Scene:
    scene = gp.Scene.from_mjcf(
        CRANE, robot="crane", tool="hook", velocity=[1.0] * 4, acceleration=[2.0] * 4, torque=[500.0] * 4
    )
    if carried is None:
        return scene
    X_TO = np.eye(4)
    X_TO[:3, 3] = 0.02, -0.03, 0.1
    return scene.attach(carried, X_TO=X_TO, object_class="glass")


def _scene(name: str) -> Scene:
    if name == "crane":
        return _crane()
    if name == "crane with crate":
        return _crane("crate")
    return next(iter(gp.load_scene(name).tasks.values())).scene


@pytest.fixture(scope="module", params=["tabletop_l1", "dining_table", "crane", "crane with crate"])
def scene(request: pytest.FixtureRequest) -> Scene:
    return _scene(request.param)


def _states(scene: Scene, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng, nq = np.random.default_rng(3), len(scene.joints)
    q = rng.uniform(*scene.limits.position.T, (n, nq))
    return q, rng.normal(size=(n, nq)), 5.0 * rng.normal(size=(n, nq))


def test_inverse_dynamics_is_that_of_mujoco(scene: Scene) -> None:
    states, exact = _states(scene, 30), RobotDynamics(scene)
    expected = np.stack([exact(*state) for state in zip(*states, strict=True)])
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(symbolic_robot(scene).torques(*states), expected, atol=_TOLERANCE)


@pytest.mark.parametrize("name", ["tabletop_l1", "crane"])
def test_inverse_dynamics_without_load_is_mj_inverse(name: str) -> None:
    scene = _scene(name).detach() if name == "tabletop_l1" else _scene(name)
    model = scene.model
    model_dofs = model.jnt_dofadr[[model.joint(joint).id for joint in scene.joints]]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    try:
        for q, qd, qdd in zip(*_states(scene, 10), strict=True):
            data = scene.data_at(q)
            data.qvel[model_dofs], data.qacc[model_dofs] = qd, qdd
            mujoco.mj_inverse(model, data)
            found = symbolic_robot(scene).torques(q[None], qd[None], qdd[None])[0]
            expected = data.qfrc_inverse[model_dofs] + data.qfrc_constraint[model_dofs]
            np.testing.assert_allclose(found, expected, atol=_TOLERANCE)
    finally:
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)


def test_tool_and_jacobian_equal_those_of_mujoco(scene: Scene) -> None:
    robot, model = symbolic_robot(scene), scene.model
    dofs = model.jnt_dofadr[[model.joint(joint).id for joint in scene.joints]]
    for q in _states(scene, 5)[0]:
        data = scene.data_at(q)
        site = data.site(scene.tool)
        X = np.asarray(robot.tool_pose(q))
        np.testing.assert_allclose(X[:3, 3], site.xpos, atol=_TOLERANCE)
        np.testing.assert_allclose(X[:3, :3], site.xmat.reshape(3, 3), atol=_TOLERANCE)
        J = np.zeros((6, model.nv))
        mujoco.mj_jacSite(model, data, J[:3], J[3:], model.site(scene.tool).id)
        np.testing.assert_allclose(np.asarray(robot.tool_jacobian(q)), J[:, dofs], atol=_TOLERANCE)


def test_link_poses_equal_those_of_the_kernels(scene: Scene) -> None:
    robot, kernels = symbolic_robot(scene), gp.Objective().bind(scene).kernels
    q = _states(scene, 1)[0][0]
    found = np.asarray(robot.link_poses(q)).reshape(4, -1, 4).transpose(1, 0, 2)
    np.testing.assert_allclose(found, kernels.link_poses(q), atol=_TOLERANCE)


def test_slopes_equal_differences(scene: Scene) -> None:
    robot, states = symbolic_robot(scene), _states(scene, 4)
    torque, slopes = robot.torques_with_slopes(*states)
    np.testing.assert_allclose(torque, robot.torques(*states), atol=1e-10)
    nq, step = len(scene.joints), 1e-5
    for k in range(3 * nq):
        moved = [
            robot.torques(*(x + sign * step * np.eye(3 * nq)[k].reshape(3, nq)[i] for i, x in enumerate(states)))
            for sign in (1.0, -1.0)
        ]
        np.testing.assert_allclose(slopes[:, :, k], (moved[0] - moved[1]) / (2.0 * step), rtol=1e-5, atol=1e-5)


def test_the_symbolic_robot_is_built_once_per_scene(scene: Scene) -> None:
    assert symbolic_robot(scene) is symbolic_robot(scene)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("<option", '<option density="1000"', "fluid"),
        ('damping="2"', 'damping="2 0.1"', "dof_dampingpoly"),
        (
            "<actuator>",
            '<tendon><fixed name="rope" stiffness="3"><joint joint="turn" coef="1"/></fixed></tendon><actuator>',
            "rope",
        ),
    ],
)
def test_unsupported_forces_are_refused(old: str, new: str, named: str) -> None:
    scene = gp.Scene.from_mjcf(
        CRANE.replace(old, new, 1), robot="crane", tool="hook", velocity=[1.0] * 4, acceleration=[2.0] * 4
    )
    with pytest.raises(UnsupportedError, match=named):
        SymbolicRobot(scene)


def test_the_drag_of_the_air_is_left_out() -> None:
    air = CRANE.replace("<option", '<option density="1.2" viscosity="2e-5"', 1)
    first, second = (
        gp.Scene.from_mjcf(source, robot="crane", tool="hook", velocity=[1.0] * 4, acceleration=[2.0] * 4)
        for source in (CRANE, air)
    )
    state = _states(first, 1)
    expected = RobotDynamics(first)(*(x[0] for x in state))
    np.testing.assert_array_equal(RobotDynamics(second)(*(x[0] for x in state)), expected)
    np.testing.assert_allclose(symbolic_robot(second).torques(*state)[0], expected, atol=_TOLERANCE)


def test_shapes_are_checked() -> None:
    robot = symbolic_robot(_crane())
    with pytest.raises(ShapeError, match="qd"):
        robot.torques(np.zeros((2, 4)), np.zeros((3, 4)), np.zeros((2, 4)))
    with pytest.raises(ShapeError, match="q "):
        robot.torques(np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)))
