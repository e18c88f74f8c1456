r"""Dynamic programming over arc length: where the base drives beside its line, and how the arm is held there.

A drive is a row of stations: control points of its curves, and the rests between them, at which the arm may move alone.
At each station the base is at one of some lateral offsets and the arm in one of some postures. From one station to the
next a step costs what J says of it,

.. math:: \sqrt{\Delta s^2 + \Delta\theta^2 + \lVert\Delta a\rVert^2} + \Delta t \left(p + \tfrac w2 (I + I')\right),
    \qquad \Delta t = \max(\Delta s / v, \Delta\theta / \omega, \max_j |\Delta a_j| / v_j)

with v the speed that bends allow: the arm has to keep its velocity limits while the base drives, or the base waits.

R. Bellman, "Dynamic Programming", 1957.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Bool, Float
from graceful_plan.mobile.motions.postures import BASE
from graceful_plan.mobile.motions.smoothing import Closeness, Smoother
from graceful_plan.planners.scene_problem import SceneProblem

Array = np.ndarray

_STAND = 1e-3
"""Speed of a base that stands, for the direction in which it does [m/s]."""


_BETWEEN = (0.25, 0.5, 0.75)
"""Of a move of the arm, where it is seen how close it comes to something."""


@dataclass(frozen=True, eq=False)
class Stations:
    """What is chosen along.

    | field   | meaning                                                     | unit  | shape     |
    |---------|-------------------------------------------------------------|-------|-----------|
    | base    | x, y and heading; of curves the middle line                 | m,rad | station 3 |
    | forward | 1, or -1 in reverse                                         |       | station   |
    | speed   | along the heading, 0 at rests                               | m/s   | station   |
    | rate    | of turning                                                  | rad/s | station   |
    | aside   | whether the base may be beside the line there               |       | station   |
    """

    base: Float[Array, "station 3"]
    forward: Float[Array, " station"]
    speed: Float[Array, " station"]
    rate: Float[Array, " station"]
    aside: Bool[Array, " station"]

    def __len__(self) -> int:
        return len(self.base)

    def velocity(self) -> Float[Array, "station 3"]:
        """Return the velocities of the base's joints."""
        along = (self.forward * np.maximum(self.speed, 0.0))[:, None]
        heading = self.base[:, 2]
        return np.column_stack([along * np.stack([np.cos(heading), np.sin(heading)], axis=1), self.rate])


@dataclass(frozen=True, eq=False)
class Reposing:
    """What was chosen at each station, and what that costs.

    | field   | meaning                     | unit     | shape       |
    |---------|-----------------------------|----------|-------------|
    | offset  | of the base to the left     | m        | station     |
    | arm     | posture                     | rad or m | station arm |
    | value   | sum of the steps' costs     |          |             |
    """

    offset: Float[Array, " station"]
    arm: Float[Array, "station arm"]
    value: float


def chosen(
    stations: Stations,
    offsets: Float[Array, " offset"],
    postures: Float[Array, "posture arm"],
    ends: tuple[int, int],
    room: Closeness,
    charged: tuple[Smoother, SceneProblem],
) -> Reposing | None:
    """Return the cheapest way along the stations; None if there is none.

    Args:
        stations: Along the drive.
        offsets: Of the base beside the middle line [m]; one of them 0.
        postures: Of the arm.
        ends: Postures at the first and the last station.
        room: What is charged for being close.
        charged: What is charged, and what has to be free.
    """
    smoother = charged[0]
    rate, free = _rates(stations, offsets, postures, room, charged)
    middle = int(np.argmin(np.abs(offsets)))
    n, m, k = rate.shape
    best = np.full((m, k), np.inf)
    best[middle, ends[0]] = 0.0
    came = np.zeros((n, m, k), dtype=int)
    arm = _ArmSteps(postures, smoother, _crowded(stations, postures, room, charged))
    for i in range(1, n):
        total = best[:, :, None, None] + _step_costs(stations, i, offsets, arm, rate, smoother)
        flat = total.reshape(m * k, m, k)
        came[i] = np.argmin(flat, axis=0)
        best = np.where(free[i], np.take_along_axis(flat, came[i][None], axis=0)[0], np.inf)
        if not stations.aside[i]:
            best[np.arange(m) != middle] = np.inf
    if not np.isfinite(best[middle, ends[1]]):
        return None
    at, path = middle * k + ends[1], []
    for i in range(n - 1, -1, -1):
        path.append(at)
        at = int(came[i].reshape(-1)[at])
    o, p = np.divmod(np.array(path[::-1]), k)
    return Reposing(offsets[o], postures[p], float(best[middle, ends[1]]))


class _ArmSteps:
    """How far postures are from each other, how long the arm takes at its limits, and what it comes close to."""

    def __init__(
        self, postures: Float[Array, "posture arm"], smoother: Smoother, crowded: Float[Array, "posture posture"]
    ) -> None:
        self.crowded = crowded
        apart = np.abs(postures[:, None] - postures)
        self.length = np.linalg.norm(apart, axis=2)
        self.seconds = (apart / (smoother.speed * smoother.objective.scene.limits.velocity[BASE:])).max(axis=2)


def _rates(
    stations: Stations,
    offsets: Float[Array, " offset"],
    postures: Float[Array, "posture arm"],
    room: Closeness,
    charged: tuple[Smoother, SceneProblem],
) -> tuple[Float[Array, "station offset posture"], Bool[Array, "station offset posture"]]:
    """Return what a second costs in each state, and which states are free."""
    smoother, problem = charged
    n, m, k = len(stations), len(offsets), len(postures)
    q = np.zeros((n, m, k, BASE + postures.shape[1]))
    qd = np.zeros_like(q)
    q[..., :BASE] = stations.base[:, None, None]
    heading = stations.base[:, 2]
    aside = offsets[None] * stations.aside[:, None]
    q[..., 0] -= (aside * np.sin(heading)[:, None])[..., None]
    q[..., 1] += (aside * np.cos(heading)[:, None])[..., None]
    q[..., BASE:] = postures
    qd[..., :BASE] = stations.velocity()[:, None, None]
    rows, rates = q.reshape(n * m * k, -1), qd.reshape(n * m * k, -1)
    free = problem.states_free(rows)
    price = np.full(len(rows), smoother.time_price)
    speed = np.repeat(stations.speed, m * k)
    price[free] += speed[free] * room.charge(smoother.clearance(rows[free])[0])
    if smoother.objective.w > 0.0 and free.any():
        price[free] += smoother.objective.w * smoother.objective.quick_states(rows[free], rates[free])
    return price.reshape(n, m, k), free.reshape(n, m, k)


def _crowded(
    stations: Stations, postures: Float[Array, "posture arm"], room: Closeness, charged: tuple[Smoother, SceneProblem]
) -> Float[Array, "posture posture"]:
    """Return what a metre costs beside while the arm moves straight from one posture to another; infinite if it cannot.

    Seen at one of three stations, at which most of it is free: how links come close to each other, and to the floor.
    """
    smoother, problem = charged
    k = len(postures)
    a, b = np.triu_indices(k, 1)
    found = np.full((k, k), np.inf)
    np.fill_diagonal(found, 0.0)
    share = np.array(_BETWEEN)[:, None, None]
    for i in {0, len(stations) // 2, len(stations) - 1}:
        base = np.tile(stations.base[i], (len(a), 1))
        ends = [np.column_stack([base, postures[of]]) for of in (a, b)]
        free = problem.edges_free(ends[0], ends[1])
        between = (1.0 - share) * ends[0][free] + share * ends[1][free]
        clearance = smoother.clearance(between.reshape(-1, between.shape[-1]))[0].reshape(len(share), -1)
        price = room.charge(clearance).mean(axis=0)
        found[a[free], b[free]] = found[b[free], a[free]] = np.minimum(found[a[free], b[free]], price)
    return found


def _step_costs(
    stations: Stations,
    i: int,
    offsets: Float[Array, " offset"],
    arm: _ArmSteps,
    rate: Float[Array, "station offset posture"],
    smoother: Smoother,
) -> Float[Array, "offset posture offset posture"]:
    """Return what steps to station i cost, between all offsets and postures."""
    before, here = stations.base[i - 1], stations.base[i]
    aside = [offsets * stations.aside[j] for j in (i - 1, i)]
    left = [np.array([-np.sin(of[2]), np.cos(of[2])]) for of in (before, here)]
    there = here[:2] + aside[1][:, None] * left[1]
    metres = np.linalg.norm(there - (before[:2] + aside[0][:, None] * left[0])[:, None], axis=2)
    turn = abs(float(here[2] - before[2]))
    speed = 0.5 * (stations.speed[i - 1] + stations.speed[i])
    seconds = np.maximum(metres / max(speed, _STAND), turn / (smoother.speed * smoother.base.omega_max))
    seconds = np.maximum(seconds[:, None, :, None], arm.seconds[None, :, None, :])
    metres = metres[:, None, :, None]
    length = np.sqrt(metres**2 + turn**2 + (arm.length**2)[None, :, None, :])
    length = length + np.maximum(metres, _STAND) * arm.crowded[None, :, None, :]
    return length + 0.5 * seconds * (rate[i - 1][:, :, None, None] + rate[i][None, None])


def nearest(postures: Float[Array, "posture arm"], arm: Float[Array, " arm"]) -> int:
    """Return which posture an arm is in."""
    return int(np.argmin(np.abs(postures - arm).max(axis=1)))
