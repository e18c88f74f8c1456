"""Costs of edges in a scene: motion cost, and exposure by component of the robot and by entity that may be hit."""

from __future__ import annotations

from itertools import product

import numpy as np

from graceful_plan.array_types import Array, Float
from graceful_plan.core.kernels import COST_STEP
from graceful_plan.costs.cost import StateBatch, checked_state
from graceful_plan.costs.edge_samples import EdgeSamples
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.objective import AT_LIMITS, Objective, search_paces
from graceful_plan.exceptions import SettingError
from graceful_plan.planners.roadmaps.edge_prices import EdgeCosts
from graceful_plan.result import CostBreakdown
from graceful_plan.scene.scene import Scene

EXPOSURE_STEP = 0.1
"""Largest joint-space distance between samples of the exposure along an edge [rad]."""
_NOTHING = 1e-9
"""Probabilities below this are stored as 0."""


class Exposure:
    """Evaluates costs of edges in a scene.

    Args:
        objective: Objective with motion cost and impact; its weight is not used.
        scene: The scene, with the carried object attached; its severities are not used.
        step: Largest joint-space distance between samples [rad].
        paces: Speeds of alternating samples, as fractions of the speed at which one joint of the edge is at its
            velocity limit. The default is from real motions: paths selected at the limits cost 22 % more once they
            are timed, the mean of ten bundled tasks.

    Raises:
        SettingError: If the exposure is by waypoints, which edges do not have.
    """

    def __init__(
        self,
        objective: Objective,
        scene: Scene,
        step: float = EXPOSURE_STEP,
        paces: tuple[float, float] = search_paces(),
    ) -> None:
        if objective.exposure == "waypoints":
            raise SettingError("exposure", objective.exposure, "'length' or 'time' for a roadmap")
        self.objective, self.scene, self.step, self.paces = objective, scene, step, paces
        impact = objective.impact
        self.by_entity = isinstance(impact, ImpactCost)
        self.entities: tuple[str, ...] = ()
        self.columns: tuple[tuple[str, str], ...] = (("", ""),)
        if isinstance(impact, ImpactCost):
            self.entities = impact.harmed_entities(scene)
            counted = [name for name in scene.components if name in impact.components]
            self.columns = tuple((name, entity) for name in counted for entity in self.entities)

    def severity(self, scene: Scene) -> Float[Array, " column"]:
        """Return the severity of each column in a scene, 0 if it has none; 1 for an impact without severities."""
        impact = self.objective.impact
        if not (self.by_entity and isinstance(impact, ImpactCost)):
            return np.ones(1)
        pairs = product(scene.components, impact.harmed_entities(scene))
        known = dict(zip(pairs, impact.severity_table(scene).flat, strict=True))
        return np.array([known.get(column, 0.0) for column in self.columns], dtype=np.float64)

    def reported(self) -> Exposure:
        """Return a copy with the samples and paces of reported costs, which are those of `evaluate`."""
        return Exposure(self.objective, self.scene, COST_STEP, AT_LIMITS)

    def price(self, q0: Float[Array, "n nq"], q1: Float[Array, "n nq"]) -> EdgeCosts:
        """Return motion cost and exposure of straight edges, travelled from `q0` to `q1`."""
        if len(q0) == 0:
            return EdgeCosts.of(np.zeros(0), np.zeros((0, len(self.columns))))
        samples = EdgeSamples(q0, q1, self.scene.limits.velocity, self.paces, self.step)
        batch = StateBatch(self.scene, samples.q, samples.direction, samples.speed)
        motion = samples.integral(checked_state(self.objective.motion, batch), samples.length)
        measure = samples.length if self.objective.exposure == "length" else samples.duration
        P = self._density(batch)
        P[P < _NOTHING] = 0.0
        return EdgeCosts.of(motion, np.add.reduceat(P * samples.weights(measure)[:, None], samples.first))

    def breakdown(self, prices: EdgeCosts, severity: Float[Array, " column"], w: float) -> CostBreakdown:
        """Return the total cost of edges, with the impact by entity and component."""
        parts = np.bincount(prices.column, prices.exposure, len(severity)) * severity
        motion, impact = float(prices.motion.sum()), float(parts.sum())
        if not self.by_entity:
            return CostBreakdown(motion=motion, impact=impact, w=w)
        components, by_entity = dict.fromkeys(self.scene.components, 0.0), dict.fromkeys(self.entities, 0.0)
        for (component, entity), part in zip(self.columns, parts.tolist(), strict=True):
            components[component] += part
            by_entity[entity] += part
        return CostBreakdown(
            motion=motion, impact=impact, w=w, impact_by_entity=by_entity, impact_by_component=components
        )

    def _density(self, batch: StateBatch) -> Float[Array, "n column"]:
        impact = self.objective.impact
        if not (self.by_entity and isinstance(impact, ImpactCost)):
            return checked_state(impact, batch)[:, None]
        counted = {component for component, _ in self.columns}
        rows = [row for row, name in enumerate(self.scene.components) if name in counted]
        return impact.probability(batch)[:, rows].reshape(len(batch), len(self.columns))
