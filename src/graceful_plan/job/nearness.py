"""Distances that straight motions of a job keep, by exact geometry.

A healthy arm and the object in its fingers deviate from their trajectory by some millimetres. So the robot should keep
a margin from all things but the object that it grasps. The object may be as near to each thing as it is where it
stands, and so may the robot be to the object: to its support, for example, and to a neighbour beside its goal.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.judge.preparation import prepare
from graceful_plan.scene.model_parts import subtree
from graceful_plan.scene.per_scene import per_layout
from graceful_plan.scene.placement import PlacementPool
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

Array = np.ndarray

_SAMPLES = 16
"""Configurations of a motion that are compared: about 5 mm apart on a way of 8 cm."""
STANDS_FIRST = {"approach": False, "lift": True, "lower": False, "retreat": True}
"""Whether the object stands in its place at the start of a straight motion, by its label; otherwise at its end."""
_SLACK = 1e-3
"""Distance by which an object may come nearer to a thing than where it stands [m]: deviations from a straight line."""


@dataclass(frozen=True, kw_only=True)
class Nearness:
    """Distances that a motion keeps; infinite where they are at least the margin.

    | field    | meaning                                                                                    | unit |
    |----------|--------------------------------------------------------------------------------------------|------|
    | moving   | least distance from things that need not be so near                                        | m    |
    | standing | distance of the object, where it stands, from things other than its supports and the robot | m    |
    | passed   | body at the first of these distances; "" if there is none                                  |      |
    | beside   | body at the second; "" if there is none                                                    |      |
    """

    moving: float = np.inf
    standing: float = np.inf
    passed: str = ""
    beside: str = ""

    def within(self, other: Nearness) -> Nearness:
        """Return the lesser distances of two motions."""
        first, second = min(self, other, key=lambda one: one.moving), min(self, other, key=lambda one: one.standing)
        return Nearness(moving=first.moving, standing=second.standing, passed=first.passed, beside=second.beside)


def nearness(motion: Trajectory, scene: Scene, name: str, *, margin: float, stands_first: bool) -> Nearness:
    """Return the distances that a straight motion keeps.

    Args:
        motion: The motion.
        scene: Its scene, with an object in the gripper or between its open fingers.
        name: Body of that object.
        margin: Distance from which on things are far enough away [m].
        stands_first: Whether the object stands in its place at the start; otherwise at the end.
    """
    q = motion.q[np.linspace(0, len(motion.q) - 1, _SAMPLES).round().astype(int)]
    return _nearness(q if stands_first else q[::-1], scene, name, margin)


def nearness_at(q: Float[Array, " nq"], scene: Scene, name: str, *, margin: float) -> Nearness:
    """Return the distances in a configuration in which the object stands; for the arguments see `nearness`."""
    return _nearness(q[None], scene, name, margin)


def _nearness(q: Float[Array, "n nq"], scene: Scene, name: str, margin: float) -> Nearness:
    """Return the distances of configurations, in the first of which the object stands."""
    model, ends = scene.model, prepare(scene).filters.ends
    mine, own = scene.robot_bodies, subtree(model, model.body(name).id)
    body = model.geom_bodyid.tolist()
    at_first: dict[tuple[int, int], float] = {}
    least: dict[tuple[int, int], float] = {}
    standing: dict[tuple[int, int], float] = {}
    for k, a, b, distance in _near(q, scene, margin):
        if body[a] in mine and body[b] in mine:
            continue
        is_own = body[a] in own or body[b] in own
        known = at_first if is_own and k == 0 else least
        known[a, b] = min(known.get((a, b), np.inf), distance)
        if known is at_first and not (ends[a, b] or body[a] in mine or body[b] in mine):
            standing[a, b] = at_first[a, b]
    moving = {pair: d for pair, d in least.items() if d < at_first.get(pair, np.inf) - _SLACK}

    def first(found: dict[tuple[int, int], float]) -> tuple[float, str]:
        if not found:
            return np.inf, ""
        a, b = min(found, key=lambda pair: found[pair])
        other = body[b] if body[a] in mine or body[a] in own else body[a]
        return found[a, b], str(model.body(other).name)

    (passing, passed), (apart, beside) = first(moving), first(standing)
    return Nearness(moving=passing, standing=apart, passed=passed, beside=beside)


def _near(q: Float[Array, "n nq"], scene: Scene, margin: float) -> Iterator[tuple[int, int, int, float]]:
    """Yield samples, pairs of geoms that the judge checks, the lower one first, and distances below a margin [m]."""
    checked, place = prepare(scene).filters.checked, _placements(scene).of(scene)
    # Margins of both geoms of a pair are added; those of bodies cull pairs before.
    place.model.geom_margin[:] = 0.5 * margin
    place.model.body_margin[:] = 0.5 * margin
    for sample, configuration in enumerate(q):
        data = place.place(configuration)
        mujoco.mj_collision(place.model, data)
        if data.ncon:
            pairs, distances = data.contact.geom.tolist(), data.contact.dist.tolist()
            for (a, b), distance in zip(pairs, distances, strict=True):
                if distance < margin and checked[a, b]:
                    yield sample, min(a, b), max(a, b), distance


@per_layout
def _placements(scene: Scene) -> PlacementPool:
    filters = prepare(scene).filters
    return PlacementPool((filters.contype, filters.conaffinity))
