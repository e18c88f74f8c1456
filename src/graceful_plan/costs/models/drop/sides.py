"""The side that blocks a flying object before it lands: step 0 of the drop model, in NumPy.

Symbols are those of the specification in the docstring of the package. The constants were chosen on the drops beside
walls of the first seed of `benchmarks/walled.py` at commit cbf77b38, with some of the other scenes' drops in view; that
benchmark measures other walls.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float, Int
from graceful_plan.costs.models.drop.constants import DropConstants
from graceful_plan.costs.models.drop.functions import GRAVITY, fall_time, smooth_step
from graceful_plan.costs.models.drop.outlines import Shape, Targets
from graceful_plan.costs.models.drop.release import Release

_TOUCH = 0.006  # smoothing width of the gap to a side, which excludes objects above its target [m]
_TOP = 0.067  # smoothing width of the heights of a side's upper and lower edge [m]
_LATE = 0.067  # smoothing width of the time by which the object reaches the side before it lands [s]
_AFTER = 0.15  # time after landing for which a side may still block the object [s]
_SLOW = 1e-3  # least speed in the time to reach a side [m/s]
_MOVES = 0.1  # speed from which the object counts fully as flying towards a side [m/s]


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class SideStop:
    """Effect of the first blocking side on the flight; W frame.

    | field  | meaning                                                             | unit | shape |
    |--------|---------------------------------------------------------------------|------|-------|
    | time   | ts: time at which the object reaches the side                       | s    | n     |
    | push   | p: change of its velocity there, times the probability of a contact | m/s  | n 2   |
    | target | target of the side                                                  |      | n     |
    | chance | E: probability of a contact, unless it lands before                 |      | n     |
    """

    time: Float[Array, " n"]
    push: Float[Array, "n 2"]
    target: Int[Array, " n"]
    chance: Float[Array, " n"]

    def pushed(self, time: Float[Array, " n *target"]) -> Float[Array, "n *target 2"]:
        """Compute the displacement by the side at a time after the release [s]."""
        many = time.ndim > 1
        start, push = (self.time[:, None], self.push[:, None]) if many else (self.time, self.push)
        return push * np.maximum(time - start, 0.0)[..., None]

    def met(self, time: Float[Array, " n"], landed: Float[Array, " n"]) -> Float[Array, " n"]:
        """Compute P that the object hits the side, given the probability and the time of landing."""
        return self.chance * (1.0 - landed * (1.0 - smooth_step((time - self.time) / _LATE)))


def find_stop(targets: Targets, constants: DropConstants, state: Release, shape: Shape) -> SideStop:
    """Find the blocking side of each flight; requires at least one target."""
    end = fall_time(state.v[:, 2:], shape.low - targets.top.min()) + constants.delay + _AFTER
    sides = [_meeting(targets, constants, state, shape, axis, end) for axis in (0, 1)]
    effect, time, chance, push = (np.stack(x, axis=2) for x in zip(*sides, strict=True))
    n, count = len(end), 2 * len(targets.top)
    first = effect.reshape(n, count).argmax(axis=1)
    row = np.arange(n)
    chosen = effect.reshape(n, count)[row, first] > 0.0
    return SideStop(
        time=np.where(chosen, time.reshape(n, count)[row, first], 0.0),
        push=np.where(chosen[:, None], push.reshape(n, -1, 2)[row, first], 0.0),
        target=first // 2,
        chance=np.where(chosen, chance.reshape(n, count)[row, first], 0.0),
    )


def _meeting(
    targets: Targets, constants: DropConstants, state: Release, shape: Shape, axis: int, end: Float[Array, "n 1"]
) -> tuple[Array, Array, Array, Array]:
    """Evaluate the sides across one axis of each target: effect, time and P [n target], push [n target 2]."""
    k, tables, other = constants, targets.tables, 1 - axis
    bottom, top = tables.target_height.T
    at, v = targets.place(state.c), targets.turn(state.v)
    lower, upper = _extents(targets, state, shape)
    back = v[axis] < 0.0
    gap = np.where(back, at[axis] + lower[axis], -at[axis] - upper[axis]) - tables.target_half[:, axis]
    time = np.maximum(gap, 0.0) / np.maximum(np.abs(v[axis]), _SLOW)
    across = at[other] + v[other] * time + 0.5 * (lower[other] + upper[other])
    s = np.sqrt(k.position_spread**2 + (k.velocity_spread * time) ** 2)
    falls = np.maximum(time - k.delay, 0.0)
    height = shape.low + state.v[:, 2:] * falls - 0.5 * GRAVITY * falls**2
    chance = smooth_step(gap / _TOUCH + 1.0)
    half = tables.target_half[:, other] + 0.5 * (upper[other] - lower[other])
    chance = chance * smooth_step((half - np.abs(across)) / (np.sqrt(5.0) * s))
    chance = chance * smooth_step((top - height) / _TOP)
    chance = chance * smooth_step((height + shape.high - shape.low - bottom) / _TOP - 1.0) * tables.target_fixed
    chance = chance * smooth_step(2.0 * np.abs(v[axis]) / _MOVES - 1.0)
    normal = (targets.x, targets.y)[axis][:, :2]
    push = -(chance * v[axis])[..., None] * normal
    return chance * np.abs(v[axis]) * np.maximum(end - time, 0.0), time, chance, push


def _extents(targets: Targets, state: Release, shape: Shape) -> tuple[list[Array], list[Array]]:
    """Compute the extent of the object from c along the targets' axes, lower and upper: per axis [n target]."""
    offsets = [targets.turn(state.offset[:, p]) for p in range(state.offset.shape[1])]
    reaches = (shape.x, shape.y)
    lower = [np.min([o[i] - r[:, p] for p, o in enumerate(offsets)], axis=0) for i, r in enumerate(reaches)]
    upper = [np.max([o[i] + r[:, p] for p, o in enumerate(offsets)], axis=0) for i, r in enumerate(reaches)]
    return lower, upper
