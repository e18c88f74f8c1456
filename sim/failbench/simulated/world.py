"""A scene prepared for simulation: with servos, a grasp, and contact sensors.

Ids of bodies, geoms and joints are those of the scene's model; only sensors and constraints are added.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import mujoco
import numpy as np

from failbench.simulated.added_drives import with_drives
from failbench.simulated.gripper import Gripper, find_gripper
from failbench.simulated.moving_entities import REACTIONS, set_free, staged
from failbench.simulated.robot import Robot
from failbench.simulated.rolling import (
    PLANAR,
    Rolling,
    add_wheels,
    driven_joints,
    find_rolling,
)
from failbench.simulated.servos import STIFF, actuator_of, tuned_robot
from graceful_plan import MovingEntity, Scene
from graceful_plan.array_types import Array, Int
from graceful_plan.exceptions import SettingError, UnsupportedError
from graceful_plan.path import plain_numbers
from graceful_plan.scene.couplings import ties_to_loose
from graceful_plan.scene.roles import free_joint

SENSOR_SIZE = 7
"""Values per contact sensor: number of contacts, net force in W [N], position in W [m]."""


@dataclass(frozen=True, kw_only=True)
class SimSettings:
    """Settings of the simulation.

    Args:
        timestep: MuJoCo's time step [s].
        grasp: "fingers": friction holds the carried object, as in the real gripper; on a base without a gripper the
            object just stands. "weld": a constraint holds it, and a failing gripper releases it cleanly, to study the
            fall alone.
        control: "servo" drives the model's own position servos with feed-forward of speed and gravity. "torque"
            applies the torques of the trajectory plus a critically damped correction.
        sleep: Whether objects at rest are skipped until something touches them.
        people: Reaction of people to the failure: "walk" on as predicted; "stop" within a step, after 0.4 s;
            or stop and step "aside", away from the tool.
    """

    timestep: float = 0.002
    grasp: str = "fingers"
    control: str = "servo"
    sleep: bool = True
    people: str = "walk"

    def __post_init__(self) -> None:
        plain_numbers(self)
        if not 1e-4 <= self.timestep <= 0.01:
            raise SettingError("timestep", self.timestep, "between 0.0001 and 0.01 s")
        for name, value, valid in (
            ("grasp", self.grasp, ("fingers", "weld")),
            ("control", self.control, ("servo", "torque")),
            ("people", self.people, REACTIONS),
        ):
            if value not in valid:
                raise SettingError(name, value, f"one of {', '.join(valid)}")


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A scene prepared for simulation. Made by `build_world`.

    | field          | meaning                                                                              |
    |----------------|--------------------------------------------------------------------------------------|
    | scene          | the simulated scene; moving entities are among its entities                          |
    | settings       | settings of the simulation                                                           |
    | model          | the model with servos, constraints and sensors; read only                            |
    | robot          | the parts that can break                                                             |
    | rolling        | indices of a driving base's parts; None if the robot does not drive                  |
    | pairs          | component and entity of each contact sensor; one for every body of an entity         |
    | sensor_adr     | start of each contact sensor in sensordata: count, force in W, position in W         |
    | obstacle_adr   | start of each sensor of the carried object against bodies that are not entities      |
    | entity_bodies  | bodies of each entity                                                                |
    | obstacles      | colliding bodies that are neither entity, robot nor carried object                   |
    | movable        | body of each entity that can move freely                                             |
    | striker_bodies | bodies of the components "body" and "carried"                                        |
    | carried_body   | body of the carried object; -1 if there is none                                      |
    | hold           | weld that holds the carried object until the fingers do; -1 if there is no object     |
    | walkers        | moving entities; they come last among the scene's entities                           |
    """

    scene: Scene
    settings: SimSettings
    model: mujoco.MjModel
    robot: Robot
    rolling: Rolling | None
    pairs: tuple[tuple[str, str], ...]
    sensor_adr: Int[Array, " pair"]
    obstacle_adr: Int[Array, " obstacle"]
    entity_bodies: Mapping[str, tuple[int, ...]]
    obstacles: tuple[int, ...]
    movable: Mapping[str, int]
    striker_bodies: Mapping[str, tuple[int, ...]]
    carried_body: int
    hold: int
    walkers: tuple[MovingEntity, ...]


def build_world(scene: Scene, settings: SimSettings | None = None) -> World:
    """Prepare a scene for simulation.

    Raises:
        UnsupportedError: If a planned joint has no position servo, if its actuator has dynamics, or if the gripper
            cannot hold.
    """
    settings = SimSettings() if settings is None else settings
    walkers, scene = tuple(scene.moving.values()), with_drives(staged(scene), settings.timestep)
    model = scene.model
    gripper = find_gripper(scene)
    driven = driven_joints(scene)
    arm = scene.joints if scene.base is None else scene.joints[PLANAR:]
    actuators = [actuator_of(model, name) for name in arm]
    strikers = {
        name: tuple(sorted({int(model.geom_bodyid[g]) for g in scene.components[name].geoms}))
        for name in ("body", "carried")
        if name in scene.components
    }
    entities = {
        entity.name: tuple(sorted({int(model.geom_bodyid[g]) for g in entity.geoms}))
        for entity in scene.entities.values()
    }
    spec = scene.spec.copy()
    set_free(spec, walkers)
    _name_bodies(spec)
    add_wheels(spec, scene)
    _set_options(spec, scene, settings)
    _exclude_links(spec, scene)
    for e in ties_to_loose(model, scene.joint_ids, scene.robot_bodies):
        spec.equalities[e].active = False  # planned motions ignore them
    pairs = _add_sensors(spec, model, strikers, entities)
    obstacles = _obstacles(scene, entities)
    carried = {name: bodies for name, bodies in strikers.items() if name == "carried"}
    landings = _add_sensors(spec, model, carried, {"": obstacles})
    for name in driven:
        _add_lock(spec, name, settings.timestep)
    if scene.carried is not None:
        _add_weld(spec, scene, gripper, settings)
    simulated = spec.compile()
    simulated.flg_surfacevel = True  # stiction moves the surfaces of the fingers
    added = 0 if scene.base is None else PLANAR + len(scene.base.wheels)
    if simulated.nq != model.nq + added or simulated.ngeom != model.ngeom:
        raise UnsupportedError("the carried object needs a free joint to be dropped")
    wheels = [] if scene.base is None else [int(simulated.actuator(name).id) for name in scene.base.wheels]
    robot = tuned_robot(
        simulated,
        scene,
        [*wheels, *actuators],
        gripper,
        timestep=settings.timestep,
        control=settings.control,
        grasp=settings.grasp,
    )
    return World(
        scene=scene,
        settings=settings,
        model=simulated,
        robot=robot,
        rolling=find_rolling(scene, simulated),
        pairs=tuple(pair for pair, _ in pairs),
        sensor_adr=np.array([int(simulated.sensor(name).adr[0]) for _, name in pairs], dtype=int),
        obstacle_adr=np.array([int(simulated.sensor(name).adr[0]) for _, name in landings], dtype=int),
        entity_bodies=MappingProxyType(entities),
        obstacles=obstacles,
        movable=MappingProxyType(_movable(model, entities)),
        striker_bodies=MappingProxyType(strikers),
        carried_body=-1 if scene.carried is None else int(model.body(scene.carried.body).id),
        hold=-1 if scene.carried is None else int(simulated.equality("failbench/hold").id),
        walkers=walkers,
    )


def _obstacles(scene: Scene, entities: Mapping[str, tuple[int, ...]]) -> tuple[int, ...]:
    """Return the colliding bodies that belong neither to the robot nor to the carried object nor to an entity."""
    model = scene.model
    known = set(scene.robot_bodies).union(*entities.values())
    if scene.carried is not None:
        root = int(model.body(scene.carried.body).id)
        known.update(body for body in range(model.nbody) if int(model.body_rootid[body]) == root)
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return tuple(sorted(set(model.geom_bodyid[collides].tolist()) - known))


def _name_bodies(spec: mujoco.MjSpec) -> None:
    """Name all unnamed bodies, since added sensors and constraints refer to bodies by name."""
    for i, body in enumerate(spec.bodies):
        body.name = body.name or f"failbench/body{i}"


def _exclude_links(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Let links of the robot pass through each other where the scene allows it: hulls of meshes overlap.

    Contacts between them would push the links apart.
    """
    of, robot = scene.model.geom_bodyid, scene.robot_bodies
    known = {frozenset((e.bodyname1, e.bodyname2)) for e in spec.excludes}
    pairs = {frozenset((int(of[a]), int(of[b]))) for a, b in scene.allowed_pairs("always")}
    for pair in sorted(tuple(sorted(pair)) for pair in pairs if len(pair) == 2 and pair <= robot):
        first, second = (spec.bodies[body].name for body in pair)
        if frozenset((first, second)) not in known:
            spec.add_exclude(bodyname1=first, bodyname2=second)


def _set_options(spec: mujoco.MjSpec, scene: Scene, settings: SimSettings) -> None:
    spec.option.timestep = settings.timestep
    # Other integrators chatter at this time step, and a held object creeps with pyramidal cones.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = max(spec.option.impratio, 10.0)
    spec.option.noslip_iterations = 0
    # Air hardly slows an arm or a falling object, but it would hold a link whose inertia is a placeholder far too large
    # for its mass, such as a fingertip of robosuite's Panda, as if it were metres wide.
    spec.option.density = spec.option.viscosity = 0.0
    if settings.sleep:
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    if scene.carried is not None:
        # It would fall asleep in the gripper, and then stay in the air after its release.
        spec.body(scene.carried.body).sleep = mujoco.mjtSleepPolicy.mjSLEEP_NEVER


def _roots(model: mujoco.MjModel, bodies: Iterable[int]) -> list[int]:
    """Return the bodies that have no ancestor among `bodies`."""
    chosen = set(bodies)
    roots = []
    for body in sorted(chosen):
        parent = int(model.body_parentid[body])
        while parent > 0 and parent not in chosen:
            parent = int(model.body_parentid[parent])
        if parent == 0:
            roots.append(body)
    return roots


def _add_sensors(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    strikers: Mapping[str, tuple[int, ...]],
    entities: Mapping[str, tuple[int, ...]],
) -> list[tuple[tuple[str, str], str]]:
    fields = ("FOUND", "FORCE", "POS")
    wanted = sum(1 << int(getattr(mujoco.mjtConDataField, f"mjCONDATA_{name}")) for name in fields)
    added = []
    for component, bodies in strikers.items():
        for root in _roots(model, bodies):
            for entity, parts in entities.items():
                for part in parts:
                    striking, struck = (spec.bodies[body].name for body in (root, part))
                    name = f"failbench/{striking}/{struck}"
                    sensor = spec.add_sensor(name=name, type=mujoco.mjtSensor.mjSENS_CONTACT)
                    # The striker's subtree (XBODY) against one body of the entity.
                    sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_XBODY, striking
                    sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_BODY, struck
                    sensor.intprm[0], sensor.intprm[1], sensor.intprm[2] = wanted, 3, 1  # 3: the net force of all
                    added.append(((component, entity), name))
    return added


def _add_lock(spec: mujoco.MjSpec, joint: str, timestep: float) -> None:
    lock = spec.add_equality(name=f"failbench/lock/{joint}", type=mujoco.mjtEq.mjEQ_JOINT)
    lock.objtype, lock.name1, lock.active = mujoco.mjtObj.mjOBJ_JOINT, joint, False
    lock.solref, lock.solimp = [2.0 * timestep, 1.0], STIFF


def _add_weld(spec: mujoco.MjSpec, scene: Scene, gripper: Gripper, settings: SimSettings) -> None:
    assert scene.carried is not None
    model = scene.model
    site = model.site(scene.tool)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, site.quat)
    X_BT = np.eye(4)
    X_BT[:3, :3], X_BT[:3, 3] = R.reshape(3, 3), site.pos
    X_BO = X_BT @ scene.carried.X_TO
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(X_BO[:3, :3]).ravel())
    weld = spec.add_equality(name="failbench/hold", type=mujoco.mjtEq.mjEQ_WELD)
    weld.objtype, weld.name1, weld.name2 = (
        mujoco.mjtObj.mjOBJ_BODY,
        spec.bodies[int(site.bodyid[0])].name,
        scene.carried.body,
    )
    weld.data = [0.0, 0.0, 0.0, *X_BO[:3, 3], *quat, 1.0, 0.0]  # anchor, pose, torque scale
    weld.solref, weld.solimp = [2.0 * settings.timestep, 1.0], STIFF
    if settings.grasp == "weld":
        for body in gripper.bodies:
            spec.add_exclude(bodyname1=spec.bodies[body].name, bodyname2=scene.carried.body)
    elif not len(gripper.actuators) and not _is_deck(scene, gripper):
        raise UnsupportedError(
            "the gripper has no position servo to hold with; hold by attach(grip=gp.Adhesion(force, radius)), or use "
            "SimSettings(grasp='weld')"
        )


def _is_deck(scene: Scene, gripper: Gripper) -> bool:
    """Whether the carried object stands on a driving base without a gripper."""
    return scene.base is not None and not len(gripper.joints)


def _movable(model: mujoco.MjModel, entities: Mapping[str, tuple[int, ...]]) -> dict[str, int]:
    free = {name: [body for body in bodies if free_joint(model, body) >= 0] for name, bodies in entities.items()}
    return {name: bodies[0] for name, bodies in free.items() if bodies}
