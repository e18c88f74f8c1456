"""Exact collision checks of configurations and motions with MuJoCo.

This module shares nothing with the planners' kernels: geometry, kinematics and code differ. MuJoCo's collision
detection runs on a private copy of the scene's model that tests only the relevant pairs: the robot and the carried
object against everything and against themselves.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.judge.kinematics import kinematics
from graceful_plan.judge.motion_samples import AUDITED, ClearanceBound, MotionSamples, motion_samples
from graceful_plan.judge.preparation import prepare
from graceful_plan.path import Path
from graceful_plan.scene.model_parts import geom_label
from graceful_plan.scene.scene import Scene
from graceful_plan.scene.specs import within_memory
from graceful_plan.timing.trajectory import Trajectory

_LOG = logging.getLogger(__name__)

DEEPEST_SUPPORT = 0.003
"""Largest penetration of a carried object into its support at the ends of a path [m]."""
_NEAR = 0.05
"""Largest distance that `nearest_pair` reports [m]; covering spheres protrude less than that."""
_FEW, _BLOCK = 32, 4096
"""Number of configurations below which poses are computed one by one, and the block size above."""
_GRAZE = 1e-6
"""Depth up to which a contact counts as rounding [m]."""


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
    """Two geoms that overlap, by name, and their penetration depth [m].

    `obstacle` describes the second: its name, or "the hull of" a mesh of the surroundings, which may be concave.
    """

    first: str
    second: str
    depth: float
    obstacle: str


@dataclass(frozen=True)
class Collision:
    """First collision of a motion."""

    q: Float[Array, " nq"]
    at: float
    """Time [s] on a trajectory, path length [rad] on a path."""
    contact: Contact


class Judge:
    """Exact collision checks in one scene. Uses MuJoCo data of the creating thread: create one instance per thread."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        prepared = prepare(scene)
        filters = prepared.filters
        self._checked, self._ends, self._movers = filters.checked, filters.ends, filters.movers
        self._placement = prepared.placements.of(scene)

    def touches(self, q: Float[Array, "n nq"], start: int = 0) -> Iterator[Touch]:
        """Yield overlaps of checked pairs in each configuration, in order; includes contacts allowed only at the ends.

        Args:
            q: Configurations.
            start: Index of the first one.
        """
        model, place = self._placement.model, self._placement.place
        with within_memory("looking for contacts"):  # outside of the loop: entering it takes as long as a check
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
        """Yield the pose of the carried object in each configuration; None where `Placement` computes it itself."""
        if self.scene.carried is None or len(q) < _FEW:
            yield from (None for _ in q)
            return
        known = kinematics(self.scene)
        for begin in range(0, len(q), _BLOCK):
            yield from known.poses(q[begin : begin + _BLOCK], known.held[[1]])[0]

    def is_violation(self, touch: Touch, *, at_end: bool) -> bool:
        """Tell whether a touch is a collision, given whether it is in the contact stretch at an end of the path."""
        stands = at_end and self._ends[touch.first, touch.second]
        return -touch.distance > (DEEPEST_SUPPORT if stands else _GRAZE)

    def violations(self, touches: list[Touch], samples: int) -> list[Touch]:
        """Return the touches that are collisions: allowed pairs may touch in one unbroken stretch at either end."""
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
        """Describe a touch by the names of its geoms, the moving one first."""
        moving, other = touch.first, touch.second
        if moving not in self._movers:
            moving, other = other, moving
        first, second = (geom_label(self.scene.model, geom) for geom in (moving, other))
        return Contact(first, second, -touch.distance, f"the hull of {second}" if self._is_hull(other) else second)

    def _is_hull(self, geom: int) -> bool:
        """Return whether a geom is a mesh of the surroundings that is not divided into convex parts."""
        model = self.scene.model
        mesh = int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH)
        mine = int(model.geom_bodyid[geom]) in self.scene.robot_bodies | self.scene.held_bodies
        return mesh and not mine and "#" not in model.mesh(model.geom_dataid[geom]).name


def state_contacts(q: Float[Array, " nq"], scene: Scene, *, at_end: bool = True) -> list[Contact]:
    """Return the collisions in one configuration, deepest first; empty if it is free.

    Args:
        q: The configuration.
        scene: The scene.
        at_end: Whether it is the start or the goal, where a carried object may stand on its support.
    """
    judge = Judge(scene)
    touches = [t for t in judge.touches(np.asarray(q, dtype=float)[None]) if judge.is_violation(t, at_end=at_end)]
    deepest: dict[tuple[int, int], Touch] = {}
    for touch in sorted(touches, key=lambda t: t.distance, reverse=True):
        deepest[touch.first, touch.second] = touch
    return [judge.named(touch) for touch in sorted(deepest.values(), key=lambda t: t.distance)]


def nearest_pair(q: Float[Array, " nq"], scene: Scene) -> Contact | None:
    """Return the nearest checked pair, the moving geom first; None if all are at least `_NEAR` apart.

    Args:
        q: The configuration.
        scene: The scene.
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
    """Tell which configurations are valid starts or goals: no collisions except for contacts allowed at an end."""
    judge, free = Judge(scene), np.ones(len(q), dtype=bool)
    for touch in judge.touches(q):
        free[touch.sample] &= not judge.is_violation(touch, at_end=True)
    return free


def motion_violations(
    motion: Path | Trajectory, scene: Scene, step: float, clearance: ClearanceBound | None = None
) -> tuple[list[Touch], MotionSamples]:
    """Return the collisions of a motion, and the samples that they refer to.

    Exact geometry checks every sample. With a bound of the clearance, it checks the samples that the bound does not
    prove free, and every `AUDITED`-th of the others. If any of those collides, the bound is wrong, and exact geometry
    checks all samples.

    Args:
        motion: The motion to check.
        scene: The scene.
        step: No point of the robot moves farther than this between two samples [m].
        clearance: A lower bound that proves configurations free.
    """
    judge = Judge(scene)
    samples = motion_samples(motion, scene, step, clearance)
    looked_at = np.flatnonzero(~samples.proved | (np.arange(len(samples.q)) % AUDITED == AUDITED - 1))
    touches = [touch._replace(sample=int(looked_at[touch.sample])) for touch in judge.touches(samples.q[looked_at])]
    if any(samples.proved[touch.sample] for touch in touches):
        _LOG.error("the clearance bound is wrong: it proves colliding samples free; all samples are checked exactly")
        return motion_violations(motion, scene, step)
    return judge.violations(touches, len(samples.q)), samples


def first_collision(
    motion: Path | Trajectory, scene: Scene, step: float = 0.002, clearance: ClearanceBound | None = None
) -> Collision | None:
    """Return the first collision of a motion, None if it is free; for the arguments see `motion_violations`."""
    judge = Judge(scene)
    violations, samples = motion_violations(motion, scene, step, clearance)
    if not violations:
        return None
    first = min(violations, key=lambda t: (t.sample, t.distance))
    return Collision(samples.q[first.sample], float(samples.at[first.sample]), judge.named(first))
