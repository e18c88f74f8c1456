"""Pose and Jacobian of one frame for batches of configurations.

Frames: W world, F the frame asked for. The chain of bodies from the world to F is multiplied out in double precision,
with everything that is not planned in the state of the scene. `core.kernels` evaluates all links at once instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.edit import PosedModel
from graceful_plan.scene.elements import Carried
from graceful_plan.scene.model_parts import ancestors, body_joints, lookup, names
from graceful_plan.scene.roles import free_joint

Array = np.ndarray

_OBJ = mujoco.mjtObj
_KINDS = (_OBJ.mjOBJ_SITE, _OBJ.mjOBJ_BODY, _OBJ.mjOBJ_GEOM)
"""Kinds of frames; of several with the same name, the first kind counts."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Turn:
    """A planned joint of a chain: a constant pose, then a rotation about or a translation along an axis.

    | field  | meaning                                                             | unit     | shape |
    |--------|---------------------------------------------------------------------|----------|-------|
    | X_PJ   | pose of the joint in the frame after the previous joint             |          | 4 4   |
    | column | index of the planned joint                                          |          |       |
    | zero   | position at which the joint does not move its body                  | rad or m |       |
    | axis   | unit vector along the joint's axis in its frame                     |          | 3     |
    | slides | whether the joint is a slide                                        |          |       |
    """

    X_PJ: Float[Array, "4 4"]
    column: int
    zero: float
    axis: Float[Array, " 3"]
    slides: bool


class Chain:
    """The joints between the world and a frame.

    Args:
        posed: Model of the scene.
        planned: Index of each planned joint among the planned ones, by joint.
        home: qpos of the whole model.
        tool: Name of the tool's site.
        carried: The object in the gripper, if any.
        frame: Name of a site, body or geom; the first of these that exists.

    Raises:
        UnknownNameError: If there is no such frame.
    """

    def __init__(
        self,
        posed: PosedModel,
        planned: Mapping[int, int],
        home: Float[Array, " model_nq"],
        tool: str,
        carried: Carried | None,
        frame: str,
    ) -> None:
        self._posed, self._model, self._planned, self._home = posed, posed.shapes, planned, home
        self._turns: list[_Turn] = []
        self._so_far = np.eye(4)
        body, X_BF = self._place(frame)
        held = -1 if carried is None else self._model.body(carried.body).id
        above = [b for b in reversed(ancestors(self._model, body)) if b > 0]
        if carried is not None and held in above:
            tool_body, X_BT = self._place(tool)
            for b in reversed(ancestors(self._model, tool_body)):
                self._add_body(b)
            self._so_far = self._so_far @ X_BT @ carried.X_TO
            above = above[above.index(held) + 1 :]
        for b in above:
            self._add_body(b)
        self._X_JF = self._so_far @ X_BF

    def _place(self, frame: str) -> tuple[int, Float[Array, "4 4"]]:
        """Return the body that a frame is fixed to, and its pose there."""
        model = self._model
        found = next(((kind, k) for kind in _KINDS if (k := lookup(model, kind, frame)) >= 0), None)
        if found is None:
            counts = (model.nsite, model.nbody, model.ngeom)
            valid = {n for kind, m in zip(_KINDS, counts, strict=True) for n in names(model, kind, range(m))}
            raise UnknownNameError("frame (site, body or geom)", frame, (n for n in valid if not n.startswith("#")))
        kind, k = found
        if kind == _OBJ.mjOBJ_BODY:
            return k, np.eye(4)
        if kind == _OBJ.mjOBJ_SITE:
            return int(model.site_bodyid[k]), _pose(model.site_pos[k], model.site_quat[k])
        return int(model.geom_bodyid[k]), _pose(model.geom_pos[k], model.geom_quat[k])

    def _add_body(self, body: int) -> None:
        model = self._model
        adr = free_joint(model, body)
        if adr >= 0:
            self._so_far = _pose(self._home[adr : adr + 3], self._home[adr + 3 : adr + 7])
            return
        self._so_far = self._so_far @ _pose(*self._posed.pose(body))
        for joint in body_joints(model, body):
            anchor, back = np.eye(4), np.eye(4)
            anchor[:3, 3], back[:3, 3] = model.jnt_pos[joint], -model.jnt_pos[joint]
            adr, slides = int(model.jnt_qposadr[joint]), model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            axis, zero = np.array(model.jnt_axis[joint]), float(model.qpos0[adr])
            if joint in self._planned:
                turn = _Turn(
                    X_PJ=self._so_far @ anchor, column=self._planned[joint], zero=zero, axis=axis, slides=bool(slides)
                )
                self._turns.append(turn)
                self._so_far = back
                continue
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
                moved = _pose(np.zeros(3), self._home[adr : adr + 4])
            else:
                moved = _moved(axis, float(self._home[adr]) - zero, slides=bool(slides))
            self._so_far = self._so_far @ anchor @ moved @ back

    def pose(self, q: Float[Array, "*batch nq"]) -> Float[Array, "*batch 4 4"]:
        """Return the pose of the frame in W."""
        return self._walk(q)[0]

    def jacobian(self, q: Float[Array, "*batch nq"]) -> Float[Array, "*batch 6 nq"]:
        """Return the Jacobian of the frame's velocity [m/s], then of its angular velocity [rad/s], both in W."""
        X_WF, X_WJ = self._walk(q)
        jacobian = np.zeros((*q.shape[:-1], 6, q.shape[-1]))
        if not self._turns:
            return jacobian
        joints, slides = self._joints, self._joints.slides[:, None]
        axis = np.einsum("...tij,tj->...ti", X_WJ[..., :3, :3], joints.axis)
        lever = X_WF[..., None, :3, 3] - X_WJ[..., :3, 3]
        jacobian[..., :3, joints.column] = np.swapaxes(np.where(slides, axis, np.cross(axis, lever)), -1, -2)
        jacobian[..., 3:, joints.column] = np.swapaxes(np.where(slides, 0.0, axis), -1, -2)
        return jacobian

    def _walk(self, q: Float[Array, "*batch nq"]) -> tuple[Float[Array, "*batch 4 4"], Float[Array, "*batch turn 4 4"]]:
        """Return the pose of the frame, and of each joint before it moves, in W."""
        X, joints = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4)), self._joints
        moved = joints.motions(q)
        X_WJ = np.empty(moved.shape)
        for k in range(len(self._turns)):
            X_WJ[..., k, :, :] = X @ joints.X_PJ[k]
            X = X_WJ[..., k, :, :] @ moved[..., k, :, :]
        return X @ self._X_JF, X_WJ

    @cached_property
    def _joints(self) -> _Joints:
        turns = self._turns
        axis = np.array([turn.axis for turn in turns]).reshape(-1, 3)
        none = np.zeros(len(turns))
        x, y, z = axis.T
        return _Joints(
            X_PJ=np.array([turn.X_PJ for turn in turns]).reshape(-1, 4, 4),
            column=np.array([turn.column for turn in turns], dtype=int),
            zero=np.array([turn.zero for turn in turns], dtype=float),
            axis=axis,
            slides=np.array([turn.slides for turn in turns], dtype=bool),
            cross=np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Joints:
    """The planned joints of a chain side by side, with the cross-product matrices of their axes."""

    X_PJ: Float[Array, "turn 4 4"]
    column: Int[Array, " turn"]
    zero: Float[Array, " turn"]
    axis: Float[Array, "turn 3"]
    slides: Bool[Array, " turn"]
    cross: Float[Array, "turn 3 3"]

    def motions(self, q: Float[Array, "*batch nq"]) -> Float[Array, "*batch turn 4 4"]:
        """Return the motion of each joint: a translation along its axis, or a rotation about it (Rodrigues)."""
        amount = q[..., self.column] - self.zero
        angle = np.where(self.slides, 0.0, amount)[..., None, None]
        X = np.zeros((*amount.shape, 4, 4))
        X[..., :3, :3] = np.eye(3) + np.sin(angle) * self.cross + (1.0 - np.cos(angle)) * (self.cross @ self.cross)
        X[..., :3, 3] = np.where(self.slides, amount, 0.0)[..., None] * self.axis
        X[..., 3, 3] = 1.0
        return X


def _pose(position: Float[Array, " 3"], quaternion: Float[Array, " 4"]) -> Float[Array, "4 4"]:
    R, X = np.empty(9), np.eye(4)
    mujoco.mju_quat2Mat(R, quaternion)
    X[:3, :3], X[:3, 3] = R.reshape(3, 3), position
    return X


def _moved(axis: Float[Array, " 3"], amount: float, *, slides: bool) -> Float[Array, "4 4"]:
    """Return the motion of a joint that is not planned [rad or m]."""
    if slides:
        return _pose(amount * axis, np.array([1.0, 0.0, 0.0, 0.0]))
    quaternion = np.empty(4)
    mujoco.mju_axisAngle2Quat(quaternion, axis, amount)
    return _pose(np.zeros(3), quaternion)
