"""States at which the cost of a motion is evaluated, with integration weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import COST_STEP
from graceful_plan.costs.cost import AHEAD, StateBatch, moving_batch
from graceful_plan.exceptions import SettingError
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory

FARTHEST = 1000.0
"""Largest position and velocity of a joint that the core accepts. Cubics between inconsistent samples may exceed it."""


@final
@dataclass(frozen=True, eq=False)
class CostSamples:
    """States at which a motion is evaluated; the integral of the impact is the sum of weight times density."""

    batch: StateBatch
    weight: Float[Array, " n"]
    """Integration weight of each state: [rad], [s], or 1 if the exposure is waypoints."""
    place: Float[Array, " n"]
    """Position of each state as an index of vertices or samples of the motion; fractional in between."""


def trajectory_batch(
    scene: Scene, trajectory: Trajectory, t: Float[Array, " n"], times: Float[Array, " n"] | None = None
) -> StateBatch:
    """Return the states of a trajectory at some of its times [s], with the motion ahead.

    Args:
        scene: The scene.
        trajectory: The trajectory.
        t: Times on the clock of the trajectory.
        times: The same times on the clock of the scene's predictions, if known.

    Raises:
        SettingError: If the trajectory has the joints of the scene in another order.
    """
    _check_order(trajectory.joints, scene.joints)
    state = trajectory.at(t)
    found = moving_batch(scene, state.q, state.qd, times)

    def ahead() -> Float[Array, "n step nq"]:
        later = trajectory.positions((t[:, None] + AHEAD).ravel()).reshape(len(t), len(AHEAD), -1)
        _check_size(later)
        return later

    return StateBatch(scene, found.q, found.direction, found.speed, times, ahead)


def _check_order(joints: tuple[str, ...], expected: tuple[str, ...]) -> None:
    """Refuse columns of the scene's joints in another order; names of other programs are accepted."""
    if joints != expected and sorted(joints) == sorted(expected):
        valid = (
            f"the order of the scene: {', '.join(expected)}; Trajectory.from_ros(message, scene.joints) sorts columns"
        )
        raise SettingError("joints of the trajectory", joints, valid)


def _check_size(*parts: Float[Array, "..."]) -> None:
    farthest = max(float(np.abs(part).max()) for part in parts)
    if farthest > FARTHEST:
        expected = f"positions and velocities of at most {FARTHEST:g}, between samples too"
        raise SettingError("trajectory", farthest, expected)


def timed_samples(scene: Scene, trajectory: Trajectory, start_time: float, *, by_length: bool) -> CostSamples:
    """Return states at most `COST_STEP` apart at their own velocities, with trapezoid weights [s, or rad]."""
    pieces = np.maximum(1, np.ceil(trajectory.path.segment_lengths / COST_STEP)).astype(int)
    piece = np.repeat(np.arange(len(pieces)), pieces)
    first = np.cumsum(pieces) - pieces
    place = np.append(piece + (np.arange(len(piece)) - first[piece]) / pieces[piece], len(pieces))
    t = np.interp(place, np.arange(len(trajectory)), trajectory.t)
    done = np.append(0.0, np.cumsum(trajectory.path.segment_lengths))
    gaps = np.diff(np.interp(place, np.arange(len(trajectory)), done) if by_length else t)
    weight = np.zeros(len(t))
    weight[:-1] += 0.5 * gaps
    weight[1:] += 0.5 * gaps
    batch = trajectory_batch(scene, trajectory, t, start_time + t)
    _check_size(batch.q, batch.qd)
    return CostSamples(batch, weight, place)
