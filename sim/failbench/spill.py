"""What carried contents lose, and whom they reach: a proxy, for there are no liquids in MuJoCo.

Contents stay in their container as a plane surface would, level with the vertical that is felt in it: gravity less the
container's acceleration, averaged over the time that slow sloshing needs. What stands above the rim is lost at once. A
jolt throws a stated part out. What is lost flies on its own from the rim, and what lands runs out to a puddle. Losses
of the healthy run do not count: what that leaves is what is there to be lost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from failbench.bounds import rotations
from failbench.closeup import Closeup
from failbench.puddle import Parcel, Puddles
from failbench.records import ContactEvent
from failbench.vessel import Vessel, find_vessel
from failbench.world import World
from graceful_plan.array_types import Float

Array = np.ndarray

STRIDE = 5
"""Steps from one sample of the container's motion to the next."""
_SLOSH = 3
"""Samples to either side over which the acceleration is averaged: 60 ms at a step of 2 ms."""
_WEIGHTLESS = 0.2
"""Below this part of gravity no surface forms, and nothing pours out."""
_JOLT = 3
"""Samples that a jolt takes at most."""
_CALM = 10
"""Samples after a jolt before the next one can begin."""
_LOSSES = ((1.5, 0.9), (0.7, 0.3))
"""Change of velocity that is felt in a jolt [m/s] and the part that it throws out: a fall onto something hard from more
than a hand's breadth; a hard stop. Assumptions: no measurements are known."""
_PARCELS = 4
"""Portions in which a loss leaves, at most."""
_DROP = 0.02
"""Part of the contents that is not divided any more."""
_NOTHING = 0.01
"""Part of the contents of which nobody notices the loss, and which this proxy does not know to any better."""


class Motion(NamedTuple):
    """A container's motion in W, a row a sample."""

    time: Float[Array, " sample"]
    axis: Float[Array, "sample xyz"]
    rim: Float[Array, "sample xyz"]
    velocity: Float[Array, "sample xyz"]
    """Of the middle of the rim [m/s]."""
    felt: Float[Array, "sample xyz"]
    """Gravity's reaction plus acceleration [m/s^2]: upward, where the container stands still."""


class Spill:
    """Follows the container through a batch of simulations.

    Args:
        world: Where.
        closeup: What to look with.
        onset: Positions and velocities at the onset [sim, ...].
        kept: Volume [m^3] that the healthy run leaves in; by default what the tilt at the onset leaves.
    """

    def __init__(self, world: World, closeup: Closeup, onset: tuple[Array, Array], kept: float | None = None) -> None:
        self._dt = STRIDE * float(world.model.opt.timestep)
        self._vessel = find_vessel(world)
        self._kept = kept
        self._gravity = -float(world.model.opt.gravity[2])
        if self._vessel is not None:
            self._columns = _columns(world)
            self._samples = [tuple(x[:, None, c] for x, c in zip(onset, self._columns, strict=True))]
            self._puddles = Puddles(world, closeup)

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
        pose, twist = (np.concatenate([sample[i][sim] for sample in self._samples]) for i in (0, 1))
        motion = _motion(vessel, pose, twist, self._dt, self._gravity)
        there = float(vessel.capacity(_angle(motion.axis[:1], np.array([[0.0, 0.0, 1.0]])))[0])
        kept = min(vessel.volume, there if self._kept is None else self._kept)
        left = kept * remaining(vessel, motion, kept, self._gravity)
        lost = kept - left[-1]
        if lost <= _NOTHING * vessel.volume:
            return 0.0, []
        return float(lost / kept), self._puddles.events(qpos, _parcels(vessel, motion, kept - left))


def kept_volume(world: World, states: Float[Array, "sample state"]) -> float:
    """Return the volume [m^3] that a healthy run leaves in the container; 0 if there is none.

    Args:
        world: Where.
        states: MuJoCo's integration state, which begins with time, positions and velocities, every `STRIDE` steps.
    """
    vessel = find_vessel(world)
    if vessel is None:
        return 0.0
    nq, nv = world.model.nq, world.model.nv
    parts = states[:, 1 : 1 + nq], states[:, 1 + nq : 1 + nq + nv]
    pose, twist = (x[:, c] for x, c in zip(parts, _columns(world), strict=True))
    # Then it stands still.
    pose = np.vstack([pose, np.repeat(pose[-1:], _CALM, axis=0)])
    twist = np.vstack([twist, np.zeros((_CALM, 6))])
    gravity = -float(world.model.opt.gravity[2])
    motion = _motion(vessel, pose, twist, STRIDE * float(world.model.opt.timestep), gravity)
    return vessel.volume * float(remaining(vessel, motion, vessel.volume, gravity)[-1])


def remaining(vessel: Vessel, motion: Motion, kept: float, gravity: float) -> Float[Array, " sample"]:
    """Return the part of `kept` [m^3] that is still in the container at each sample."""
    if kept <= 0.0:
        return np.zeros(len(motion.felt))
    heavy = np.linalg.norm(motion.felt, axis=1) > _WEIGHTLESS * gravity
    capacity = np.where(heavy, vessel.capacity(_angle(motion.axis, motion.felt)) / kept, 1.0)
    return np.minimum.accumulate(np.minimum(capacity, _after_jolts(motion, gravity)))


def _after_jolts(motion: Motion, gravity: float) -> Float[Array, " sample"]:
    """Return the part that jolts have left in at each sample."""
    v = motion.velocity + np.outer(motion.time, [0.0, 0.0, gravity])  # constant in free fall
    part = np.ones(len(v))
    change = np.linalg.norm(v[_JOLT:] - v[:-_JOLT], axis=1)
    sample = 0
    for i in np.flatnonzero(change > _LOSSES[-1][0]).tolist():
        if i >= sample:
            worst = float(change[i : i + _JOLT].max())
            part[i + 1 :] *= 1.0 - next(loss for least, loss in _LOSSES if worst >= least)
            sample = i + _CALM
    return part


def _motion(
    vessel: Vessel, pose: Float[Array, "sample 7"], twist: Float[Array, "sample 6"], dt: float, gravity: float
) -> Motion:
    R = rotations(pose[:, 3:])
    arm = R @ vessel.p_BR
    velocity = twist[:, :3] + np.cross(np.einsum("nij,nj->ni", R, twist[:, 3:]), arm)
    n = len(pose)
    # Near the ends that of the nearest sample that has neighbours enough, for shorter means would be less smooth.
    first = np.clip(np.arange(n) - _SLOSH, 0, max(n - 1 - 2 * _SLOSH, 0))
    last = np.minimum(first + 2 * _SLOSH, n - 1)
    felt = (velocity[last] - velocity[first]) / (np.maximum(last - first, 1) * dt)[:, None]
    felt[:, 2] += gravity
    return Motion(np.arange(n) * dt, R @ vessel.axis, pose[:, :3] + arm, velocity, felt)


def _angle(a: Float[Array, "n xyz"], b: Float[Array, "#n xyz"]) -> Float[Array, " n"]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("nx,nx->n", a, np.broadcast_to(b, a.shape)))


def _parcels(vessel: Vessel, motion: Motion, gone: Float[Array, " sample"]) -> list[Parcel]:
    """Divide what is gone, by sample, into equal portions that leave over the lowest point of the rim."""
    count = min(_PARCELS, max(1, int(gone[-1] / (_DROP * vessel.volume))))
    parcels = []
    for k in range(count):
        i = int(np.searchsorted(gone, (k + 0.5) / count * gone[-1]))
        i = max(i - 1, 0)  # before the loss shows, and before a container that lands has stopped
        down = motion.axis[i] * (motion.axis[i] @ motion.felt[i]) - motion.felt[i]
        length = float(np.linalg.norm(down))
        edge = vessel.radius * down / length if length > 1e-6 else np.zeros(3)
        parcels.append(
            Parcel(
                time=float(motion.time[i]),
                volume=float(gone[-1]) / count,
                position=motion.rim[i] + edge,
                velocity=motion.velocity[i],
            )
        )
    return parcels


def _columns(world: World) -> tuple[slice, slice]:
    """Return where the pose and the velocity of the carried object are in qpos and qvel."""
    joint = int(world.model.body_jntadr[world.carried_body])
    qpos, dof = int(world.model.jnt_qposadr[joint]), int(world.model.jnt_dofadr[joint])
    return slice(qpos, qpos + 7), slice(dof, dof + 6)
