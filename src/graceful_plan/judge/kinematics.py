"""The judge's forward kinematics for many configurations at once: a product of exponentials in NumPy.

MuJoCo computes all poses once, with all planned joints at 0, and the axis of each joint there. The planned joints are
hinges and slides in a tree: a chain from the world to the tool, or several arms. So a link moves by the product of the
rigid motions about the axes of the joints before it. Other joints stay where the scene holds them.

References:
    R. W. Brockett, "Robotic manipulators and the product of exponentials formula", 1984.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float, Int
from graceful_plan.judge.preparation import own_placement
from graceful_plan.scene.model_parts import body_joints, subtree
from graceful_plan.scene.per_scene import per_scene
from graceful_plan.scene.scene import Scene

_BLOCK = 512
"""Configurations per block: their matrices fit into the cache of a core."""
_POINT_BLOCK = 4096
"""The same for `held_point`, which has vectors instead of matrices."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """Frames attached to links; link k + 1 is moved by planned joint k and those before it, link 0 is fixed.

    | field | meaning                                     | shape     |
    |-------|---------------------------------------------|-----------|
    | link  | link of each frame                          | frame     |
    | X_WF  | its pose with all planned joints at 0 [m]   | frame 4 4 |
    """

    link: Int[Array, " frame"]
    X_WF: Float[Array, "frame 4 4"]

    def __getitem__(self, chosen: Sequence[int] | Int[Array, " some"]) -> Frames:
        """Return the given frames."""
        rows = np.asarray(chosen, dtype=int)
        return Frames(link=self.link[rows], X_WF=self.X_WF[rows])


@dataclass(frozen=True, kw_only=True, eq=False)
class Kinematics:
    """Forward kinematics of one scene, including the carried object; made by `kinematics`.

    | field  | meaning                                                                        | shape   |
    |--------|--------------------------------------------------------------------------------|---------|
    | parent | link on which each planned joint is                                            | nq      |
    | slides | whether each planned joint is a slide rather than a hinge                      | nq      |
    | motion | coefficients of 1, sin q and cos q for a hinge, or of 1, q and 0 for a slide;  | nq 3 16 |
    |        | their sum is the joint's motion in W as a 4 x 4 matrix                         |         |
    | axes   | columns: a point on each joint's axis [m] and its direction, at 0              | nq 4 2  |
    | geoms  | frames of the model's geoms                                                    |         |
    | held   | of the tool site, and of the body of the carried object if there is one        |         |
    | bodies | link of each body of the model                                                 | body    |
    """

    parent: Int[Array, " nq"]
    slides: Bool[Array, " nq"]
    motion: Float[Array, "nq 3 16"]
    axes: Float[Array, "nq 4 2"]
    geoms: Frames
    held: Frames
    bodies: Int[Array, " body"]

    @cached_property
    def carries(self) -> Bool[Array, "nq link"]:
        """Whether each planned joint moves each link."""
        found = np.zeros((len(self.parent), len(self.parent) + 1), dtype=bool)
        for joint, parent in enumerate(self.parent.tolist()):
            found[:, joint + 1] = found[:, parent]
            found[joint, joint + 1] = True
        return found

    def links(self, q: Float[Array, "n nq"]) -> Iterator[Float[Array, "n 4 4"]]:
        """Yield the rigid motion of each link in W relative to all planned joints at 0, from link 0 to link nq."""
        factors = np.empty((q.shape[1], len(q), 3))
        factors[..., 0] = 1.0
        np.sin(q.T, out=factors[..., 1])
        np.cos(q.T, out=factors[..., 2])
        if self.slides.any():
            factors[self.slides, :, 1] = q.T[self.slides]
        links = [np.broadcast_to(np.eye(4), (len(q), 4, 4))]
        yield links[0]
        for factor, motion, parent in zip(factors, self.motion, self.parent.tolist(), strict=True):
            each = (factor @ motion).reshape(-1, 4, 4)
            links.append(links[parent] @ each if parent else each)
            yield links[-1]

    def poses(self, q: Float[Array, "n nq"], frames: Frames) -> Float[Array, "frame n 4 4"]:
        """Return the poses of frames in W [m]."""
        found = np.empty((len(frames.link), len(q), 4, 4))
        riders = [np.flatnonzero(frames.link == k).tolist() for k in range(q.shape[1] + 1)]
        for begin in range(0, len(q), _BLOCK):
            poses = found[:, begin : begin + _BLOCK]
            for moved, mine in zip(self.links(q[begin : begin + _BLOCK]), riders, strict=True):
                for frame in mine:
                    np.matmul(moved.reshape(-1, 4), frames.X_WF[frame], out=poses[frame].reshape(-1, 4))
        return found

    def held_point(self, q: Float[Array, "n nq"], point: Float[Array, " xyz"]) -> Float[Array, "n xyz"]:
        """Return the positions in W of a point of the carried object [m], in a third of the time of `poses`."""
        joints = np.flatnonzero(self.carries[:, self.held.link[-1]])[::-1].tolist()
        rows = self.motion.reshape(-1, 3, 4, 4).transpose(0, 2, 1, 3)[:, :3].reshape(-1, 3, 12)
        found = np.empty((3, len(q)))
        for begin in range(0, len(q), _POINT_BLOCK):
            angles = q[begin : begin + _POINT_BLOCK].T
            first, second = np.sin(angles), np.cos(angles)
            first[self.slides] = angles[self.slides]
            x = np.repeat((self.held.X_WF[-1] @ np.append(point, 1.0))[:, None], angles.shape[1], axis=1)
            for k in joints:  # the last one on the way from the base first
                x[:3] = rows[k] @ np.concatenate([x, first[k] * x, second[k] * x])
            found[:, begin : begin + _POINT_BLOCK] = x[:3]
        return found.T

    def joint_axes(self, links: Float[Array, "link n 4 4"]) -> Float[Array, "nq n 4 2"]:
        """Return a point on the axis of each planned joint [m], and its direction, as columns."""
        return links[self.parent] @ self.axes[:, None]


@per_scene
def kinematics(scene: Scene) -> Kinematics:
    """Return the forward kinematics of a scene."""
    placement = own_placement(scene)
    data, model = placement.place(np.zeros(len(scene.joints))), placement.model
    joints = [model.joint(name).id for name in scene.joints]
    tool = model.site(scene.tool).id
    link, before = np.zeros(model.nbody, dtype=int), np.zeros(len(joints), dtype=int)
    number = {joint: k for k, joint in enumerate(joints)}
    for body, parent in enumerate(model.body_parentid.tolist()):  # parents precede children; the world is its own
        link[body] = link[parent]
        for joint in body_joints(model, body):
            if joint in number:
                before[number[joint]], link[body] = link[body], number[joint] + 1
    held = Frames(link=link[model.site_bodyid[[tool]]], X_WF=_matrices(data.site_xpos[[tool]], data.site_xmat[[tool]]))
    if scene.carried is not None:
        body = model.body(scene.carried.body).id
        link[sorted(subtree(model, body))] = held.link
        carried = _matrices(data.xpos[[body]], data.xmat[[body]])
        held = Frames(link=np.repeat(held.link, 2), X_WF=np.concatenate([held.X_WF, carried]))
    slides = model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_SLIDE)
    anchor, axis = data.xanchor[joints], data.xaxis[joints]
    ones = np.ones(len(joints))
    return Kinematics(
        parent=before,
        slides=slides,
        motion=np.where(slides[:, None, None], _slides(axis), _turns(anchor, axis)),
        axes=np.stack([np.column_stack([anchor, ones]), np.column_stack([axis, 0.0 * ones])], axis=2),
        geoms=Frames(link=link[model.geom_bodyid], X_WF=_matrices(data.geom_xpos, data.geom_xmat)),
        held=held,
        bodies=link,
    )


def _turns(anchor: Float[Array, "nq 3"], axis: Float[Array, "nq 3"]) -> Float[Array, "nq 3 16"]:
    """Return the terms of rotations about axes in W: R = a a^T + sin q [a] + cos q (1 - a a^T), about the anchors."""
    along = axis[:, :, None] * axis[:, None]
    terms = np.zeros((len(axis), 3, 4, 4))
    terms[:, :, :3, :3] = np.stack([along, cross_matrix(axis), np.eye(3) - along], axis=1)
    terms[:, :, :3, 3] = -(terms[:, :, :3, :3] @ anchor[:, None, :, None])[..., 0]
    terms[:, 0, :3, 3] += anchor
    terms[:, 0, 3, 3] = 1.0
    return terms.reshape(-1, 3, 16)


def _slides(axis: Float[Array, "nq 3"]) -> Float[Array, "nq 3 16"]:
    """Return the terms of translations along axes in W."""
    terms = np.zeros((len(axis), 3, 4, 4))
    terms[:, 0] = np.eye(4)
    terms[:, 1, :3, 3] = axis
    return terms.reshape(-1, 3, 16)


def cross_matrix(a: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Return the matrix [a] with [a] b = a x b."""
    upper = np.zeros((*a.shape, 3))
    upper[..., 0, 1], upper[..., 0, 2], upper[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    return upper - np.swapaxes(upper, -1, -2)


def _matrices(p: Float[Array, "frame 3"], R: Float[Array, "frame 9"]) -> Float[Array, "frame 4 4"]:
    poses = np.zeros((len(p), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = R.reshape(-1, 3, 3), p, 1.0
    return poses
