"""Spilled contents and the entities they reach: a proxy model, since MuJoCo does not simulate liquids.

The surface of the contents is a plane normal to the felt vertical: gravity minus the container's acceleration, averaged
over the time scale of slow sloshing. Contents above the rim are lost at once, and a jolt throws out a fixed fraction.
Lost parcels fly freely from the rim, and landed contents spread to a puddle. A failure counts the loss from its onset
on; `HealthyLoss` is the loss of a healthy run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from failbench.recording.bounds import rotations
from failbench.recording.contact_query import ContactQuery
from failbench.recording.puddle import Parcel, Puddles
from failbench.recording.records import ContactEvent
from failbench.simulated.states import CHECKPOINT
from failbench.simulated.world import World
from graceful_plan.array_types import Array, Float
from graceful_plan.scene.rules.vessel import Vessel, find_vessel

STRIDE = CHECKPOINT
"""Steps between samples of the container's motion; the healthy run is sampled at its checkpoints."""
_SLOSH = 0.03
"""Half width of the window over which the acceleration is averaged [s]."""
_WEIGHTLESS = 0.2
"""Fraction of gravity below which no surface forms and nothing pours out."""
_JOLT = 0.03
"""Greatest duration of a jolt [s]."""
_CALM = 0.1
"""Least time from the beginning of a jolt to the next one [s]."""
_LOSSES = ((1.5, 0.9), (0.7, 0.3))
"""Felt change of velocity in a jolt [m/s], and the fraction it throws out. The first pair is a fall onto a hard surface
from more than a hand's breadth, the second a hard stop. Both are assumptions: no measurements are known."""
_PARCELS = 4
"""Greatest number of parcels of a loss."""
_DROP = 0.02
"""Fraction of the contents that is not divided further."""
_NOTHING = 0.01
"""Fraction of the contents below which a loss is ignored; it is below the accuracy of this proxy."""


class VesselMotion(NamedTuple):
    """Motions of containers in W."""

    time: Float[Array, " sample"]
    axis: Float[Array, "sim sample xyz"]
    rim: Float[Array, "sim sample xyz"]
    velocity: Float[Array, "sim sample xyz"]
    """Velocity of the middle of the rim [m/s]."""
    felt: Float[Array, "sim sample xyz"]
    """Acceleration minus gravity [m/s^2]; it points upward while the container stands still."""


class HealthyLoss(NamedTuple):
    """Contents that leave the container without a failure."""

    there: float
    """Volume in the container at rest in the first state [m^3]."""
    kept: Float[Array, " checkpoint"]
    """Volume in the container at each checkpoint [m^3]."""
    end: float
    """Volume in the container after it has stopped [m^3]."""
    parcels: tuple[Parcel, ...]
    """Lost parcels, in the order in which they leave; empty if the loss is negligible."""

    @property
    def part(self) -> float:
        """Lost fraction of the initial contents, in [0, 1]; exactly 0 if it is negligible."""
        return 1.0 - self.end / self.there if self.parcels else 0.0


class Spill:
    """Tracks the contents of the carried container in a batch of simulations.

    Args:
        world: The simulated world.
        closeup: Contact queries for single states.
        onset: Positions and velocities at the onset [sim, ...].
        kept: Volume in the container at each onset [m^3]; by default the volume that the tilt at the onset allows.
    """

    def __init__(
        self,
        world: World,
        closeup: ContactQuery,
        onset: tuple[Array, Array],
        kept: Float[Array, " sim"] | None = None,
    ) -> None:
        self._dt = STRIDE * float(world.model.opt.timestep)
        self._vessel = find_vessel(world.scene)
        self._kept = kept
        self._gravity = -float(world.model.opt.gravity[2])
        if self._vessel is not None:
            self._columns = _columns(world)
            self._samples = [tuple(x[:, None, c] for x, c in zip(onset, self._columns, strict=True))]
            self._puddles = Puddles(world, closeup)
        self._done: tuple[VesselMotion, Array, Array] | None = None

    def observe(self, qpos: Float[Array, "sim step qpos"], qvel: Float[Array, "sim step qvel"]) -> None:
        """Process the next steps."""
        if self._vessel is not None:
            steps = slice(STRIDE - 1, None, STRIDE)
            self._samples.append(tuple(x[:, steps, c].copy() for x, c in zip((qpos, qvel), self._columns, strict=True)))

    def finish(self, sim: int, qpos: Float[Array, " qpos"]) -> tuple[float, list[ContactEvent]]:
        """Return the lost fraction of the contents, and the events of the entities that they reach.

        Args:
            sim: Index of the simulation.
            qpos: Positions at the simulation's end, for the places of the entities.
        """
        vessel = self._vessel
        if vessel is None:
            return 0.0, []
        if self._done is None:
            self._done = self._losses(vessel)
        motion, kept, left = self._done
        gone = kept[sim] - left[sim]
        if gone[-1] <= _NOTHING * vessel.volume:
            return 0.0, []
        own = VesselMotion(motion.time, *(x[sim : sim + 1] for x in motion[1:]))
        return float(gone[-1] / kept[sim]), self._puddles.events(qpos, _parcels(vessel, own, gone))

    def _losses(self, vessel: Vessel) -> tuple[VesselMotion, Float[Array, " sim"], Float[Array, "sim sample"]]:
        """Return all motions, and the volumes in the containers at the onset and at each sample [m^3]."""
        pose, twist = (np.concatenate([sample[i] for sample in self._samples], axis=1) for i in (0, 1))
        motion = _motion(vessel, pose, twist, self._dt, self._gravity)
        kept = _standing(vessel, motion) if self._kept is None else np.minimum(vessel.volume, self._kept)
        return motion, kept, kept[:, None] * remaining(vessel, motion, kept, self._gravity)


def kept_volume(world: World, states: Float[Array, "checkpoint state"]) -> float:
    """Return the volume [m^3] in the container after a healthy run; 0 if there is none.

    Args:
        world: The simulated world.
        states: MuJoCo's integration state at each checkpoint; it begins with time, positions and velocities.
    """
    loss = healthy_loss(world, states)
    return 0.0 if loss is None else loss.end


def healthy_loss(world: World, states: Float[Array, "checkpoint state"]) -> HealthyLoss | None:
    """Return the contents that a healthy run loses; None if no container is carried.

    Args:
        world: The simulated world.
        states: States as for `kept_volume`. The container never holds more than it does at rest in the first state.
    """
    vessel = find_vessel(world.scene)
    if vessel is None:
        return None
    nq, nv = world.model.nq, world.model.nv
    parts = states[:, 1 : 1 + nq], states[:, 1 + nq : 1 + nq + nv]
    pose, twist = (x[:, c] for x, c in zip(parts, _columns(world), strict=True))
    dt = STRIDE * float(world.model.opt.timestep)
    after = _samples(_CALM, dt)  # the container stands still after the end
    pose = np.vstack([pose, np.repeat(pose[-1:], after, axis=0)])
    twist = np.vstack([twist, np.zeros((after, 6))])
    gravity = -float(world.model.opt.gravity[2])
    motion = _motion(vessel, pose[None], twist[None], dt, gravity)
    there = _standing(vessel, motion)
    left = there[0] * remaining(vessel, motion, there, gravity)[0]
    gone = there[0] - left
    parcels = _parcels(vessel, motion, gone) if gone[-1] > _NOTHING * vessel.volume else []
    return HealthyLoss(float(there[0]), left[: len(states)], float(left[-1]), tuple(parcels))


def remaining(
    vessel: Vessel, motion: VesselMotion, kept: Float[Array, " sim"], gravity: float
) -> Float[Array, "sim sample"]:
    """Return the fraction of `kept` [m^3] in the container at each sample."""
    heavy = np.linalg.norm(motion.felt, axis=-1) > _WEIGHTLESS * gravity
    capacity = vessel.capacity(_angle(motion.axis, motion.felt)) / np.maximum(kept, 1e-12)[:, None]
    part = np.minimum(np.where(heavy, capacity, 1.0), _after_jolts(motion, gravity))
    return np.minimum.accumulate(part, axis=1)


def _standing(vessel: Vessel, motion: VesselMotion) -> Float[Array, " sim"]:
    """Return the volume [m^3] that each container holds at rest in the pose of its first sample."""
    up = np.broadcast_to([0.0, 0.0, 1.0], motion.axis[:, 0].shape)
    return np.minimum(vessel.volume, vessel.capacity(_angle(motion.axis[:, 0], up)))


def _after_jolts(motion: VesselMotion, gravity: float) -> Float[Array, "sim sample"]:
    """Return the fraction that earlier jolts have left in the container, at each sample."""
    v = motion.velocity + np.outer(motion.time, [0.0, 0.0, gravity])  # constant in free fall
    part = np.ones(v.shape[:2])
    if len(motion.time) < 2:
        return part
    jolt, rest = (_samples(duration, float(motion.time[1] - motion.time[0])) for duration in (_JOLT, _CALM))
    change = np.linalg.norm(v[:, jolt:] - v[:, :-jolt], axis=-1)
    calm = np.zeros(len(v), dtype=int)
    for sim, i in np.argwhere(change > _LOSSES[-1][0]).tolist():
        if i >= calm[sim]:
            worst = float(change[sim, i : i + jolt].max())
            part[sim, i + 1 :] *= 1.0 - next(loss for least, loss in _LOSSES if worst >= least)
            calm[sim] = i + rest
    return part


def _motion(
    vessel: Vessel, pose: Float[Array, "sim sample 7"], twist: Float[Array, "sim sample 6"], dt: float, gravity: float
) -> VesselMotion:
    R = rotations(pose[..., 3:])
    arm, axis, turn = (np.einsum("...ij,...j->...i", R, x) for x in (vessel.p_BR, vessel.axis, twist[..., 3:]))
    velocity = twist[..., :3] + np.cross(turn, arm)
    n = pose.shape[1]
    # Samples near the ends take the value of the nearest full window, since shorter means would be less smooth.
    slosh = _samples(_SLOSH, dt)
    first = np.clip(np.arange(n) - slosh, 0, max(n - 1 - 2 * slosh, 0))
    last = np.minimum(first + 2 * slosh, n - 1)
    felt = (velocity[:, last] - velocity[:, first]) / (np.maximum(last - first, 1) * dt)[:, None]
    felt[..., 2] += gravity
    return VesselMotion(np.arange(n) * dt, axis, pose[..., :3] + arm, velocity, felt)


def _samples(duration: float, dt: float) -> int:
    """Return the number of samples in a duration [s], at least one."""
    return max(1, round(duration / dt))


def _angle(a: Float[Array, "*batch xyz"], b: Float[Array, "*batch xyz"]) -> Float[Array, "*batch"]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))


def _parcels(vessel: Vessel, motion: VesselMotion, gone: Float[Array, " sample"]) -> list[Parcel]:
    """Divide the loss of one container, given by sample, into equal parcels that leave over the rim's lowest point."""
    count = min(_PARCELS, max(1, int(gone[-1] / (_DROP * vessel.volume))))
    parcels = []
    for k in range(count):
        i = int(np.searchsorted(gone, (k + 0.5) / count * gone[-1]))
        i = max(i - 1, 0)  # the sample before the loss, since a landing container has stopped afterwards
        axis, felt = motion.axis[0, i], motion.felt[0, i]
        down = axis * (axis @ felt) - felt
        length = float(np.linalg.norm(down))
        edge = vessel.radius * down / length if length > 1e-6 else np.zeros(3)
        parcels.append(
            Parcel(
                time=float(motion.time[i]),
                volume=float(gone[-1]) / count,
                position=motion.rim[0, i] + edge,
                velocity=motion.velocity[0, i],
            )
        )
    return parcels


def _columns(world: World) -> tuple[slice, slice]:
    """Return the slices of the carried object's pose in qpos and of its velocity in qvel."""
    joint = int(world.model.body_jntadr[world.carried_body])
    qpos, dof = int(world.model.jnt_qposadr[joint]), int(world.model.jnt_dofadr[joint])
    return slice(qpos, qpos + 7), slice(dof, dof + 6)
