"""The cost of a motion with its impact by entity and component."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from graceful_plan.costs.cost import Cost, checked_state, terms_of
from graceful_plan.costs.cost_samples import CostSamples
from graceful_plan.costs.impact import ImpactCost
from graceful_plan.result import CostBreakdown

_AT_A_TIME = 20_000
"""Number of states whose probabilities are in memory at a time."""


def impact_breakdown(impact: Cost, samples: CostSamples, *, motion: float, w: float, exposure: str) -> CostBreakdown:
    """Return the cost of a motion from the states at which it is evaluated.

    Args:
        impact: The impact. Of a sum, the terms that do not know entities are listed by class name.
        samples: The states, with integration weights.
        motion: The motion cost V.
        w: Safety weight.
        exposure: Integration variable of the weights.
    """
    batch, weight = samples.batch, samples.weight
    total, by_entity, by_component = 0.0, defaultdict[str, float](float), defaultdict[str, float](float)
    for factor, cost in terms_of(impact):
        if not isinstance(cost, ImpactCost):
            part = factor * float(weight @ checked_state(cost, batch))
            total += part
            by_entity[type(cost).__name__] += part
            continue
        expected = sum(
            np.tensordot(weight[k : k + _AT_A_TIME], cost.probability(batch[k : k + _AT_A_TIME]), axes=1)
            for k in range(0, len(batch), _AT_A_TIME)
        )
        parts = factor * expected * cost.severity_table(batch.scene)
        total += float(parts.sum())
        for entity, part in zip(cost.harmed_entities(batch.scene), parts.sum(axis=0).tolist(), strict=True):
            by_entity[entity] += part
        for component, part in zip(batch.scene.components, parts.sum(axis=1).tolist(), strict=True):
            by_component[component] += part
    return CostBreakdown(
        motion=motion,
        impact=total,
        w=w,
        exposure=exposure,
        impact_by_entity=dict(by_entity),
        impact_by_component=dict(by_component),
    )
