"""Landing places of lost contents, and the entities that their puddles reach.

A parcel flies along a parabola and lands on the first thing below; it passes through robot and carried object. Liquids
spread to a disc whose depth is set by surface tension, dry contents to a heap. A puddle reaches every entity that
stands in it on the same surface. The part of a puddle beyond an edge flows on to the surface below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from failbench.recording.contact_query import NOBODY, ContactQuery
from failbench.recording.records import ContactEvent
from failbench.simulated.world import World
from graceful_plan import Granular
from graceful_plan.array_types import Array, Float
from graceful_plan.scene.rules.vessel import REPOSE

DEPTH = 0.002
"""Depth of a puddle [m]: water at a contact angle of 45 degrees stands at 2.1 mm."""
_DENSITY = 1000.0
"""Density of lost contents [kg/m^3]."""
_STEP = 0.03
"""Time step along the parabola [s]; its chords deviate by less than 2 mm."""
_LONGEST = 1.5
"""Longest flight [s]."""
_STANDS = 0.01
"""Greatest gap between an entity's lowest point and the surface it stands on [m]."""
_FLAT = 1e-3
"""Greatest height above a surface up to which a geom counts as that surface [m]."""
_EDGE = 0.02
"""Drop from which a lower surface counts as another one [m]."""
_POINTS = 24
"""Number of points at which the ground under a puddle is probed."""
_LEVELS = 3
"""Greatest number of surfaces that a puddle reaches one after another."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Parcel:
    """A volume [m^3] that leaves the container at a time [s], position [m] and velocity [m/s] in W."""

    time: float
    volume: float
    position: Float[Array, " xyz"]
    velocity: Float[Array, " xyz"]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Landing:
    geom: int
    time: float
    volume: float
    position: Float[Array, " xyz"]
    speed: float


class Puddles:
    """Finds the entities that lost contents reach.

    Args:
        world: The simulated world.
        closeup: Contact queries for single states. Its geom groups are changed, so that rays hit only wettable geoms.
    """

    def __init__(self, world: World, closeup: ContactQuery) -> None:
        model = closeup.model
        self._closeup = closeup
        self._dry = isinstance(world.scene.contents, Granular)
        self._gravity = model.opt.gravity.copy()
        own = np.isin(model.geom_bodyid, sorted(world.scene.robot_bodies)) | (model.geom_bodyid == world.carried_body)
        wettable = ((model.geom_contype != 0) | (model.geom_conaffinity != 0)) & ~own
        model.geom_group[:] = np.where(wettable, 0, 5)
        model.geom_rgba[:, 3] = 1.0  # rays ignore transparent geoms
        self._wettable = np.flatnonzero(wettable & (model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)))
        self._groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
        self._hit = np.zeros((1, 1), dtype=np.int32)

    def events(self, qpos: Float[Array, " qpos"], parcels: Sequence[Parcel]) -> list[ContactEvent]:
        """Return one event for each reached entity, at the first time it is reached.

        Args:
            qpos: Positions of the whole model.
            parcels: The lost contents.
        """
        self._closeup.place(qpos)
        low, high = self._heights()
        found: dict[int, ContactEvent] = {}
        landings = [landing for parcel in parcels if (landing := self._fly(parcel)) is not None]
        for _ in range(_LEVELS):
            puddles = [_merged([a for a in landings if a.geom == geom]) for geom in {a.geom: 0 for a in landings}]
            for landing in landings:
                self._reach(found, landing.geom, landing)
            landings = []
            for puddle in puddles:
                radius = self._radius(puddle.volume)
                for geom in self._standing(puddle.position, radius, low, high):
                    self._reach(found, geom, puddle, flown=False)
                landings += self._run_off(puddle, radius)
        return list(found.values())

    def _reach(self, found: dict[int, ContactEvent], geom: int, landing: _Landing, *, flown: bool = True) -> None:
        entity = int(self._closeup.owner[geom])
        if entity <= NOBODY or entity in found:
            return
        mass = _DENSITY * landing.volume if flown else 0.0
        x, y, z = landing.position
        found[entity] = ContactEvent(
            striker="contents",
            entity=self._closeup.entities[entity],
            time=landing.time,
            position=(float(x), float(y), float(z)),
            peak_force=0.0,
            impulse=mass * landing.speed,
            speed=landing.speed if flown else 0.0,
            energy=0.5 * mass * landing.speed**2,
        )

    def _fly(self, parcel: Parcel) -> _Landing | None:
        """Follow a parcel's parabola to its first hit."""
        p, v, time = parcel.position, parcel.velocity, 0.0
        while time < _LONGEST:
            step = v * _STEP + 0.5 * self._gravity * _STEP**2
            distance, geom = self._ray(p, step)
            if geom >= 0 and distance <= 1.0:
                time += distance * _STEP
                speed = float(np.linalg.norm(v + distance * _STEP * self._gravity))
                return _Landing(
                    geom=geom,
                    time=parcel.time + time,
                    volume=parcel.volume,
                    position=p + distance * step,
                    speed=speed,
                )
            p, v, time = p + step, v + self._gravity * _STEP, time + _STEP
        return None

    def _ray(self, origin: Float[Array, " xyz"], direction: Float[Array, " xyz"]) -> tuple[float, int]:
        """Return the distance to the first wettable geom, in multiples of `direction`, and the geom's id."""
        model, data = self._closeup.model, self._closeup.data
        distance = mujoco.mj_ray(
            model, data, origin, direction, geomgroup=self._groups, flg_static=True, bodyexclude=-1, geomid=self._hit
        )
        return float(distance), int(self._hit[0, 0])

    def _radius(self, volume: float) -> float:
        if self._dry:
            return float(np.cbrt(3.0 * volume / (np.pi * np.tan(REPOSE))))
        return float(np.sqrt(volume / (np.pi * DEPTH)))

    def _heights(self) -> tuple[Float[Array, " geom"], Float[Array, " geom"]]:
        """Return the height of the lowest and highest point of each wettable geom [m]."""
        model, data, geoms = self._closeup.model, self._closeup.data, self._wettable
        vertical = data.geom_xmat[geoms].reshape(-1, 3, 3)[:, 2]
        middle = data.geom_xpos[geoms, 2] + np.einsum("gx,gx->g", vertical, model.geom_aabb[geoms, :3])
        half = np.einsum("gx,gx->g", np.abs(vertical), model.geom_aabb[geoms, 3:])
        return middle - half, middle + half

    def _standing(
        self, p: Float[Array, " xyz"], radius: float, low: Float[Array, " geom"], high: Float[Array, " geom"]
    ) -> list[int]:
        """Return the geoms that stand within a puddle, the nearest first."""
        model, data = self._closeup.model, self._closeup.data
        at = (low < p[2] + _STANDS) & (high > p[2] + _FLAT)
        geoms = self._wettable[at]
        local = np.einsum("gji,gj->gi", data.geom_xmat[geoms].reshape(-1, 3, 3), p - data.geom_xpos[geoms])
        outside = np.maximum(np.abs(local - model.geom_aabb[geoms, :3]) - model.geom_aabb[geoms, 3:], 0.0)
        distance = np.linalg.norm(outside, axis=1)
        return [int(geoms[i]) for i in np.argsort(distance, kind="stable") if distance[i] <= radius]

    def _run_off(self, puddle: _Landing, radius: float) -> list[_Landing]:
        """Return the parts that flow over edges; each probed point stands for an equal part of the disc."""
        k = np.arange(_POINTS)
        r, angle = radius * np.sqrt((k + 0.5) / _POINTS), k * np.pi * (3.0 - np.sqrt(5.0))
        down = np.array([0.0, 0.0, -1.0])
        fallen = []
        for x, y in zip(r * np.cos(angle), r * np.sin(angle), strict=True):
            depth, geom = self._ray(puddle.position + np.array([x, y, 1e-3]), down)
            if geom >= 0 and depth > _EDGE:
                fallen.append(
                    _Landing(
                        geom=geom,
                        time=puddle.time + float(np.sqrt(2.0 * depth / -self._gravity[2])),
                        volume=puddle.volume / _POINTS,
                        position=puddle.position + np.array([x, y, -depth]),
                        speed=float(np.sqrt(2.0 * depth * -self._gravity[2])),
                    )
                )
        return [_merged([f for f in fallen if f.geom == geom]) for geom in {f.geom: 0 for f in fallen}]


def _merged(parts: Sequence[_Landing]) -> _Landing:
    """Merge landings on one geom into one."""
    volume = np.array([part.volume for part in parts])
    share = volume / volume.sum()
    return _Landing(
        geom=parts[0].geom,
        time=min(part.time for part in parts),
        volume=float(volume.sum()),
        position=share @ np.array([part.position for part in parts]),
        speed=float(share @ [part.speed for part in parts]),
    )
