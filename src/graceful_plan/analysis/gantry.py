"""The carried object without the robot: a scene in which three slides put the object anywhere.

Quantities that depend only on the position and velocity of the object are evaluated in this scene: q is the position of
its centre of mass in W [m], qd its velocity [m/s].
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Float
from graceful_plan.exceptions import ShapeError
from graceful_plan.path import finite_array
from graceful_plan.scene.scene import Scene

_NAME = "object_gantry"
_RANGE = 1000.0  # of the slides, in both directions [m]
_NO_ONE = 1 << 30  # a collision bit that no other geom has


def gantry_scene(scene: Scene, R_WO: ArrayLike) -> Scene:
    """Return the scene with the robot replaced by three slides, along x, y and z of W, that hold the object.

    Entities, severities, contents and obstacles are those of the scene; the robot no longer collides.

    Args:
        scene: A scene with an object in the gripper.
        R_WO: Orientation of the object.

    Raises:
        ShapeError: If nothing is carried.
    """
    held = scene.notes.held
    if scene.carried is None or held is None:
        raise ShapeError("scene.carried", (), "a scene with a carried object; see Scene.attach")
    X_TO = np.eye(4)
    X_TO[:3, :3] = finite_array("R_WO", R_WO, ndim=2, last=3)
    X_TO[:3, 3] = -X_TO[:3, :3] @ centre_of_mass(scene)
    notes = replace(
        scene.notes,
        robot=_NAME,
        tool=_NAME,
        fingers=None,
        velocity=(1.0,) * 3,
        acceleration=(1.0,) * 3,
        torque=None,
        keyframes={},
        tasks={},
        allowed=(),
        support=(),
        held=replace(held, X_TO=X_TO, fingers=None),
    )
    return Scene.build(_spec(scene), notes)


def centre_of_mass(scene: Scene) -> Float[Array, " 3"]:
    """Return the centre of mass of the carried object and everything attached to it, in its body frame O [m]."""
    assert scene.carried is not None
    data = scene.data_at(scene.model.qpos0[scene.qpos_adr])
    body = scene.model.body(scene.carried.body).id
    return data.xmat[body].reshape(3, 3).T @ (data.subtree_com[body] - data.xpos[body])


def _spec(scene: Scene) -> mujoco.MjSpec:
    spec = scene.spec.copy()
    bodies = {scene.model.body(body).name for body in scene.robot_bodies}
    for geom in spec.geoms:
        if geom.parent.name in bodies:
            geom.contype = geom.conaffinity = 0
    mine = {geom.name for geom in spec.geoms if geom.parent.name in bodies}
    for pair in list(spec.pairs):
        if {pair.geomname1, pair.geomname2} & mine:
            spec.delete(pair)
    for key in list(spec.keys):  # keyframes do not fit the slides
        spec.delete(key)
    body = spec.worldbody.add_body(name=_NAME)
    for name, axis in (("x", [1, 0, 0]), ("y", [0, 1, 0]), ("z", [0, 0, 1])):
        body.add_joint(
            name=f"{_NAME}_{name}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, limited=True, range=[-_RANGE, _RANGE]
        )
    # A component needs a colliding geom; this one touches nothing.
    body.add_geom(name=_NAME, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-3, 0, 0], contype=_NO_ONE, conaffinity=0)
    body.add_site(name=_NAME)
    return spec
