"""Selection of usable configurations: within the limits and free of collision, with messages about the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.judge.exact import exactly_free, state_contacts
from graceful_plan.query.endpoints.travel import Travel
from graceful_plan.scene.scene import Scene

CLAMPED = 1e-6
"""Largest distance outside a position limit [rad or m] that is clamped instead of refused."""
MOST_GOALS = 1000
"""Largest number of goal configurations for planners: each is the root of a tree."""
_PROVED_AT_A_TIME, _AT_A_TIME = 1024, 64
"""Batch sizes of the check by spheres, and of exact geometry between two readings of the clock."""
_TOLD = 5
"""Largest number of configurations in a list of problems or notes."""


@dataclass(frozen=True, eq=False)
class Resolved:
    """Usable configurations, and messages about the others.

    | field    | meaning                                                | unit     | shape     |
    |----------|--------------------------------------------------------|----------|-----------|
    | q        | configurations inside the limits and free of collision | rad or m | usable nq |
    | index    | index of the given configuration or goal               |          | usable    |
    | notes    | descriptions of adjustments                            |          |           |
    | problems | reasons why the others cannot be used                  |          |           |
    """

    q: Float[Array, "usable nq"]
    index: tuple[int, ...]
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()

    @property
    def detail(self) -> str:
        """Notes and problems in one line."""
        return "; ".join([*self.notes, *self.problems])


def usable(
    words: Sequence[str],
    q: Float[Array, "n nq"],
    scene: Scene,
    travel: Travel,
    *,
    cancelled: Callable[[], bool] = lambda: False,
    hurried: Callable[[], bool] = lambda: False,
) -> Resolved:
    """Select configurations within the limits and free of collision, in the order given, with problems of the others.

    Configurations are checked in the order of the cost of a straight move from the start, until `MOST_GOALS` are
    usable. Bounding spheres prove most of them free; exact geometry checks the others.

    Args:
        words: Names of the configurations for messages.
        q: The configurations [rad or m].
        scene: The scene.
        travel: Cost of moves from the start.
        cancelled: Ends the checks by exact geometry once it returns True.
        hurried: Ends them once it returns True and a usable configuration is known.
    """
    lower, upper = scene.limits.position.T
    inside = np.clip(q, lower, upper)
    excess = np.abs(q - inside).max(axis=1)
    outside, moved = np.flatnonzero(excess > CLAMPED), np.flatnonzero((excess > 0) & (excess <= CLAMPED))
    notes = [f"{_beyond(words[i], q[i], scene)}; moved onto it" for i in map(int, moved[:_TOLD])]
    notes += [f"so were {len(moved) - _TOLD} more"] if len(moved) > _TOLD else []

    within = np.flatnonzero(excess <= CLAMPED)
    nearest = within[np.argsort(travel.cost(inside[within]), kind="stable")]
    free, blocked, unseen = _sorted_out(inside[nearest], scene, cancelled, hurried)
    problems = [_beyond(words[i], q[i], scene) for i in map(int, outside[:_TOLD])]
    problems += [f"no time to look at {unseen} of {len(q)}"] if unseen else []
    problems += [collision(words[i], inside[i], scene) for i in map(int, nearest[blocked[:_TOLD]])]
    untold = len(outside[_TOLD:]) + len(blocked[_TOLD:])
    problems += [f"{untold} more of {len(q)} likewise"] if untold else []
    if len(free) > MOST_GOALS:
        notes.append(f"planned for the {MOST_GOALS} nearest free goals of {len(q)}")
        free = free[:MOST_GOALS]
    index = np.sort(nearest[free])
    return Resolved(inside[index], tuple(index.tolist()), tuple(notes), tuple(problems))


def _sorted_out(
    q: Float[Array, "n nq"], scene: Scene, cancelled: Callable[[], bool], hurried: Callable[[], bool]
) -> tuple[list[int], list[int], int]:
    """Return indices of free and of colliding configurations, both in order, and the number of unchecked ones.

    The check ends once more than `MOST_GOALS` are free.
    """
    proof = compile_scene(scene).proof
    free, blocked, looked_at, unseen = [], [], 0, 0
    for first in range(0, len(q), _PROVED_AT_A_TIME):
        some = np.arange(first, min(first + _PROVED_AT_A_TIME, len(q)))
        proved = proof.free(q[some]) if len(q) > 1 else np.zeros(1, dtype=bool)
        found, doubtful = some[proved].tolist(), some[~proved]
        for k in range(0, len(doubtful), _AT_A_TIME):
            if looked_at and (cancelled() or (hurried() and (free or found))):
                unseen += len(doubtful) - k
                break
            ok = exactly_free(q[doubtful[k : k + _AT_A_TIME]], scene)
            found += doubtful[k : k + _AT_A_TIME][ok].tolist()
            blocked += doubtful[k : k + _AT_A_TIME][~ok].tolist()
            looked_at += len(ok)
        free += sorted(found)
        if len(free) > MOST_GOALS:
            break
    return free, blocked, unseen


def free_of_collision(q: Float[Array, "n nq"], scene: Scene) -> Bool[Array, " n"]:
    """Return which configurations are free, by bounding spheres first and by exact geometry for the others."""
    free = compile_scene(scene).proof.free(q)
    free[~free] = exactly_free(q[~free], scene)
    return free


def _beyond(word: str, q: Float[Array, " nq"], scene: Scene) -> str:
    """Return a message about the joint that is the farthest outside its limits."""
    lower, upper = scene.limits.position.T
    inside = np.clip(q, lower, upper)
    worst = int(np.argmax(np.abs(q - inside)))
    limit = f"{'lower' if q[worst] < lower[worst] else 'upper'} limit {inside[worst]:.9g}"
    return f"{word}: joint {scene.joints[worst]!r} is at {q[worst]:.9g}, beyond its {limit}"


def collision(word: str, q: Float[Array, " nq"], scene: Scene) -> str:
    """Return a message about the deepest contact; empty if the configuration is free."""
    contacts = state_contacts(q, scene)
    if not contacts:
        return ""
    deepest = contacts[0]
    more = f" and {len(contacts) - 1} more" if len(contacts) > 1 else ""
    pair = ", ".join(repr(name.partition("#")[0]) for name in deepest[:2])  # for unnamed geoms, the body
    told = f"{word}: {deepest.first} is {1e3 * deepest.depth:.3g} mm in {deepest.obstacle}{more}"
    return f"{told}; if they may touch, say AllowedContact({pair})"
