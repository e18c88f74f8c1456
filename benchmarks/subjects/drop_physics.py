"""Does what is dropped fly as it must, and how do the shipped objects bounce, slide and roll?"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

import failbench
import graceful_plan as gp
from benchmarks import materials, report, suite
from failbench.fault.registry import GripperFailure
from failbench.recording.contact_query import ContactQuery
from failbench.rollouts.sampling import make_jobs
from failbench.simulated.states import STATE

TITLE = "Drop physics: flight against ballistics, and how the shipped objects bounce, slide and roll"
MEASURED = """\
"Flight": the gripper fails at a random time of a planned motion; how far the object's centre is, at its first contact
with anything but the robot, from where a free fall through the same height takes it, from its position and velocity at
the failure. Every task of every bundled scene; falls of less than 1 cm do not count. "Weld": the grasp is a constraint
that is cut, for a clean release. "Fingers": the real grasp, which holds and drags the object for some more steps;
"after the last touch" counts from where the robot touched it last.

"Objects": each alone on a plane with the contact parameters of what it stands on. Rebound: dropped flat from 0.3 m;
e = sqrt(rebound / 0.3 m). Pushed: with 1 m/s, standing as in the scene and lying on its side, for 2 s; its coefficient
is the lost v^2 / (2 g distance), be it by sliding, tumbling or rolling; that of rolling is of the last second, for what
still moves then. A solid cylinder that slides until it rolls keeps two thirds of its speed; rolling resistance c slows
it down by two thirds of c g. MuJoCo has no coefficient of restitution: the damping ratio of a contact decides, and with
its default of 1, which the scenes of the paper keep, nothing bounces.

"Materials": each on its scene's wood. A sphere falls from 0.1, 0.3 and 0.8 m; asked for is e from 0.3 m. A cylinder as
thick as the sphere (7 cm) rolls; the lever arm of its rolling resistance over its radius is the coefficient c.
"""
FLIGHT_WITHIN = 0.005
"""Mean distance from ballistics [m]."""
GRAVITY = materials.GRAVITY
DROPS = 1000
"""Of each grasp; as many more as fall less than 1 cm."""
_LEAST_FALL = 0.01
_SUNK = 0.002
"""Things are placed without touching; this far below [m], they touch what they stand on."""
_HEIGHT, _SPEED, _SECONDS = 0.3, 1.0, 2.0
_STOPPED = 0.05
"""What is slower [m/s] has stopped."""
_PUSHED = ("standing, goes", "left", "coefficient", "lying, goes", "left", "coefficient")

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class FreeFlight:
    """One drop."""

    fall: float
    """Height that the object's centre fell until its first contact [m]."""
    error: float
    """Distance from ballistics there [m]."""
    error_after_touch: float
    """The same, from the last touch of the robot on."""


class Push(NamedTuple):
    """What became of an object that was pushed."""

    distance: float
    """How far it went [m]."""
    speed: float
    """How fast it still is [m/s]."""
    coefficient: float
    """Of all that slowed it down."""
    rolling: float
    """The same of the last second; NaN if it has stopped."""


@dataclass(frozen=True, kw_only=True)
class ObjectMotion:
    """What one object does on its support."""

    scene: str
    name: str
    alike: int
    """How many of the scene's objects are just like it."""
    mass: float
    rebound: float
    """[m]"""
    upright: Push
    on_side: Push


def run(options: suite.Options) -> str:
    """Drop everything."""
    scenes = options.pick(None, quick=1)
    found = {grasp: _flights(grasp, options) for grasp in ("weld", "fingers")}
    names = list(gp.scenes())[:scenes]
    landings = [landing for part in suite.spread(land, names, options.processes, "objects") for landing in part]
    flown = report.table(("grasp", "drops", "mean error", "90 %", "worst", "mean after the last touch"), _rows(found))
    header = ("object", "mass", "rebound", "e", *_PUSHED, "rolling")
    table = report.table(header, [_row(landing) for landing in sorted(landings, key=lambda x: (x.scene, x.name))])
    made = report.table(materials.HEADER, [row for name in names for row in materials.rows(name)])
    return f"{MEASURED}\n{report.targets(_targets(found['weld']))}\n{flown}\n{table}\n{made}"


def _flights(grasp: str, options: suite.Options) -> tuple[list[FreeFlight], int]:
    """Return the drops with one grasp, and how many tasks its healthy robot could not do."""
    drops, most = options.pick((DROPS, None), quick=(12, 2))
    tasks = suite.task_names()[:most]
    each = -(-2 * drops // len(tasks))  # about half of them fall less than 1 cm, or not at all
    jobs = [(task, grasp, each) for task in tasks]
    parts = list(suite.spread(fly, jobs, options.processes, f"flight, {grasp}"))
    flights = [flight for part in parts if part is not None for flight in part]
    chosen = np.random.default_rng(0).permutation(len(flights))[:drops]
    return [flights[i] for i in chosen], sum(part is None for part in parts)


def fly(job: tuple[str, str, int]) -> list[FreeFlight] | None:
    """Drop the object of a task many times; None if the healthy robot cannot do the task."""
    name, grasp, count = job
    task = suite.task(name)
    planned = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=50, speed=0.5)
    try:
        execution = failbench.execute(planned, failbench.build_world(task.scene, failbench.SimSettings(grasp=grasp)))
    except failbench.ExecutionRefused:
        return None
    drops = make_jobs([GripperFailure(degree="critical")], execution.duration, n=count)
    return [found for drop in drops if (found := flight(execution, drop)).fall >= _LEAST_FALL]


def flight(execution: failbench.Execution, job: failbench.Job) -> FreeFlight:
    """Follow one drop until the object touches something."""
    world = execution.world
    model, body = world.model, world.carried_body
    own, robot = np.isin(model.geom_bodyid, world.striker_bodies["carried"]), _robot(world)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, execution.states[execution.checkpoint(job.onset)], STATE)
    mujoco.mj_forward(model, data)
    released = touched = centre(model, data, body)
    for _, now in failbench.rollout_steps(execution, job):
        # Contacts and centres of mass after a step are those before it; so is the velocity, but for gravity's part.
        pairs = now.contact.geom
        mine = own[pairs]
        other = np.where(mine[:, 0], pairs[:, 1], pairs[:, 0])[mine.any(axis=1)]
        if len(other) and not robot[other].all():
            place = now.xipos[body].copy()
            return FreeFlight(
                fall=released[0][2] - place[2],
                error=_off(released, place),
                error_after_touch=_off(touched, place),
            )
        if len(other):
            touched = centre(model, now, body, kinematics=True)
    return FreeFlight(fall=0.0, error=0.0, error_after_touch=0.0)


def centre(model: mujoco.MjModel, data: mujoco.MjData, body: int, *, kinematics: bool = False) -> tuple[Array, Array]:
    """Return position [m] and velocity [m/s] of a body's centre of mass in W.

    Args:
        model: The model.
        data: A state, with what is derived from it.
        body: Which.
        kinematics: Whether to derive it anew, on a copy, since a step has made the state newer.
    """
    if kinematics:
        qpos, qvel, data = data.qpos, data.qvel, _scratch(model)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, velocity, 0)
    return data.xipos[body].copy(), velocity[3:]


@functools.lru_cache(maxsize=2)
def _scratch(model: mujoco.MjModel) -> mujoco.MjData:
    return mujoco.MjData(model)


def _robot(world: failbench.World) -> Array:
    return np.isin(world.model.geom_bodyid, sorted(world.scene.robot_bodies))


def _off(start: tuple[Array, Array], place: Array) -> float:
    """Return how far a place is from where a free fall to its height ends."""
    (x, y, z), (u, v, w) = start
    fall = z - place[2]
    time = (w + np.sqrt(max(0.0, w * w + 2.0 * GRAVITY * fall))) / GRAVITY
    return float(np.hypot(x + u * time - place[0], y + v * time - place[1]))


def land(name: str) -> list[ObjectMotion]:
    """Drop and push every kind of object of a scene."""
    scene = suite.scene(name)
    world = failbench.build_world(scene)
    kinds: dict[tuple, list[str]] = {}
    for entity, body in world.movable.items():
        kinds.setdefault(_kind(world.model, body), []).append(entity)
    return [_land(name, world, entities) for entities in kinds.values()]


def _kind(model: mujoco.MjModel, body: int) -> tuple:
    """Return all that decides how an object bounces."""
    geoms = np.flatnonzero(model.geom_bodyid == body)
    names = ("type", "size", "pos", "quat", "condim", "friction", "solref", "solimp")
    return tuple(getattr(model, f"geom_{name}")[geoms].tobytes() for name in names) + (float(model.body_mass[body]),)


def _land(scene: str, world: failbench.World, entities: list[str]) -> ObjectMotion:
    body = world.movable[entities[0]]
    model = alone(world, body)
    upright = world.scene.home_qpos[world.model.jnt_qposadr[world.model.body_jntadr[body]] + 3 :][:4]
    lying = np.zeros(4)
    mujoco.mju_mulQuat(lying, np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]), upright)  # a quarter turn about x
    fallen = _path(model, upright, lift=_HEIGHT)[:, 2]
    lowest = int(np.argmin(fallen[: len(fallen) // 4]))  # half a second; it falls for a quarter
    return ObjectMotion(
        scene=scene,
        name=entities[0],
        alike=len(entities),
        mass=float(model.body_mass[1]),
        rebound=max(0.0, float(fallen[lowest:].max() - fallen[-1])),
        upright=_pushed(model, upright),
        on_side=_pushed(model, lying),
    )


def alone(world: failbench.World, body: int) -> mujoco.MjModel:
    """Return a model of one free body on a plane that touches as what supports it does."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="plane", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    source = world.scene.spec.copy()
    for name in (
        "timestep",
        "integrator",
        "cone",
        "impratio",
        "noslip_iterations",
        "gravity",
        "iterations",
        "tolerance",
    ):
        for option in (spec.option, source.option):
            setattr(option, name, getattr(world.model.opt, name))
    spec.worldbody.add_frame().attach_body(source.body(world.model.body(body).name), "object/", "")
    model = spec.compile()
    support = _support(world, body)
    for name in ("friction", "solref", "solimp", "solmix", "condim", "priority"):
        getattr(model, f"geom_{name}")[0] = getattr(world.model, f"geom_{name}")[support]
    return model


def _support(world: failbench.World, body: int) -> int:
    """Return the geom that a body stands on."""
    closeup, qpos = ContactQuery(world), np.array(world.scene.home_qpos)
    qpos[world.model.jnt_qposadr[world.model.body_jntadr[body]] + 2] -= _SUNK
    closeup.place(qpos, np.zeros(world.model.nv))
    contact = closeup.data.contact
    for geoms in (*contact.geom, *contact.geom[:, ::-1]):
        bodies = world.model.geom_bodyid[geoms]
        if bodies[0] == body != bodies[1]:
            return int(geoms[1])
    raise LookupError(f"{world.model.body(body).name!r} stands on nothing")


def _pushed(model: mujoco.MjModel, quat: Array) -> Push:
    path = _path(model, quat, push=_SPEED)[:, :2]
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / model.opt.timestep
    half = len(path) // 2
    ways = [float(np.linalg.norm(path[-1] - path[first])) for first in (0, half)]
    lost = [
        (before**2 - speeds[-1] ** 2) / (2.0 * GRAVITY * way)
        for before, way in zip((_SPEED, speeds[half]), ways, strict=True)
    ]
    return Push(ways[0], float(speeds[-1]), float(lost[0]), float(lost[1]) if speeds[-1] > _STOPPED else np.nan)


def _path(model: mujoco.MjModel, quat: Array, *, lift: float = 0.0, push: float = 0.0) -> Array:
    """Return where an object's centre is during two seconds [step xyz]."""
    data = mujoco.MjData(model)
    data.qpos[:] = [0.0, 0.0, 1.0, *quat]
    mujoco.mj_kinematics(model, data)
    data.qpos[2] += lift - _lowest(model, data)
    data.qvel[0] = push
    path = np.zeros((round(_SECONDS / model.opt.timestep), 3))
    for place in path:
        mujoco.mj_step(model, data)
        place[:] = data.xipos[1]
    return path


def _lowest(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the height of the lowest point of the object [m]."""
    solid = [g for g in range(1, model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    return min(mujoco.mj_geomDistance(model, data, 0, g, 10.0, None) for g in solid)


def _rows(found: dict[str, tuple[list[FreeFlight], int]]) -> Iterator[tuple[object, ...]]:
    for grasp, (flights, refused) in found.items():
        errors = 1e3 * np.array([flight.error for flight in flights])
        after = 1e3 * np.mean([flight.error_after_touch for flight in flights])
        yield (
            grasp + (f" ({refused} tasks refused)" if refused else ""),
            len(flights),
            *(f"{value:.2f} mm" for value in (errors.mean(), np.quantile(errors, 0.9), errors.max(), after)),
        )


def _row(found: ObjectMotion) -> tuple[object, ...]:
    more = f" and {found.alike - 1} alike" if found.alike > 1 else ""
    cells: list[object] = [
        f"{found.scene}/{found.name}{more}",
        f"{found.mass:.3f} kg",
        f"{1e3 * found.rebound:.1f} mm",
        f"{np.sqrt(found.rebound / _HEIGHT):.2f}",
    ]
    for push in (found.upright, found.on_side):
        cells += [f"{push.distance:.3f} m", f"{push.speed:.2f} m/s", report.quantity(push.coefficient, digits=2)]
    rolling = found.on_side.rolling
    return (*cells, "-" if np.isnan(rolling) else f"{max(0.0, rolling):.4f}")


def _targets(found: tuple[list[FreeFlight], int]) -> list[report.Target]:
    flights, _ = found
    mean = float(np.mean([flight.error for flight in flights]))
    return [
        report.Target(
            what=f"mean distance from ballistics at first contact, {len(flights)} clean drops",
            wanted=f"< {1e3 * FLIGHT_WITHIN:g} mm, {DROPS} drops",
            measured=f"{1e3 * mean:.2f} mm",
            met=mean < FLIGHT_WITHIN and len(flights) >= DROPS,
        )
    ]
