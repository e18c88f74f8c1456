"""The robot as CasADi expressions: kinematics and inverse dynamics, from the same tables as the kernels.

Frames: W world, P parent link, L link, C centre of mass of a link, T tool. A link is a joint with all bodies rigidly
attached to it. The fingers stay still, and the carried object moves as part of the hand, as in `RobotDynamics`.

References:
    [Craig2005] Introduction to Robotics, Sec. 6.5: the recursive Newton-Euler algorithm in link frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.core.arrays import RobotArrays
from graceful_plan.core.compile import compile_scene
from graceful_plan.exceptions import ShapeError, UnsupportedError
from graceful_plan.path import finite_array
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene

Expression = Any
"""A CasADi SX. CasADi has no type stubs and is imported on demand."""

_AIR = 1.3
"""Density of air at sea level [kg/m^3], whose drag is left out as in `RobotDynamics`; a denser fluid is refused."""
_KEPT = 8
"""Number of cached batch functions, one for each batch size."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class LinkInertia:
    """Mass properties of a link, in its own frame.

    | field       | meaning                                                          | unit   | shape |
    |-------------|------------------------------------------------------------------|--------|-------|
    | mass        | mass                                                             | kg     |       |
    | centre      | centre of mass                                                   | m      | 3     |
    | tensor      | moments of inertia about the centre of mass                      | kg m^2 | 3 3   |
    | compensated | first mass moment of the bodies with gravity compensation        | kg m   | 3     |
    | floating    | mass of these bodies                                             | kg     |       |
    """

    mass: float
    centre: Float[Array, "3"]
    tensor: Float[Array, "3 3"]
    compensated: Float[Array, "3"]
    floating: float


@final
class SymbolicRobot:
    """CasADi functions of a scene's robot, each built on first use.

    Args:
        scene: The scene; the carried object counts as attached.

    Raises:
        UnsupportedError: If passive forces other than linear springs, linear damping and gravity compensation act on
            the planned joints.
    """

    def __init__(self, scene: Scene) -> None:
        model = scene.model
        joints = [model.joint(name).id for name in scene.joints]
        dofs = model.jnt_dofadr[joints]
        _check_passive(model, joints, dofs)
        self.robot = compile_scene(scene).robot
        self.nq = len(joints)
        self.inertias = _inertias(scene, self.robot)
        self.gravity = model.opt.gravity.copy()
        self.armature, self.damping = model.dof_armature[dofs].copy(), _column(model.dof_damping, dofs)
        self.stiffness = _column(model.jnt_stiffness, joints)
        self.spring = model.qpos_spring[model.jnt_qposadr[joints]].copy()
        self.compensates = ~model.jnt_actgravcomp[joints].astype(bool)
        """Whether gravity compensation relieves the joint's actuator; otherwise the actuator itself provides it."""
        self._maps: dict[tuple[str, int], Any] = {}

    @cached_property
    def link_poses(self) -> Any:
        """Function of q: X_WL of every link [m], 4 x 4 matrices side by side."""
        import casadi

        q = casadi.SX.sym("q", self.nq)
        return casadi.Function("link_poses", [q], [casadi.horzcat(*self._poses(q))], ["q"], ["X_WL"])

    @cached_property
    def tool_pose(self) -> Any:
        """Function of q: X_WT [m]."""
        import casadi

        q = casadi.SX.sym("q", self.nq)
        return casadi.Function("tool_pose", [q], [self._tool(q)], ["q"], ["X_WT"])

    @cached_property
    def tool_jacobian(self) -> Any:
        """Function of q: J_WT in W, velocity rows [m/rad] above angular velocity rows."""
        import casadi

        q = casadi.SX.sym("q", self.nq)
        X = self._tool(q)
        R = X[:3, :3]
        columns = []
        for k in range(self.nq):
            spin = casadi.jacobian(casadi.vec(R), q[k]).reshape((3, 3)) @ R.T
            columns.append(casadi.vertcat(spin[2, 1], spin[0, 2], spin[1, 0]))
        J = casadi.vertcat(casadi.jacobian(X[:3, 3], q), casadi.horzcat(*columns))
        return casadi.Function("tool_jacobian", [q], [J], ["q"], ["J_WT"])

    @cached_property
    def inverse_dynamics(self) -> Any:
        """Function of q, qd, qdd: joint torques [N m or N]."""
        import casadi

        state = [casadi.SX.sym(name, self.nq) for name in ("q", "qd", "qdd")]
        return casadi.Function("inverse_dynamics", state, [self._torque(*state)], ["q", "qd", "qdd"], ["torque"])

    @cached_property
    def torque_derivatives(self) -> Any:
        """Function of q, qd, qdd: torques, and their derivatives with respect to all three, nq x 3 nq."""
        import casadi

        state = [casadi.SX.sym(name, self.nq) for name in ("q", "qd", "qdd")]
        torque = self._torque(*state)
        slope = casadi.densify(casadi.jacobian(torque, casadi.vertcat(*state)))
        return casadi.Function("torque_derivatives", state, [torque, slope], {"cse": True})

    def torques(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Float[Array, "n nq"]:
        """Return the joint torques [N m or N] of a batch of states and accelerations."""
        states = self._states(q, qd, qdd)
        return np.array(self._mapped("inverse_dynamics", len(states[0]))(*(x.T for x in states))).T

    def torques_with_slopes(
        self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n nq state"]]:
        """Return the torques of a batch, and their derivatives with respect to q, qd and qdd side by side."""
        states = self._states(q, qd, qdd)
        n = len(states[0])
        torque, slope = self._mapped("torque_derivatives", n)(*(x.T for x in states))
        return np.array(torque).T, np.array(slope).reshape(self.nq, n, 3 * self.nq).transpose(1, 0, 2)

    def _mapped(self, name: str, n: int) -> Any:
        """Return a function mapped over `n` states; cached because a solve uses the same batch size repeatedly."""
        if (name, n) not in self._maps:
            if len(self._maps) >= _KEPT:
                self._maps.pop(next(iter(self._maps)))
            self._maps[name, n] = getattr(self, name).map(n)
        return self._maps[name, n]

    def _states(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> list[Float[Array, "n nq"]]:
        states = [finite_array(n, x, ndim=2, last=self.nq) for n, x in (("q", q), ("qd", qd), ("qdd", qdd))]
        for name, x in zip(("qd", "qdd"), states[1:], strict=True):
            if x.shape != states[0].shape:
                raise ShapeError(name, x.shape, f"that of q, {states[0].shape}")
        return states

    def _in_parent(self, link: int, q: Expression) -> tuple[Expression, Expression]:
        """Return R_PL and p_PL at a configuration; joints rotate about, or slide along, the link's own z axis."""
        import casadi

        X, joint = self.robot.X_PL[link], int(self.robot.joint[link])
        R, p = casadi.SX(casadi.DM(X[:3, :3])), casadi.SX(casadi.DM(X[:3, 3]))
        if joint < 0:
            return R, p
        if self.robot.slide[link]:
            return R, p + R[:, 2] * q[joint]
        c, s = casadi.cos(q[joint]), casadi.sin(q[joint])
        turn = casadi.vertcat(casadi.horzcat(c, -s, 0), casadi.horzcat(s, c, 0), casadi.horzcat(0, 0, 1))
        return R @ turn, p

    def _poses(self, q: Expression) -> list[Expression]:
        import casadi

        poses: list[Expression] = []
        for link, parent in enumerate(self.robot.parent.tolist()):
            R, p = self._in_parent(link, q)
            X = casadi.vertcat(casadi.horzcat(R, p), casadi.SX([[0, 0, 0, 1]]))
            poses.append(X if parent < 0 else poses[parent] @ X)
        return poses

    def _tool(self, q: Expression) -> Expression:
        import casadi

        return self._poses(q)[self.robot.tool_link] @ casadi.DM(self.robot.X_LT)

    def _torque(self, q: Expression, qd: Expression, qdd: Expression) -> Expression:
        import casadi

        torque = self._inertial(q, qd, qdd) + self._against_gravity(q)
        passive = casadi.DM(self.damping) * qd + casadi.DM(self.stiffness) * (q - casadi.DM(self.spring))
        return torque + casadi.DM(self.armature) * qdd + passive

    def _against_gravity(self, q: Expression) -> Expression:
        """Return the gradient of the potential energy, minus the part that gravity compensation carries."""
        import casadi

        poses, gravity = self._poses(q), casadi.DM(self.gravity)
        energy, carried = casadi.SX(0), casadi.SX(0)
        for X, link in zip(poses, self.inertias, strict=True):
            energy -= gravity.T @ (X[:3, :3] @ casadi.DM(link.mass * link.centre) + link.mass * X[:3, 3])
            carried -= gravity.T @ (X[:3, :3] @ casadi.DM(link.compensated) + link.floating * X[:3, 3])
        lifted = casadi.DM(self.compensates.astype(float)) * casadi.gradient(carried, q)
        return casadi.gradient(energy, q) - lifted

    def _inertial(self, q: Expression, qd: Expression, qdd: Expression) -> Expression:
        """Return the torques that accelerate the links, by the outward and inward passes of Newton-Euler."""
        import casadi

        cross, zero, z = casadi.cross, casadi.SX.zeros(3), casadi.DM([0.0, 0.0, 1.0])
        parents = self.robot.parent.tolist()
        frames = [self._in_parent(link, q) for link in range(len(parents))]
        spin, turn, push, force, moment = ([zero] * len(parents) for _ in range(5))
        for i, (parent, (R, p)) in enumerate(zip(parents, frames, strict=True)):
            joint, slides = int(self.robot.joint[i]), bool(self.robot.slide[i])
            if parent >= 0:
                w, a = spin[parent], turn[parent]
                spin[i], turn[i] = R.T @ w, R.T @ a
                push[i] = R.T @ (push[parent] + cross(a, p) + cross(w, cross(w, p)))
            if joint >= 0 and slides:
                push[i] += 2.0 * cross(spin[i], z * qd[joint]) + z * qdd[joint]
            elif joint >= 0:
                turn[i] += cross(spin[i], z * qd[joint]) + z * qdd[joint]
                spin[i] += z * qd[joint]
            body = self.inertias[i]
            c, inertia = casadi.DM(body.centre), casadi.DM(body.tensor)
            force[i] = body.mass * (push[i] + cross(turn[i], c) + cross(spin[i], cross(spin[i], c)))
            moment[i] = inertia @ turn[i] + cross(spin[i], inertia @ spin[i]) + cross(c, force[i])
        torque = casadi.SX.zeros(self.nq)
        for i in reversed(range(len(parents))):
            (R, p), joint = frames[i], int(self.robot.joint[i])
            if joint >= 0:
                torque[joint] += (force[i] if self.robot.slide[i] else moment[i])[2]
            if parents[i] >= 0:
                force[parents[i]] += R @ force[i]
                moment[parents[i]] += R @ moment[i] + cross(p, R @ force[i])
        return torque


@per_scene
def symbolic_robot(scene: Scene) -> SymbolicRobot:
    """Return the expressions of a scene's robot; cached per scene.

    Raises:
        UnsupportedError: As in `SymbolicRobot`.
    """
    return SymbolicRobot(scene)


def _column(values: Array, rows: Any) -> Float[Array, " nq"]:
    return np.array(values[rows], dtype=np.float64)


def _check_passive(model: mujoco.MjModel, joints: list[int], dofs: Array) -> None:
    for name, of_joints in (("jnt_stiffnesspoly", joints), ("dof_dampingpoly", dofs)):
        if np.any(getattr(model, name)[of_joints]):
            raise UnsupportedError(f"symbolic dynamics of joints with {name} are not supported")
    if model.opt.density > _AIR:
        raise UnsupportedError(f"symbolic dynamics in a fluid of density {model.opt.density:g} are not supported")
    for tendon in range(model.ntendon):
        acts = np.any(model.tendon_stiffness[tendon]) or np.any(model.tendon_damping[tendon])
        if acts or np.any(model.tendon_armature[tendon]):
            raise UnsupportedError(f"symbolic dynamics of tendon {model.tendon(tendon).name!r} are not supported")


def _inertias(scene: Scene, robot: RobotArrays) -> list[LinkInertia]:
    """Sum the bodies of each planned joint, with the carried object as part of the tool's link."""
    model, nq = scene.model, len(scene.joints)
    data = Placement(scene).place(np.zeros(nq))
    X_WL = compile_scene(scene).kernels.link_poses(np.zeros(nq))
    link_of_joint = {
        model.joint(name).id: int(np.flatnonzero(robot.joint == k)[0]) for k, name in enumerate(scene.joints)
    }
    members: list[list[int]] = [[] for _ in robot.parent]
    for body in range(1, model.nbody):
        link = _link_of(model, body, link_of_joint)
        if link is not None and model.body_mass[body] > 0.0:
            members[link].append(body)
    if scene.carried is not None:
        root = model.body_rootid[model.body(scene.carried.body).id]
        members[robot.tool_link] += [b for b in range(model.nbody) if model.body_rootid[b] == root]
    return [_together(model, data, bodies, X_WL[link]) for link, bodies in enumerate(members)]


def _link_of(model: mujoco.MjModel, body: int, link_of_joint: dict[int, int]) -> int | None:
    """Return the link that a body moves with: that of the nearest planned joint above it."""
    while body:
        first = int(model.body_jntadr[body])
        for joint in reversed(range(first, first + int(model.body_jntnum[body]))):
            if joint in link_of_joint:
                return link_of_joint[joint]
        body = int(model.body_parentid[body])
    return None


def _together(model: mujoco.MjModel, data: mujoco.MjData, bodies: list[int], X_WL: Float[Array, "4 4"]) -> LinkInertia:
    R_LW, mass = X_WL[:3, :3].T, model.body_mass[bodies]
    total = float(mass.sum())
    places = (data.xipos[bodies].reshape(-1, 3) - X_WL[:3, 3]) @ R_LW.T
    centre = mass @ places / total if total > 0.0 else np.zeros(3)
    tensor = np.zeros((3, 3))
    for body, m, place in zip(bodies, mass, places, strict=True):
        R = R_LW @ data.ximat[body].reshape(3, 3)
        r = place - centre
        tensor += R @ np.diag(model.body_inertia[body]) @ R.T + m * (r @ r * np.eye(3) - np.outer(r, r))
    share = mass * model.body_gravcomp[bodies]
    return LinkInertia(
        mass=total, centre=centre, tensor=tensor, compensated=share @ places, floating=float(share.sum())
    )
