"""MuJoCo's exact geometry as the judge of configurations and paths.

Nothing here is shared with the kernels that planners use: other geometry, other kinematics, other code. MuJoCo's
collision detection runs on a private copy of the scene's model that tests only what matters: the robot and the object
it carries, against everything and themselves.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.judge.motion_samples import AUDITED, ClearanceBound, MotionSamples, motion_samples
from graceful_plan.judge.preparation import prepare
from graceful_plan.path import Path
from graceful_plan.scene.model_parts import geom_label
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.screening import within_memory
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray
_LOG = logging.getLogger(__name__)

DEEPEST_SUPPORT = 0.003
"""How deep [m] a carried object may sink into its support at the ends of a path."""
_NEAR = 0.05
"""From which distance on things are not near [m]: farther than spheres stick out."""
_FEW, _BLOCK = 32, 4096
"""Configurations below which each is placed alone, and above which not all are placed in advance."""
_GRAZE = 1e-6
"""Contacts of an object with its support that are shallower [m] are rounding, wherever they are on the path."""


class Touch(NamedTuple):
    """Two geoms that overlap."""

    sample: int
    """Index of the configuration."""
    first: int
    second: int
    """Geom ids, the lower one first."""
    distance: float
    """Signed distance [m], at most 0."""


class Contact(NamedTuple):
    """Two geoms that overlap, by name, and how deep [m]."""

    first: str
    second: str
    depth: float


@dataclass(frozen=True)
class Collision:
    """Where a motion first collides."""

    q: Float[Array, " nq"]
    at: float
    """Time [s] on a trajectory, path length [rad] on a path."""
    contact: Contact


class Judge:
    """Exact collision checks in one scene. Uses MuJoCo state of the thread that makes it: one per thread."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        prepared = prepare(scene)
        filters = prepared.filters
        self._checked, self._ends, self._movers = filters.checked, filters.ends, filters.movers
        self._placement = prepared.placements.of(scene)

    def touches(self, q: Float[Array, "n nq"], start: int = 0) -> Iterator[Touch]:
        """Yield what overlaps in each configuration, in order; allowed contacts at the ends are in it, others are not.

        Args:
            q: Configurations.
            start: What to call the first one.
        """
        model, place = self._placement.model, self._placement.place
        with within_memory("looking for contacts"):  # around the loop: it takes as long as a look does
            for sample, (configuration, X_WO) in enumerate(zip(q, self._carried_poses(q), strict=True), start):
                data = place(configuration, X_WO)
                mujoco.mj_collision(model, data)
                if data.ncon:
                    contact = data.contact
                    pairs, distances = contact.geom, contact.dist
                    for (a, b), distance in zip(pairs.tolist(), distances.tolist(), strict=True):
                        if distance < 0.0 and self._checked[a, b]:
                            yield Touch(sample, min(a, b), max(a, b), distance)

    def _carried_poses(self, q: Float[Array, "n nq"]) -> Iterator[Float[Array, "4 4"] | None]:
        """Yield where the carried object is in each configuration; None where `Placement` finds that out itself."""
        if self.scene.carried is None or len(q) < _FEW:
            yield from (None for _ in q)
            return
        known = kinematics(self.scene)
        for begin in range(0, len(q), _BLOCK):
            yield from known.poses(q[begin : begin + _BLOCK], known.held[[1]])[0]

    def is_violation(self, touch: Touch, *, at_end: bool) -> bool:
        """Whether a touch is a collision, given whether it belongs to the stretch of contact at an end of the path."""
        if not self._ends[touch.first, touch.second]:
            return True
        return -touch.distance > (DEEPEST_SUPPORT if at_end else _GRAZE)

    def violations(self, touches: list[Touch], samples: int) -> list[Touch]:
        """Tell collisions from allowed contacts: such a pair may touch in one unbroken stretch at either end."""
        at_end = np.zeros(samples, dtype=bool)
        found = []
        for pair in {(t.first, t.second) for t in touches}:
            mine = [t for t in touches if (t.first, t.second) == pair]
            touching = np.zeros(samples + 1, dtype=bool)
            touching[[t.sample for t in mine]] = True
            lifted = int(np.argmin(touching))
            set_down = samples - int(np.argmin(np.append(touching[:-1][::-1], False)))
            at_end[:] = False
            at_end[:lifted] = at_end[set_down:] = True
            found += [t for t in mine if self.is_violation(t, at_end=bool(at_end[t.sample]))]
        return sorted(found)

    def named(self, touch: Touch) -> Contact:
        """Put a touch in words, what moves first."""
        first, second = (geom_label(self.scene.model, geom) for geom in (touch.first, touch.second))
        if touch.first not in self._movers:
            first, second = second, first
        return Contact(first, second, -touch.distance)


def state_contacts(q: Float[Array, " nq"], scene: Scene, *, at_end: bool = True) -> list[Contact]:
    """Return what collides in one configuration, deepest first; empty if it is free.

    Args:
        q: The configuration.
        scene: Where.
        at_end: Whether it is the start or the goal, where a carried object may stand on its support.
    """
    judge = Judge(scene)
    touches = [t for t in judge.touches(np.asarray(q, dtype=float)[None]) if judge.is_violation(t, at_end=at_end)]
    deepest: dict[tuple[int, int], Touch] = {}
    for touch in sorted(touches, key=lambda t: t.distance, reverse=True):
        deepest[touch.first, touch.second] = touch
    return [judge.named(touch) for touch in sorted(deepest.values(), key=lambda t: t.distance)]


def nearest_pair(q: Float[Array, " nq"], scene: Scene) -> Contact | None:
    """Return what is nearest to each other of all that may not touch, what moves first; None if nothing is near.

    Args:
        q: The configuration.
        scene: Where.
    """
    judge, data = Judge(scene), scene.data_at(q)
    pairs = scene.collision_pairs().tolist()
    away = [mujoco.mj_geomDistance(scene.model, data, a, b, _NEAR, None) for a, b in pairs]
    if min(away, default=_NEAR) >= _NEAR:
        return None
    nearest = int(np.argmin(away))
    first, second = sorted(pairs[nearest])
    return judge.named(Touch(0, first, second, away[nearest]))


def exactly_free(q: Float[Array, "n nq"], scene: Scene) -> Bool[Array, " n"]:
    """Tell which configurations may be the start or the goal: nothing collides, but for allowed contacts at an end."""
    judge, free = Judge(scene), np.ones(len(q), dtype=bool)
    for touch in judge.touches(q):
        free[touch.sample] &= not judge.is_violation(touch, at_end=True)
    return free


def motion_violations(
    motion: Path | Trajectory, scene: Scene, step: float, clearance: ClearanceBound | None = None
) -> tuple[list[Touch], MotionSamples]:
    """Return the collisions of a motion, and the samples that they are numbered by.

    Exact geometry looks at every sample, or at those that a bound of the clearance leaves open, and at one in `AUDITED`
    of the others. If that one touches anything the bound is wrong: then exact geometry looks at everything.

    Args:
        motion: What is to be checked.
        scene: Where.
        step: No point of the robot moves farther than this between two samples [m].
        clearance: Proves configurations free.
    """
    judge = Judge(scene)
    samples = motion_samples(motion, scene, step, clearance)
    looked_at = np.flatnonzero(~samples.proved | (np.arange(len(samples.q)) % AUDITED == AUDITED - 1))
    touches = [touch._replace(sample=int(looked_at[touch.sample])) for touch in judge.touches(samples.q[looked_at])]
    if any(samples.proved[touch.sample] for touch in touches):
        _LOG.error("spheres that prove a configuration free are wrong; the whole motion is looked at exactly")
        return motion_violations(motion, scene, step)
    return judge.violations(touches, len(samples.q)), samples


def first_collision(
    motion: Path | Trajectory, scene: Scene, step: float = 0.002, clearance: ClearanceBound | None = None
) -> Collision | None:
    """Return where a motion first collides, None if it is free; the arguments are those of `motion_violations`."""
    judge = Judge(scene)
    violations, samples = motion_violations(motion, scene, step, clearance)
    if not violations:
        return None
    first = min(violations, key=lambda t: (t.sample, t.distance))
    return Collision(samples.q[first.sample], float(samples.at[first.sample]), judge.named(first))
