"""Materials of the bundled scenes: specified and measured restitution and rolling resistance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

import mujoco
import numpy as np

import failbench
from benchmarks import suite
from failbench import SimSettings
from failbench.recording.contact_query import ContactQuery

GRAVITY = 9.81
HEIGHTS = (0.1, 0.3, 0.8)
"""Heights of the fall [m]; the specified restitution is that at the second."""
RADIUS = 0.035
"""Radius of the sphere and of the cylinder [m]: that of a bottle."""
_SPEED, _SECONDS = 0.5, 1.0
_SUNK = 0.002
"""Lowering at which objects touch their support [m]."""
_SOLID = 1.5
"""Inertia of a rolling solid cylinder over that of a sliding one."""

Array = np.ndarray


class Asked(NamedTuple):
    """Specified behaviour of a material on wood. All are assumptions; see docs/failbench.md."""

    restitution: float
    """Speed after over speed before the impact of a fall from 0.3 m."""
    rolling: float
    """Lever arm of the rolling resistance [m]; over the radius it is the coefficient."""


MATERIALS: Mapping[str, Asked] = MappingProxyType(
    {
        "glass": Asked(0.25, 0.0005),
        "china": Asked(0.25, 0.0005),
        "steel": Asked(0.30, 0.0005),
        "iron": Asked(0.25, 0.0005),
        "wood": Asked(0.20, 0.0005),
        "plastic": Asked(0.20, 0.0005),
        "soft": Asked(0.0, 0.003),
        "paper": Asked(0.0, 0.0005),
    }
)
"""Default classes of the scenes' movable objects."""


class Measured(NamedTuple):
    """Measured behaviour."""

    restitution: tuple[float, ...]
    """One value for each of `HEIGHTS`."""
    rolling: float
    """As in the specification."""


def measure(scene: str, material: str, *, on: str = "wood") -> Measured:
    """Drop a sphere and roll a cylinder of a scene's material on another material."""
    spec = suite.scene(scene).spec
    sphere, cylinder = (_model(spec, material, on, kind) for kind in ("SPHERE", "CYLINDER"))
    return Measured(tuple(restitution(sphere, height) for height in HEIGHTS), rolling(cylinder))


def of(scene: str) -> dict[str, Asked]:
    """Return the materials of a scene, by name."""
    spec = suite.scene(scene).spec
    return {name: asked for name, asked in MATERIALS.items() if spec.find_default(name) is not None}


HEADER = ("material", "e asked", *(f"e, {height:g} m" for height in HEIGHTS), "lever arm asked", "measured")


def rows(scene: str) -> Iterator[tuple[str, ...]]:
    """Measure all materials of a scene; rows of a table, after `HEADER`."""
    for name, asked in of(scene).items():
        found = measure(scene, name)
        arms = (f"{1e3 * arm:.2f} mm" for arm in (asked.rolling, found.rolling))
        yield (f"{scene}/{name}", f"{asked.restitution:.2f}", *(f"{e:.2f}" for e in found.restitution), *arms)


def restitution(model: mujoco.MjModel, height: float) -> float:
    """Drop a sphere [m] and return sqrt(rebound height / height): the effective coefficient of restitution."""
    data = mujoco.MjData(model)
    data.qpos[2] = RADIUS + height
    fall = np.sqrt(2.0 * height / GRAVITY)
    places = np.zeros(int(3.5 * fall / model.opt.timestep))  # with e = 1 it is up again after three times the fall
    for i in range(len(places)):
        mujoco.mj_step(model, data)
        places[i] = data.qpos[2]
    lowest = int(np.argmin(places[: int(1.3 * fall / model.opt.timestep)]))
    return float(np.sqrt(max(0.0, places[lowest:].max() - RADIUS) / height))


def rolling(model: mujoco.MjModel) -> float:
    """Let a solid cylinder roll and return the lever arm of the rolling resistance [m]."""
    data = mujoco.MjData(model)
    data.qpos[2:] = [RADIUS, np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]  # its axis along -y
    data.qvel[0], data.qvel[5] = _SPEED, -_SPEED / RADIUS
    places = np.zeros(int(_SECONDS / model.opt.timestep))
    for i in range(len(places)):
        mujoco.mj_step(model, data)
        places[i] = data.qpos[0]
    times = model.opt.timestep * np.arange(len(places))
    settled = (times > 0.1) & (np.gradient(places, times) > 0.02)  # a stopped body does not slow down
    slowing = -2.0 * np.polyfit(times[settled], places[settled], 2)[0]
    return float(_SOLID * slowing * RADIUS / GRAVITY)


def _model(source: mujoco.MjSpec, material: str, support: str, kind: str) -> mujoco.MjModel:
    """Return a body of one material on a plane of another, with FailBench's options."""
    spec = mujoco.MjSpec()
    spec.option.timestep = SimSettings().timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    plane = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0])
    body = spec.worldbody.add_body()
    body.add_freejoint()
    thing = body.add_geom(type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"), size=[RADIUS, 0.08, 0.0], density=1000.0)
    for geom, name in ((plane, support), (thing, material)):
        like = source.find_default(name).geom
        for field in ("condim", "friction", "solref", "solimp", "solmix", "priority"):
            setattr(geom, field, getattr(like, field))
    return spec.compile()


def alone(world: failbench.World, body: int) -> mujoco.MjModel:
    """Return a model of one free body on a plane with the contact parameters of its support."""
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
