"""What an object sweeps past while somebody moves: shapes seen from above, and how likely they meet."""

from __future__ import annotations

from typing import final

import numpy as np

from graceful_plan.array_types import Float
from graceful_plan.costs.models.drop.functions import box
from graceful_plan.scene.moving import MovingEntity

Array = np.ndarray

_FOUR = np.pi * np.array([0.0, 0.5, 0.25, 0.75])
_LEAST_MOVE = 1e-9  # [m]; who moves less has no direction


@final
class Outline:
    """How far a moving entity reaches, seen from above, for pairs of a state and a time.

    Args:
        entity: Who.
        yaw: How far turned at each pair [rad].
    """

    def __init__(self, entity: MovingEntity, yaw: Float[Array, " pair"]) -> None:
        self.is_round, (self.a, self.b) = entity.is_round, entity.half_size[:2]
        self.yaw = np.zeros_like(yaw) if entity.is_round else yaw
        self.x = np.stack([np.cos(self.yaw), np.sin(self.yaw)], axis=-1)[:, None]
        self.y = np.stack([-np.sin(self.yaw), np.cos(self.yaw)], axis=-1)[:, None]

    def directions(self, move: Float[Array, "pair 2"]) -> Float[Array, "pair direction 2"]:
        """Return unit vectors across which things pass each other that move so, one relative to the other [m].

        A disc has those along and across the move and halfway between; a box has those of its own axes, and the one
        across the move, without which what passes it in a slant would be taken to meet it.
        """
        along = np.where(np.linalg.norm(move, axis=1) > _LEAST_MOVE, np.arctan2(move[:, 1], move[:, 0]), self.yaw)
        angle = (along if self.is_round else self.yaw)[:, None] + _FOUR
        if not self.is_round:
            angle = np.concatenate([angle, along[:, None] + 0.5 * np.pi], axis=1)
        return np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def reach(self, u: Float[Array, "pair direction 2"], margin: Array | float = 0.0) -> Float[Array, "pair direction"]:
        """Return how far the entity with a margin around it reaches in directions [m], at least a little."""
        margin = np.asarray(margin)[..., None]
        if self.is_round:
            return np.maximum(self.a + margin, 1e-4) + 0.0 * u[..., 0]
        across = np.abs((u * self.x).sum(axis=-1)), np.abs((u * self.y).sum(axis=-1))
        return np.maximum((self.a + margin) * across[0] + (self.b + margin) * across[1], 1e-4)


def sweep(
    u: Float[Array, "pair direction 2"],
    ends: tuple[Float[Array, "pair 2"], Float[Array, "pair 2"]],
    reach: Float[Array, "pair direction"],
    spread: Float[Array, " pair"],
) -> Float[Array, " pair"]:
    """P that something is within reach at some time while its place relative to the entity goes from end to end."""
    x0, x1 = ((u * end[:, None]).sum(axis=-1) for end in ends)
    each = box(0.5 * (x0 + x1), reach + 0.5 * np.abs(x1 - x0), spread[:, None])
    # A fifth direction is not as independent of the others as they are of each other, but no less a bound.
    return np.minimum(each[:, :4].prod(axis=1), each[:, 4:].min(axis=1, initial=1.0))
