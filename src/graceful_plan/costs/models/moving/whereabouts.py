"""Where somebody may be who is expected somewhere: a few places of equal weight, and which of them are not free.

Whoever is off the prediction by so much at the release is still off by it, grown in proportion, while the object falls:
so each place is followed on its own. And nobody is where robot or object are: they would have been touched before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Bool, Float, Int
from graceful_plan.costs.cost import StateBatch
from graceful_plan.costs.models.moving.outlines import outlines, outside
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray

PLACES = 24
"""Places that stand for a normal distribution, unless fewer do; an even number, and no multiple of `_STRIDE`."""
_SHARP = 0.01
"""Standard deviations below this need no more than one place [m]."""
_AT_ONCE = 200_000
"""Pairs times spheres that are looked at at once, to bound memory."""
_GOLDEN, _STRIDE = np.pi * (3.0 - np.sqrt(5.0)), 7


def check_places(places: int) -> None:
    """Raise SettingError if so many places cannot stand for a normal distribution."""
    if not (isinstance(places, int) and 4 <= places <= PLACES and places % 2 == 0 and places % _STRIDE):
        raise SettingError("places", places, f"an even number from 4 to {PLACES}, and no multiple of {_STRIDE}")


def normal_places(count: int = PLACES) -> Float[Array, "place 2"]:
    """Return places of equal weight for a normal distribution with standard deviation 1, that within them included.

    Seeds of a sunflower and their mirror images, brought to this variance; neighbours in the list are far apart.
    """
    k = np.arange(count // 2)
    radius, angle = np.sqrt(-2.0 * np.log(1.0 - (k + 0.5) / len(k))), k * _GOLDEN
    half = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    half = half @ np.linalg.inv(np.linalg.cholesky(half.T @ half / len(k))).T * np.sqrt(1.0 - cell_of(count) ** 2)
    return np.concatenate([half, -half])[_STRIDE * np.arange(count) % count]


def cell_of(count: int) -> float:
    """Return the standard deviation within what one of so many places stands for, over that of all."""
    return float(np.sqrt(2.0 * np.pi / 12.0 / count))


@final
@dataclass(frozen=True, eq=False)
class OffPrediction:
    """Somebody who keeps off the prediction by so many standard deviations, at each pair of a state and a time.

    Args:
        entity: Who is expected where.
        off: By how many.
        cell: Standard deviation of what is not known beyond that, over that of the prediction.
    """

    entity: MovingEntity
    off: Float[Array, "pair 2"]
    cell: float

    def at(self, time: Float[Array, " pair"]) -> Float[Array, "pair 2"]:
        """Return where the entity is, seen from above [m]."""
        there = self.entity.at(time)
        return there.position[:, :2] + self.off * there.spread[:, None]

    def spread(self, time: Float[Array, " pair"]) -> Float[Array, " pair"]:
        """Return the standard deviation of that [m]."""
        return self.cell * self.entity.at(time).spread

    def only(self, rows: Int[Array, " m"]) -> OffPrediction:
        """Return some of the pairs."""
        return OffPrediction(self.entity, self.off[rows], self.cell)


def off_predictions(
    entity: MovingEntity, times: Float[Array, "n k"], each: bool, places: int = PLACES
) -> tuple[OffPrediction, Float[Array, "n place"]]:
    """Return where somebody may be at times of states, and the time of each of these places [s].

    Args:
        entity: Who.
        times: Times of each state [s].
        each: Whether each time has all places; else they take turns over a state's times, as often as need be.
        places: How many there are.
    """
    if entity.at(times.max(initial=entity.t[0])).spread < _SHARP:
        return OffPrediction(entity, np.zeros((times.size, 2)), 1.0), times
    count = places if each else -(-places // times.shape[1])
    whole = np.repeat(times, count, axis=1)
    z = normal_places(places)[np.arange(whole.shape[1]) % places]
    return OffPrediction(entity, np.tile(z, (len(times), 1)), cell_of(places)), whole


def touched(
    batch: StateBatch, who: OffPrediction, state: Int[Array, " pair"], time: Float[Array, " pair"]
) -> Bool[Array, " pair"]:
    """Tell for which pairs the entity would be touched by moving links or what they carry before anything fails."""
    robot, half = batch.compiled.robot, who.entity.half_size
    here, there = who.at(time), who.entity.at(time)
    shape, height = outlines(who.entity, here, there.yaw), there.position[:, 2]
    reach = float(half[0]) if who.entity.is_round else float(np.hypot(half[0], half[1]))
    found = np.zeros(len(state), dtype=bool)
    for link in np.unique(robot.sphere_link[robot.sphere_link > 0]):
        poses, (*middle, bound) = batch.link_poses[:, link], robot.bound[link]
        centre = (poses[:, :2, :3] @ np.array(middle) + poses[:, :2, 3])[state]
        near = np.flatnonzero(~found & (np.linalg.norm(centre - here, axis=1) < bound + reach))
        spheres = robot.sphere[robot.sphere_link == link] - [0.0, 0.0, 0.0, robot.protrusion]
        for rows in np.array_split(near, -(-len(near) * len(spheres) // _AT_ONCE) or 1):
            found[rows] = outside(poses[state[rows]], spheres, shape[rows], height[rows], float(half[2])) < 0.0
    return found
