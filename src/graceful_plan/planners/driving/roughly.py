"""Impact of bases as searches and descents ask for it: thousands of times, and not to the last percent."""

from __future__ import annotations

from dataclasses import replace

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.coast.thinned import thinned
from graceful_plan.costs.models.mixture.mixture import Footprint
from graceful_plan.costs.objective import SceneObjective


def roughly(cost: ImpactCost) -> ImpactCost:
    """Return a cost that is close and takes a tenth of the time for a base that fails; else the same."""
    model = cost.interaction
    if not isinstance(model, Footprint):
        return cost
    return replace(cost, model=replace(model, base=thinned(model.base)))


def rough_objective(objective: SceneObjective) -> SceneObjective:
    """Return an objective with such a cost; the same if it has another, or knows no base."""
    impact = objective.objective.impact
    if objective.scene.base is None or not isinstance(impact, ImpactCost) or (rough := roughly(impact)) is impact:
        return objective
    return SceneObjective(replace(objective.objective, impact=rough), objective.scene, objective.paces)
