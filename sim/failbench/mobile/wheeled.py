"""Simulation model of a scene whose base stands on rotating wheels."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan import Scene
from graceful_plan.array_types import Array, Float, Int
from graceful_plan.exceptions import UnsupportedError
from graceful_plan.scene.mobile.diff_drive import DiffDrive
from graceful_plan.scene.mobile.wheels import KEEP_OUT
from graceful_plan.scene.model_parts import subtree
from graceful_plan.scene.per_scene import per_scene

TIMESTEP = 0.002
"""MuJoCo time step [s]."""
ARMATURE = 0.1
"""Inertia of a wheel's drive about its axle [kg m^2]. Without it a skid-steer turns far too little, because soft
contacts of light wheels creep. With it the effective track of a Jackal is 1.5 times the real one, as in its
maker's data."""
_GAIN = 20.0
"""Gain of the wheels' speed controllers [N m s/rad]."""
_UNDER = 0.002
"""Radius difference between a wheel's floor contact sphere and the geom that collides with other bodies [m]. Every
dimension equal to the wheel radius shrinks by it; otherwise the geom would also carry half of the weight."""
_PLANAR = 3
"""Number of planned joints of a base."""
_FLOOR_BIT = 1 << 20
"""Collision mask of floors and of the parts that stand on them."""


@dataclass(frozen=True, eq=False)
class Wheeled:
    """Model of a free base with hinged wheels, and the indices of its parts.

    | field  | meaning                                                                 |
    |--------|-------------------------------------------------------------------------|
    | scene  | simulated scene                                                         |
    | base   | drive parameters of the base                                            |
    | model  | the model; read only, copy it to change friction                        |
    | body   | body of the base                                                        |
    | qpos   | address of the free joint; its dofs begin at `dof`                      |
    | wheel  | dof of each wheel, left ones first                                      |
    | motor  | actuator of each wheel; other actuators hold the arm in its placed pose |
    | sphere | geoms that roll on the floor                                            |
    | robot  | geoms of the robot that may hit entities or obstacles                   |
    | floor  | geoms that the robot may always touch                                   |
    | entity | entity index of each geom; -1 if it belongs to none                     |
    """

    scene: Scene
    base: DiffDrive
    model: mujoco.MjModel
    body: int
    qpos: int
    dof: int
    wheel: Int[Array, " wheel"]
    motor: Int[Array, " wheel"]
    sphere: tuple[int, ...]
    robot: frozenset[int]
    floor: frozenset[int]
    entity: Int[Array, " geom"]

    @property
    def sides(self) -> Float[Array, " wheel"]:
        """-1 for left wheels, 1 for right ones: sign of the turning rate's contribution to the wheel speed."""
        half = len(self.wheel) // 2
        return np.concatenate([-np.ones(half), np.ones(half)])

    def wheel_rates(self, v: float, omega: float) -> Float[Array, " wheel"]:
        """Return the wheel rates [rad/s] for a speed along the heading [m/s] and a turning rate [rad/s]."""
        return (v + self.sides * self.base.lever * omega) / self.base.radius

    def placed(self, q: Float[Array, " nq"], v: float, omega: float) -> mujoco.MjData:
        """Return data with the base at a configuration, driving with rolling wheels, and the arm held in place."""
        data = mujoco.MjData(self.model)
        a, d = self.qpos, self.dof
        for name, value in zip(self.scene.joints[_PLANAR:], q[_PLANAR:], strict=True):
            data.qpos[int(self.model.joint(name).qposadr[0])] = value
            servo = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
            if servo >= 0:
                data.ctrl[servo] = value
        data.qpos[a : a + 3] = q[0], q[1], 0.0
        data.qpos[a + 3 : a + 7] = np.cos(0.5 * q[2]), 0.0, 0.0, np.sin(0.5 * q[2])
        data.qvel[d : d + 2] = v * np.cos(q[2]), v * np.sin(q[2])
        data.qvel[d + 5] = omega
        data.qvel[self.wheel] = data.ctrl[self.motor] = self.wheel_rates(v, omega)
        mujoco.mj_forward(self.model, data)
        return data

    def pose(self, data: mujoco.MjData) -> tuple[float, float, float]:
        """Return the pose of the base: x, y [m] and heading [rad]."""
        R = data.xmat[self.body].reshape(3, 3)
        x, y = data.xpos[self.body][:2]
        return float(x), float(y), float(np.arctan2(R[1, 0], R[0, 0]))


@per_scene
def wheeled(scene: Scene) -> Wheeled:
    """Build the model of a scene with its base on wheels.

    Raises:
        UnsupportedError: If the scene has no base, the base has an odd number of wheels, a joint of its arm has no
            servo of its name, or it carries an object.
    """
    return _stood(scene)


@per_scene
def on_endless_floor(scene: Scene) -> Wheeled:
    """Build the model of a scene with its base on wheels and unbounded floors, to measure its drive; obstacles remain.

    Raises:
        UnsupportedError: For the same reasons as `wheeled`.
    """
    return _stood(scene, endless=True)


def _stood(scene: Scene, *, endless: bool = False) -> Wheeled:
    base = scene.base
    if base is None or not base.wheels or len(base.wheels) % 2:
        raise UnsupportedError("rotating wheels need a DiffDrive with `wheels`: left ones, then as many right ones")
    if scene.carried is not None:
        raise UnsupportedError("a carried object cannot be simulated on wheels: use the scene without it")
    spec = scene.spec.copy()
    servos = {actuator.name for actuator in spec.actuators}
    loose = [name for name in scene.joints[_PLANAR:] if name not in servos]
    if loose:
        raise UnsupportedError(
            f"these joints have no servo; each needs an actuator of the joint's name: {', '.join(loose)}"
        )
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    body = spec.joint(base.joints[2]).parent
    for name in base.joints:
        spec.delete(spec.joint(name))
    body.add_freejoint(name="wheels/free")
    touched = {name for contact in scene.allowed_contacts for name in (contact.first, contact.second)}
    for geom in spec.geoms:
        named = geom.name in touched or geom.parent.name in touched
        if geom.type == mujoco.mjtGeom.mjGEOM_PLANE or (named and not geom.parent.name.startswith(scene.robot)):
            geom.contype |= _FLOOR_BIT
            geom.conaffinity |= _FLOOR_BIT
            if endless and geom.type == mujoco.mjtGeom.mjGEOM_BOX:
                geom.pos = [*geom.pos[:2], geom.pos[2] + geom.size[2]]
                geom.type, geom.size = mujoco.mjtGeom.mjGEOM_PLANE, [0.0, 0.0, 0.1]
        if geom.name.startswith(KEEP_OUT):
            geom.contype = geom.conaffinity = 0
    for name in base.wheels:
        wheel = spec.body(name)
        wheel.add_joint(
            name=f"wheels/{name}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0], armature=ARMATURE
        )
        for geom in wheel.geoms:
            geom.size = [size - _UNDER * (abs(size - base.radius) < _UNDER) for size in geom.size]
        wheel.add_geom(
            name=f"wheels/{name}/tyre",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[base.radius, 0.0, 0.0],
            contype=_FLOOR_BIT,
            conaffinity=_FLOOR_BIT,
            mass=0.0,
            priority=1,
            friction=[0.7, 0.005, 0.0001],
            condim=3,
            group=3,
        )
        actuator = spec.add_actuator(name=f"wheels/{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"wheels/{name}")
        actuator.set_to_velocity(kv=_GAIN)
    return _found(scene, base, spec.compile())


def _found(scene: Scene, base: DiffDrive, model: mujoco.MjModel) -> Wheeled:
    free = model.joint("wheels/free")
    body = int(model.jnt_bodyid[free.id])
    bodies = subtree(model, body)
    spheres = tuple(int(model.geom(f"wheels/{name}/tyre").id) for name in base.wheels)
    entity = np.full(model.ngeom, -1)
    names = {name: k for k, name in enumerate(scene.entities)}
    for g in range(model.ngeom):
        at = int(model.geom_bodyid[g])
        while at > 0 and entity[g] < 0:
            entity[g] = names.get(model.body(at).name, -1)
            at = int(model.body_parentid[at])
    return Wheeled(
        scene=scene,
        base=base,
        model=model,
        body=body,
        qpos=int(model.jnt_qposadr[free.id]),
        dof=int(model.jnt_dofadr[free.id]),
        wheel=np.array([int(model.joint(f"wheels/{name}").dofadr[0]) for name in base.wheels]),
        motor=np.array([model.actuator(f"wheels/{name}").id for name in base.wheels]),
        sphere=spheres,
        robot=frozenset(g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in bodies and g not in spheres),
        floor=frozenset(np.flatnonzero(model.geom_contype & _FLOOR_BIT).tolist()) - set(spheres),
        entity=entity,
    )
