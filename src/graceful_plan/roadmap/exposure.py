"""What edges cost before anybody says how bad an impact is: motion, and exposure by component and by who may be hit.

The exposure of an edge is the integral of P along it. Its impact under given severities is the sum of exposure times
severity, so that other severities and other weights need no more than a product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graceful_plan.array_types import Float, Int
from graceful_plan.costs.cost import StateBatch, checked_state
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import EdgeSamples, Objective
from graceful_plan.exceptions import SettingError
from graceful_plan.scene import Scene

Array = np.ndarray

EXPOSURE_STEP = 0.1
"""Largest joint-space distance between samples of the exposure along an edge [rad]."""
_NOTHING = 1e-9
"""Probability below which nothing is stored."""


@dataclass(frozen=True, eq=False)
class EdgePrices:
    """Motion cost and exposure of edges.

    | field    | meaning                                                     | unit | shape |
    |----------|-------------------------------------------------------------|------|-------|
    | motion   | V of each edge                                              | rad  | edge  |
    | edge     | edge of each stored exposure, ascending                     |      | entry |
    | column   | its pair of component and hazard, see `Exposure.columns`    |      | entry |
    | exposure | its value, above 0                                          | rad  | entry |
    """

    motion: Float[Array, " edge"]
    edge: Int[Array, " entry"]
    column: Int[Array, " entry"]
    exposure: Float[Array, " entry"]

    @classmethod
    def of(cls, motion: Float[Array, " edge"], exposure: Float[Array, "edge column"]) -> EdgePrices:
        """Keep what is not zero."""
        edge, column = np.nonzero(exposure)
        return cls(motion, edge.astype(np.int32), column.astype(np.int32), exposure[edge, column])

    def impact(self, severity: Float[Array, " column"]) -> Float[Array, " edge"]:
        """S of each edge under these severities."""
        return np.bincount(self.edge, self.exposure * severity[self.column], len(self.motion))

    def joined(self, other: EdgePrices) -> EdgePrices:
        """Return the prices of these edges and, after them, of others."""
        return EdgePrices(
            np.concatenate([self.motion, other.motion]),
            np.concatenate([self.edge, other.edge + np.int32(len(self.motion))]),
            np.concatenate([self.column, other.column]),
            np.concatenate([self.exposure, other.exposure]),
        )


class Exposure:
    """Prices edges of a scene.

    Args:
        objective: Motion and impact; its weight does not matter.
        scene: The scene, with what is carried attached; its severities do not matter.
        step: Largest joint-space distance between samples [rad].

    Raises:
        SettingError: If the exposure is counted in waypoints, of which edges have none.
    """

    def __init__(self, objective: Objective, scene: Scene, step: float = EXPOSURE_STEP) -> None:
        if objective.exposure == "waypoints":
            raise SettingError("exposure", objective.exposure, "'length' or 'time' for a roadmap")
        self.objective, self.scene, self.step = objective, scene, step
        self.by_hazard = type(objective.impact) is ImpactCost  # a subclass may compute otherwise
        self.columns: tuple[tuple[str, str], ...] = (("", ""),)
        if self.by_hazard:
            counted = [name for name in scene.components if name in objective.impact.components]  # pyright: ignore[reportAttributeAccessIssue]
            self.columns = tuple((name, hazard) for name in counted for hazard in scene.hazards)

    def severity(self, scene: Scene) -> Float[Array, " column"]:
        """Severities of a scene by column; 1 if the impact is not one of severities."""
        impact = self.objective.impact
        if not (self.by_hazard and isinstance(impact, ImpactCost)):
            return np.ones(1)
        return impact.hazard_severity(scene)[self._rows(scene)].ravel()

    def price(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> EdgePrices:
        """Motion cost and exposure of straight edges, travelled from `q0` to `q1`."""
        if len(q0) == 0:
            return EdgePrices.of(np.zeros(0), np.zeros((0, len(self.columns))))
        samples = EdgeSamples(q0, q1, self.scene.limits.velocity, self.objective.paces, self.step)
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        motion = samples.integral(checked_state(self.objective.motion, batch), samples.length)
        measure = samples.length if self.objective.exposure == "length" else samples.duration
        P = self._density(batch)
        P[P < _NOTHING] = 0.0
        return EdgePrices.of(motion, np.add.reduceat(P * samples.weights(measure)[:, None], samples.first))

    def _density(self, batch: StateBatch) -> Float[Array, "n column"]:
        impact = self.objective.impact
        if not (self.by_hazard and isinstance(impact, ImpactCost)):
            return checked_state(impact, batch)[:, None]
        return impact.probability(batch)[:, self._rows(self.scene)].reshape(len(batch), len(self.columns))

    def _rows(self, scene: Scene) -> list[int]:
        counted = {component for component, _ in self.columns}
        return [row for row, name in enumerate(scene.components) if name in counted]
