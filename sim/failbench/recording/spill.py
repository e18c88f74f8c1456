"""What carried contents lose, and whom they reach: a proxy, for there are no liquids in MuJoCo.

Contents stay in their container as a plane surface would, level with the vertical that is felt in it: gravity less the
container's acceleration, averaged over the time that slow sloshing needs. What stands above the rim is lost at once. A
jolt throws a stated part out. What is lost flies on its own from the rim, and what lands runs out to a puddle. Of a
failure counts what is lost from its onset on; what a healthy run loses is `HealthyLoss`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from failbench.recording.bounds import rotations
from failbench.recording.closeup import Closeup
from failbench.recording.puddle import Parcel, Puddles
from failbench.recording.records import ContactEvent
from failbench.simulated.states import CHECKPOINT
from failbench.simulated.world import World
from graceful_plan.array_types import Float
from graceful_plan.scene.rules.vessel import Vessel, find_vessel

Array = np.ndarray

STRIDE = CHECKPOINT
"""Steps from one sample of the container's motion to the next; the healthy run is sampled at its checkpoints."""
_SLOSH = 0.03
"""Time to either side over which the acceleration is averaged [s]."""
_WEIGHTLESS = 0.2
"""Below this part of gravity no surface forms, and nothing pours out."""
_JOLT = 0.03
"""Time that a jolt takes at most [s]."""
_CALM = 0.1
"""Time after the beginning of a jolt before the next one can begin [s]."""
_LOSSES = ((1.5, 0.9), (0.7, 0.3))
"""Change of velocity that is felt in a jolt [m/s] and the part that it throws out: a fall onto something hard from more
than a hand's breadth; a hard stop. Assumptions: no measurements are known."""
_PARCELS = 4
"""Portions in which a loss leaves, at most."""
_DROP = 0.02
"""Part of the contents that is not divided any more."""
_NOTHING = 0.01
"""Part of the contents of which nobody notices the loss, and which this proxy does not know to any better."""


class VesselMotion(NamedTuple):
    """Containers' motions in W."""

    time: Float[Array, " sample"]
    axis: Float[Array, "sim sample xyz"]
    rim: Float[Array, "sim sample xyz"]
    velocity: Float[Array, "sim sample xyz"]
    """Of the middle of the rim [m/s]."""
    felt: Float[Array, "sim sample xyz"]
    """Gravity's reaction plus acceleration [m/s^2]: upward, where the container stands still."""


class HealthyLoss(NamedTuple):
    """What leaves the container without any failure."""

    there: float
    """Volume that stands in it at rest in the first state [m^3]."""
    kept: Float[Array, " checkpoint"]
    """Volume that is still in it at each checkpoint [m^3]."""
    end: float
    """Volume that is left when it has come to a stop [m^3]."""
    parcels: tuple[Parcel, ...]
    """What is gone, in the order in which it leaves; none if nobody would notice."""

    @property
    def part(self) -> float:
        """Lost part of what was there, in [0, 1]; exactly 0 if nobody would notice."""
        return 1.0 - self.end / self.there if self.parcels else 0.0


class Spill:
    """Follows the container through a batch of simulations.

    Args:
        world: Where.
        closeup: What to look with.
        onset: Positions and velocities at the onset [sim, ...].
        kept: Volume [m^3] that is in the container at each onset; by default what the tilt there leaves.
    """

    def __init__(
        self,
        world: World,
        closeup: Closeup,
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
        """Take in the next steps."""
        if self._vessel is not None:
            steps = slice(STRIDE - 1, None, STRIDE)
            self._samples.append(tuple(x[:, steps, c].copy() for x, c in zip((qpos, qvel), self._columns, strict=True)))

    def finish(self, sim: int, qpos: Float[Array, " qpos"]) -> tuple[float, list[ContactEvent]]:
        """Return the part of the contents that was lost, and whom it reached.

        Args:
            sim: Which simulation.
            qpos: Positions at its end: what stands around is looked for there.
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
        """Return all motions, and the volumes that are in the containers first and at each sample [m^3]."""
        pose, twist = (np.concatenate([sample[i] for sample in self._samples], axis=1) for i in (0, 1))
        motion = _motion(vessel, pose, twist, self._dt, self._gravity)
        kept = _standing(vessel, motion) if self._kept is None else np.minimum(vessel.volume, self._kept)
        return motion, kept, kept[:, None] * remaining(vessel, motion, kept, self._gravity)


def kept_volume(world: World, states: Float[Array, "checkpoint state"]) -> float:
    """Return the volume [m^3] that a healthy run leaves in the container; 0 if there is none.

    Args:
        world: Where.
        states: MuJoCo's integration state, which begins with time, positions and velocities, at each checkpoint.
    """
    loss = healthy_loss(world, states)
    return 0.0 if loss is None else loss.end


def healthy_loss(world: World, states: Float[Array, "checkpoint state"]) -> HealthyLoss | None:
    """Return what a healthy run loses of the contents; None if nothing is carried in a container.

    Args:
        world: Where.
        states: As of `kept_volume`. What does not stand in the container at rest in the first one was never there.
    """
    vessel = find_vessel(world.scene)
    if vessel is None:
        return None
    nq, nv = world.model.nq, world.model.nv
    parts = states[:, 1 : 1 + nq], states[:, 1 + nq : 1 + nq + nv]
    pose, twist = (x[:, c] for x, c in zip(parts, _columns(world), strict=True))
    dt = STRIDE * float(world.model.opt.timestep)
    after = _samples(_CALM, dt)  # then it stands still
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
    """Return the part of `kept` [m^3] that is still in the container at each sample."""
    heavy = np.linalg.norm(motion.felt, axis=-1) > _WEIGHTLESS * gravity
    capacity = vessel.capacity(_angle(motion.axis, motion.felt)) / np.maximum(kept, 1e-12)[:, None]
    part = np.minimum(np.where(heavy, capacity, 1.0), _after_jolts(motion, gravity))
    return np.minimum.accumulate(part, axis=1)


def _standing(vessel: Vessel, motion: VesselMotion) -> Float[Array, " sim"]:
    """Return the volume [m^3] that stands in each container if it rests as it does in the first sample."""
    up = np.broadcast_to([0.0, 0.0, 1.0], motion.axis[:, 0].shape)
    return np.minimum(vessel.volume, vessel.capacity(_angle(motion.axis[:, 0], up)))


def _after_jolts(motion: VesselMotion, gravity: float) -> Float[Array, "sim sample"]:
    """Return the part that jolts have left in at each sample."""
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
    # Near the ends that of the nearest sample that has neighbours enough, for shorter means would be less smooth.
    slosh = _samples(_SLOSH, dt)
    first = np.clip(np.arange(n) - slosh, 0, max(n - 1 - 2 * slosh, 0))
    last = np.minimum(first + 2 * slosh, n - 1)
    felt = (velocity[:, last] - velocity[:, first]) / (np.maximum(last - first, 1) * dt)[:, None]
    felt[..., 2] += gravity
    return VesselMotion(np.arange(n) * dt, axis, pose[..., :3] + arm, velocity, felt)


def _samples(duration: float, dt: float) -> int:
    """Return how many samples a duration has [s], at least one."""
    return max(1, round(duration / dt))


def _angle(a: Float[Array, "*batch xyz"], b: Float[Array, "*batch xyz"]) -> Float[Array, "*batch"]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))


def _parcels(vessel: Vessel, motion: VesselMotion, gone: Float[Array, " sample"]) -> list[Parcel]:
    """Divide what is gone from one container, by sample, into equal portions that leave over the rim's lowest point."""
    count = min(_PARCELS, max(1, int(gone[-1] / (_DROP * vessel.volume))))
    parcels = []
    for k in range(count):
        i = int(np.searchsorted(gone, (k + 0.5) / count * gone[-1]))
        i = max(i - 1, 0)  # before the loss shows, and before a container that lands has stopped
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
    """Return where the pose and the velocity of the carried object are in qpos and qvel."""
    joint = int(world.model.body_jntadr[world.carried_body])
    qpos, dof = int(world.model.jnt_qposadr[joint]), int(world.model.jnt_dofadr[joint])
    return slice(qpos, qpos + 7), slice(dof, dof + 6)
