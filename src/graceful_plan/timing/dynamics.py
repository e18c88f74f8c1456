"""Joint torques of a motion, by MuJoCo's recursive Newton-Euler algorithm."""

from __future__ import annotations

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.scene.placement import Placement
from graceful_plan.scene.scene import Scene


class RobotDynamics:
    """Inverse dynamics of a scene's robot with its carried object, called with q, qd, qdd.

    Not thread-safe: use one instance per thread.

    The model's rotor inertia, viscous damping and gravity compensation are included; dry friction, contacts and the
    drag of the air are not. The fingers stay still, and the carried object moves as if it were part of the hand.
    """

    def __init__(self, scene: Scene) -> None:
        self._placement = Placement(scene)
        model = self._placement.model
        joints = [model.joint(name).id for name in scene.joints]
        self._dofs = model.jnt_dofadr[joints]
        self._tool_body = int(model.site_bodyid[model.site(scene.tool).id])
        self._load = [] if scene.carried is None else _bodies_of(model, model.body(scene.carried.body).id)

    def __call__(
        self, q: Float[Array, " nq"], qd: Float[Array, " nq"], qdd: Float[Array, " nq"]
    ) -> Float[Array, " nq"]:
        """Return the joint torques [N m or N] for a state and an acceleration."""
        model, data = self._placement.model, self._placement.place(q)
        data.qvel[:] = data.qacc[:] = 0.0
        data.qvel[self._dofs], data.qacc[self._dofs] = qd, qdd
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_passive(model, data)
        torque = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 1, torque)
        torque += model.dof_armature * data.qacc - (data.qfrc_passive - data.qfrc_fluid)
        for body in self._load:
            torque += self._of_load(body, data)
        return torque[self._dofs]

    def _of_load(self, body: int, data: mujoco.MjData) -> Float[Array, " nv"]:
        """Return the torques that accelerate and hold a body of the carried object, by virtual work."""
        model = self._placement.model
        J_v, J_w, dJ_v, dJ_w = (np.zeros((3, model.nv)) for _ in range(4))
        centre = data.xipos[body].copy()
        mujoco.mj_jac(model, data, J_v, J_w, centre, self._tool_body)
        mujoco.mj_jacDot(model, data, dJ_v, dJ_w, centre, self._tool_body)
        acceleration = J_v @ data.qacc + dJ_v @ data.qvel - model.opt.gravity
        turning, angular = J_w @ data.qacc + dJ_w @ data.qvel, J_w @ data.qvel
        R = data.ximat[body].reshape(3, 3)
        inertia = (R * model.body_inertia[body]) @ R.T
        gyration = np.empty(3)
        mujoco.mju_cross(gyration, angular, inertia @ angular)
        moment = inertia @ turning + gyration
        return J_v.T @ (model.body_mass[body] * acceleration) + J_w.T @ moment


def _bodies_of(model: mujoco.MjModel, root: int) -> list[int]:
    return [
        b for b in range(model.nbody) if model.body_rootid[b] == model.body_rootid[root] and model.body_mass[b] > 0.0
    ]
