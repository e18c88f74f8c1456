"""Impact on those who move as searches ask for it: thousands of times, and not to the last percent."""

from __future__ import annotations

from dataclasses import replace

from graceful_plan.costs.impact import ImpactCost
from graceful_plan.costs.models.coast.thinned import thinned
from graceful_plan.costs.models.mixture.mixture import Footprint


def roughly(cost: ImpactCost) -> ImpactCost:
    """Return a cost that is close and takes a tenth of the time for a base that fails; else the same."""
    model = cost.interaction
    if not isinstance(model, Footprint):
        return cost
    return replace(cost, model=replace(model, base=thinned(model.base)))
