"""Pose and Jacobian of one frame for batches of configurations: a product of exponentials in double precision.

Frames: W world, F the frame asked for. MuJoCo computes F and the axes of the joints once, with all planned joints at 0.
`core.kernels` evaluates all links at once instead.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import UnknownNameError
from graceful_plan.scene.elements import Carried
from graceful_plan.scene.model_parts import ancestors, body_joints, lookup, names

_OBJ = mujoco.mjtObj
_KINDS = (_OBJ.mjOBJ_SITE, _OBJ.mjOBJ_BODY, _OBJ.mjOBJ_GEOM)
"""Kinds of frames; of several with the same name, the first kind counts."""


class Chain:
    """The planned joints between the world and a frame.

    Args:
        data: The scene with all planned joints at 0.
        planned: The planned joints.
        tool: Name of the tool's site.
        carried: The object in the gripper, if any.
        frame: Name of a site, body or geom; the first of these that exists.

    Raises:
        UnknownNameError: If there is no such frame.
    """

    def __init__(
        self, data: mujoco.MjData, planned: Sequence[int], tool: str, carried: Carried | None, frame: str
    ) -> None:
        model = data.model
        body, self._X_WF = _placed(data, frame)
        above = ancestors(model, body)
        if carried is not None and model.body(carried.body).id in above:
            above = ancestors(model, int(model.site(tool).bodyid[0]))
        joints = [j for b in reversed(above) for j in body_joints(model, b) if j in planned]
        self._columns = [planned.index(j) for j in joints]
        self._slides = model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_SLIDE)
        self._axes, self._anchors = data.xaxis[joints], data.xanchor[joints]
        none, (x, y, z) = np.zeros(len(joints)), self._axes.T
        self._cross = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3)

    def pose(self, q: Float[Array, "*batch nq"]) -> Float[Array, "*batch 4 4"]:
        """Return the pose of the frame in W."""
        return self._walk(q)[0]

    def jacobian(self, q: Float[Array, "*batch nq"]) -> Float[Array, "*batch 6 nq"]:
        """Return the Jacobian of the frame's velocity [m/s], then of its angular velocity [rad/s], both in W."""
        X_WF, moved = self._walk(q)
        jacobian, slides = np.zeros((*q.shape[:-1], 6, q.shape[-1])), self._slides[:, None]
        axis = np.einsum("...jik,jk->...ji", moved[..., :3, :3], self._axes)
        anchor = np.einsum("...jik,jk->...ji", moved[..., :3, :3], self._anchors) + moved[..., :3, 3]
        lever = X_WF[..., None, :3, 3] - anchor
        jacobian[..., :3, self._columns] = np.swapaxes(np.where(slides, axis, np.cross(axis, lever)), -1, -2)
        jacobian[..., 3:, self._columns] = np.swapaxes(np.where(slides, 0.0, axis), -1, -2)
        return jacobian

    def _walk(
        self, q: Float[Array, "*batch nq"]
    ) -> tuple[Float[Array, "*batch 4 4"], Float[Array, "*batch joint 4 4"]]:
        """Return the pose of the frame, and the motion of each joint's axis relative to all joints at 0, in W."""
        X, each = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4)), self._motions(q[..., self._columns])
        before = np.empty(each.shape)
        for k in range(len(self._columns)):
            before[..., k, :, :] = X
            X = X @ each[..., k, :, :]
        return X @ self._X_WF, before

    def _motions(self, q: Float[Array, "*batch joint"]) -> Float[Array, "*batch joint 4 4"]:
        """Return the motion of each joint: a translation along its axis, or a rotation about it (Rodrigues)."""
        angle = np.where(self._slides, 0.0, q)[..., None, None]
        R = np.eye(3) + np.sin(angle) * self._cross + (1.0 - np.cos(angle)) * (self._cross @ self._cross)
        X = np.zeros((*q.shape, 4, 4))
        X[..., :3, :3], X[..., 3, 3] = R, 1.0
        turned = self._anchors - np.einsum("...jik,jk->...ji", R, self._anchors)
        X[..., :3, 3] = np.where(self._slides[:, None], q[..., None] * self._axes, turned)
        return X


def _placed(data: mujoco.MjData, frame: str) -> tuple[int, Float[Array, "4 4"]]:
    """Return the body that a frame is fixed to, and its pose in W."""
    model, X = data.model, np.eye(4)
    found = next(((kind, k) for kind in _KINDS if (k := lookup(model, kind, frame)) >= 0), None)
    if found is None:
        counts = (model.nsite, model.nbody, model.ngeom)
        valid = {n for kind, m in zip(_KINDS, counts, strict=True) for n in names(model, kind, range(m))}
        raise UnknownNameError("frame (site, body or geom)", frame, (n for n in valid if not n.startswith("#")))
    kind, k = found
    at = {_OBJ.mjOBJ_SITE: data.site, _OBJ.mjOBJ_BODY: data.body, _OBJ.mjOBJ_GEOM: data.geom}[kind](k)
    X[:3, :3], X[:3, 3] = at.xmat.reshape(3, 3), at.xpos
    bodies = {_OBJ.mjOBJ_SITE: model.site_bodyid, _OBJ.mjOBJ_GEOM: model.geom_bodyid}
    return (int(bodies[kind][k]) if kind in bodies else k), X
