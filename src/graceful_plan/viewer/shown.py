"""Display data of a motion over time: poses of all parts, and the impact of a failure by entity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.costs.cost_samples import trajectory_batch
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.scene import Scene
from graceful_plan.timing.trajectory import Trajectory
from graceful_plan.viewer.poses import Poses, poses_along
from graceful_plan.viewer.shapes import parts

_STEP = 1.0 / 60.0
_MOST_FRAMES = 1800
"""Time between frames [s], and their maximum number (half a minute); longer motions have longer steps."""
_RISKS = 160
"""Number of moments with a computed impact."""


@final
@dataclass(frozen=True, kw_only=True, eq=False)
class ShownMotion:
    """A motion sampled for display.

    | field      | meaning                                                             | unit | shape          |
    |------------|---------------------------------------------------------------------|------|----------------|
    | label      | label of the motion                                                 |      |                |
    | scene      | scene of the motion                                                 |      |                |
    | trajectory | the motion                                                          |      |                |
    | cost       | cost of the motion                                                  |      |                |
    | t          | time of each frame, from 0 on                                       | s    | frame          |
    | poses      | poses of each drawn part                                            |      |                |
    | tool       | positions of the tool                                               | m    | frame 3        |
    | risk_t     | times with a computed impact                                        | s    | moment         |
    | entities   | names of all entities, the carried object last                      |      | entity         |
    | by_entity  | P S of each of them, given a failure then                           |      | moment entity  |
    """

    label: str
    scene: Scene
    trajectory: Trajectory
    cost: CostBreakdown
    t: Float[Array, " frame"]
    poses: Poses
    tool: Float[Array, "frame 3"]
    risk_t: Float[Array, " moment"]
    entities: tuple[str, ...]
    by_entity: Float[Array, "moment entity"]

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return float(self.t[-1])

    @property
    def risk(self) -> Float[Array, " moment"]:
        """Impact of a failure at each of `risk_t`."""
        return self.by_entity.sum(axis=1)

    def frame(self, t: float) -> int:
        """Return the frame nearest to a time [s]; the first one before the start, the last one after the end."""
        return int(np.argmin(np.abs(self.t - t)))

    def impact_at(self, t: float) -> Mapping[str, float]:
        """Return the impact of a failure at a time [s] by entity, the worst first, without safe entities."""
        values = [float(np.interp(t, self.risk_t, column)) for column in self.by_entity.T]
        found = sorted(zip(self.entities, values, strict=True), key=lambda pair: -pair[1])
        return {name: value for name, value in found if value > 0.0}

    def risk_at(self, t: Float[Array, " n"]) -> Float[Array, " n"]:
        """Return the impact of a failure at some times [s]."""
        return np.interp(t, self.risk_t, self.risk)

    def worst(self, count: int) -> tuple[str, ...]:
        """Return at most `count` entities with the highest impact at some moment, without safe entities."""
        peak = self.by_entity.max(axis=0, initial=0.0)
        order = np.argsort(-peak, kind="stable")[:count]
        return tuple(self.entities[k] for k in order if peak[k] > 0.0)


def shown_motion(
    label: str, trajectory: Trajectory, scene: Scene, impact: ImpactCost, cost: CostBreakdown
) -> ShownMotion:
    """Sample a motion.

    Args:
        label: Label of the motion.
        trajectory: The motion.
        scene: Scene of the motion.
        impact: Impact cost.
        cost: Cost of the motion.
    """
    frames = min(max(2, int(np.ceil(trajectory.duration / _STEP)) + 1), _MOST_FRAMES)
    t = np.linspace(0.0, trajectory.duration, frames)
    poses, X_WT = poses_along(scene, parts(scene), trajectory.positions(trajectory.t[0] + t), t)
    risk_t = np.linspace(0.0, trajectory.duration, min(_RISKS, frames))
    return ShownMotion(
        label=label,
        scene=scene,
        trajectory=trajectory,
        cost=cost,
        t=t,
        poses=poses,
        tool=X_WT[:, :3, 3].copy(),
        risk_t=risk_t,
        entities=impact.harmed_entities(scene),
        by_entity=impact_by_entity(trajectory, scene, risk_t, impact),
    )


def impact_by_entity(
    trajectory: Trajectory, scene: Scene, t: Float[Array, " n"], impact: ImpactCost
) -> Float[Array, "n entity"]:
    """Return P S of each of `impact.harmed_entities(scene)`, given a failure at some times after the start [s]."""
    batch = trajectory_batch(scene, trajectory, trajectory.t[0] + t, t)
    return np.einsum("nce,ce->ne", impact.probability(batch), impact.severity_table(scene))
